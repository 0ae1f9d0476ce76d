use super::*;
use std::sync::atomic::AtomicU32;

const LONG: Duration = Duration::from_secs(20);

fn soon() -> Instant {
    Instant::now() + LONG
}

/// Runs `jobs` jobs of `bytes` each at once. Returns the most that ever ran together.
async fn most_at_once(pool: &Pool, jobs: usize, bytes: u64, hang_up: bool) -> u32 {
    let (now, most) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
    let mut tasks = tokio::task::JoinSet::new();
    for _ in 0..jobs {
        let (pool, now, most) = (pool.clone(), now.clone(), most.clone());
        tasks.spawn(async move {
            let slot = pool.admit(soon()).unwrap();
            let job = pool.run(&slot, Memory::Of(bytes), move |_| {
                let running = now.fetch_add(1, Ordering::SeqCst) + 1;
                most.fetch_max(running, Ordering::SeqCst);
                std::thread::sleep(Duration::from_millis(30));
                now.fetch_sub(1, Ordering::SeqCst);
            });
            if hang_up {
                let _ = tokio::time::timeout(Duration::from_millis(10), job).await;
            } else {
                job.await.unwrap();
            }
        });
    }
    while tasks.join_next().await.is_some() {}
    pool.drain(LONG).await;
    most.load(Ordering::SeqCst)
}

#[tokio::test(flavor = "multi_thread")]
async fn never_more_than_the_workers() {
    assert_eq!(most_at_once(&Pool::new(2, 20, 1 << 40), 12, 1, false).await, 2);
    assert!(most_at_once(&Pool::new(2, 20, 1 << 40), 12, 1, true).await <= 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn never_more_than_the_memory() {
    // Seven eighths of the budget are for first jobs.
    let budget = 115 << 20;
    assert_eq!(most_at_once(&Pool::new(8, 20, budget), 8, 50 << 20, false).await, 2);
    // A job that needs more than the whole budget runs alone, but it runs.
    assert_eq!(most_at_once(&Pool::new(8, 20, budget), 3, 1 << 50, false).await, 1);
}

#[tokio::test]
async fn a_full_queue_refuses_at_once() {
    let pool = Pool::new(1, 1, 1 << 30);
    let first = pool.admit(soon()).unwrap();
    let _second = pool.admit(soon()).unwrap();
    assert!(matches!(pool.admit(soon()), Err(JobError::Busy { .. })));
    assert!(matches!(pool.check(), Err(JobError::Busy { .. })));
    drop(first);
    pool.check().unwrap();
    pool.admit(soon()).unwrap();
}

#[tokio::test]
async fn a_panic_is_contained() {
    let pool = Pool::new(1, 0, 1 << 30);
    for _ in 0..3 {
        let slot = pool.admit(soon()).unwrap();
        let ended = pool.run(&slot, Memory::Of(1), |_| panic!("on purpose")).await;
        assert_eq!(ended, Err::<(), _>(JobError::Panicked));
    }
    assert_eq!(pool.run(&pool.admit(soon()).unwrap(), Memory::Of(1), |_| 7).await, Ok(7));
    assert_eq!(pool.running(), 0);
}

#[tokio::test]
async fn the_deadline_ends_waiting_and_tells_the_job() {
    let pool = Pool::new(1, 1, 1 << 30);
    let near = Instant::now() + Duration::from_millis(50);
    let [slow_slot, late_slot] = [(); 2].map(|()| pool.admit(near).unwrap());
    let slow = pool.run(&slow_slot, Memory::Of(1), |job| {
        while !job.stop().now() {
            std::thread::sleep(Duration::from_millis(5));
        }
        std::thread::sleep(Duration::from_millis(50));
        job.stop().now()
    });
    let late = pool.run(&late_slot, Memory::Of(1), |_| ());
    let (slow, late) = tokio::join!(slow, late);
    assert_eq!(slow, Ok(true));
    assert_eq!(late, Err(JobError::DeadlinePassed));
}

#[tokio::test(flavor = "multi_thread")]
async fn draining_waits_then_stops() {
    for (grace, ends) in [(LONG, true), (Duration::from_millis(20), false)] {
        let pool = Pool::new(1, 1, 1 << 30);
        let slot = pool.admit(soon()).unwrap();
        let running = tokio::spawn({
            let pool = pool.clone();
            async move {
                pool.run(&slot, Memory::Of(1), |job| {
                    let start = Instant::now();
                    while !job.stop().now() && start.elapsed() < Duration::from_millis(200) {
                        std::thread::sleep(Duration::from_millis(5));
                    }
                })
                .await
            }
        });
        while pool.running() == 0 {
            tokio::task::yield_now().await;
        }
        assert_eq!(pool.drain(grace).await, ends);
        assert!(matches!(pool.admit(soon()), Err(JobError::ShuttingDown)));
        running.await.unwrap().unwrap();
    }
}

/// A job that runs until it is told to stop. Returns whether that came soon enough.
fn until_stopped(job: &Allowance) -> bool {
    let start = Instant::now();
    while !job.stop().now() && start.elapsed() < LONG {
        std::thread::sleep(Duration::from_millis(1));
    }
    job.stop().now()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_keeps_its_place_between_its_jobs() {
    let pool = Pool::new(1, 0, 1 << 30);
    let slot = pool.admit(soon()).unwrap();
    assert_eq!(pool.run(&slot, Memory::Of(1), |_| 1).await, Ok(1));
    // No job runs now, and still nobody else is admitted.
    assert_eq!(pool.running(), 0);
    assert!(matches!(pool.admit(soon()), Err(JobError::Busy { .. })));
    assert_eq!(pool.run(&slot, Memory::Beyond(1), |_| 2).await, Ok(2));
    drop(slot);
    pool.admit(soon()).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn draining_waits_for_all_jobs_of_a_request() {
    let pool = Pool::new(1, 1, 1 << 30);
    let slot = pool.admit(soon()).unwrap();
    pool.run(&slot, Memory::Of(1), |_| ()).await.unwrap();
    let drained = tokio::spawn({
        let pool = pool.clone();
        async move { pool.drain(LONG).await }
    });
    while pool.check() != Err(JobError::ShuttingDown) {
        tokio::task::yield_now().await;
    }
    // The request was between its jobs when the service was told to shut down.
    assert_eq!(pool.run(&slot, Memory::Beyond(1), |_| 2).await, Ok(2));
    assert!(!drained.is_finished());
    drop(slot);
    assert!(drained.await.unwrap());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_hangs_up_ends_its_job_and_gives_its_place_back() {
    let pool = Pool::new(1, 0, 1 << 30);
    let (ended, hears) = tokio::sync::oneshot::channel();
    let slot = pool.admit(soon()).unwrap();
    let handler = tokio::spawn({
        let pool = pool.clone();
        async move {
            let job = move |job: &Allowance| ended.send((until_stopped(job), job.stop().reason()));
            let _ = pool.run(&slot, Memory::Of(1), job).await;
        }
    });
    while pool.running() == 0 {
        tokio::task::yield_now().await;
    }
    handler.abort();
    let ended = tokio::time::timeout(LONG, hears).await.unwrap().unwrap();
    assert_eq!(ended, (true, JobError::HungUp));
    while pool.free_slots() == 0 {
        tokio::task::yield_now().await;
    }
    assert_eq!(pool.running(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn memory_is_reserved_anew_once_the_need_is_known() {
    let pool = Pool::new(3, 3, 342 << 20);
    let [first, second] = [(); 2].map(|()| pool.admit(soon()).unwrap());
    let mebibytes = |n: u64| n << 20;
    // A job that needs more than all jobs may have is refused, not queued for ever.
    let refused = pool.run(&first, Memory::Of(1), move |job| job.need(mebibytes(301))).await;
    assert_eq!(refused, Ok(Err(JobError::TooMuchMemory { bytes: mebibytes(301) })));
    let grown = pool.run(&first, Memory::Of(1), move |job| job.need(mebibytes(200))).await;
    assert_eq!(grown, Ok(Ok(())));
    // A request keeps its reservation between its jobs.
    let job = move |job: &Allowance| (job.need(mebibytes(200)), job.need(mebibytes(100)));
    let again = Err(JobError::Again { bytes: mebibytes(200) });
    assert_eq!(pool.run(&second, Memory::Of(1), job).await, Ok((again, Ok(()))));
    // A surplus is released.
    let shrunk = pool.run(&first, Memory::Of(mebibytes(200)), move |job| job.need(1)).await;
    assert_eq!(shrunk, Ok(Ok(())));
    let grown = pool.run(&second, Memory::Of(1), move |job| job.need(mebibytes(299))).await;
    assert_eq!(grown, Ok(Ok(())));
}

/// Two jobs that both want more than is left beside the other: each releases its memory before it
/// waits.
#[tokio::test(flavor = "multi_thread")]
async fn two_that_want_more_do_not_wait_for_each_other() {
    let pool = Pool::new(2, 2, 342 << 20);
    let mut requests = tokio::task::JoinSet::new();
    for _ in 0..2 {
        let pool = pool.clone();
        requests.spawn(async move {
            let slot = pool.admit(soon()).unwrap();
            let mut memory = 100 << 20;
            loop {
                let job = |job: &Allowance| {
                    std::thread::sleep(Duration::from_millis(20));
                    job.need(250 << 20)
                };
                match pool.run(&slot, Memory::Of(memory), job).await.unwrap() {
                    Err(JobError::Again { bytes }) => memory = bytes,
                    ended => return ended,
                }
            }
        });
    }
    while let Some(ended) = requests.join_next().await {
        assert_eq!(ended.unwrap(), Ok(()));
    }
}

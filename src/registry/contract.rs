//! What every registry must do, whichever database it uses: one function per promise, run by the
//! tests of each implementation.

use std::sync::Arc;

use jiff::Timestamp;
use uuid::Uuid;

use super::sqlite_rows::sample_record;
use super::{
    Counts, Cursor, Filter, IdempotencyEntry, Order, Record, Registry, RegistryError,
    StoredVerification, Tally,
};

fn owned_by(owner_id: &str) -> Record {
    Record { owner_id: owner_id.to_owned(), ..sample_record() }
}

/// All records that pass a filter, page by page.
async fn all_pages(
    registry: &dyn Registry,
    filter: &Filter,
    order: Order,
    limit: u32,
) -> Vec<Uuid> {
    let (mut seen, mut after) = (Vec::new(), None);
    loop {
        let page = registry.page(filter, order, after, limit).await.unwrap();
        seen.extend(page.records.iter().map(|record| record.id));
        after = page.next;
        if after.is_none() {
            return seen;
        }
    }
}

pub(super) async fn pages_are_in_order_and_complete(registry: &dyn Registry) {
    let mut ids = Vec::new();
    for index in 0..7 {
        let record = owned_by(if index % 2 == 0 { "acme" } else { "other" });
        registry.register(&record, None).await.unwrap();
        ids.push(record.id);
    }
    for order in [Order::Oldest, Order::Newest] {
        for (owner_id, limit) in [(None, 1), (None, 3), (None, 7), (Some("acme"), 2)] {
            let filter = Filter { owner_id: owner_id.map(str::to_owned), recipient: None };
            let expected: Vec<_> = match owner_id {
                None => ids.clone(),
                Some(_) => ids.iter().copied().step_by(2).collect(),
            };
            let seen = all_pages(registry, &filter, order, limit).await;
            assert_eq!(seen, expected, "{order:?} {owner_id:?} {limit}");
        }
        ids.reverse();
    }
    let nobody = Filter { recipient: Some("nobody".to_owned()), ..Filter::default() };
    let page = registry.page(&nobody, Order::Oldest, None, 5).await.unwrap();
    assert!(page.records.is_empty() && page.resume.is_none());
    let foreign = Cursor::from_text(&Cursor(Uuid::nil()).to_text());
    let refused = registry.page(&Filter::default(), Order::Newest, foreign, 5).await;
    assert!(matches!(refused, Err(RegistryError::ForeignCursor)));
    registry.revoke(ids[0], Timestamp::now()).await.unwrap();
    assert_eq!(registry.counts(None).await.unwrap(), Counts { live: 6, revoked: 1 });
    assert_eq!(registry.counts(Some("other")).await.unwrap(), Counts { live: 3, revoked: 0 });
    assert_eq!(registry.counts(Some("nobody")).await.unwrap(), Counts::default());
}

/// The first record to be registered has the last id, and the clock jumped back by a year
/// meanwhile.
pub(super) async fn pages_go_by_registration_whatever_ids_and_clocks_say(registry: &dyn Registry) {
    let fast = sample_record();
    let mut slow = Record { id: Uuid::from_u128(fast.id.as_u128() - (1 << 90)), ..sample_record() };
    slow.created_at = fast.created_at - jiff::SignedDuration::from_hours(365 * 24);
    registry.register(&fast, None).await.unwrap();
    let seen = registry.page(&Filter::default(), Order::Oldest, None, 9).await.unwrap();
    assert_eq!(seen.records, std::slice::from_ref(&fast));
    registry.register(&slow, None).await.unwrap();
    let later = registry.page(&Filter::default(), Order::Oldest, seen.resume, 9).await.unwrap();
    assert_eq!(
        later.records,
        std::slice::from_ref(&slow),
        "a poller sees what was registered later"
    );
    let none = registry.page(&Filter::default(), Order::Oldest, later.resume, 9).await.unwrap();
    assert!(none.records.is_empty() && none.next.is_none());
    assert_eq!(none.resume, later.resume, "and goes on from where it was");
    let newest = registry.page(&Filter::default(), Order::Newest, None, 9).await.unwrap();
    assert_eq!(newest.records, [slow, fast]);
    assert!(newest.resume.is_none());
}

pub(super) async fn a_poller_misses_nothing(registry: Arc<dyn Registry>) {
    const WRITERS: usize = 8;
    const EACH: usize = 25;
    let mut writers = tokio::task::JoinSet::new();
    for writer in 0..WRITERS {
        let registry = registry.clone();
        writers.spawn(async move {
            // The ids are drawn long before they are registered, in another order for every writer.
            let mut records: Vec<Record> =
                std::iter::repeat_with(sample_record).take(EACH).collect();
            if writer % 2 == 0 {
                records.reverse();
            }
            for record in records {
                registry.register(&record, None).await.unwrap();
            }
        });
    }
    let (mut seen, mut after) = (Vec::new(), None);
    loop {
        // Checked before the page is read: what was registered by then must be on it.
        let done = writers.is_empty();
        while writers.try_join_next().map(Result::unwrap).is_some() {}
        let page = registry.page(&Filter::default(), Order::Oldest, after, 7).await.unwrap();
        seen.extend(page.records.iter().map(|record| record.id));
        after = page.resume;
        if done && page.next.is_none() {
            break;
        }
    }
    let all = all_pages(&*registry, &Filter::default(), Order::Oldest, 200).await;
    assert_eq!(all.len(), WRITERS * EACH);
    assert_eq!(seen, all, "each once, in order");
}

pub(super) async fn revoked_records_are_kept_but_not_live(registry: &dyn Registry) {
    let (first, second) = (owned_by("acme"), owned_by("other"));
    registry.register(&first, None).await.unwrap();
    registry.register(&second, None).await.unwrap();
    assert_eq!(registry.live_ids("acme", None, 9).await.unwrap(), [first.id]);
    assert_eq!(registry.live_ids("other", None, 9).await.unwrap(), [second.id]);
    let at = Timestamp::from_microsecond(1_800_000_000_000_000).unwrap();
    let revoked = registry.revoke(first.id, at).await.unwrap().unwrap();
    assert_eq!(revoked.revoked_at, Some(at));
    let again = registry.revoke(first.id, Timestamp::now()).await.unwrap().unwrap();
    assert_eq!(again.revoked_at, Some(at), "the first revocation stands");
    assert!(registry.live_ids("acme", None, 9).await.unwrap().is_empty());
    assert_eq!(registry.live_ids("other", Some(first.id), 9).await.unwrap(), [second.id]);
    assert!(registry.live_ids("other", Some(second.id), 9).await.unwrap().is_empty());
    assert!(registry.revoke(Uuid::now_v7(), at).await.unwrap().is_none());
    let last = registry.last_row().await.unwrap();
    let sources = registry.mark_sources(0, last).await.unwrap();
    assert_eq!(sources, [second.source()]);
    assert!(registry.mark_sources(last, last + 5).await.unwrap().is_empty());
}

pub(super) async fn a_taken_idempotency_key_registers_nothing(registry: &dyn Registry) {
    let entry = |record: &Record| IdempotencyEntry {
        owner_id: record.owner_id.clone(),
        key: "retry-1".to_owned(),
        fingerprint: [3; 32],
        watermark_id: record.id,
    };
    let (first, second) = (owned_by("acme"), owned_by("acme"));
    registry.register(&first, Some(&entry(&first))).await.unwrap();
    let error = registry.register(&second, Some(&entry(&second))).await.unwrap_err();
    assert!(matches!(error, RegistryError::IdempotencyTaken), "{error}");
    assert!(registry.existing(&[second.id]).await.unwrap().is_empty());
    let found = registry.idempotency("acme", "retry-1").await.unwrap();
    assert_eq!(found, Some(entry(&first)));
    assert_eq!(registry.idempotency("other", "retry-1").await.unwrap(), None);
}

pub(super) async fn verdicts_are_kept(registry: &dyn Registry) {
    let verification = StoredVerification {
        id: Uuid::now_v7(),
        created_at: Timestamp::from_microsecond(1_800_000_000_000_000).unwrap(),
        answer: serde_json::json!({ "verdict": "match", "log10_fp": -17.25 }),
    };
    registry.keep_verification(&verification).await.unwrap();
    assert_eq!(registry.verification(verification.id).await.unwrap(), Some(verification));
    assert_eq!(registry.verification(Uuid::now_v7()).await.unwrap(), None);
}

pub(super) async fn many_records_at_once(registry: &dyn Registry) {
    let records = [owned_by("acme"), owned_by("acme"), owned_by("other")];
    for record in &records {
        registry.register(record, None).await.unwrap();
    }
    let asked = [records[2].id, Uuid::now_v7(), records[0].id];
    let found = registry.records(&asked).await.unwrap();
    assert_eq!(found, [records[0].clone(), records[2].clone()]);
    assert_eq!(registry.existing(&asked).await.unwrap(), [records[0].id, records[2].id]);
    assert!(registry.records(&[]).await.unwrap().is_empty());
}

pub(super) async fn many_writers_at_once(registry: Arc<dyn Registry>) {
    let mut tasks = tokio::task::JoinSet::new();
    for _ in 0..40 {
        let registry = registry.clone();
        tasks.spawn(async move { registry.register(&sample_record(), None).await });
    }
    while let Some(done) = tasks.join_next().await {
        done.unwrap().unwrap();
    }
    let end = registry.last_row().await.unwrap();
    assert_eq!(registry.mark_sources(0, end).await.unwrap().len(), 40);
}

pub(super) async fn sketches_are_kept_once_per_host(registry: &dyn Registry) {
    let start = registry.last_row().await.unwrap();
    let kept = Record { host_geometry: Some([8; 32]), host_kept: true, ..sample_record() };
    let also = Record { id: Uuid::now_v7(), ..kept.clone() };
    let without = Record { host_kept: false, ..sample_record() };
    for record in [&kept, &also, &without] {
        let geometry = record.host_geometry.unwrap();
        registry.keep_sketch(&geometry, b"sketch").await.unwrap();
        registry.keep_sketch(&geometry, b"another").await.unwrap();
        registry.register(record, None).await.unwrap();
    }
    let sketches = registry.sketches(0, 100).await.unwrap();
    let of = |hash| sketches.iter().filter(|s| s.geometry == hash).collect::<Vec<_>>();
    assert_eq!(of([8; 32]).len(), 1);
    assert_eq!(of([8; 32])[0].sketch, b"sketch");
    let after = registry.sketches(of([8; 32])[0].row, 100).await.unwrap();
    assert!(after.iter().all(|s| s.geometry != [8; 32]));
    let end = registry.last_row().await.unwrap();
    let hosts = registry.hosts(start, end).await.unwrap();
    assert_eq!(hosts, [(kept.id, [8; 32]), (also.id, [8; 32])]);
    registry.revoke(kept.id, Timestamp::now()).await.unwrap();
    assert_eq!(registry.hosts(start, end).await.unwrap(), [(also.id, [8; 32])]);
    registry.revoke(also.id, Timestamp::now()).await.unwrap();
    assert!(registry.uses_host(&[8; 32]).await.unwrap(), "revoked records count");
    assert!(!registry.uses_host(&[9; 32]).await.unwrap());
    assert!(!registry.uses_host(&without.host_geometry.unwrap()).await.unwrap(), "not kept");
}

pub(super) async fn tries_and_questions_are_counted(registry: Arc<dyn Registry>) {
    let (first, other) = (owned_by("acme"), owned_by("other"));
    // Another file with the same geometry: an added comment does not make another host.
    let second = Record { host_sha256: [77; 32], ..owned_by("acme") };
    let host = first.host_geometry.unwrap();
    registry.refused(&host, "acme", 2).await.unwrap();
    registry.refused(&host, "acme", 1).await.unwrap();
    registry.refused(&[9; 32], "acme", 5).await.unwrap();
    for record in [&first, &second, &other] {
        registry.register(record, None).await.unwrap();
    }
    // The first record takes the tries over; the second was not chosen.
    let tally = |id| {
        let registry = registry.clone();
        async move { registry.tally(id).await.unwrap() }
    };
    let expected = Tally { refused_before: 3, siblings: 1, ..Tally::default() };
    assert_eq!(tally(first.id).await, expected);
    assert_eq!(tally(second.id).await, Tally { siblings: 1, ..Tally::default() });
    assert_eq!(tally(other.id).await, Tally::default());
    assert_eq!(tally(Uuid::now_v7()).await, Tally::default());
    registry.revoke(second.id, Timestamp::now()).await.unwrap();
    assert_eq!(tally(first.id).await, Tally { revoked_siblings: 1, ..expected });
    // Many questions at once: each is counted once, none is lost, and a repeated one keeps its
    // number.
    let mut asking = tokio::task::JoinSet::new();
    for k in (0..40).chain(0..40) {
        let (registry, ids) = (registry.clone(), [first.id, other.id]);
        asking.spawn(async move {
            let answer = registry.ask(&ids, &[k; 32]).await.unwrap();
            assert_eq!(answer.len(), 2);
            (k, answer)
        });
    }
    let mut of_first = std::collections::BTreeMap::new();
    while let Some(answer) = asking.join_next().await {
        let (k, answer) = answer.unwrap();
        let nth = answer.iter().find(|(id, _)| *id == first.id).unwrap().1;
        assert_eq!(*of_first.entry(k).or_insert(nth), nth, "question {k}");
    }
    for (k, nth) in &of_first {
        assert_eq!(registry.question(first.id, &[*k; 32]).await.unwrap(), *nth);
    }
    assert_eq!(registry.question(first.id, &[99; 32]).await.unwrap(), 41);
    assert_eq!(registry.question(second.id, &[0; 32]).await.unwrap(), 1);
    let mut of_first: Vec<u64> = of_first.into_values().collect();
    of_first.sort_unstable();
    assert!(of_first.into_iter().eq(1..=40));
    assert_eq!(tally(first.id).await.asked, 40);
    assert_eq!(tally(second.id).await.asked, 0);
}

//! Connections that do nothing, or too little, do not affect others and are ended.

use std::time::{Duration, Instant};

use quadmark::config::Settings;
use quadmark::sample::{Sample, to_obj};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::process::Process;
use crate::server::Server;

/// Far longer than anything here takes, even on the slowest machine.
const LIVENESS: Duration = Duration::from_mins(1);

/// Sends a request and reads the first bytes of what comes back.
async fn ask(stream: &mut TcpStream, request: &str) -> String {
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut text = vec![0; 4096];
    let read = tokio::time::timeout(LIVENESS, stream.read(&mut text)).await.unwrap().unwrap();
    String::from_utf8_lossy(&text[..read]).into_owned()
}

fn get(path: &str) -> String {
    format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n")
}

/// A connection that was served and waits for its next request.
async fn kept_alive(address: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let answer = ask(&mut stream, &get("/livez")).await;
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    stream
}

/// Reads to the end of the connection, by closing or by a reset. Returns the number of bytes.
async fn read_to_the_end(stream: &mut TcpStream) -> usize {
    let mut bytes = 0;
    let mut part = vec![0; 1 << 16];
    let reading = async {
        while let Ok(read) = stream.read(&mut part).await
            && read > 0
        {
            bytes += read;
        }
    };
    tokio::time::timeout(LIVENESS, reading).await.expect("the connection ends");
    bytes
}

async fn median_latency(address: &str) -> Duration {
    let mut times = Vec::new();
    for _ in 0..51 {
        let start = Instant::now();
        drop(kept_alive(address).await);
        times.push(start.elapsed());
    }
    times.sort();
    times[times.len() / 2]
}

/// Lets this process open more files than the usual 1,024.
#[cfg(unix)]
fn raise_file_limit() {
    use rustix::process::{Resource, getrlimit, setrlimit};
    let mut limit = getrlimit(Resource::Nofile);
    limit.current = limit.maximum;
    setrlimit(Resource::Nofile, limit).unwrap();
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn a_thousand_idle_connections_do_not_slow_the_others() {
    raise_file_limit();
    let directory = tempfile::tempdir().unwrap();
    let process = Process::start(directory.path(), &[]);
    let alone = median_latency(&process.address).await;
    let mut idle = Vec::new();
    for number in 0..1000 {
        // Some have sent nothing, some half a header, and some are kept alive.
        let mut stream = TcpStream::connect(&process.address).await.expect("ulimit -n of 1100");
        match number % 3 {
            0 => {}
            1 => stream.write_all(b"GET /livez HTTP/1.1\r\nHost: lo").await.unwrap(),
            _ => _ = ask(&mut stream, &get("/livez")).await,
        }
        idle.push(stream);
    }
    let beside = median_latency(&process.address).await;
    println!("median of /livez alone {alone:?}, beside {} idle connections {beside:?}", idle.len());
    // Fast, or on a machine that is slow for other reasons, not much slower than alone.
    assert!(beside < Duration::from_millis(50) || beside < 10 * alone, "{alone:?} {beside:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_service_answers_probes_and_closes_what_is_too_much() {
    let server = Server::with(Settings { max_connections: Some(3), ..Settings::default() }).await;
    let address = server.address.to_string();
    let mut held = Vec::new();
    for _ in 0..3 {
        held.push(kept_alive(&address).await);
    }
    for path in ["/livez", "/readyz"] {
        let mut probe = TcpStream::connect(&address).await.unwrap();
        let answer = ask(&mut probe, &get(path)).await;
        assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
        assert_eq!(read_to_the_end(&mut probe).await, 0, "one request each");
    }
    let mut other = TcpStream::connect(&address).await.unwrap();
    let answer = ask(&mut other, &get("/v1/watermarks")).await;
    assert!(answer.starts_with("HTTP/1.1 503 "), "{answer}");
    for word in ["too_many_connections", "retry-after: 5", "connection: close"] {
        assert!(answer.contains(word), "{answer}");
    }
    // Earlier connections are served as before.
    let answer = ask(&mut held[0], &get("/v1/watermarks")).await;
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    // Connections beyond the reserve are closed at once, long before any time limit. A connection
    // within the reserve that sends nothing is ended soon after.
    let mut crowd = Vec::new();
    for _ in 0..80 {
        crowd.push(TcpStream::connect(&address).await.unwrap());
    }
    let start = Instant::now();
    let mut closed = 0;
    for stream in crowd.iter_mut().rev() {
        let mut byte = [0];
        let read = tokio::time::timeout(Duration::from_millis(500), stream.read(&mut byte)).await;
        if read.is_err() {
            break;
        }
        closed += 1;
    }
    println!("{closed} of 80 were closed in {:?}", start.elapsed());
    assert!((10..=20).contains(&closed), "{closed}");
    for stream in &mut crowd {
        assert_eq!(read_to_the_end(stream).await, 0);
    }
    drop(held);
    let again = async {
        while server.get("/v1/watermarks").await.status() != 200 {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(LIVENESS, again).await.expect("there is room again");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_stands_still_or_dribbles_is_ended() {
    let server = Server::with(Settings { idle_timeout: Some(1), ..Settings::default() }).await;
    let address = server.address.to_string();
    let mut silent = TcpStream::connect(&address).await.unwrap();
    assert_eq!(read_to_the_end(&mut silent).await, 0);
    let mut idle = kept_alive(&address).await;
    assert_eq!(read_to_the_end(&mut idle).await, 0);
    // An occasional byte does not keep a header alive.
    let (mut reader, mut writer) = TcpStream::connect(&address).await.unwrap().into_split();
    let dribbling = tokio::spawn(async move {
        let header = "GET /livez HTTP/1.1\r\n".bytes().chain("a: b\r\n".bytes().cycle());
        for byte in header {
            if writer.write_all(&[byte]).await.is_err() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
    let mut answer = Vec::new();
    let read = tokio::time::timeout(LIVENESS, reader.read_to_end(&mut answer));
    let _ = read.await.expect("the connection ends");
    assert!(!answer.starts_with(b"HTTP/1.1 200"));
    tokio::time::timeout(LIVENESS, dribbling).await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_that_nobody_reads_is_ended() {
    let server = Server::with(Settings { idle_timeout: Some(1), ..Settings::default() }).await;
    // More than the system's buffers hold on both sides.
    let (id, file) = server.mark(&to_obj(&Sample::Blob.mesh(120_000).unwrap()), "acme").await;
    let path = format!("/v1/watermarks/{id}/file");
    let socket = tokio::net::TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(16 << 10).unwrap();
    let mut stream = socket.connect(server.address).await.unwrap();
    let answer = ask(&mut stream, &get(&path)).await;
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    tokio::time::sleep(Duration::from_secs(4)).await;
    let read = read_to_the_end(&mut stream).await;
    assert!(read < file.len(), "{read} of {}", file.len());
    // A slow but steady reader gets it.
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    let mut bytes = ask(&mut stream, &get(&path)).await.len();
    let mut part = vec![0; file.len() / 20];
    while bytes < file.len() {
        tokio::time::sleep(Duration::from_millis(100)).await;
        let read = tokio::time::timeout(LIVENESS, stream.read(&mut part)).await.unwrap().unwrap();
        assert!(read > 0, "{bytes} of {}", file.len());
        bytes += read;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn headers_have_a_limit() {
    let server = Server::start().await;
    let head = |more: &str| format!("GET /livez HTTP/1.1\r\nHost: localhost\r\n{more}\r\n");
    for (more, status) in [
        ("a: b\r\n".repeat(90), 200),
        ("a: b\r\n".repeat(200), 431),
        (format!("a: {}\r\n", "b".repeat(16 << 10)), 200),
        (format!("a: {}\r\n", "b".repeat(60 << 10)), 431),
    ] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        let answer = ask(&mut stream, &head(&more)).await;
        assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")), "{answer}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn idle_connections_do_not_hold_the_shutdown() {
    let server = Server::start().await;
    let address = server.address.to_string();
    let mut idle = vec![TcpStream::connect(&address).await.unwrap(), kept_alive(&address).await];
    // The grace period is 30 s.
    let restarted = tokio::time::timeout(Duration::from_secs(20), server.restart()).await;
    assert!(restarted.is_ok(), "it waits for connections that ask for nothing");
    for stream in &mut idle {
        assert_eq!(read_to_the_end(stream).await, 0);
    }
}

//! What a well-behaved client library never does: partial bodies, slow bodies, hanging up.

use std::time::Duration;

use quadmark::config::Settings;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::server::{Server, obj};

async fn connect(server: &Server, head: &str) -> TcpStream {
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(head.as_bytes()).await.unwrap();
    stream
}

async fn answer(mut stream: TcpStream) -> String {
    let mut text = Vec::new();
    let read = stream.read_to_end(&mut text);
    tokio::time::timeout(Duration::from_mins(1), read).await.unwrap().unwrap();
    String::from_utf8_lossy(&text).into_owned()
}

fn head(length: usize) -> String {
    format!(
        "POST /v1/watermarks?owner_id=acme HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\
         Content-Length: {length}\r\n\r\n"
    )
}

fn assert_problem(text: &str, status: u16, code: &str) {
    assert!(text.starts_with(&format!("HTTP/1.1 {status} ")), "{text}");
    assert!(text.contains("application/problem+json"), "{text}");
    assert!(text.contains(&format!("\"code\":\"{code}\"")), "{text}");
    assert!(text.contains("\"request_id\":\""), "{text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_that_stops_midway() {
    let server = Server::start().await;
    let mut stream = connect(&server, &head(obj().len())).await;
    stream.write_all(&obj()[..obj().len() / 2]).await.unwrap();
    stream.shutdown().await.unwrap();
    assert_problem(&answer(stream).await, 400, "upload_incomplete");
    server.assert_empty("half a body").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_that_comes_too_slowly() {
    let server = Server::with(Settings { upload_timeout: Some(1), ..Settings::default() }).await;
    let mut stream = connect(&server, &head(obj().len())).await;
    stream.write_all(&obj()[..1000]).await.unwrap();
    let mut first = vec![0; 2000];
    let read = stream.read(&mut first);
    let length = tokio::time::timeout(Duration::from_secs(20), read).await.unwrap().unwrap();
    assert_problem(&String::from_utf8_lossy(&first[..length]), 408, "upload_timeout");
    server.assert_empty("a slow body").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_hangs_up_midway() {
    let server = Server::start().await;
    for part in [0, 10, obj().len() / 2, obj().len() - 1] {
        let mut stream = connect(&server, &head(obj().len())).await;
        stream.write_all(&obj()[..part]).await.unwrap();
        drop(stream);
    }
    tokio::time::sleep(Duration::from_millis(300)).await;
    server.assert_empty("clients that hung up").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_hangs_up_before_the_answer_leaves_a_whole_record() {
    let server = Server::start().await;
    let mut stream = connect(&server, &head(obj().len())).await;
    stream.write_all(obj()).await.unwrap();
    // Long enough for the upload to be read, far too short for the work.
    while server.service.pool().running() == 0 {
        tokio::task::yield_now().await;
    }
    drop(stream);
    for _ in 0..600 {
        let page = server.get_json("/v1/watermarks").await;
        if let Some(record) = page["watermarks"].as_array().unwrap().first() {
            let file = server.get(record["file_url"].as_str().unwrap()).await;
            assert_eq!(file.status(), 200);
            assert_eq!(server.service.blob_count().await.unwrap(), 2);
            return;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("the work was not seen through");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_sends_on_still_reads_the_refusal() {
    let limit = 1 << 20;
    let server =
        Server::with(Settings { max_body_bytes: Some(limit), ..Settings::default() }).await;
    let length = 64 << 20;
    let chunked = "POST /v1/watermarks?owner_id=acme HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\
                   Transfer-Encoding: chunked\r\n\r\n";
    for (head, framed) in [(head(length), false), (chunked.to_owned(), true)] {
        let stream = connect(&server, &head).await;
        let (mut reader, mut writer) = stream.into_split();
        let sending = tokio::spawn(async move {
            let piece = vec![b'#'; 1 << 16];
            for _ in 0..length >> 16 {
                if framed {
                    writer.write_all(b"10000\r\n").await?;
                }
                writer.write_all(&piece).await?;
                if framed {
                    writer.write_all(b"\r\n").await?;
                }
            }
            if framed {
                writer.write_all(b"0\r\n\r\n").await?;
            }
            Ok::<_, std::io::Error>(writer)
        });
        // Like simple clients, it reads nothing until everything is sent.
        let writer = sending.await.unwrap();
        assert!(writer.is_ok(), "reset while sending");
        let mut text = Vec::new();
        let read = reader.read_to_end(&mut text);
        tokio::time::timeout(Duration::from_secs(30), read).await.unwrap().unwrap();
        assert_problem(&String::from_utf8_lossy(&text), 413, "too_large");
    }
    server.assert_empty("an upload far over the limit").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn expect_continue() {
    let limit = 10 << 20;
    let server =
        Server::with(Settings { max_body_bytes: Some(limit), ..Settings::default() }).await;
    let head = |length: usize| {
        head(length).replace("Host: localhost", "Host: localhost\r\nExpect: 100-continue")
    };
    // Too large: refused before the first byte.
    assert_problem(&answer(connect(&server, &head(300 << 20)).await).await, 413, "too_large");
    let mut stream = connect(&server, &head(obj().len())).await;
    let mut first = [0; 25];
    stream.read_exact(&mut first).await.unwrap();
    assert_eq!(&first, b"HTTP/1.1 100 Continue\r\n\r\n");
    stream.write_all(obj()).await.unwrap();
    assert!(answer(stream).await.starts_with("HTTP/1.1 201 "));
}

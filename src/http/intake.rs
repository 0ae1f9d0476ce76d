//! Request bodies on their way in: a limit that holds whether or not a length is declared, a limit
//! on what the form parser may gather, and answers that reach a client that is refused while it
//! sends.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, BodyDataStream};
use bytes::Bytes;
use futures::{Stream, StreamExt};

use super::stall::Stall;

/// Most bytes that the form parser may hold without passing them on. The headers of a part and the
/// buffer of one chunk are far smaller; an endless header line is not.
const MOST_BACKLOG: u64 = 1 << 20;
/// Most times that the parser may ask for more with a full backlog before it counts as stuck. Once
/// per part and per chunk is normal.
const MOST_FRUITLESS: u32 = 200;
/// Most bytes that are read and discarded after an early refusal.
const LINGER_BYTES: u64 = 2 << 30;
const LINGER_TIME: Duration = Duration::from_secs(30);

/// The state of a body while it is read, visible outside the parser that hides it.
#[derive(Debug, Default)]
pub(super) struct Meter {
    pulled: AtomicU64,
    delivered: AtomicU64,
    over_limit: AtomicBool,
    broken: AtomicBool,
    stalled: AtomicBool,
}

impl Meter {
    /// Notes that the consumer has taken these bytes.
    pub(super) fn deliver(&self, bytes: usize) {
        self.delivered.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    /// Whether the body was longer than the limit.
    pub(super) fn over_limit(&self) -> bool {
        self.over_limit.load(Ordering::Relaxed)
    }

    /// Whether the bytes stopped coming.
    pub(super) fn stalled(&self) -> bool {
        self.stalled.load(Ordering::Relaxed)
    }

    /// Whether the connection broke before the body ended.
    pub(super) fn broken(&self) -> bool {
        self.broken.load(Ordering::Relaxed)
    }
}

/// A body with limits.
pub(super) struct Intake {
    inner: BodyDataStream,
    limit: u64,
    meter: Arc<Meter>,
    stuck_polls: u32,
    delivered_before: u64,
    stall: Stall,
}

impl Intake {
    /// A body of at most `limit` bytes that may stand still for at most `idle`.
    pub(super) fn new(body: Body, limit: u64, idle: Duration) -> (Self, Arc<Meter>) {
        let meter = Arc::new(Meter::default());
        let inner = body.into_data_stream();
        let shared = meter.clone();
        let stall = Stall::new(idle);
        (Self { inner, limit, meter, stuck_polls: 0, delivered_before: 0, stall }, shared)
    }

    /// Holds the parser back while it holds many bytes. The parser reads as long as there is
    /// something to read, and would otherwise hold the whole body in memory.
    fn throttle(&mut self, context: &Context<'_>) -> Option<Poll<Option<io::Result<Bytes>>>> {
        let delivered = self.meter.delivered.load(Ordering::Relaxed);
        let pulled = self.meter.pulled.load(Ordering::Relaxed);
        if pulled.saturating_sub(delivered) <= MOST_BACKLOG {
            return None;
        }
        self.stuck_polls =
            if delivered == self.delivered_before { self.stuck_polls + 1 } else { 0 };
        self.delivered_before = delivered;
        if self.stuck_polls > MOST_FRUITLESS {
            return Some(Poll::Ready(Some(Err(io::Error::other(
                "a part of the form is too long",
            )))));
        }
        context.waker().wake_by_ref();
        Some(Poll::Pending)
    }
}

impl Stream for Intake {
    type Item = io::Result<Bytes>;

    fn poll_next(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Bytes>>> {
        if let Some(held_back) = self.throttle(context) {
            return held_back;
        }
        match self.inner.poll_next_unpin(context) {
            Poll::Ready(Some(Ok(bytes))) => {
                self.stall.moved(bytes.len());
                let length = bytes.len() as u64;
                let before = self.meter.pulled.fetch_add(length, Ordering::Relaxed);
                if before.saturating_add(length) > self.limit {
                    self.meter.over_limit.store(true, Ordering::Relaxed);
                    return Poll::Ready(Some(Err(io::Error::other("the body is too large"))));
                }
                Poll::Ready(Some(Ok(bytes)))
            }
            Poll::Ready(Some(Err(error))) => {
                self.meter.broken.store(true, Ordering::Relaxed);
                Poll::Ready(Some(Err(io::Error::other(error))))
            }
            Poll::Ready(None) => Poll::Ready(None),
            Poll::Pending if self.stall.lasted(context) => {
                self.meter.stalled.store(true, Ordering::Relaxed);
                Poll::Ready(Some(Err(io::Error::other("the body stands still"))))
            }
            Poll::Pending => Poll::Pending,
        }
    }
}

/// A body whose rest, when it is dropped before its end, is read and discarded for a while.
///
/// If a server answers early and closes the connection, the client's system discards the answer:
/// the client, which is still sending, sees a reset connection instead of the 413. A client that
/// waits for `100 Continue` has not begun to send, and is not asked to.
pub(super) struct DrainOnDrop {
    inner: Option<BodyDataStream>,
    begun: bool,
}

impl DrainOnDrop {
    pub(super) fn new(body: Body, expects_continue: bool) -> Self {
        Self { inner: Some(body.into_data_stream()), begun: !expects_continue }
    }
}

impl Stream for DrainOnDrop {
    type Item = Result<Bytes, axum::Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.begun = true;
        let Some(inner) = &mut self.inner else { return Poll::Ready(None) };
        let polled = inner.poll_next_unpin(context);
        if matches!(polled, Poll::Ready(None | Some(Err(_)))) {
            self.inner = None;
        }
        polled
    }
}

impl Drop for DrainOnDrop {
    fn drop(&mut self) {
        if let (Some(rest), true, Ok(runtime)) =
            (self.inner.take(), self.begun, tokio::runtime::Handle::try_current())
        {
            runtime.spawn(tokio::time::timeout(LINGER_TIME, discard(rest)));
        }
    }
}

async fn discard(mut rest: BodyDataStream) {
    let mut left = LINGER_BYTES;
    while let Some(Ok(bytes)) = rest.next().await {
        left = left.saturating_sub(bytes.len() as u64);
        if left == 0 {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::stream;

    const CHUNK: usize = 1 << 16;

    fn endless() -> Body {
        Body::from_stream(stream::repeat_with(|| Ok::<_, io::Error>(Bytes::from(vec![0; CHUNK]))))
    }

    /// Takes bytes and never passes any on.
    async fn gather(intake: &mut Intake) -> (u64, bool) {
        let mut bytes = 0;
        while let Some(chunk) = intake.next().await {
            match chunk {
                Ok(chunk) if bytes < 100 << 20 => bytes += chunk.len() as u64,
                Ok(_) => return (bytes, false),
                Err(_) => return (bytes, true),
            }
        }
        (bytes, false)
    }

    #[tokio::test]
    async fn a_parser_that_hands_nothing_on_is_stopped() {
        let (mut intake, meter) = Intake::new(endless(), u64::MAX, LINGER_TIME);
        // Without its own wake-up, the throttle would hang here.
        let (bytes, failed) =
            tokio::time::timeout(Duration::from_secs(20), gather(&mut intake)).await.unwrap();
        assert!(failed && bytes <= MOST_BACKLOG + CHUNK as u64, "{bytes}");
        assert!(!meter.over_limit() && !meter.broken());
    }

    #[tokio::test]
    async fn one_that_hands_on_reads_all_up_to_the_limit() {
        let (mut intake, meter) = Intake::new(endless(), 50 << 20, LINGER_TIME);
        let mut bytes = 0;
        while let Some(Ok(chunk)) = intake.next().await {
            meter.deliver(chunk.len());
            bytes += chunk.len();
        }
        assert_eq!(bytes, 50 << 20);
        assert!(meter.over_limit());
    }
}

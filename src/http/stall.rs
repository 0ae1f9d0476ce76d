//! Ends what stands still: an upload whose bytes stop coming, an answer that nobody reads.

use std::future::Future;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep};

/// Fewest bytes in one time limit that count as progress: otherwise a byte now and then would hold
/// a connection for ever. With the default limit, a modem of 1985 is three times faster.
const LEAST_PROGRESS: u64 = 4 << 10;

/// Detects that too little has moved for too long.
pub(super) struct Stall {
    limit: Duration,
    timer: Pin<Box<Sleep>>,
    /// Bytes that have moved since the timer was started; `None` while the timer is not running.
    moved: Option<u64>,
}

impl Stall {
    pub(super) fn new(limit: Duration) -> Self {
        Self { limit, timer: Box::pin(sleep(limit)), moved: None }
    }

    /// Notes that bytes moved.
    pub(super) fn moved(&mut self, bytes: usize) {
        if let Some(moved) = &mut self.moved {
            *moved = moved.saturating_add(bytes as u64);
            if *moved >= LEAST_PROGRESS {
                self.moved = None;
            }
        }
    }

    /// Notes that there is nothing to move now.
    pub(super) fn rest(&mut self) {
        self.moved = None;
    }

    /// Notes that nothing moves now, and returns whether that has lasted too long. Otherwise the
    /// task is woken once it has.
    pub(super) fn lasted(&mut self, context: &mut Context<'_>) -> bool {
        if self.moved.is_none() {
            self.timer.as_mut().reset(Instant::now() + self.limit);
            self.moved = Some(0);
        }
        self.timer.as_mut().poll(context).is_ready()
    }
}

/// A connection whose writes fail once the other side has not read for the time limit. Reads are
/// not limited here: while a request is processed, its client rightly sends nothing.
pub(super) struct Writes<S> {
    inner: S,
    stall: Stall,
}

impl<S> Writes<S> {
    pub(super) fn new(inner: S, limit: Duration) -> Self {
        Self { inner, stall: Stall::new(limit) }
    }

    fn judged(
        &mut self,
        context: &mut Context<'_>,
        written: Poll<io::Result<usize>>,
    ) -> Poll<io::Result<usize>> {
        match written {
            Poll::Ready(Ok(bytes)) => self.stall.moved(bytes),
            Poll::Pending if self.stall.lasted(context) => {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
            _ => {}
        }
        written
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Writes<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.inner).poll_write(context, bytes);
        self.judged(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.inner).poll_write_vectored(context, parts);
        self.judged(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.inner.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        // Called only after everything was written.
        self.stall.rest();
        Pin::new(&mut self.inner).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_shutdown(context)
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Writes<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_read(context, buffer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, duplex};

    const LIMIT: Duration = Duration::from_millis(200);

    #[tokio::test]
    async fn a_reader_that_stops_ends_the_writer() {
        let (near, mut far) = duplex(1 << 10);
        let mut near = Writes::new(near, LIMIT);
        let writing = tokio::spawn(async move { near.write_all(&vec![0; 1 << 20]).await });
        far.read_exact(&mut [0; 3 << 10]).await.unwrap();
        assert_eq!(writing.await.unwrap().unwrap_err().kind(), io::ErrorKind::TimedOut);
    }

    #[tokio::test]
    async fn one_that_takes_a_byte_at_a_time_does_not_hold_it() {
        let (near, mut far) = duplex(1 << 10);
        let mut near = Writes::new(near, LIMIT);
        let writing = tokio::spawn(async move { near.write_all(&vec![0; 1 << 20]).await });
        let reading = async {
            while far.read_u8().await.is_ok() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        let written =
            tokio::select! { written = writing => written.unwrap(), () = reading => Ok(()) };
        assert_eq!(written.unwrap_err().kind(), io::ErrorKind::TimedOut);
    }

    #[tokio::test]
    async fn a_slow_reader_and_a_resting_writer_are_left_alone() {
        let (near, mut far) = duplex(1 << 10);
        let mut near = Writes::new(near, LIMIT);
        let writing = tokio::spawn(async move {
            for _ in 0..3 {
                near.write_all(&[0; 10 << 10]).await?;
                near.flush().await?;
                tokio::time::sleep(2 * LIMIT).await;
            }
            Ok::<_, io::Error>(())
        });
        let mut bytes = 0;
        let mut part = [0; 1 << 10];
        while let Ok(read) = far.read(&mut part).await
            && read > 0
        {
            bytes += read;
            tokio::time::sleep(LIMIT / 20).await;
        }
        writing.await.unwrap().unwrap();
        assert_eq!(bytes, 30 << 10);
    }
}

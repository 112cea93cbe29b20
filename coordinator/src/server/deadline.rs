//! Connections whose other end must go on reading.

use std::io::{self, ErrorKind, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Sleep, sleep};

/// A connection that fails once the other end has taken nothing for so long. It counts only while there is something to
/// be taken.
pub(super) struct Deadline<S> {
    stream: S,
    longest: Duration,
    /// Set while the other end is waited for.
    limit: Option<Pin<Box<Sleep>>>,
}

impl<S> Deadline<S> {
    pub(super) fn of(stream: S, longest: Duration) -> Self {
        Self {
            stream,
            longest,
            limit: None,
        }
    }

    fn limited(&mut self, context: &mut Context<'_>, written: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        if written.is_ready() {
            self.limit = None;
            return written;
        }
        let longest = self.longest;
        let limit = self.limit.get_or_insert_with(|| Box::pin(sleep(longest)));
        limit.as_mut().poll(context).map(|()| {
            let detail = "the other end has read nothing for too long";
            Err(io::Error::new(ErrorKind::TimedOut, detail))
        })
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Deadline<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Deadline<S> {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.limited(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.limited(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};

    /// Whoever reads gets everything, whatever the time between.
    #[tokio::test]
    async fn who_reads_gets_everything() {
        let (mut reader, writer) = duplex(10);
        let mut writer = Deadline::of(writer, Duration::from_secs(3600));
        let write = tokio::spawn(async move { writer.write_all(&[7; 1000]).await });
        let mut read = Vec::new();
        reader.read_to_end(&mut read).await.unwrap();
        write.await.unwrap().unwrap();
        assert_eq!(read, [7; 1000]);
    }

    #[tokio::test]
    async fn who_reads_nothing_is_given_up() {
        let (_reader, writer) = duplex(10);
        let mut writer = Deadline::of(writer, Duration::from_millis(20));
        let error = writer.write_all(&[7; 1000]).await.unwrap_err();
        assert_eq!(error.kind(), ErrorKind::TimedOut);
    }
}

//! Bodies that must keep coming.

use super::Timeouts;
use axum::body::{Body, BodyDataStream, Bytes};
use futures_util::{Stream, StreamExt};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::time::{Instant, Sleep, sleep};

/// A body that ends with an error when it stalls, or when it comes too slowly over all.
pub(super) struct Patience {
    body: BodyDataStream,
    timeouts: Timeouts,
    began: Instant,
    received: u64,
    /// Set while the next piece is awaited.
    limit: Option<Pin<Box<Sleep>>>,
    over: bool,
}

impl Patience {
    pub(super) fn of(body: Body, timeouts: Timeouts) -> Self {
        Self {
            body: body.into_data_stream(),
            timeouts,
            began: Instant::now(),
            received: 0,
            limit: None,
            over: false,
        }
    }

    /// How long the next piece may take.
    fn wait(&self) -> Duration {
        let transfer =
            Duration::from_millis(self.received.saturating_mul(1000) / self.timeouts.bytes_per_second.max(1));
        let whole = (self.timeouts.stall + transfer).saturating_sub(self.began.elapsed());
        whole.min(self.timeouts.stall)
    }
}

impl Stream for Patience {
    type Item = Result<Bytes, axum::Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if self.over {
            return Poll::Ready(None);
        }
        if let Poll::Ready(piece) = self.body.poll_next_unpin(context) {
            self.limit = None;
            if let Some(Ok(bytes)) = &piece {
                self.received += bytes.len() as u64;
            }
            return Poll::Ready(piece);
        }
        let wait = self.wait();
        let limit = self.limit.get_or_insert_with(|| Box::pin(sleep(wait)));
        match limit.as_mut().poll(context) {
            Poll::Pending => Poll::Pending,
            Poll::Ready(()) => {
                self.over = true;
                Poll::Ready(Some(Err(axum::Error::new("it comes too slowly"))))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::stream;

    const TIMEOUTS: Timeouts = Timeouts {
        head: Duration::from_secs(1),
        stall: Duration::from_secs(10),
        handshake: Duration::from_secs(1),
        bytes_per_second: 100,
    };

    /// What arrives of pieces of `bytes` every so many seconds, and after how many seconds it is over.
    async fn received(bytes: usize, pause_s: u64, pieces: usize) -> (usize, bool, u64) {
        let slow = stream::iter(0..pieces).then(move |_| async move {
            sleep(Duration::from_secs(pause_s)).await;
            Ok::<_, std::io::Error>(Bytes::from(vec![0; bytes]))
        });
        let began = Instant::now();
        let mut body = Patience::of(Body::from_stream(slow), TIMEOUTS);
        let (mut total, mut whole) = (0, true);
        while let Some(piece) = body.next().await {
            match piece {
                Ok(bytes) => total += bytes.len(),
                Err(_) => whole = false,
            }
        }
        (total, whole, began.elapsed().as_secs())
    }

    #[tokio::test(start_paused = true)]
    async fn a_body_that_comes_is_whole() {
        assert_eq!(received(1000, 9, 20).await, (20_000, true, 180));
    }

    #[tokio::test(start_paused = true)]
    async fn a_body_that_stalls_is_given_up() {
        assert_eq!(received(1000, 11, 20).await, (0, false, 10));
    }

    #[tokio::test(start_paused = true)]
    async fn a_body_that_drips_is_given_up() {
        let (total, whole, seconds) = received(1, 5, 1000).await;
        assert!(!whole && total <= 2 && seconds <= 11, "{total} {whole} {seconds}");
    }
}

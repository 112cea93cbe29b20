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
}

impl Timeouts {
    /// How long the next piece of a body may take, of which `received` bytes came within `elapsed`.
    fn wait(&self, received: u64, elapsed: Duration) -> Duration {
        let transfer = Duration::from_millis(received.saturating_mul(1000) / self.bytes_per_second.max(1));
        (self.stall + transfer).saturating_sub(elapsed).min(self.stall)
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
        let wait = self.timeouts.wait(self.received, self.began.elapsed());
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

    fn timeouts(stall: Duration) -> Timeouts {
        Timeouts {
            head: Duration::from_secs(1),
            stall,
            handshake: Duration::from_secs(1),
            bytes_per_second: 100,
        }
    }

    /// How many bytes arrive of `pieces` with nothing after them for ever, or with their end.
    async fn received(pieces: usize, ends: bool, stall: Duration) -> (usize, bool) {
        let pieces = stream::iter(0..pieces).map(|_| Ok::<_, std::io::Error>(Bytes::from_static(&[0; 1000])));
        let body = match ends {
            true => Body::from_stream(pieces),
            false => Body::from_stream(pieces.chain(stream::pending())),
        };
        let mut body = Patience::of(body, timeouts(stall));
        let (mut total, mut whole) = (0, true);
        while let Some(piece) = body.next().await {
            match piece {
                Ok(bytes) => total += bytes.len(),
                Err(_) => whole = false,
            }
        }
        (total, whole)
    }

    #[tokio::test]
    async fn a_body_that_comes_is_whole() {
        assert_eq!(received(20, true, Duration::from_secs(3600)).await, (20_000, true));
    }

    #[tokio::test]
    async fn a_body_that_stalls_is_given_up() {
        assert_eq!(received(2, false, Duration::from_millis(10)).await, (2000, false));
    }

    /// At most 1000 bytes a second for ever, where a million are asked for.
    #[tokio::test]
    async fn a_body_that_drips_is_given_up() {
        let drip = stream::repeat(()).then(|()| async {
            sleep(Duration::from_millis(1)).await;
            Ok::<_, std::io::Error>(Bytes::from_static(b"x"))
        });
        let patience = Timeouts {
            bytes_per_second: 1_000_000,
            ..timeouts(Duration::from_millis(20))
        };
        let pieces = Patience::of(Body::from_stream(drip), patience);
        let last = pieces.fold(None, |_, piece| async { Some(piece) }).await;
        assert!(last.is_some_and(|piece| piece.is_err()));
    }

    #[test]
    fn a_body_that_drips_gets_ever_less_time() {
        let timeouts = timeouts(Duration::from_secs(10));
        let wait = |received, elapsed_s| timeouts.wait(received, Duration::from_secs(elapsed_s)).as_millis();
        assert_eq!([wait(0, 0), wait(1000, 10), wait(20_000, 180)], [10_000; 3]);
        assert_eq!([wait(1, 5), wait(2, 10), wait(2, 11)], [5010, 20, 0]);
    }
}

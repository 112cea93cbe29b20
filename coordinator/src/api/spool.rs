//! Long answers on their way to slow readers: in a file without a name or in the store, and not in memory.

use super::ApiError;
use crate::background::in_background;
use crate::store::BlobReader;
use axum::body::{Body, Bytes};
use axum::http::header::CONTENT_LENGTH;
use axum::response::Response;
use futures_util::StreamExt;
use photonfarm_proto::problem::{ErrorCode, Problem};
use std::io::{Seek, Write};
use std::sync::Arc;
use std::time::Duration;
use tokio::fs::File;
use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::io::ReaderStream;

/// Long answers under way at once; more wait for a moment, then are to come again.
const ANSWERS: usize = 64;
/// Long answers in memory at once, until they are in their files.
const MAKING: usize = 4;
/// How long an answer waits for its turn.
const WAIT: Duration = Duration::from_secs(20);
/// Shorter answers stay in memory [bytes].
const SHORT: usize = 1 << 20;

/// Bounds the long answers that are made and sent.
pub(super) struct Spool {
    answers: Arc<Semaphore>,
    making: Semaphore,
    wait: Duration,
}

impl Default for Spool {
    fn default() -> Self {
        Self {
            answers: Arc::new(Semaphore::new(ANSWERS)),
            making: Semaphore::new(MAKING),
            wait: WAIT,
        }
    }
}

/// The body of a long answer.
pub(super) enum LongBody {
    /// There is none.
    None,
    /// It was made for this answer.
    Bytes(Bytes),
    /// So many bytes in the store, the first that the reader gives.
    Stored(u64, BlobReader),
}

impl Spool {
    /// Makes an answer, head and body, and moves a body that is not in the store to a file; its reader then takes disk for
    /// as long as it likes, and no memory.
    pub(super) async fn answer<F>(&self, make: F) -> Result<Response, ApiError>
    where
        F: Future<Output = Result<(Response, LongBody), ApiError>>,
    {
        let busy = || {
            Problem::new(
                ErrorCode::Unavailable,
                "too many pictures are being sent: try again soon",
            )
            .after(5)
        };
        let turn = tokio::time::timeout(self.wait, async {
            let answer = self.answers.clone().acquire_owned().await.ok()?;
            Some((answer, self.making.acquire().await.ok()?))
        });
        let (answer, _making) = turn.await.ok().flatten().ok_or_else(busy)?;
        let (mut response, body) = make.await?;
        let (length, body) = match body {
            LongBody::None => return Ok(response),
            LongBody::Bytes(bytes) if bytes.len() <= SHORT => (bytes.len() as u64, bytes.into()),
            LongBody::Bytes(bytes) => (bytes.len() as u64, read_to_end(put_aside(bytes).await?, answer)),
            LongBody::Stored(length, reader) => (length, read_to_end(reader.take(length), answer)),
        };
        response.headers_mut().insert(CONTENT_LENGTH, length.into());
        *response.body_mut() = body;
        Ok(response)
    }
}

/// Moves bytes to a file without a name.
async fn put_aside(bytes: Bytes) -> Result<File, ApiError> {
    let file = in_background(move || {
        let mut file = tempfile::tempfile()?;
        file.write_all(&bytes)?;
        file.rewind()?;
        Ok::<_, std::io::Error>(file)
    });
    let file = file.await.map_err(std::io::Error::other).flatten().map_err(|error| {
        let folder = std::env::temp_dir();
        tracing::error!(%error, folder = %folder.display(), "a picture could not be put aside to be sent");
        Problem::new(ErrorCode::Internal, "the coordinator could not do it; its log says why")
    })?;
    Ok(File::from_std(file))
}

/// A body that counts as an answer until its last piece was read.
fn read_to_end(reader: impl AsyncRead + Send + 'static, answer: OwnedSemaphorePermit) -> Body {
    let pieces = ReaderStream::with_capacity(reader, 64 << 10);
    Body::from_stream(pieces.map(move |piece| {
        let _until_the_last = &answer;
        piece
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::BodyDataStream;
    use std::sync::atomic::{AtomicUsize, Ordering};

    async fn answer(spool: &Spool, bytes: usize) -> Result<BodyDataStream, ApiError> {
        let made = async { Ok((Response::default(), LongBody::Bytes(vec![7; bytes].into()))) };
        Ok(spool.answer(made).await?.into_body().into_data_stream())
    }

    #[tokio::test]
    async fn slow_readers_of_long_answers_are_bounded_and_hold_files_and_no_memory() {
        let spool = Spool {
            wait: Duration::from_millis(1),
            ..Spool::default()
        };
        let mut slow = Vec::new();
        for _ in 0..ANSWERS {
            slow.push(answer(&spool, SHORT + 1).await.unwrap());
        }
        let refused = answer(&spool, 1).await.expect_err("one too many").0;
        assert_eq!((refused.code, refused.retry_after_s), (ErrorCode::Unavailable, Some(5)));

        // In memory it would come in one piece.
        let mut read = slow.pop().unwrap();
        let first = read.next().await.unwrap().unwrap();
        assert!(first.len() <= 64 << 10, "a piece of {} bytes", first.len());
        let mut total = first.len();
        while let Some(piece) = read.next().await {
            total += piece.unwrap().iter().filter(|byte| **byte == 7).count();
        }
        assert_eq!(total, SHORT + 1);
        drop(read);
        slow.push(answer(&spool, SHORT + 1).await.expect("the place of who has read all"));

        drop(slow.pop());
        let short = [answer(&spool, 1).await, answer(&spool, SHORT).await];
        assert!(short.iter().all(Result::is_ok), "short answers hold no place");
    }

    #[tokio::test]
    async fn few_answers_are_made_at_once() {
        let spool = Spool::default();
        let (begun, go_on) = (AtomicUsize::new(0), Semaphore::new(0));
        let make = || async {
            begun.fetch_add(1, Ordering::Relaxed);
            drop(go_on.acquire().await);
            Ok((Response::default(), LongBody::None))
        };
        let all = futures_util::future::join_all((0..2 * MAKING).map(|_| spool.answer(make())));
        // Polled after all of them were.
        let later = async {
            assert_eq!(begun.load(Ordering::Relaxed), MAKING);
            go_on.add_permits(1);
        };
        let (answers, ()) = tokio::join!(biased; all, later);
        assert!(answers.iter().all(Result::is_ok));
        assert_eq!(begun.into_inner(), 2 * MAKING);
    }
}

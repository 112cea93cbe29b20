//! Requests and answers of any length, at any speed that makes progress.
//!
//! A limit on the time of a whole request ends whatever is longer than the line carries within it. So the limit here is
//! on silence: it begins anew with each piece that moves.

use bytes::Bytes;
use futures_util::{Stream, stream};
use reqwest::header::CONTENT_LENGTH;
use reqwest::{Body, Client, Request, Response};
use std::pin::pin;
use std::time::Duration;
use thiserror::Error;
use tokio::sync::watch;

/// Longest silence of the other side, beyond the time of what is on its way.
pub const SILENCE: Duration = Duration::from_secs(30);
/// Slowest line that is waited for [bytes per second]; a coordinator takes bodies as slowly.
const SLOWEST: u64 = 1000;
/// Most bytes of a body that buffers on this side hold, so that they count as moved before they are [bytes].
const BUFFERED: u64 = 4 << 20;
/// Bytes that are handed on at once.
const PIECE: usize = 64 << 10;

/// Why a transfer failed.
#[derive(Debug, Error)]
pub enum TransferError {
    /// The connection failed.
    #[error(transparent)]
    Http(#[from] reqwest::Error),
    /// The connection stands, and nothing comes or goes.
    #[error("the other side was silent for {} s, after {moved} bytes", silence.as_secs())]
    Silent {
        /// How long.
        silence: Duration,
        /// Bytes that were moved until then.
        moved: u64,
    },
}

/// How long the other side may be silent after `moved` bytes, of which the last ones may still be on their way.
fn patience(silence: Duration, moved: u64) -> Duration {
    silence + Duration::from_secs(moved.min(BUFFERED).div_ceil(SLOWEST))
}

/// Sends a request with a body, and returns its answer as soon as that begins. The answer may take `silence` after the
/// last piece of the body that moved, and the time that a slow line needs for what is on its way. `told` is told of how many bytes
/// of the body have moved so far.
///
/// # Errors
/// A connection that fails; a silence that lasts.
pub async fn send(
    client: &Client,
    mut request: Request,
    body: Bytes,
    silence: Duration,
    told: impl Fn(u64),
) -> Result<Response, TransferError> {
    request.headers_mut().insert(CONTENT_LENGTH, body.len().into());
    let (moved, mut progress) = watch::channel(0);
    let pieces = stream::unfold((body, moved), |(mut rest, moved)| async move {
        if rest.is_empty() {
            return None;
        }
        let piece = rest.split_to(rest.len().min(PIECE));
        moved.send_modify(|bytes| *bytes += piece.len() as u64);
        Some((Ok::<_, std::io::Error>(piece), (rest, moved)))
    });
    *request.body_mut() = Some(Body::wrap_stream(pieces));
    let mut answer = pin!(client.execute(request));
    loop {
        let moved = *progress.borrow_and_update();
        told(moved);
        let silence = patience(silence, moved);
        let more = async {
            if progress.changed().await.is_err() {
                std::future::pending().await
            }
        };
        tokio::select! {
            answer = &mut answer => return Ok(answer?),
            () = more => {}
            () = tokio::time::sleep(silence) => return Err(TransferError::Silent { silence, moved }),
        }
    }
}

/// The body of an answer, piece by piece, none of which may take longer than `silence`.
pub fn pieces(response: Response, silence: Duration) -> impl Stream<Item = Result<Bytes, TransferError>> {
    stream::try_unfold((response, 0), move |(mut response, moved)| async move {
        let late = |_| TransferError::Silent { silence, moved };
        let next = tokio::time::timeout(silence, response.chunk()).await.map_err(late)??;
        Ok(next.map(|piece| {
            let moved = moved + piece.len() as u64;
            (piece, (response, moved))
        }))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::StreamExt;
    use reqwest::Method;
    use std::cell::Cell;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    /// Many times what a connection's buffers hold, so that it takes pieces only as they are read.
    const BYTES: usize = 40 << 20;
    const BRIEF: Duration = Duration::from_millis(50);
    /// Never reached.
    const LONG: Duration = Duration::from_secs(3600);

    async fn server() -> (TcpListener, Request) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/", listener.local_addr().unwrap());
        (listener, Request::new(Method::POST, url.parse().unwrap()))
    }

    fn client() -> Client {
        Client::builder().no_proxy().build().unwrap()
    }

    /// A body of 40 MiB arrives whole, with its length, at whatever speed it is read.
    #[tokio::test]
    async fn a_body_arrives_in_pieces_and_with_its_length() {
        let (listener, request) = server().await;
        let received = tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            let (mut said, mut buffer) = (Vec::new(), vec![0; 1 << 20]);
            let body = loop {
                let read = stream.read(&mut buffer).await.unwrap();
                said.extend_from_slice(&buffer[..read]);
                let end = said.windows(4).position(|four| four == b"\r\n\r\n");
                if let Some(end) = end.filter(|end| said.len() >= end + 4 + BYTES) {
                    break said.split_off(end + 4);
                }
            };
            stream
                .write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\nok")
                .await
                .unwrap();
            (String::from_utf8(said).unwrap().to_lowercase(), body)
        });
        let moved = Cell::new(0);
        let sent: Bytes = (0..BYTES).map(|i| (i % 251) as u8).collect();
        let answer = send(&client(), request, sent.clone(), LONG, |bytes| moved.set(bytes))
            .await
            .unwrap();
        let answer: Vec<_> = pieces(answer, LONG).map(Result::unwrap).collect().await;
        assert_eq!(answer.concat(), b"ok");
        let (head, body) = received.await.unwrap();
        assert!(head.contains(&format!("content-length: {BYTES}\r\n")), "{head}");
        assert!(body == sent, "the body arrived otherwise");
        assert_eq!(moved.get(), BYTES as u64);
    }

    #[tokio::test]
    async fn silence_ends_a_request_and_an_answer() {
        let (listener, request) = server().await;
        let silent = send(&client(), request.try_clone().unwrap(), Bytes::new(), BRIEF, |_| {}).await;
        assert!(matches!(silent, Err(TransferError::Silent { moved: 0, .. })));
        tokio::spawn(async move {
            let mut open = Vec::new();
            while let Ok((mut stream, _)) = listener.accept().await {
                let _head = stream.read(&mut [0; 4096]).await;
                let _gone = stream
                    .write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 5\r\n\r\nok")
                    .await;
                open.push(stream);
            }
        });
        let answer = send(&client(), request, Bytes::new(), LONG, |_| {}).await.unwrap();
        let mut answer = pin!(pieces(answer, BRIEF));
        let mut last = None;
        while let Some(piece) = answer.next().await {
            last = Some(piece);
        }
        assert!(matches!(last, Some(Err(TransferError::Silent { .. }))));
    }

    /// Whatever its length, a body that moves as fast as the slowest line is waited for: the time begins anew with each
    /// piece, and is longer than all that buffers hold takes.
    #[test]
    fn the_slowest_line_is_fast_enough() {
        let slowest = |bytes: u64| Duration::from_secs(bytes / SLOWEST);
        for moved in [0, 1, 999, 1 << 20, BUFFERED, 1 << 30, u64::MAX] {
            let left = patience(SILENCE, moved) - SILENCE;
            assert!(left >= slowest(moved.min(BUFFERED)), "{moved}");
            assert!(left <= slowest(BUFFERED) + Duration::from_secs(1), "{moved}");
        }
    }
}

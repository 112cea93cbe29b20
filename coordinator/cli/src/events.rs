//! Streams of server-sent events.

use anyhow::{Result, bail};
use futures_util::StreamExt;
use reqwest::Response;

/// Longest line of an event stream: far beyond any job's status.
const EVENT_BYTES: usize = 16 << 20;

/// Server-sent events (HTML standard, section 9.2) of an answer.
pub(crate) struct Events {
    response: std::pin::Pin<Box<dyn futures_util::Stream<Item = reqwest::Result<Vec<u8>>> + Send>>,
    pending: Vec<u8>,
}

impl Events {
    pub(crate) fn of(response: Response) -> Self {
        let chunks = response.bytes_stream().map(|chunk| chunk.map(|bytes| bytes.to_vec()));
        Self {
            response: Box::pin(chunks),
            pending: Vec::new(),
        }
    }

    /// The name and data of the next event; nothing once the connection has ended.
    pub(crate) async fn next(&mut self) -> Result<Option<(String, String)>> {
        let (mut name, mut data) = (String::new(), String::new());
        while let Some(line) = self.line().await? {
            match line.split_once(':') {
                Some(("event", value)) => name = value.trim_start().to_owned(),
                Some(("data", value)) => {
                    data.push_str(value.strip_prefix(' ').unwrap_or(value));
                    data.push('\n');
                }
                _ if line.is_empty() && !data.is_empty() => return Ok(Some((name, data))),
                _ => {}
            }
        }
        Ok(None)
    }

    async fn line(&mut self) -> Result<Option<String>> {
        loop {
            if let Some(end) = self.pending.iter().position(|b| *b == b'\n') {
                let line: Vec<u8> = self.pending.drain(..=end).collect();
                return Ok(Some(
                    String::from_utf8_lossy(&line).trim_end_matches(['\r', '\n']).to_owned(),
                ));
            }
            if self.pending.len() > EVENT_BYTES {
                bail!("an event of more than {EVENT_BYTES} bytes: is this a Photonfarm coordinator?");
            }
            match self.response.next().await {
                Some(Ok(chunk)) => self.pending.extend_from_slice(&chunk),
                Some(Err(_)) | None => return Ok(None),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn events(chunks: &[&str]) -> Events {
        let chunks: Vec<reqwest::Result<Vec<u8>>> = chunks.iter().map(|c| Ok(c.as_bytes().to_vec())).collect();
        Events {
            response: Box::pin(futures_util::stream::iter(chunks)),
            pending: Vec::new(),
        }
    }

    #[tokio::test]
    async fn events_are_read_across_chunks() {
        let mut events = events(&[
            "event: sta",
            "tus\nda",
            "ta: {}\n\n: alive\n\nevent:end\r\ndata:1\r\ndata:2\r\n\r\n",
            "data: cut",
        ]);
        let mut next = async || events.next().await.unwrap();
        assert_eq!(next().await, Some(("status".into(), "{}\n".into())));
        assert_eq!(next().await, Some(("end".into(), "1\n2\n".into())));
        assert_eq!(next().await, None);
    }
}

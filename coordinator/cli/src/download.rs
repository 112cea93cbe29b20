//! Pictures on their way from a farm: a connection that breaks is gone on with where it broke, and so is a command that was killed.

use crate::client::{Client, PATIENCE};
use crate::progress::Transfer;
use anyhow::{Context, Result, bail};
use futures_util::StreamExt;
use photonfarm_core::picture;
use photonfarm_proto::id::JobId;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_worker::transfer::{self, SILENCE};
use reqwest::header::{CONTENT_RANGE, ETAG, HeaderMap, IF_RANGE, RANGE};
use reqwest::{Method, RequestBuilder, Response, StatusCode};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::time::{Duration, Instant};

/// Wait before a broken transfer goes on.
const PAUSE: Duration = Duration::from_millis(100);
/// Most bytes of the line that a file of a part begins with.
const HEAD_BYTES: u64 = 4096;

/// Which picture a part is of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Head {
    /// Farm and path.
    source: String,
    /// The entity tag, a strong one, which names the bytes.
    etag: String,
    /// How many they are in all.
    bytes: u64,
}

/// What has arrived of a picture.
#[derive(Debug, Default)]
pub(crate) struct Part {
    /// None while nothing has arrived that could be gone on with.
    head: Option<Head>,
    bytes: Vec<u8>,
    /// Where it is kept for the next command, if anywhere: a line of JSON, the [`Head`], then the bytes.
    kept: Option<(File, PathBuf)>,
}

impl Part {
    /// A part that is kept beside the file that it will become, with what an earlier command has left of it. Where another
    /// command fetches the same file at this moment, nothing is kept.
    pub(crate) fn beside(path: &Path) -> Result<Self> {
        let mut name = std::ffi::OsString::from(".");
        name.push(path.file_name().unwrap_or_default());
        name.push(".part");
        let path = path.with_file_name(name);
        let context = || format!("cannot write {}", path.display());
        let mut options = File::options();
        let options = options.read(true).write(true).create(true).truncate(false);
        let file = options.open(&path).with_context(context)?;
        if file.try_lock().is_err() {
            return Ok(Self::default());
        }
        let (head, bytes) = read(&file).unwrap_or_default();
        Ok(Self {
            head,
            bytes,
            kept: Some((file, path)),
        })
    }

    /// Asks for what is missing, if the picture is still the same. At least one byte is asked for: an empty range is an error.
    fn ask(&self, request: RequestBuilder) -> RequestBuilder {
        match &self.head {
            Some(head) => request
                .header(RANGE, format!("bytes={}-", self.first_missing(head)))
                .header(IF_RANGE, &head.etag),
            None => request,
        }
    }

    fn first_missing(&self, head: &Head) -> u64 {
        (self.bytes.len() as u64).min(head.bytes.saturating_sub(1))
    }

    /// Reads the head of an answer: what comes goes on from what is there, or takes its place.
    fn meet(&mut self, source: &str, response: &Response) -> Result<()> {
        let (headers, length) = (response.headers(), response.content_length());
        if response.status() == StatusCode::PARTIAL_CONTENT {
            let head = self.head.as_ref().context("a part came that nobody asked for")?;
            let first = self.first_missing(head);
            let expected = format!("bytes {first}-{}/{}", head.bytes.saturating_sub(1), head.bytes);
            let range = text(headers, CONTENT_RANGE.as_str());
            if range != Some(&expected) || text(headers, ETAG.as_str()) != Some(&head.etag) {
                bail!("the answer is another part than the one that was asked for ({expected})");
            }
            return self.cut(first);
        }
        let strong = text(headers, ETAG.as_str()).filter(|tag| tag.starts_with('"'));
        self.clear(strong.zip(length).map(|(etag, bytes)| Head {
            source: source.to_owned(),
            etag: etag.to_owned(),
            bytes,
        }))
    }

    /// Begins anew.
    fn clear(&mut self, head: Option<Head>) -> Result<()> {
        self.bytes.clear();
        if let Some((file, path)) = &mut self.kept {
            let mut begin = || {
                file.set_len(0)?;
                file.rewind()?;
                match &head {
                    Some(head) => writeln!(file, "{}", serde_json::to_string(head)?),
                    None => Ok(()),
                }
            };
            begin().with_context(|| format!("cannot write {}", path.display()))?;
        }
        self.head = head;
        Ok(())
    }

    /// Leaves so many bytes.
    fn cut(&mut self, bytes: u64) -> Result<()> {
        let dropped = self.bytes.len() as u64 - bytes;
        self.bytes.truncate(bytes as usize);
        if let Some((file, path)) = &mut self.kept {
            let mut cut = || {
                let end = file.seek(SeekFrom::End(0))? - dropped;
                file.set_len(end)?;
                file.seek(SeekFrom::Start(end))
            };
            cut().with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    fn take(&mut self, piece: &[u8]) -> Result<()> {
        if self
            .head
            .as_ref()
            .is_some_and(|head| (self.bytes.len() + piece.len()) as u64 > head.bytes)
        {
            bail!("the answer is longer than it says");
        }
        self.bytes.extend_from_slice(piece);
        if let Some((file, path)) = &mut self.kept {
            file.write_all(piece)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    /// The picture is written: nothing is kept of it any more.
    pub(crate) fn remove(mut self) -> Result<()> {
        match self.kept.take() {
            Some((_, path)) => std::fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display())),
            None => Ok(()),
        }
    }
}

/// Where nothing has arrived, nothing is left.
impl Drop for Part {
    fn drop(&mut self) {
        if let Some((_, path)) = self.kept.as_ref().filter(|_| self.head.is_none()) {
            let _left = std::fs::remove_file(path);
        }
    }
}

/// What an earlier command has left; an error for what is none of ours, or damaged.
fn read(file: &File) -> std::io::Result<(Option<Head>, Vec<u8>)> {
    let mut reader = BufReader::new(file);
    let mut line = Vec::new();
    reader.by_ref().take(HEAD_BYTES).read_until(b'\n', &mut line)?;
    let head: Head = serde_json::from_slice(&line)?;
    let mut bytes = Vec::new();
    reader.take(head.bytes).read_to_end(&mut bytes)?;
    Ok((Some(head), bytes))
}

fn text<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    headers.get(name)?.to_str().ok()
}

/// Whether bytes are a whole picture in this format.
fn is_picture(bytes: &[u8], format: &str) -> bool {
    match format {
        "exr" => picture::decode_exr(bytes, usize::MAX).is_ok(),
        _ => image::load_from_memory(bytes).is_ok(),
    }
}

impl Client {
    /// An image of a job, in the format `exr` or `png`.
    pub(crate) async fn image(&self, job: JobId, format: &str) -> Result<Vec<u8>> {
        self.download(job, format, &mut Part::default()).await
    }

    /// As [`image`](Self::image), going on from a part. What was put together of parts is looked at: one that is damaged is fetched
    /// anew.
    pub(crate) async fn download(&self, job: JobId, format: &str, part: &mut Part) -> Result<Vec<u8>> {
        let path = format!("jobs/{job}/image.{format}");
        let source = format!("{} {path}", self.farm_or_address());
        if part.head.as_ref().is_some_and(|head| head.source != source) {
            part.clear(None)?;
        }
        let mut moved = Instant::now();
        let mut pieced = part.head.is_some();
        loop {
            let response = self.retry(PATIENCE, || part.ask(self.request(Method::GET, &path)));
            let response = match response.await {
                Err(error) if part.head.is_some() && is_beyond(&error) => {
                    part.clear(None)?;
                    continue;
                }
                response => response?,
            };
            match part.meet(&source, &response) {
                Err(error) if part.head.is_none() => return Err(error),
                Err(_) => {
                    part.clear(None)?;
                    continue;
                }
                Ok(()) => {}
            }
            let total = part.head.as_ref().map(|head| head.bytes);
            let mut shown = Transfer::start("fetching", total.unwrap_or(0), part.bytes.len() as u64);
            let mut pieces = pin!(transfer::pieces(response, SILENCE));
            let broken = loop {
                match pieces.next().await {
                    None => break None,
                    Some(Err(error)) => break Some(error),
                    Some(Ok(piece)) => {
                        part.take(&piece)?;
                        shown.at(part.bytes.len() as u64);
                        moved = Instant::now();
                    }
                }
            };
            drop(shown);
            let whole = match total {
                Some(total) => part.bytes.len() as u64 == total,
                None => broken.is_none(),
            };
            match broken {
                _ if whole && pieced && !is_picture(&part.bytes, format) => {
                    part.clear(None)?;
                    pieced = false;
                }
                _ if whole => return Ok(std::mem::take(&mut part.bytes)),
                Some(error) if moved.elapsed() > PATIENCE => return Err(error.into()),
                None if moved.elapsed() > PATIENCE => bail!("the picture ends early, again and again"),
                _ => {
                    pieced = part.head.is_some();
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
    }
}

/// Whether a range was refused: the picture is another one by now.
fn is_beyond(error: &anyhow::Error) -> bool {
    let problem = error.downcast_ref::<Problem>();
    problem.is_some_and(|problem| problem.code == ErrorCode::RangeNotSatisfiable)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head() -> Head {
        Head {
            source: "ab jobs/1/image.exr".into(),
            etag: "\"7\"".into(),
            bytes: 6,
        }
    }

    fn part_of(path: &Path) -> Part {
        Part::beside(path).unwrap()
    }

    #[test]
    fn what_has_arrived_is_there_for_the_next_command() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let mut first = part_of(&path);
        first.clear(Some(head())).unwrap();
        first.take(b"abc").unwrap();
        let beside = part_of(&path);
        assert!(beside.kept.is_none() && beside.head.is_none(), "another command has it");
        drop(first);
        let mut second = part_of(&path);
        assert_eq!(
            (second.head.as_ref(), second.bytes.as_slice()),
            (Some(&head()), &b"abc"[..])
        );
        assert!(second.take(b"defg").is_err(), "more than the picture has");
        second.cut(2).unwrap();
        second.take(b"cdef").unwrap();
        drop(second);
        let third = part_of(&path);
        assert_eq!(third.bytes, b"abcdef");
        assert_eq!(third.first_missing(&head()), 5, "one byte is always asked for");
        third.remove().unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn what_is_no_part_is_begun_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        for content in [
            "",
            "{",
            "a picture\n",
            "{\"source\":\"a\",\"etag\":\"\\\"7\\\"\",\"bytes\":-1}\n",
        ] {
            std::fs::write(folder.path().join(".a.exr.part"), content).unwrap();
            let mut part = part_of(&path);
            assert!(part.head.is_none() && part.bytes.is_empty(), "{content}");
            part.clear(Some(head())).unwrap();
            part.take(b"ab").unwrap();
            drop(part);
            assert_eq!(part_of(&path).bytes, b"ab", "{content}");
        }
    }
}

//! The audit log: who changed what, when, and what became of it. One line of JSON for each request that changes something.
//!
//! A line is written and synced before its request is answered; requests that come together share a sync. What cannot be written, as on a
//! full disk, does not stop the farm: it is counted, the log of the coordinator says so, and the next line that can be written says
//! how many are missing.

use crate::access::{Buckets, Caller};
use photonfarm_proto::id::JobId;
use photonfarm_proto::time::rfc3339;
use photonfarm_proto::token::Role;
use serde::Serialize;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::{mpsc, oneshot};

/// Lines that wait to be written; more are lost.
const WAITING: usize = 1024;
/// Longest wait of a request for its line.
const PATIENCE: Duration = Duration::from_secs(5);
/// Lines a second about requests of nobody who is known; more are counted only, so that strangers cannot fill the disk.
const STRANGERS_PER_SECOND: u32 = 5;

/// What a request was, and what became of it.
#[derive(Debug)]
pub(crate) struct Entry<'a> {
    /// Who asked, where that is known.
    pub(crate) caller: Option<&'a Caller>,
    /// Where the request came from.
    pub(crate) address: IpAddr,
    /// Its name.
    pub(crate) request_id: Option<String>,
    /// Its method.
    pub(crate) method: &'a str,
    /// The template of its path, where there is such a route.
    pub(crate) route: Option<&'a str>,
    /// Its path.
    pub(crate) path: &'a str,
    /// The job that it was about, or made.
    pub(crate) job: Option<JobId>,
    /// What else it made, by its name.
    pub(crate) made: Option<&'a str>,
    /// The status of the answer.
    pub(crate) status: u16,
}

/// An entry as it is written.
#[derive(Serialize)]
struct Line<'a> {
    at: String,
    request_id: Option<String>,
    token: Option<&'a str>,
    role: Option<Role>,
    address: IpAddr,
    method: &'a str,
    route: Option<&'a str>,
    path: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    job: Option<JobId>,
    #[serde(skip_serializing_if = "Option::is_none")]
    made: Option<&'a str>,
    status: u16,
}

/// What is not in the log.
#[derive(Serialize)]
struct Missing {
    at: String,
    /// Lines that could not be written.
    lost: u64,
    /// Requests of strangers beyond what is written of them.
    left_out: u64,
}

/// The audit log of a coordinator.
pub(crate) struct Audit {
    work: mpsc::Sender<Work>,
    strangers: Mutex<Buckets<()>>,
    left_out: Arc<AtomicU64>,
    lost: Arc<AtomicU64>,
}

enum Work {
    /// A line, and whoever waits for it.
    Line(Vec<u8>, oneshot::Sender<()>),
    /// The file was moved away.
    Reopen,
}

impl Audit {
    /// Opens or makes the file. Lines are counted as `lost` that cannot be written.
    ///
    /// # Errors
    /// The file cannot be opened.
    pub(crate) fn open(path: PathBuf, lost: Arc<AtomicU64>) -> std::io::Result<Self> {
        let file = open(&path)?;
        let (work, received) = mpsc::channel(WAITING);
        let left_out = Arc::<AtomicU64>::default();
        let writer = Writer {
            path,
            file,
            missing: 0,
            left_out: left_out.clone(),
            lost: lost.clone(),
        };
        std::thread::Builder::new()
            .name("audit".into())
            .spawn(move || writer.run(received))?;
        Ok(Self {
            work,
            strangers: Mutex::new(Buckets::new(STRANGERS_PER_SECOND)),
            left_out,
            lost,
        })
    }

    /// Writes an entry, and waits until it is safe.
    pub(crate) async fn note(&self, entry: Entry<'_>) {
        if entry.caller.is_none() {
            let mut strangers = self.strangers.lock().unwrap_or_else(PoisonError::into_inner);
            if strangers.take((), Instant::now()).is_err() {
                self.left_out.fetch_add(1, Ordering::Relaxed);
                return;
            }
        }
        let Some(line) = line(&Line {
            at: now(),
            request_id: entry.request_id,
            token: entry.caller.map(|caller| caller.name.as_str()),
            role: entry.caller.map(|caller| caller.role),
            address: entry.address,
            method: entry.method,
            route: entry.route,
            path: entry.path,
            job: entry.job,
            made: entry.made,
            status: entry.status,
        }) else {
            return;
        };
        let (written, wait) = oneshot::channel();
        if self.work.try_send(Work::Line(line, written)).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
            tracing::error!("a line of the audit log is lost: too many wait to be written");
            return;
        }
        if tokio::time::timeout(PATIENCE, wait).await.is_err() {
            tracing::error!("the audit log takes no lines: requests go on without");
        }
    }

    /// Opens the file again, which was moved away.
    pub(crate) async fn reopen(&self) {
        if self.work.send(Work::Reopen).await.is_err() {
            tracing::error!("the audit log is closed");
        }
    }
}

/// Writes lines, in a thread of its own.
struct Writer {
    path: PathBuf,
    file: File,
    /// Lines that were lost since the last one that was written.
    missing: u64,
    left_out: Arc<AtomicU64>,
    lost: Arc<AtomicU64>,
}

impl Writer {
    fn run(mut self, mut work: mpsc::Receiver<Work>) {
        let mut next = work.blocking_recv();
        while let Some(first) = next.take() {
            let (mut text, mut waiting) = (Vec::new(), Vec::new());
            let mut taken = Some(first);
            while let Some(Work::Line(line, written)) = taken {
                text.extend(line);
                waiting.push(written);
                taken = work.try_recv().ok();
            }
            if !waiting.is_empty() {
                self.write(text, waiting.len() as u64);
            }
            // Whoever has left waits no more.
            waiting.into_iter().for_each(|written| _ = written.send(()));
            if let Some(Work::Reopen) = taken {
                self.reopen();
            }
            next = work.blocking_recv();
        }
    }

    fn write(&mut self, lines: Vec<u8>, count: u64) {
        let left_out = self.left_out.swap(0, Ordering::Relaxed);
        let missing = Missing {
            at: now(),
            lost: self.missing,
            left_out,
        };
        let mut text = Vec::new();
        if missing.lost > 0 || missing.left_out > 0 {
            text.extend(line(&missing).unwrap_or_default());
        }
        text.extend(lines);
        match append(&mut self.file, &text) {
            Ok(()) => self.missing = 0,
            Err(error) => {
                self.missing += count;
                self.left_out.fetch_add(left_out, Ordering::Relaxed);
                self.lost.fetch_add(count, Ordering::Relaxed);
                tracing::error!(
                    "{count} lines of the audit log are lost: {}: {error}; the farm goes on",
                    self.path.display()
                );
            }
        }
    }

    fn reopen(&mut self) {
        match open(&self.path) {
            Ok(file) => {
                self.file = file;
                tracing::info!("the audit log was opened again: {}", self.path.display());
            }
            Err(error) => tracing::error!(
                "the audit log goes on in the file that was open: {}: {error}",
                self.path.display()
            ),
        }
    }
}

/// Appends lines and syncs them. Where that fails, what was written of them is taken back as well as that can be done.
fn append(file: &mut File, text: &[u8]) -> std::io::Result<()> {
    let before = file.metadata()?;
    let appended = file.write_all(text).and_then(|()| match before.is_file() {
        true => file.sync_data(),
        // A pipe or a device keeps nothing.
        false => Ok(()),
    });
    appended.inspect_err(|_| _ = file.set_len(before.len()))
}

/// Opens or makes the file, for its owner alone. A line that a crash has torn ends there.
fn open(path: &Path) -> std::io::Result<File> {
    let mut options = File::options();
    options.read(true).append(true).create(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(path)?;
    let metadata = file.metadata()?;
    if metadata.is_file() && metadata.len() > 0 {
        let mut last = [0];
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last)?;
        if last != *b"\n" {
            append(&mut file, b"\n")?;
        }
    }
    Ok(file)
}

/// Something as a line of JSON. What is written here can always be.
fn line(content: &impl Serialize) -> Option<Vec<u8>> {
    let mut line = serde_json::to_vec(content).ok()?;
    line.push(b'\n');
    Some(line)
}

fn now() -> String {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    rfc3339(since_1970.as_millis() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn entry<'a>(path: &'a str, caller: Option<&'a Caller>) -> Entry<'a> {
        Entry {
            caller,
            address: IpAddr::from([10, 0, 0, 7]),
            request_id: Some("abc".into()),
            method: "POST",
            route: None,
            path,
            job: None,
            made: None,
            status: 200,
        }
    }

    fn lines(path: &Path) -> Vec<Value> {
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    fn paths(path: &Path) -> Vec<String> {
        lines(path)
            .iter()
            .map(|line| line["path"].as_str().unwrap().to_owned())
            .collect()
    }

    #[tokio::test]
    async fn lines_are_there_when_their_request_is_answered_and_go_to_the_new_file_after_a_rotation() {
        let folder = tempfile::tempdir().unwrap();
        let (path, old) = (folder.path().join("audit"), folder.path().join("audit.1"));
        let audit = Audit::open(path.clone(), Arc::default()).unwrap();
        let ann = Caller {
            name: "ann".into(),
            ..Caller::anyone()
        };
        audit.note(entry("/a\n\"b\"", Some(&ann))).await;
        let written = &lines(&path)[0];
        assert_eq!((&written["token"], &written["role"]), (&"ann".into(), &"admin".into()));
        assert_eq!(
            (&written["address"], &written["status"]),
            (&"10.0.0.7".into(), &200.into())
        );
        assert!(photonfarm_proto::time::parsed(written["at"].as_str().unwrap()).is_some());
        std::fs::rename(&path, &old).unwrap();
        audit.note(entry("/moved", Some(&ann))).await;
        assert_eq!(paths(&old), ["/a\n\"b\"", "/moved"], "the file is open still");
        audit.reopen().await;
        let all = (0..100).map(|_| audit.note(entry("/new", Some(&ann))));
        futures_util::future::join_all(all).await;
        assert_eq!((lines(&old).len(), lines(&path).len()), (2, 100));
    }

    #[tokio::test]
    async fn a_line_that_a_crash_has_torn_spoils_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("audit");
        std::fs::write(&path, "{\"at\":\"20").unwrap();
        let audit = Audit::open(path.clone(), Arc::default()).unwrap();
        audit.note(entry("/a", None)).await;
        let text = std::fs::read_to_string(&path).unwrap();
        let (torn, whole) = text.split_once('\n').unwrap();
        assert_eq!(torn, "{\"at\":\"20");
        assert_eq!(serde_json::from_str::<Value>(whole).unwrap()["path"], "/a");
    }

    #[tokio::test]
    async fn strangers_cannot_fill_the_disk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("audit");
        let audit = Audit::open(path.clone(), Arc::default()).unwrap();
        for _ in 0..1000 {
            audit.note(entry("/a", None)).await;
        }
        let anyone = Caller::anyone();
        audit.note(entry("/b", Some(&anyone))).await;
        let lines = lines(&path);
        assert!(lines.len() < 200, "{}", lines.len());
        let left_out: u64 = lines.iter().filter_map(|line| line["left_out"].as_u64()).sum();
        let written = lines.iter().filter(|line| line["path"] == "/a").count() as u64;
        assert_eq!(left_out + written, 1000);
    }

    /// What is lost on a full disk is counted, and said once there is room.
    #[cfg(target_os = "linux")]
    #[tokio::test]
    async fn a_full_disk_stops_nobody_and_is_said_later() {
        let (lost, folder) = (Arc::<AtomicU64>::default(), tempfile::tempdir().unwrap());
        let path = folder.path().join("audit");
        std::os::unix::fs::symlink("/dev/full", &path).unwrap();
        let audit = Audit::open(path.clone(), lost.clone()).unwrap();
        let anyone = Caller::anyone();
        for _ in 0..3 {
            audit.note(entry("/lost", Some(&anyone))).await;
        }
        assert_eq!(lost.load(Ordering::Relaxed), 3);
        std::fs::remove_file(&path).unwrap();
        audit.reopen().await;
        audit.note(entry("/kept", Some(&anyone))).await;
        let lines = lines(&path);
        assert_eq!((&lines[0]["lost"], &lines[1]["path"]), (&3.into(), &"/kept".into()));
        assert_eq!(lines.len(), 2);
    }
}

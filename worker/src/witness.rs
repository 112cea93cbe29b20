//! A file of the cache folder that says what this process renders, for the next one to find if it is killed.
//!
//! Whoever runs out of memory is killed without a word. The next process on the folder finds the file unlocked, and asks
//! the kernel whether it has killed anybody for lack of memory since: on the machine (`oom_kill` of `/proc/vmstat`) or in
//! the control group (`memory.events`, of version 1 `memory.oom_control`). If so, it reports the lease as failed for lack
//! of memory; if not, nothing is known, and the lease ends by itself. What cannot be told: a kill by another program (such
//! as systemd-oomd), an allocation that is refused, which ends the process by SIGABRT, and whether it was another process
//! of the machine that was killed for lack of memory while this one was killed otherwise.

use crate::cache::Cache;
use crate::client::{Client, ClientError};
use crate::held::LeaseState;
use crate::memory::{Gauge, group_folders};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::job::FailureKind;
use photonfarm_proto::memory::Shortage;
use photonfarm_proto::worker::{Acknowledged, FailureReport, Lease, cut_text};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

/// How the names of such files begin.
const AT_WORK: &str = "at-work-";
/// Time between two looks at the memory that is held.
const LOOK: Duration = Duration::from_millis(250);
/// Most that is read of a file: it is written by this program, but may be damaged.
const FILE_BYTES: u64 = 1 << 16;

/// What is known when a lease begins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Contents {
    /// URL of the coordinator that lent it.
    coordinator: String,
    /// The worker's name for people.
    name: String,
    lease: Lease,
    /// Memory that the worker has said it has \[MiB\].
    memory_mb: Option<u32>,
    kills: Kills,
}

/// How often the kernel has killed for lack of memory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Kills {
    /// Since which start of the machine.
    boot: String,
    /// On the whole machine.
    machine: Option<u64>,
    /// In each of the control groups.
    groups: BTreeMap<PathBuf, u64>,
}

impl Kills {
    fn counted(proc: &Path, groups: &Path) -> Self {
        let boot = std::fs::read_to_string(proc.join("sys/kernel/random/boot_id")).unwrap_or_default();
        let of_group = |folder: PathBuf| {
            let files = ["memory.events", "memory.oom_control"].map(|name| folder.join(name));
            let count = files.iter().find_map(|file| count_in(file))?;
            Some((folder, count))
        };
        Self {
            boot: boot.trim().to_owned(),
            machine: count_in(&proc.join("vmstat")),
            groups: group_folders(proc, groups).into_iter().filter_map(of_group).collect(),
        }
    }

    fn now() -> Self {
        Self::counted(Path::new("/proc"), Path::new("/sys/fs/cgroup"))
    }

    /// Whether there were more since `before`.
    fn rose_since(&self, before: &Self) -> bool {
        let grew = |(group, count): (&PathBuf, &u64)| before.groups.get(group).is_some_and(|known| known < count);
        let machine = matches!((before.machine, self.machine), (Some(known), Some(count)) if known < count);
        self.boot == before.boot && (machine || self.groups.iter().any(grew))
    }
}

/// The number after `oom_kill` in a file of the kernel.
fn count_in(file: &Path) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let count = text.lines().find_map(|line| line.strip_prefix("oom_kill "))?;
    count.trim().parse().ok()
}

/// The file of a lease while it is worked on; it goes when this is dropped.
pub(crate) struct Witness {
    path: PathBuf,
    _watch: AbortOnDropHandle<()>,
}

impl Drop for Witness {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_file(&self.path) {
            tracing::debug!(%error, path = %self.path.display(), "a file of the cache cannot be removed");
        }
    }
}

/// Who works on a lease, with how much memory.
pub(crate) struct Bench<'a> {
    pub(crate) coordinator: &'a str,
    pub(crate) name: &'a str,
    /// Memory that the worker has said it has \[MiB\].
    pub(crate) memory_mb: Option<u32>,
    pub(crate) gauge: Gauge,
}

impl Cache {
    /// Says that a lease is worked on, and how far that is, until the witness is dropped.
    pub(crate) fn witness(&self, bench: Bench, lease: Lease, state: Arc<LeaseState>) -> io::Result<Witness> {
        let contents = Contents {
            coordinator: bench.coordinator.to_owned(),
            name: bench.name.to_owned(),
            lease,
            memory_mb: bench.memory_mb,
            kills: Kills::now(),
        };
        let (path, file, end) = self.begin(&contents)?;
        let watch = watch(file, end, bench.gauge, state);
        Ok(Witness {
            path,
            _watch: AbortOnDropHandle::new(tokio::spawn(watch)),
        })
    }

    /// Writes a file with its first line, and says where that ends.
    fn begin(&self, contents: &Contents) -> io::Result<(PathBuf, File, u64)> {
        let mut line = serde_json::to_vec(contents)?;
        line.push(b'\n');
        let mut file = self.part()?;
        file.write_all(&line)?;
        let path = self.root().join(format!("{AT_WORK}{}", BlobHash::of(&line)));
        let file = file.persist(&path).map_err(|error| error.error)?;
        Ok((path, file, line.len() as u64))
    }

    fn witnesses(&self) -> io::Result<Vec<PathBuf>> {
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(self.root())? {
            let entry = entry?;
            if entry.file_name().to_string_lossy().starts_with(AT_WORK) {
                paths.push(entry.path());
            }
        }
        paths.sort();
        Ok(paths)
    }
}

/// Writes down behind the first line how far the lease is and the most memory that was held, whenever either has changed.
/// The file is locked for as long as it is open.
async fn watch(file: File, end: u64, gauge: Gauge, state: Arc<LeaseState>) {
    let mut known = None;
    loop {
        let now = (state.leaves_done(), gauge.peak_mb().unwrap_or(0));
        if known != Some(now) {
            known = Some(now);
            if let Err(error) = note(&file, end, now) {
                tracing::debug!(%error, "how far a lease is cannot be written down");
            }
        }
        tokio::time::sleep(LOOK).await;
    }
}

fn note(mut file: &File, end: u64, (leaves_done, peak_mb): (u32, u32)) -> io::Result<()> {
    file.seek(SeekFrom::Start(end))?;
    file.write_all(format!("{leaves_done:10} {peak_mb:10}\n").as_bytes())
}

/// What a process left that ended without a word.
struct Found {
    contents: Contents,
    leaves_done: u32,
    peak_mb: Option<u32>,
    /// Locked until it is dropped.
    _file: File,
}

/// Reads what a process left; none while it lives.
fn read(path: &Path) -> io::Result<Option<Found>> {
    let file = File::open(path)?;
    if file.try_lock().is_err() {
        return Ok(None);
    }
    let mut text = String::new();
    (&file).take(FILE_BYTES).read_to_string(&mut text)?;
    let (first, rest) = text.split_once('\n').unwrap_or((&text, ""));
    let contents = serde_json::from_str(first)?;
    let mut numbers = rest.split_whitespace().map_while(|number| number.parse::<u32>().ok());
    Ok(Some(Found {
        contents,
        leaves_done: numbers.next().unwrap_or(0),
        peak_mb: numbers.next().filter(|peak| *peak > 0),
        _file: file,
    }))
}

impl Found {
    /// What is said of the lease, if its process ran out of memory.
    fn report(&self, now: &Kills) -> Option<FailureReport> {
        let Contents {
            name,
            lease,
            memory_mb,
            kills,
            ..
        } = &self.contents;
        if !now.rose_since(kills) {
            return None;
        }
        let known = |memory: Option<u32>| memory.map_or_else(|| "an unknown number of".to_owned(), |mb| mb.to_string());
        let message = format!(
            "worker {} ({name}) ran out of memory: it was killed when it had {} MiB of {} MiB",
            lease.worker,
            known(self.peak_mb),
            known(*memory_mb)
        );
        let leaf = (lease.node.first() + u64::from(self.leaves_done)).min(lease.node.end() - 1);
        Some(FailureReport {
            token: lease.token,
            worker: lease.worker,
            job: lease.job,
            leaf: leaf as u32,
            kind: FailureKind::OutOfMemory,
            message: cut_text(message),
            shortage: Some(Shortage {
                held_mb: self.peak_mb,
                has_mb: *memory_mb,
            }),
        })
    }
}

/// Reports the leases of processes on this folder that were killed, since memory had run out. Of other coordinators
/// nothing is said.
pub(crate) async fn report_killed(client: &Client, cache: &Cache, stop: &CancellationToken) {
    let paths = cache.witnesses().unwrap_or_else(|error| {
        tracing::warn!(%error, "what an earlier process was at cannot be looked for");
        Vec::new()
    });
    let now = Kills::now();
    for path in paths {
        let found = match read(&path) {
            Ok(Some(found)) if found.contents.coordinator == client.coordinator() => found,
            Ok(_) => continue,
            // Another process on the folder was faster.
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            Err(error) => {
                tracing::warn!(path = %path.display(), %error, "what an earlier process was at cannot be read");
                let _gone = std::fs::remove_file(&path);
                continue;
            }
        };
        let Lease { job, node, .. } = found.contents.lease;
        match found.report(&now) {
            Some(report) => {
                tracing::warn!(%job, %node, "an earlier process was killed: {}", report.message);
                let said: Result<Acknowledged, _> = client.insist("worker/failures", &report, stop).await;
                match said {
                    Ok(Acknowledged) => {}
                    Err(ClientError::Stopping) => return,
                    Err(error) => tracing::info!(%job, %node, %error, "that is not heard any more"),
                }
            }
            None => tracing::info!(%job, %node, "an earlier process ended without a word, and not for lack of memory"),
        }
        if let Err(error) = std::fs::remove_file(&path) {
            tracing::warn!(path = %path.display(), %error, "what an earlier process was at cannot be removed");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_proto::id::{JobId, LeaseToken, WorkerId};
    use photonfarm_proto::node::NodeKey;
    use photonfarm_proto::trace::Context;

    fn kills(machine: Option<u64>, group: Option<u64>) -> Kills {
        Kills {
            boot: "a".into(),
            machine,
            groups: group.map(|count| (PathBuf::from("/g"), count)).into_iter().collect(),
        }
    }

    fn contents() -> Contents {
        Contents {
            coordinator: "http://a/".into(),
            name: "rack".into(),
            lease: Lease {
                token: LeaseToken { number: 9, nonce: 8 },
                job: JobId(3),
                node: NodeKey { level: 2, index: 1 },
                worker: WorkerId(4),
                attempt: 1,
                expires_in_ms: 30_000,
                ends_in_ms: None,
                trace: Context::default(),
            },
            memory_mb: Some(2048),
            kills: kills(Some(5), None),
        }
    }

    #[test]
    fn a_kill_for_lack_of_memory_is_told_from_another_end() {
        let before = kills(Some(5), Some(1));
        for (now, rose) in [
            (kills(Some(5), Some(1)), false),
            (kills(Some(6), Some(1)), true),
            (kills(Some(5), Some(2)), true),
            // A service that is started again has a new group, which counts from zero.
            (kills(Some(6), Some(0)), true),
            (kills(None, None), false),
        ] {
            assert_eq!(now.rose_since(&before), rose, "{now:?}");
        }
        let other = Kills {
            boot: "b".into(),
            ..kills(Some(9), Some(9))
        };
        assert!(!other.rose_since(&before), "the machine was started again");
    }

    #[test]
    fn what_a_killed_process_was_at_is_read_by_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 100).unwrap();
        let (path, file, end) = cache.begin(&contents()).unwrap();
        assert_eq!(cache.witnesses().unwrap(), std::slice::from_ref(&path));
        assert!(read(&path).unwrap().is_none(), "it lives");
        for now in [(2, 1999), (3, 700)] {
            note(&file, end, now).unwrap();
        }
        drop(file);
        let found = read(&path).unwrap().unwrap();
        assert_eq!(found.contents, contents());
        assert_eq!(found.report(&kills(Some(5), None)), None);
        let report = found.report(&kills(Some(6), None)).unwrap();
        assert_eq!((report.leaf, report.kind), (7, FailureKind::OutOfMemory));
        assert_eq!(
            report.message,
            "worker 4 (rack) ran out of memory: it was killed when it had 700 MiB of 2048 MiB"
        );
        drop(found);
        std::fs::write(&path, b"{").unwrap();
        assert!(read(&path).is_err(), "it is damaged");
    }

    #[test]
    fn counts_are_those_of_the_kernels_files() {
        let folder = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = folder.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        write("proc/vmstat", "pgfault 7\noom_kill 3\noom_kill_other 9\n");
        write("proc/sys/kernel/random/boot_id", "b\n");
        write("proc/self/cgroup", "0::/a\n");
        write("groups/a/memory.events", "oom 4\noom_kill 2\n");
        let found = Kills::counted(&folder.path().join("proc"), &folder.path().join("groups"));
        assert_eq!((found.boot.as_str(), found.machine), ("b", Some(3)));
        assert_eq!(found.groups.into_values().collect::<Vec<_>>(), [2]);
    }
}

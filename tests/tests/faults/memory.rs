//! Workers that the kernel kills, since memory runs out.

use photonfarm_proto::job::{FailureKind, JobState, JobStatus};
use photonfarm_proto::waiting::Waiting;
use photonfarm_tests::processes::{Coordinator, Launch, Process, get, jobs, photonfarm, printed, scene, wait_for};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};

/// Memory of the small worker [MiB]: enough to begin with, and less than the job takes.
const SMALL_MB: u32 = 48;

/// A control group with a limit of memory. Its processes have to end before it does.
struct Group(PathBuf);

impl Group {
    /// Makes a group below that of this process.
    fn new(limit_mb: u32) -> Self {
        let text = std::fs::read_to_string("/proc/self/cgroup").unwrap();
        let of_memory = |line: &&str| line.split(':').nth(1).is_some_and(|names| names.contains("memory"));
        let line = text.lines().find(of_memory).or_else(|| text.lines().last()).unwrap();
        let path = line.splitn(3, ':').nth(2).unwrap().trim_start_matches('/');
        let (root, name) = match of_memory(&line) {
            true => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
            false => ("/sys/fs/cgroup", "memory.max"),
        };
        let parent = Path::new(root).join(path);
        if !of_memory(&line) {
            let _there_already = std::fs::write(parent.join("cgroup.subtree_control"), "+memory");
        }
        let group = parent.join(format!("photonfarm-tests-{}", std::process::id()));
        let made = std::fs::create_dir(&group).and_then(|()| {
            let bytes = u64::from(limit_mb) << 20;
            std::fs::write(group.join(name), bytes.to_string())
        });
        made.unwrap_or_else(|error| panic!("{}: {error}: this test needs control groups of memory", group.display()));
        Self(group)
    }

    /// A worker in the group.
    fn worker(&self, url: &str, cache: &Path) -> Process {
        let enter = format!("echo $$ > {}/cgroup.procs; exec \"$@\"", self.0.display());
        let launch = Launch {
            wrapper: ["sh", "-c", &enter, "sh"].map(str::to_owned).to_vec(),
            ..Launch::default()
        };
        Process::spawn(launch.command("photonfarm-worker", &arguments(url, cache)))
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        // The last process may take a moment to leave.
        wait_for("a control group to be left", || std::fs::remove_dir(&self.0).ok());
    }
}

fn arguments<'a>(url: &'a str, cache: &'a Path) -> [&'a str; 8] {
    let cache = cache.to_str().unwrap();
    [
        "--coordinator",
        url,
        "--threads",
        "1",
        "--name",
        "small",
        "--cache",
        cache,
    ]
}

fn when(url: &str, what: &str, condition: impl Fn(&JobStatus) -> bool) -> JobStatus {
    wait_for(what, || jobs(url)?.into_iter().next().filter(|job| condition(job)))
}

#[test]
fn a_job_that_takes_too_much_memory_is_left_to_a_larger_worker_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let mut coordinator = Coordinator::start(&folder.path().join("data"));
    let url = coordinator.url.clone();
    let scene = scene("environment.xml");
    printed(&photonfarm(&[
        "submit",
        scene.to_str().unwrap(),
        "--coordinator",
        &url,
        "--iterations",
        "1",
        "--integrator",
        "path",
        "--set",
        "samples=1",
        "-D",
        // Its pixels take more than a hundred megabytes.
        "res=2048",
    ]));
    let group = Group::new(SMALL_MB);
    for round in 0..3 {
        let (status, _, errors) = group.worker(&url, &cache).finish();
        assert_eq!(status.signal(), Some(9), "{errors}");
        let reported = errors.contains("ran out of memory: it was killed when it had");
        assert_eq!(reported, round > 0, "{errors}");
    }
    let small = group.worker(&url, &cache);
    let status = when(&url, "a job that nobody has the memory for", |job| {
        job.waiting_reason == Some(Waiting::Memory)
    });
    let text = status.waiting.unwrap();
    assert!(
        text.starts_with(&format!("workers with {SMALL_MB} MiB of memory ran out of it")),
        "{text}"
    );
    assert!(status.memory_mb.unwrap() <= SMALL_MB && status.poisoned.is_empty());
    let log = printed(&photonfarm(&["logs", "1", "--coordinator", &url]));
    assert_eq!(log.matches(&format!("MiB of {SMALL_MB} MiB")).count(), 3, "{log}");
    let history: serde_json::Value = get(&format!("{url}/v1/jobs/1/history")).unwrap();
    let kind = serde_json::to_value(FailureKind::OutOfMemory).unwrap();
    assert_eq!(history["failures"][0]["attempts"][0]["kind"], kind);

    let large = Process::start(
        "photonfarm-worker",
        &arguments(&url, &folder.path().join("other cache")),
    );
    let status = when(&url, "the end of the job", |job| job.state.ended());
    assert_eq!(status.state, JobState::Done, "{status:?}");
    assert!(status.memory_mb.unwrap() > SMALL_MB);
    for worker in [small, large] {
        worker.signal("TERM");
        let (status, _, errors) = worker.finish();
        assert!(status.success(), "{errors}");
    }
    let left = std::fs::read_dir(&cache).unwrap().map(|file| file.unwrap().file_name());
    let left: Vec<_> = left
        .filter(|name| name.to_string_lossy().starts_with("at-work-"))
        .collect();
    assert!(left.is_empty(), "{left:?}");
    let (status, ..) = coordinator.stop().finish();
    assert!(status.success());
}

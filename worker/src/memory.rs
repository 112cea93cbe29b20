//! Memory of this machine, and of this process.

use photonfarm_proto::memory::{MOST_MEMORY_MB, step_down};
use std::path::{Path, PathBuf};

/// Memory that jobs may take of this machine, if that can be told \[MiB\]: all that the machine has, to a step down, so
/// that machines of a kind are alike; or less, where a control group has a limit.
#[must_use]
pub fn available_mb() -> Option<u32> {
    let machine = std::fs::read_to_string("/proc/meminfo").ok();
    let machine = machine.and_then(|text| kibibytes(&text, "MemTotal:"));
    let machine = machine.map(|kibibytes| step_down(mebibytes(1024 * kibibytes)));
    let groups = group_folders(Path::new("/proc"), Path::new("/sys/fs/cgroup"));
    let limit = limit_of(&groups).map(mebibytes);
    machine.into_iter().chain(limit).min().filter(|memory| *memory > 0)
}

/// Bytes in whole mebibytes.
fn mebibytes(bytes: u64) -> u32 {
    u32::try_from(bytes >> 20).unwrap_or(u32::MAX).min(MOST_MEMORY_MB)
}

/// A value of a file such as `/proc/meminfo` or `/proc/self/status`, which are in kibibytes.
fn kibibytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse().ok()
}

/// The folders of the control groups that bound the memory of this process, its own first: of version 2, or of version 1
/// where that has the memory.
pub(crate) fn group_folders(proc: &Path, groups: &Path) -> Vec<PathBuf> {
    let text = std::fs::read_to_string(proc.join("self/cgroup")).unwrap_or_default();
    let entries = text.lines().filter_map(|line| {
        let mut parts = line.splitn(3, ':').skip(1);
        Some((parts.next()?, parts.next()?))
    });
    let mut folders = Vec::new();
    for (controllers, path) in entries {
        let root = match controllers {
            "" => groups.to_owned(),
            _ if controllers.split(',').any(|name| name == "memory") => groups.join("memory"),
            _ => continue,
        };
        let own = root.join(path.trim_start_matches('/'));
        let within = own.ancestors().take_while(|folder| folder.starts_with(&root));
        folders.extend(within.map(Path::to_owned));
    }
    folders
}

/// The lowest limit of memory of some control groups [bytes].
fn limit_of(folders: &[PathBuf]) -> Option<u64> {
    let limits = folders.iter().flat_map(|folder| {
        let names = ["memory.max", "memory.limit_in_bytes"];
        names.map(|name| std::fs::read_to_string(folder.join(name)))
    });
    // Version 2 says `max` where there is none, version 1 a number beyond all memory.
    limits.flatten().filter_map(|text| text.trim().parse().ok()).min()
}

/// The most memory that this process holds at a time, from when it is told to begin. It is the process's as a whole: its
/// scene, what is rendered and what waits for delivery; two jobs at once cannot be told apart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gauge {
    /// The mark as it was, where it cannot be set back.
    before_mb: Option<u32>,
}

impl Gauge {
    /// Begins: the kernel's high-water mark is set back to what is held now (`clear_refs` of proc(5)).
    pub(crate) fn begin() -> Self {
        let is_set_back = std::fs::write("/proc/self/clear_refs", "5").is_ok();
        Self {
            before_mb: if is_set_back { None } else { high_water_mb() },
        }
    }

    /// The most since then \[MiB\]. Where the mark cannot be set back, it is known only if it has risen.
    pub(crate) fn peak_mb(&self) -> Option<u32> {
        high_water_mb().filter(|peak| Some(*peak) > self.before_mb)
    }
}

/// The high-water mark of resident memory, `VmHWM` of proc(5) \[MiB\], rounded up.
fn high_water_mb() -> Option<u32> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let kibibytes = kibibytes(&status, "VmHWM:")?;
    Some(u32::try_from(kibibytes.div_ceil(1024)).ok()?.min(MOST_MEMORY_MB))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn the_gauge_sees_what_is_held_and_forgets_what_was() {
        let touched = |bytes: usize| std::hint::black_box(vec![1u8; bytes]);
        let gauge = Gauge::begin();
        drop(touched(300 << 20));
        let peak = gauge.peak_mb().unwrap();
        assert!(peak >= 300, "{peak}");
        let again = Gauge::begin();
        if again.before_mb.is_none() {
            let later = again.peak_mb().unwrap();
            assert!(later < 300, "{later}");
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_machine_has_memory() {
        let memory = available_mb().unwrap();
        assert!((64..=MOST_MEMORY_MB).contains(&memory), "{memory}");
    }

    #[test]
    fn the_lowest_limit_of_nested_groups_holds() {
        let folder = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = folder.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        let found = || {
            limit_of(&group_folders(
                &folder.path().join("proc"),
                &folder.path().join("groups"),
            ))
        };
        assert_eq!(found(), None, "there are none");
        write("proc/self/cgroup", "0::/a.slice/b.service\n");
        write("groups/a.slice/b.service/memory.max", "max\n");
        assert_eq!(found(), None);
        write("groups/a.slice/memory.max", "3000\n");
        assert_eq!(found(), Some(3000));
        write("groups/a.slice/b.service/memory.max", "2000\n");
        assert_eq!(found(), Some(2000));
        write("proc/self/cgroup", "5:cpu:/x\n4:memory,hugetlb:/c\n0::/\n");
        write("groups/memory/c/memory.limit_in_bytes", "9223372036854771712\n");
        write("groups/memory/memory.limit_in_bytes", "5000\n");
        assert_eq!(found(), Some(5000));
    }
}

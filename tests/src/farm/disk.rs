//! Small disks that run full.

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Mounts a file system in memory, waits for the end of its standard input, and takes it away.
const SCRIPT: &str = "mount -t tmpfs -o size=\"$1\"m photonfarm-tests \"$2\" && echo ready && cat; \
                      cd / && umount --lazy \"$2\" && rmdir \"$2\"";

/// A file system of a bounded size. It is gone when this is dropped, and also when this process ends in any other way.
#[derive(Debug)]
pub struct Disk {
    folder: PathBuf,
    reaper: Child,
}

impl Disk {
    /// Makes a disk of so many megabytes.
    ///
    /// # Panics
    /// Where this process may not mount file systems.
    #[must_use]
    pub fn new(megabytes: u32) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder").keep();
        let mut reaper = Command::new("sh");
        reaper
            .args(["-c", SCRIPT, "reaper", &megabytes.to_string()])
            .arg(&folder);
        reaper.stdin(Stdio::piped()).stdout(Stdio::piped());
        // A signal to the group of this process, such as Ctrl-C, must not end what tidies up after it.
        let mut reaper = reaper.process_group(0).spawn().expect("sh runs");
        let mut ready = [0; 6];
        let said = reaper.stdout.as_mut().expect("piped").read_exact(&mut ready);
        assert!(
            said.is_ok() && ready == *b"ready\n",
            "a small disk cannot be mounted: these tests need the rights of root (CAP_SYS_ADMIN)"
        );
        Self { folder, reaper }
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.folder
    }

    fn ballast(&self) -> PathBuf {
        self.folder.join("ballast")
    }

    /// Takes all the room that is left.
    ///
    /// # Panics
    /// Where the disk fails in another way than by being full.
    pub fn fill(&self) {
        let ballast = File::options().create(true).append(true).open(self.ballast());
        let mut ballast = ballast.expect("a file on the disk");
        let piece = [1; 1 << 16];
        let mut length = piece.len();
        while length > 0 {
            match ballast.write_all(&piece[..length]) {
                Ok(()) => {}
                Err(error) if error.kind() == ErrorKind::StorageFull => length /= 2,
                Err(error) => panic!("the ballast cannot be written: {error}"),
            }
        }
    }

    /// Gives the room back.
    ///
    /// # Panics
    /// Where that fails.
    pub fn free(&self) {
        std::fs::remove_file(self.ballast()).expect("the ballast can be removed");
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        drop(self.reaper.stdin.take());
        let _ended = self.reaper.wait();
    }
}

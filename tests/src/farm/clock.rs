//! Programs that see a wrong wall clock, by libfaketime.

use crate::processes::Launch;
use tempfile::NamedTempFile;

/// Starts a program whose wall clock is wrong by so much, such as `+6h` or `-6h`. Its other clocks are right, as they
/// are where somebody sets the time of a machine.
///
/// # Panics
/// Where libfaketime is not installed.
#[must_use]
pub fn wrong_clock(offset: &str) -> Launch {
    faked("FAKETIME", offset)
}

/// A wall clock that is set while programs run.
#[derive(Debug)]
pub struct Clock(NamedTempFile);

impl Clock {
    /// A clock that is wrong by so much, such as `+6h`.
    ///
    /// # Panics
    /// Where there is no room for a file.
    #[must_use]
    pub fn new(offset: &str) -> Self {
        let clock = Self(NamedTempFile::new().expect("a temporary file"));
        clock.set(offset);
        clock
    }

    /// Sets it.
    ///
    /// # Panics
    /// Where that fails.
    pub fn set(&self, offset: &str) {
        std::fs::write(self.0.path(), offset).expect("the clock can be set");
    }

    /// Starts a program with this clock.
    ///
    /// # Panics
    /// Where libfaketime is not installed.
    #[must_use]
    pub fn launch(&self) -> Launch {
        let mut launch = faked("FAKETIME_TIMESTAMP_FILE", self.0.path().to_str().expect("a UTF-8 path"));
        launch.environment.push(("FAKETIME_NO_CACHE".into(), "1".into()));
        launch
    }
}

fn faked(variable: &str, value: &str) -> Launch {
    let folders = std::fs::read_dir("/usr/lib").into_iter().flatten().flatten();
    let library = folders
        .map(|folder| folder.path().join("faketime/libfaketimeMT.so.1"))
        .find(|library| library.exists())
        .expect("libfaketime is not installed: these tests need it (apt-get install faketime; tests/run does so)");
    Launch::with(&[
        ("LD_PRELOAD", library.to_str().expect("a UTF-8 path").to_owned()),
        (variable, value.to_owned()),
        ("FAKETIME_DONT_FAKE_MONOTONIC", "1".to_owned()),
        ("DONT_FAKE_MONOTONIC", "1".to_owned()),
    ])
}

//! Small jobs, and what they come to by one process with one thread.

use crate::processes::{photonfarm, printed, scene};
use photonfarm_core::integrator::Counts;
use serde_json::Value;
use std::sync::Arc;

/// A job on a test scene.
#[derive(Clone, Debug)]
pub struct Job {
    /// The scene's name.
    pub scene: &'static str,
    /// The integrator's name.
    pub integrator: &'static str,
    /// Pixels across and down.
    pub size: u32,
    /// Iterations to average.
    pub iterations: u32,
    /// Further options, such as `--set`.
    pub more: &'static [&'static str],
}

impl Job {
    /// The scene and the options that `render` and `submit` share.
    #[must_use]
    pub fn options(&self) -> Vec<String> {
        let scene = scene(&format!("{}.xml", self.scene))
            .to_str()
            .expect("a UTF-8 path")
            .to_owned();
        let mut options = vec![scene, "--integrator".into(), self.integrator.into()];
        options.extend(["--iterations".into(), self.iterations.to_string()]);
        options.extend(["--seed".into(), "7".into(), "-D".into(), format!("res={}", self.size)]);
        options.extend(self.more.iter().map(|option| (*option).to_owned()));
        options
    }

    /// Renders it by one process with one thread.
    ///
    /// # Panics
    /// Where that fails.
    #[must_use]
    pub fn alone(self) -> Arc<Reference> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = |name: &str| folder.path().join(name).to_str().expect("a UTF-8 path").to_owned();
        let (picture, stats) = (path("alone.exr"), path("stats.json"));
        let mut arguments = vec!["render".to_owned()];
        arguments.extend(self.options());
        arguments.extend(["-o", &picture, "--stats", &stats, "--threads", "1"].map(str::to_owned));
        printed(&photonfarm(&arguments));
        let stats: Value = serde_json::from_slice(&std::fs::read(stats).expect("the statistics")).expect("JSON");
        let count = |name: &str| stats[name].as_u64().expect("a count");
        Arc::new(Reference {
            job: self,
            picture: std::fs::read(picture).expect("the picture"),
            counts: Counts {
                light_paths: count("light_paths"),
                records_stored: count("records_stored"),
                records_read: count("records_read"),
                records_counted: count("records_counted"),
                rays: count("rays"),
            },
        })
    }
}

/// What a job comes to.
#[derive(Clone, Debug)]
pub struct Reference {
    /// The job.
    pub job: Job,
    /// The picture's file.
    pub picture: Vec<u8>,
    /// Light paths, records and rays of all iterations.
    pub counts: Counts,
}

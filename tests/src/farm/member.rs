//! Processes of a farm that are killed, stopped and started again; what they log is kept.

use super::books::Stores;
use super::client::Client;
use crate::processes::{Launch, Process, serve_command, try_to_serve};
use photonfarm_proto::id::BlobHash;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A coordinator.
#[derive(Debug)]
pub struct Server {
    /// How it is started; may be changed between two lives.
    pub launch: Launch,
    arguments: Vec<String>,
    url: String,
    process: Option<Process>,
    earlier: String,
}

impl Server {
    /// Starts a coordinator on the stores.
    ///
    /// # Panics
    /// Where it does not say that it listens.
    #[must_use]
    pub fn start(mut launch: Launch, stores: &Stores, listen: &str, more: &[&str]) -> Self {
        launch.environment.extend(stores.environment.clone());
        let mut arguments: Vec<String> = ["serve", "--state", &stores.state, "--blobs", &stores.blobs]
            .map(str::to_owned)
            .into();
        arguments.extend(more.iter().map(|option| (*option).to_owned()));
        let place = |address: &str| [arguments.clone(), vec!["--listen".into(), address.into()]].concat();
        let (process, url) = serve_command(launch.command("photonfarm", &place(listen)));
        let address = url.rsplit('/').next().expect("an address").to_owned();
        Self {
            arguments: place(&address),
            launch,
            url,
            process: Some(process),
            earlier: String::new(),
        }
    }

    /// Where it answers.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// The running process.
    ///
    /// # Panics
    /// Where it was killed or stopped.
    pub fn process(&mut self) -> &mut Process {
        self.process.as_mut().expect("the coordinator was started")
    }

    /// SIGKILL.
    ///
    /// # Panics
    /// Where it does not run.
    pub fn kill(&mut self) {
        let process = self.process.take().expect("the coordinator was started");
        self.earlier += &process.kill();
    }

    /// Starts it again at the same address, and waits until it listens.
    ///
    /// # Panics
    /// Where it does not.
    pub fn resume(&mut self) {
        let (process, url) = serve_command(self.launch.command("photonfarm", &self.arguments));
        assert_eq!(url, self.url);
        self.process = Some(process);
    }

    /// Starts it again and kills it after so much time, wherever it is then.
    ///
    /// # Panics
    /// Where it ends by itself.
    pub fn start_in_vain(&mut self, after: Duration) {
        let process = Process::spawn(self.launch.command("photonfarm", &self.arguments));
        std::thread::sleep(after);
        self.earlier += &process.kill();
    }

    /// Starts it again where it may not be able to. Otherwise it says why, and ends.
    ///
    /// # Panics
    /// Where it ends in another way.
    #[must_use]
    pub fn try_to_resume(&mut self) -> bool {
        match try_to_serve(self.launch.command("photonfarm", &self.arguments)) {
            Ok((process, _)) => self.process = Some(process),
            Err((status, errors)) => {
                assert_eq!(status.code(), Some(1), "{errors}");
                self.earlier += &errors;
            }
        }
        self.process.is_some()
    }

    /// SIGTERM, and waits for a clean end.
    ///
    /// # Panics
    /// Where it ends with an error.
    pub fn stop(&mut self) {
        self.earlier += &stop(self.process.take().expect("the coordinator was started"));
    }

    /// All that it has logged in all its lives.
    #[must_use]
    pub fn log(&self) -> String {
        self.earlier.clone() + &self.process.as_ref().map(Process::errors).unwrap_or_default()
    }
}

/// A worker.
#[derive(Debug)]
pub struct Worker {
    /// How it is started; may be changed between two lives.
    pub launch: Launch,
    arguments: Vec<String>,
    /// Its cache, if it is a folder that this process reaches.
    cache: PathBuf,
    process: Option<Process>,
    earlier: String,
}

impl Worker {
    /// Starts a worker of one thread.
    ///
    /// # Panics
    /// Where it cannot be started.
    #[must_use]
    pub fn start(mut launch: Launch, client: &Client, name: &str, cache: &Path) -> Self {
        if let Some(token) = client.token() {
            launch.environment.push(("PHOTONFARM_TOKEN".into(), token.into()));
        }
        let cache_name = cache.to_str().expect("a UTF-8 path");
        let arguments = [
            "--coordinator",
            &client.url,
            "--threads",
            "1",
            "--name",
            name,
            "--cache",
            cache_name,
        ];
        let mut worker = Self {
            launch,
            arguments: arguments.map(str::to_owned).into(),
            cache: cache.to_owned(),
            process: None,
            earlier: String::new(),
        };
        worker.resume();
        worker
    }

    /// The running process.
    ///
    /// # Panics
    /// Where it was killed or stopped.
    pub fn process(&mut self) -> &mut Process {
        self.process.as_mut().expect("the worker was started")
    }

    /// SIGKILL.
    ///
    /// # Panics
    /// Where it does not run.
    pub fn kill(&mut self) {
        let process = self.process.take().expect("the worker was started");
        self.earlier += &process.kill();
    }

    /// Starts it again.
    ///
    /// # Panics
    /// Where it cannot be started.
    pub fn resume(&mut self) {
        self.process = Some(Process::spawn(
            self.launch.command("photonfarm-worker", &self.arguments),
        ));
    }

    /// Removes the files of scenes from its cache, as somebody does who needs the room.
    ///
    /// # Panics
    /// Where they cannot be removed.
    pub fn forget_scenes(&self) {
        for (path, name) in files(&self.cache) {
            if name.parse::<BlobHash>().is_ok() {
                std::fs::remove_file(path).expect("a file of the cache can be removed");
            }
        }
    }

    /// SIGTERM, and waits for a clean end.
    ///
    /// # Panics
    /// Where it ends with an error.
    pub fn stop(&mut self) {
        self.earlier += &stop(self.process.take().expect("the worker was started"));
    }

    /// All that it has logged in all its lives.
    #[must_use]
    pub fn log(&self) -> String {
        self.earlier.clone() + &self.process.as_ref().map(Process::errors).unwrap_or_default()
    }

    /// Its cache holds files of scenes, whole, and nothing else.
    ///
    /// # Panics
    /// Where there is something else.
    pub fn check_cache(&self) {
        for (path, name) in files(&self.cache) {
            let hash: BlobHash = name
                .parse()
                .unwrap_or_else(|_| panic!("{} is left over", path.display()));
            let bytes = std::fs::read(&path).expect("a file of the cache");
            assert_eq!(BlobHash::of(&bytes), hash, "{} is damaged", path.display());
        }
    }
}

fn files(folder: &Path) -> Vec<(PathBuf, String)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let named = entries.map(|entry| (entry.path(), entry.file_name().to_string_lossy().into_owned()));
    named.collect()
}

fn stop(mut process: Process) -> String {
    assert!(
        process.is_running(),
        "the process ended by itself:\n{}",
        process.errors()
    );
    process.signal("TERM");
    let (status, _, errors) = process.finish();
    assert!(status.success(), "ended with {status} after SIGTERM:\n{errors}");
    errors
}

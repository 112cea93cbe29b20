//! Farms of real processes that are made to fail, and the proof that nothing came of it.

mod balance;
mod books;
mod client;
mod clock;
mod disk;
mod job;
mod member;
mod network;
mod random;

pub use balance::balance;
pub use books::Stores;
pub use client::Client;
pub use clock::{Clock, wrong_clock};
pub use disk::Disk;
pub use job::{Job, Reference};
pub use member::{Server, Worker};
pub use network::{Host, Network};
pub use random::Random;

use crate::processes::{Launch, wait_for};
use photonfarm_proto::id::JobId;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tempfile::TempDir;

/// Coordinators, workers, and the jobs that they were given.
pub struct Farm {
    /// The coordinators, in the order of their first start.
    pub servers: Vec<Server>,
    /// The workers, likewise.
    pub workers: Vec<Worker>,
    /// Where clients and workers send their requests.
    pub client: Client,
    stores: Stores,
    jobs: Vec<(JobId, Arc<Reference>)>,
    folder: TempDir,
}

impl Farm {
    /// A farm of one coordinator that keeps everything in a folder of this test, with further options of `serve`.
    ///
    /// # Panics
    /// Where it does not start.
    #[must_use]
    pub fn start(more: &[&str]) -> Self {
        let folder = folder();
        let stores = Stores::folder(&folder.path().join("farm"));
        Self::with(folder, &stores, &[Launch::default()], "127.0.0.1:0", more)
    }

    /// A farm of so many coordinators on stores of the test's, behind a load balancer if they are several.
    ///
    /// # Panics
    /// Where one does not start.
    #[must_use]
    pub fn on(stores: &Stores, servers: usize) -> Self {
        let launches = vec![Launch::default(); servers];
        Self::with(folder(), stores, &launches, "127.0.0.1:0", &[])
    }

    /// A farm of one coordinator, on stores of the test's and at an address of it.
    ///
    /// # Panics
    /// Where it does not start.
    #[must_use]
    pub fn at(listen: &str, stores: &Stores) -> Self {
        Self::with(folder(), stores, &[Launch::default()], listen, &[])
    }

    /// A farm of one coordinator on each of these hosts; clients and workers ask the last of them.
    ///
    /// # Panics
    /// Where one does not start.
    #[must_use]
    pub fn across(hosts: &[Host], stores: &Stores) -> Self {
        let start = |host: &Host| Server::start(host.launch(), stores, &format!("{}:7800", host.address()), &[]);
        let servers: Vec<Server> = hosts.iter().map(start).collect();
        Self {
            client: Client::new(servers.last().expect("a host").url()),
            servers,
            workers: Vec::new(),
            stores: stores.clone(),
            jobs: Vec::new(),
            folder: folder(),
        }
    }

    fn with(folder: TempDir, stores: &Stores, launches: &[Launch], listen: &str, more: &[&str]) -> Self {
        let start = |launch: &Launch| Server::start(launch.clone(), stores, listen, more);
        let servers: Vec<Server> = launches.iter().map(start).collect();
        let url = match servers.as_slice() {
            [one] => one.url().to_owned(),
            several => balance(&several.iter().map(Server::url).collect::<Vec<_>>()),
        };
        Self {
            servers,
            workers: Vec::new(),
            client: Client::new(&url),
            stores: stores.clone(),
            jobs: Vec::new(),
            folder,
        }
    }

    /// The folder of this test.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Starts workers of one thread each.
    ///
    /// # Panics
    /// Where one cannot be started.
    pub fn hire(&mut self, count: usize) {
        (0..count).for_each(|_| self.hire_with(Launch::default(), None));
    }

    /// Starts a worker in another way, perhaps with a cache elsewhere.
    ///
    /// # Panics
    /// Where it cannot be started.
    pub fn hire_with(&mut self, launch: Launch, cache: Option<PathBuf>) {
        let name = format!("worker-{}", self.workers.len());
        let cache = cache.unwrap_or_else(|| self.folder.path().join(&name));
        self.workers.push(Worker::start(launch, &self.client, &name, &cache));
    }

    /// Submits a job by the command line.
    ///
    /// # Panics
    /// Where it is refused.
    pub fn submit(&mut self, reference: &Arc<Reference>) -> JobId {
        let id = self.client.submit(&reference.job);
        self.expect(id, reference);
        id
    }

    /// A job was submitted whose picture will be the reference.
    pub fn expect(&mut self, id: JobId, reference: &Arc<Reference>) {
        self.jobs.push((id, reference.clone()));
    }

    /// A figure of `/metrics`, summed up over all coordinators, none of which may be away.
    ///
    /// # Panics
    /// Where one does not tell it.
    #[must_use]
    pub fn figure(&self, series: &str) -> u64 {
        let of = |server: &Server| {
            let client = Client::new(server.url()).with_token(self.client.token());
            wait_for(series, || client.figure(series))
        };
        self.servers.iter().map(of).sum()
    }

    /// Attempts at iterations that failed, of whatever kind.
    ///
    /// # Panics
    /// Where a coordinator does not tell.
    #[must_use]
    pub fn failed_attempts(&self) -> u64 {
        let kinds = ["scene", "render", "panic", "lost"];
        let of = |kind| self.figure(&format!("failed_attempts_total{{kind=\"{kind}\"}}"));
        kinds.into_iter().map(of).sum()
    }

    /// Waits for all jobs, and proves that nothing was lost, nothing counted twice and nothing left behind; ends
    /// everything. Returns what was logged: by the coordinators, by the workers.
    ///
    /// # Panics
    /// Where the books do not balance.
    #[must_use]
    pub fn settle(self) -> (String, String) {
        self.settle_after(|_| {})
    }

    /// As [`settle`](Self::settle); `later` happens before the first coordinator starts once more, days later as it
    /// seems, and removes what is left.
    ///
    /// # Panics
    /// Where the books do not balance.
    #[must_use]
    pub fn settle_after(mut self, later: impl FnOnce(&mut Server)) -> (String, String) {
        self.jobs
            .iter()
            .for_each(|(id, reference)| self.client.check(*id, reference));
        self.client.check_idle();
        self.workers.iter_mut().for_each(Worker::stop);
        self.servers.iter_mut().for_each(Server::stop);
        let again = &mut self.servers[0];
        later(again);
        self.stores.age();
        again.resume();
        let client = Client::new(again.url()).with_token(self.client.token());
        self.jobs
            .iter()
            .for_each(|(id, reference)| client.check(*id, reference));
        assert_eq!(
            client.newest_job(),
            self.jobs.iter().map(|(id, _)| *id).max(),
            "jobs that nobody sent"
        );
        again.stop();
        self.stores.check(self.jobs.iter().map(|(id, _)| *id));
        self.workers.iter().for_each(Worker::check_cache);
        let all = |logs: Vec<String>| logs.concat();
        let logs = (
            all(self.servers.iter().map(Server::log).collect()),
            all(self.workers.iter().map(Worker::log).collect()),
        );
        assert!(!logs.0.contains("panicked"), "a coordinator panicked:\n{}", logs.0);
        assert!(!logs.1.contains("panicked"), "a worker panicked:\n{}", logs.1);
        logs
    }
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

//! A PostgreSQL cluster of its own in a temporary folder, reached by a socket in that folder.

use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use tempfile::TempDir;

const USER: &str = "photonfarm";
/// Programs of PostgreSQL where Debian has them, below a folder for each version.
const DEBIAN: &str = "/usr/lib/postgresql";

/// A cluster. It is stopped and removed when this is dropped, and also when this process ends in any other way.
#[derive(Debug)]
pub struct Postgres {
    programs: PathBuf,
    folder: PathBuf,
    /// Who runs the programs, which refuse to be run by root.
    owner: Option<(u32, u32)>,
    databases: AtomicU32,
    /// Waits for the end of its standard input, which this process holds, and tidies up.
    reaper: Child,
}

impl Postgres {
    /// Makes and starts a cluster.
    ///
    /// # Panics
    /// Where PostgreSQL is not installed, or does not start.
    #[must_use]
    pub fn start() -> Self {
        let programs = programs();
        let folder = TempDir::new().expect("a temporary folder").keep();
        let owner = (fs::metadata(&folder).expect("the folder is there").uid() == 0).then(unprivileged);
        if let Some((user, group)) = owner {
            chown(&folder, Some(user), Some(group)).expect("root can give a folder away");
        }
        let reaper = reaper(&programs, &folder, owner);
        let cluster = Self {
            programs,
            folder,
            owner,
            databases: AtomicU32::new(0),
            reaper,
        };
        let data = cluster.data();
        cluster.run(
            "initdb",
            &[
                "-D",
                &data,
                "-U",
                USER,
                "-A",
                "trust",
                "-E",
                "UTF8",
                "--locale=C",
                "--no-sync",
            ],
        );
        cluster.resume();
        cluster
    }

    /// A cluster that the tests of this process share.
    #[must_use]
    pub fn shared() -> &'static Self {
        static SHARED: OnceLock<Postgres> = OnceLock::new();
        SHARED.get_or_init(Self::start)
    }

    /// Makes an empty database and returns its URL.
    ///
    /// # Panics
    /// Where the cluster does not answer.
    #[must_use]
    pub fn database(&self) -> String {
        let name = format!("farm{}", self.databases.fetch_add(1, Ordering::Relaxed));
        let folder = self.folder.to_str().expect("a UTF-8 path");
        self.run("createdb", &["-h", folder, "-U", USER, &name]);
        format!("postgres:///{name}?host={folder}&user={USER}")
    }

    /// Runs SQL in a database.
    ///
    /// # Panics
    /// Where it fails.
    pub fn execute(&self, url: &str, sql: &str) {
        self.run("psql", &["-q", "-X", "-v", "ON_ERROR_STOP=1", "-c", sql, url]);
    }

    /// Saves a database by `pg_dump`, whoever uses it, and restores it as another one. Returns the URL of that.
    ///
    /// # Panics
    /// Where the cluster does not answer.
    #[must_use]
    pub fn restored(&self, url: &str) -> String {
        let copy = self.database();
        let dump = self
            .folder
            .join(format!("{}.sql", self.databases.load(Ordering::Relaxed)));
        let dump = dump.to_str().expect("a UTF-8 path");
        self.run("pg_dump", &["-f", dump, url]);
        self.run("psql", &["-q", "-X", "-v", "ON_ERROR_STOP=1", "-f", dump, &copy]);
        copy
    }

    /// Stops the cluster at once, as a crash would.
    ///
    /// # Panics
    /// Where it does not stop.
    pub fn stop(&self) {
        let data = self.data();
        self.run("pg_ctl", &["-D", &data, "-w", "-m", "immediate", "stop"]);
    }

    /// Starts the cluster once more, so that it takes encrypted connections, and no others, at a port of 127.0.0.1 besides its
    /// socket. Returns the port.
    ///
    /// # Panics
    /// Where it does not start.
    #[must_use]
    pub fn encrypt(&self, certificate: &str, key: &str) -> u16 {
        self.stop();
        for (name, content) in [("server.crt", certificate), ("server.key", key)] {
            let path = self.folder.join("data").join(name);
            fs::write(&path, content).expect("the file can be written");
            fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).expect("its owner sets its mode");
            if let Some((user, group)) = self.owner {
                chown(&path, Some(user), Some(group)).expect("root can give a file away");
            }
        }
        let rules = self.folder.join("data/pg_hba.conf");
        let open = fs::read_to_string(&rules).expect("the rules of access");
        fs::write(&rules, open.replace("\nhost ", "\nhostssl ")).expect("the rules can be written");
        let free = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr());
        let port = free.expect("a free port").port();
        self.start_with(&format!("-c ssl=on -c listen_addresses=127.0.0.1 -c port={port}"));
        port
    }

    /// Starts the cluster once more, so that it takes connections from other hosts at an address of this one. Returns the
    /// URL of an empty database.
    ///
    /// # Panics
    /// Where it does not start.
    #[must_use]
    pub fn listen(&self, address: &str) -> String {
        self.stop();
        let rules = self.folder.join("data/pg_hba.conf");
        let known = fs::read_to_string(&rules).expect("the rules of access");
        fs::write(&rules, known + "\nhost all all samenet trust\n").expect("the rules can be written");
        self.start_with(&format!("-c listen_addresses={address}"));
        let url = self.database();
        let name = url.split(['/', '?']).nth(3).expect("the name of the database");
        format!("postgres://{USER}@{address}/{name}")
    }

    /// Starts the cluster where it was stopped.
    ///
    /// # Panics
    /// Where it does not start.
    pub fn resume(&self) {
        self.start_with("-c listen_addresses=");
    }

    fn start_with(&self, more: &str) {
        let folder = self.folder.to_str().expect("a UTF-8 path");
        let options = format!("-k {folder} -c fsync=off -c max_connections=200 {more}");
        let (data, log) = (self.data(), format!("{folder}/log"));
        let start = ["-D", &data, "-w", "-l", &log, "-o", &options, "start"];
        self.run("pg_ctl", &start);
    }

    fn data(&self) -> String {
        format!("{}/data", self.folder.to_str().expect("a UTF-8 path"))
    }

    fn run(&self, program: &str, arguments: &[&str]) {
        let mut command = command(&self.programs.join(program), self.owner);
        // A server that goes on must not keep a pipe of this process open.
        let log = fs::File::create(self.folder.join("last")).expect("a file for the output");
        let errors = log.try_clone().expect("the file once more");
        command.args(arguments).stdin(Stdio::null()).stdout(log).stderr(errors);
        let status = command.current_dir(&self.folder).status();
        let status = status.unwrap_or_else(|error| panic!("{program} cannot be run: {error}"));
        if !status.success() {
            let read = |name| fs::read_to_string(self.folder.join(name)).unwrap_or_default();
            panic!("{program} ended with {status}:\n{}{}", read("last"), read("log"));
        }
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        drop(self.reaper.stdin.take());
        let _ended = self.reaper.wait();
    }
}

/// The folder of PostgreSQL's programs: the newest version that Debian installed, or whatever is in the path.
fn programs() -> PathBuf {
    let versions = fs::read_dir(DEBIAN).into_iter().flatten().flatten();
    let newest = versions
        .filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok())
        .filter(|version| Path::new(DEBIAN).join(version.to_string()).join("bin/initdb").exists())
        .max();
    if let Some(version) = newest {
        return Path::new(DEBIAN).join(version.to_string()).join("bin");
    }
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path)
        .find(|folder| folder.join("initdb").exists())
        .expect("PostgreSQL is not installed: these tests need it (apt-get install postgresql; tests/run does so)")
}

/// User and group without rights: `postgres`, or `nobody`.
fn unprivileged() -> (u32, u32) {
    let users = fs::read_to_string("/etc/passwd").expect("the list of users");
    let ids = |name: &str| {
        let mut fields = users
            .lines()
            .find_map(|line| line.strip_prefix(name)?.strip_prefix(":x:"))?
            .split(':');
        Some((fields.next()?.parse().ok()?, fields.next()?.parse().ok()?))
    };
    ids("postgres")
        .or_else(|| ids("nobody"))
        .expect("a user `postgres` or `nobody`")
}

fn command(program: &Path, owner: Option<(u32, u32)>) -> Command {
    let Some((user, group)) = owner else {
        return Command::new(program);
    };
    let mut command = Command::new("setpriv");
    command.args([
        format!("--reuid={user}"),
        format!("--regid={group}"),
        "--clear-groups".into(),
    ]);
    command.arg(program);
    command
}

fn reaper(programs: &Path, folder: &Path, owner: Option<(u32, u32)>) -> Child {
    let stop = command(&programs.join("pg_ctl"), owner);
    let script = "folder=$1; shift; cat; cd \"$folder\" && \"$@\"; cd / && rm -rf \"$folder\"";
    let mut command = Command::new("sh");
    command.args(["-c", script, "reaper"]).arg(folder);
    command.arg(stop.get_program()).args(stop.get_args());
    command
        .arg("-D")
        .arg(folder.join("data"))
        .args(["-w", "-m", "immediate", "stop"]);
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    // A signal to the group of this process, such as Ctrl-C, must not end what tidies up after it.
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command.spawn().expect("sh runs")
}

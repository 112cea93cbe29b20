//! Real processes on this machine: coordinators, workers, and the command line.

use crate::scenes;
use photonfarm_proto::api::WorkerList;
use photonfarm_proto::job::JobStatus;
use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The longest that a test waits for anything.
pub const DEADLINE: Duration = Duration::from_secs(300);

/// How the variables begin that describe the package under test.
const OF_THE_PACKAGE: [&str; 2] = ["CARGO_PKG_", "CARGO_MANIFEST_"];

/// The folder of small scenes.
#[must_use]
pub fn scene(name: &str) -> PathBuf {
    scenes::folder().join(name)
}

/// A program of the workspace, built in the profile of the running test.
///
/// # Panics
/// Where it cannot be built.
#[must_use]
pub fn program(name: &str) -> PathBuf {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let this = std::env::current_exe().expect("the program has a path");
        let folder = this.parent().expect("programs lie in target/PROFILE");
        // Tests lie a folder deeper.
        let folder = folder
            .parent()
            .filter(|_| folder.ends_with("deps"))
            .unwrap_or(folder)
            .to_owned();
        let mut build = Command::new(env!("CARGO"));
        build.args(["build", "--quiet", "--locked", "--workspace", "--bins", "--tests"]);
        if folder.ends_with("release") {
            build.arg("--release");
        }
        build.current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace"));
        // What cargo tells a running test of its package would make build scripts run again that ask for it.
        for (name, _) in std::env::vars().filter(|(name, _)| OF_THE_PACKAGE.iter().any(|of| name.starts_with(of))) {
            build.env_remove(name);
        }
        assert!(
            build.status().expect("cargo runs").success(),
            "the programs under test do not build"
        );
        folder
    });
    folder.join(name).with_extension(std::env::consts::EXE_EXTENSION)
}

/// How a program is started: by another one that sets the scene for it, with further variables.
#[derive(Clone, Debug, Default)]
pub struct Launch {
    /// A program and its arguments that become the program, such as `nsenter --net=FILE`; may be empty.
    pub wrapper: Vec<String>,
    /// Variables of the environment.
    pub environment: Vec<(String, String)>,
}

impl Launch {
    /// With variables alone.
    #[must_use]
    pub fn with(environment: &[(&str, String)]) -> Self {
        let owned = |(name, value): &(&str, String)| ((*name).to_owned(), value.clone());
        Self {
            wrapper: Vec::new(),
            environment: environment.iter().map(owned).collect(),
        }
    }

    /// A program of the workspace, ready to be started; nothing of this process's environment steers it.
    pub fn command<S: AsRef<OsStr>>(&self, name: &str, arguments: &[S]) -> Command {
        let mut command = match self.wrapper.split_first() {
            Some((wrapper, first)) => {
                let mut command = Command::new(wrapper);
                command.args(first).arg(program(name));
                command
            }
            None => Command::new(program(name)),
        };
        command
            .args(arguments)
            .env_remove("RUST_LOG")
            .env_remove("PHOTONFARM_COORDINATOR")
            .env_remove("PHOTONFARM_TOKEN")
            .env_remove("PHOTONFARM_TOKEN_FILE")
            .env_remove("PHOTONFARM_CA")
            .env_remove("PHOTONFARM_HOURS")
            .envs(self.environment.iter().map(|(name, value)| (name, value)));
        command
    }
}

/// A process that is killed when the test is over.
#[derive(Debug)]
pub struct Process {
    child: Child,
    /// Standard error as it comes.
    errors: Arc<Mutex<String>>,
    reader: Option<JoinHandle<()>>,
}

impl Process {
    /// Starts a program of the workspace.
    ///
    /// # Panics
    /// Where it cannot be started.
    pub fn start<S: AsRef<OsStr>>(name: &str, arguments: &[S]) -> Self {
        Self::spawn(command(name, arguments))
    }

    /// Starts a program of the workspace with `folder` for its temporary files.
    ///
    /// # Panics
    /// Where it cannot be started.
    pub fn start_in<S: AsRef<OsStr>>(folder: &Path, name: &str, arguments: &[S]) -> Self {
        let mut command = command(name, arguments);
        command.env("TMPDIR", folder);
        Self::spawn(command)
    }

    /// Starts a program of the workspace with further variables in its environment.
    ///
    /// # Panics
    /// Where it cannot be started.
    pub fn start_with<S: AsRef<OsStr>>(environment: &[(&str, String)], name: &str, arguments: &[S]) -> Self {
        let mut command = command(name, arguments);
        command.envs(environment.iter().map(|(name, value)| (name, value)));
        Self::spawn(command)
    }

    /// Starts a prepared program.
    ///
    /// # Panics
    /// Where it cannot be started.
    #[must_use]
    pub fn spawn(mut command: Command) -> Self {
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?} does not start: {error}"));
        let stderr = child.stderr.take().expect("piped");
        let errors = Arc::new(Mutex::new(String::new()));
        let sink = errors.clone();
        let reader = std::thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                let mut errors = sink.lock().expect("no test panics here");
                errors.push_str(&line);
                errors.push('\n');
            }
        });
        Self {
            child,
            errors,
            reader: Some(reader),
        }
    }

    /// Waits until standard error contains `text`.
    ///
    /// # Panics
    /// After [`DEADLINE`].
    pub fn wait_for_error(&self, text: &str) {
        wait_for(text, || self.errors().contains(text).then_some(()));
    }

    /// Standard error so far.
    ///
    /// # Panics
    /// Where its reader panicked.
    #[must_use]
    pub fn errors(&self) -> String {
        self.errors.lock().expect("no test panics here").clone()
    }

    /// The most memory that it has used so far \[bytes\], where the system tells.
    #[must_use]
    pub fn peak_memory(&self) -> Option<u64> {
        self.memory("VmHWM:")
    }

    /// The memory that it uses now \[bytes\], where the system tells.
    #[must_use]
    pub fn resident_memory(&self) -> Option<u64> {
        self.memory("VmRSS:")
    }

    fn memory(&self, which: &str) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix(which))?;
        Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
    }

    /// SIGKILL: the process gets no chance to tidy up. Returns what it wrote to standard error.
    ///
    /// # Panics
    /// Where the process has ended by itself.
    pub fn kill(mut self) -> String {
        let ended = self.child.try_wait().expect("the process can be asked");
        assert_eq!(ended, None, "the process ended by itself:\n{}", self.errors());
        self.child.kill().expect("the process can be killed");
        self.child.wait().expect("the process can be awaited");
        self.errors()
    }

    /// Sends a signal by its name, such as `TERM`.
    ///
    /// # Panics
    /// Where there is no such process.
    pub fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let status = Command::new("kill")
            .args(["-s", name, &id])
            .status()
            .expect("kill runs");
        assert!(status.success(), "cannot send {name} to {id}");
    }

    /// Waits for the end: exit status, standard output, standard error.
    ///
    /// # Panics
    /// After [`DEADLINE`].
    pub fn finish(mut self) -> (ExitStatus, String, String) {
        let started = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("the process can be asked") {
                break status;
            }
            assert!(started.elapsed() < DEADLINE, "the process does not end");
            pause();
        };
        let mut output = String::new();
        if let Some(mut stdout) = self.child.stdout.take() {
            stdout.read_to_string(&mut output).expect("standard output is text");
        }
        if let Some(reader) = self.reader.take() {
            reader.join().expect("reading does not panic");
        }
        let errors = self.errors.lock().expect("no test panics here").clone();
        (status, output, errors)
    }

    /// Whether it runs.
    ///
    /// # Panics
    /// Where the system does not tell.
    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().expect("the process can be asked").is_none()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Runs the command line to its end.
///
/// # Panics
/// Where it cannot be started.
pub fn photonfarm<S: AsRef<OsStr>>(arguments: &[S]) -> Output {
    command("photonfarm", arguments).output().expect("photonfarm starts")
}

/// What a program printed that ended well, without white space around it.
///
/// # Panics
/// Where it failed, with what it said.
pub fn printed(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

fn command<S: AsRef<OsStr>>(name: &str, arguments: &[S]) -> Command {
    Launch::default().command(name, arguments)
}

/// A coordinator on the loopback interface.
#[derive(Debug)]
pub struct Coordinator {
    process: Option<Process>,
    /// Where it answers, such as `http://127.0.0.1:7800`.
    pub url: String,
    data: PathBuf,
    options: Vec<String>,
}

impl Coordinator {
    /// Starts a coordinator with the folder `data` on a free port.
    ///
    /// # Panics
    /// Where it does not say that it listens.
    #[must_use]
    pub fn start(data: &Path) -> Self {
        Self::start_with(data, &[])
    }

    /// As [`start`](Self::start), with further options.
    ///
    /// # Panics
    /// Where it does not say that it listens.
    #[must_use]
    pub fn start_with(data: &Path, more: &[&str]) -> Self {
        let (process, url) = serve(data, "127.0.0.1:0", more);
        Self {
            process: Some(process),
            url,
            data: data.to_owned(),
            options: more.iter().map(|option| (*option).to_owned()).collect(),
        }
    }

    /// SIGKILL.
    ///
    /// # Panics
    /// Where it is not running.
    pub fn kill(&mut self) {
        self.process.take().expect("the coordinator runs").kill();
    }

    /// Starts it again, with the same folder and options, at the same address.
    ///
    /// # Panics
    /// Where it does not come back.
    pub fn restart(&mut self) {
        assert!(self.process.is_none(), "the coordinator runs");
        let address = self.url.trim_start_matches("http://").to_owned();
        let options: Vec<&str> = self.options.iter().map(String::as_str).collect();
        let (process, url) = serve(&self.data, &address, &options);
        assert_eq!(url, self.url);
        self.process = Some(process);
    }

    /// Starts a worker with one thread.
    #[must_use]
    pub fn worker(&self) -> Process {
        Process::start("photonfarm-worker", &["--coordinator", &self.url, "--threads", "1"])
    }

    /// Waits until so many workers are registered.
    ///
    /// # Panics
    /// After [`DEADLINE`].
    pub fn wait_for_workers(&self, count: usize) {
        let url = format!("{}/v1/workers", self.url);
        wait_for("workers", || {
            get::<WorkerList>(&url)
                .filter(|list| list.workers.len() >= count)
                .map(drop)
        });
    }

    /// Asks it to stop (SIGTERM) and gives the process back.
    ///
    /// # Panics
    /// Where it is not running.
    pub fn stop(&mut self) -> Process {
        let process = self.process.take().expect("the coordinator runs");
        process.signal("TERM");
        process
    }

    /// The most memory that it has used so far \[bytes\], where the system tells.
    #[must_use]
    pub fn peak_memory(&self) -> Option<u64> {
        self.process.as_ref()?.peak_memory()
    }

    /// The memory that it uses now \[bytes\], where the system tells.
    #[must_use]
    pub fn resident_memory(&self) -> Option<u64> {
        self.process.as_ref()?.resident_memory()
    }

    /// Whether it runs.
    ///
    /// # Panics
    /// Where it was killed.
    pub fn is_running(&mut self) -> bool {
        self.process.as_mut().expect("the coordinator runs").is_running()
    }
}

/// Starts `photonfarm serve` with further options, and waits until it says where it listens.
///
/// # Panics
/// Where it does not say so.
#[must_use]
pub fn serve(data: &Path, address: &str, more: &[&str]) -> (Process, String) {
    let data = data.to_str().expect("a UTF-8 path");
    serve_with(&[], &[&["serve", "--listen", address, "--data", data], more].concat())
}

/// Starts a coordinator, which is the last to know its address; returns its URL as well.
///
/// # Panics
/// Where it does not say that it listens.
#[must_use]
pub fn serve_with(environment: &[(&str, String)], arguments: &[&str]) -> (Process, String) {
    serve_command(Launch::with(environment).command("photonfarm", arguments))
}

/// As [`serve_with`], of a prepared program.
///
/// # Panics
/// Where it does not say that it listens.
#[must_use]
pub fn serve_command(command: Command) -> (Process, String) {
    try_to_serve(command).unwrap_or_else(|(status, errors)| panic!("serve ended with {status}: {errors}"))
}

/// Starts a coordinator that may be unable to serve; then its status and its standard error come back.
pub fn try_to_serve(command: Command) -> Result<(Process, String), (ExitStatus, String)> {
    let mut process = Process::spawn(command);
    let mut lines = BufReader::new(process.child.stdout.take().expect("piped")).lines();
    let line = lines.next().and_then(Result::ok).unwrap_or_default();
    match line.strip_prefix("listening on ") {
        Some(url) => Ok((process, url.to_owned())),
        None => {
            let (status, _, errors) = process.finish();
            Err((status, errors))
        }
    }
}

/// Asks again and again until there is an answer.
///
/// # Panics
/// After [`DEADLINE`], with `what`.
pub fn wait_for<T>(what: &str, mut ask: impl FnMut() -> Option<T>) -> T {
    let started = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return answer;
        }
        assert!(started.elapsed() < DEADLINE, "waited in vain for {what}");
        pause();
    }
}

/// Waits a moment between two questions; correctness never depends on its length.
pub fn pause() {
    std::thread::sleep(Duration::from_millis(5));
}

/// Asks for JSON; nothing where the coordinator is away or has no such thing.
pub fn get<T: serde::de::DeserializeOwned>(url: &str) -> Option<T> {
    let response = http(reqwest::Method::GET, url, Vec::new(), &[])?;
    if response.0 == 200 {
        serde_json::from_slice(&response.1).ok()
    } else {
        None
    }
}

/// The jobs of a farm, newest first.
pub fn jobs(url: &str) -> Option<Vec<JobStatus>> {
    get::<photonfarm_proto::api::JobPage>(&format!("{url}/v1/jobs")).map(|page| page.jobs)
}

/// Sends a request; nothing where no answer comes. Its connection belongs to the calling thread, and so to that
/// thread's network.
///
/// # Panics
/// Where no runtime can be made.
pub fn http(method: reqwest::Method, url: &str, body: Vec<u8>, headers: &[(&str, &str)]) -> Option<(u16, Vec<u8>)> {
    thread_local! {
        static CLIENT: (tokio::runtime::Runtime, reqwest::Client) = (
            tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()
                .expect("a runtime"),
            reqwest::Client::builder().no_proxy().build().expect("a client"),
        );
    }
    CLIENT.with(|(runtime, client)| {
        let mut request = client.request(method, url).body(body).timeout(DEADLINE);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        runtime.block_on(async {
            let response = request.send().await.ok()?;
            let status = response.status().as_u16();
            Some((status, response.bytes().await.ok()?.into()))
        })
    })
}

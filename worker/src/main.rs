//! `photonfarm-worker`: renders for a coordinator until it is told to stop.

use anyhow::Context;
use clap::{Parser, ValueEnum};
use photonfarm_proto::memory::MOST_MEMORY_MB;
use photonfarm_worker::{
    Attendance, CancellationToken, Credentials, Exporter, Hours, OTHERS_PERCENT, Worker, WorkerConfig, available_mb,
};
use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use tracing_subscriber::EnvFilter;

/// Renders iterations for a coordinator of Photonfarm.
///
/// The first SIGTERM or SIGINT ends the iteration at hand, delivers what is done and gives the rest back, within
/// --drain-seconds; the second ends the process at once. Of an option that is given twice the last one counts.
#[derive(Parser)]
#[command(version, args_override_self = true)]
struct Options {
    /// URL of the coordinator, such as http://127.0.0.1:7800.
    #[arg(long, env = "PHOTONFARM_COORDINATOR")]
    coordinator: String,
    /// File with a token of the role `worker`; else the variable PHOTONFARM_TOKEN holds one, if the farm asks for any.
    #[arg(long, value_name = "FILE", env = "PHOTONFARM_TOKEN_FILE")]
    token_file: Option<PathBuf>,
    /// File with the certificate of the authority that the coordinator's comes from; else those that the system trusts.
    #[arg(long, value_name = "FILE", env = "PHOTONFARM_CA")]
    ca: Option<PathBuf>,
    /// Threads to render with; 0: all processors.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Folder for the files of scenes; several workers may share it.
    #[arg(long, env = "PHOTONFARM_CACHE")]
    cache: Option<PathBuf>,
    /// Gigabytes that the folder may hold.
    #[arg(long, default_value_t = 16)]
    cache_gigabytes: u64,
    /// Name shown to people; the host's by default.
    #[arg(long)]
    name: Option<String>,
    /// Something that this machine has, for jobs that ask for it, such as gpu=no (repeatable).
    #[arg(long, value_name = "TAG")]
    tag: Vec<String>,
    /// Memory that jobs may take of this machine (MiB): none that needs more is taken; the machine's, or the limit of its
    /// control group, by default.
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_MEMORY_MB)))]
    memory: Option<u32>,
    /// Hours in which to take work, such as "mon-fri 19:00-07:00, sat-sun 00:00-24:00", in local time (the variable TZ, else
    /// that of the system). When they end, the iteration at hand comes to its end and counts, and the rest goes back; the
    /// worker stays registered.
    #[arg(long, value_name = "HOURS", env = "PHOTONFARM_HOURS")]
    hours: Option<Hours>,
    /// Take work only while others leave the machine alone: other processes use no more than so many percent of its
    /// processors. They count after a quarter of a minute, and are gone after two minutes without them.
    #[arg(long, value_name = "PERCENT", num_args = 0..=1, require_equals = true, value_parser = percent,
          default_missing_value = OTHERS_PERCENT)]
    idle_only: Option<f64>,
    /// Seconds that a worker that is told to stop may go on: three quarters of them with the iteration at hand, the rest with
    /// the delivery of what is done. What is not delivered then is kept in the cache's folder and delivered at the next start
    /// with the same folder and coordinator; it counts if its lease has not ended meanwhile.
    #[arg(long, value_name = "S", default_value_t = 100)]
    drain_seconds: u32,
    /// Send spans of the work on each job to this collector of OpenTelemetry, by OTLP over HTTP, such as http://127.0.0.1:4318.
    #[arg(
        long,
        value_name = "URL",
        env = "OTEL_EXPORTER_OTLP_ENDPOINT",
        hide_env_values = true
    )]
    otlp: Option<String>,
    /// Format of the log; RUST_LOG chooses what it tells.
    #[arg(long, value_enum, default_value_t = LogFormat::Text)]
    log_format: LogFormat,
}

#[derive(Clone, Copy, ValueEnum)]
enum LogFormat {
    /// Lines for people.
    Text,
    /// One JSON object a line.
    Json,
}

fn percent(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..100.0).contains(&value) => Ok(value),
        _ => Err("expected a share of the processors, from 0 to less than 100 percent".to_owned()),
    }
}

fn main() -> ExitCode {
    let options = Options::parse();
    start_log(options.log_format);
    let result = tokio::runtime::Runtime::new()
        .context("no threads can be started")
        .and_then(|runtime| {
            let result = runtime.block_on(run(options));
            // An iteration or a scene that was given up need not come to its end.
            runtime.shutdown_background();
            result
        });
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!("{error:#}");
            ExitCode::FAILURE
        }
    }
}

async fn run(options: Options) -> anyhow::Result<()> {
    let cache = options
        .cache
        .unwrap_or_else(|| std::env::temp_dir().join("photonfarm-cache"));
    let mut config = WorkerConfig::new(options.coordinator, cache);
    config.credentials = Credentials::load(options.token_file.as_deref(), options.ca.as_deref())?;
    config.threads = options.threads;
    config.drain = Duration::from_secs(options.drain_seconds.into());
    config.tags = options.tag.into_iter().collect();
    config.cache_bytes = options.cache_gigabytes.saturating_mul(1 << 30);
    config.name = options.name.unwrap_or_else(host_name);
    config.memory_mb = options.memory.or_else(available_mb);
    config.watches_memory = true;
    if let Some(hours) = &options.hours {
        tracing::info!("takes work in these hours, by local time: {hours}");
    }
    config.rest = Attendance::new(options.hours, options.idle_only).begin();
    if let Some(rest) = *config.rest.borrow() {
        tracing::info!("{rest}");
    }
    let otlp = options.otlp.filter(|url| !url.is_empty());
    let exporter = otlp.map(|url| Exporter::start(&url, "photonfarm-worker", &config.name));
    let exporter = exporter.transpose()?;
    config.tracer = exporter.as_ref().map(Exporter::tracer).unwrap_or_default();
    let drain = CancellationToken::new();
    stop_on_signals(drain.clone()).context("signals cannot be handled")?;
    let worked = Worker::new(config)?.run(drain).await;
    if let Some(exporter) = exporter {
        exporter.finish().await;
    }
    worked?;
    tracing::info!("stopped");
    Ok(())
}

/// The first signal drains, the second ends the process.
fn stop_on_signals(drain: CancellationToken) -> std::io::Result<()> {
    let mut signals = Signals::new()?;
    tokio::spawn(async move {
        loop {
            let code = signals.next().await;
            if drain.is_cancelled() {
                std::process::exit(code);
            }
            tracing::info!("told to stop; once more to stop at once");
            drain.cancel();
        }
    });
    Ok(())
}

/// What tells the worker to stop: SIGTERM and SIGINT.
#[cfg(unix)]
struct Signals {
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
        })
    }

    /// The status that a process ends with which the next signal kills.
    async fn next(&mut self) -> i32 {
        tokio::select! {
            _ = self.terminate.recv() => 143,
            _ = self.interrupt.recv() => 130,
        }
    }
}

/// What tells the worker to stop: Ctrl-C.
#[cfg(windows)]
struct Signals(tokio::signal::windows::CtrlC);

#[cfg(windows)]
impl Signals {
    fn new() -> std::io::Result<Self> {
        tokio::signal::windows::ctrl_c().map(Self)
    }

    async fn next(&mut self) -> i32 {
        self.0.recv().await;
        130
    }
}

fn host_name() -> String {
    #[cfg(windows)]
    let name = std::env::var("COMPUTERNAME").unwrap_or_default();
    #[cfg(not(windows))]
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name = name.trim();
    if name.is_empty() {
        "worker".to_owned()
    } else {
        name.to_owned()
    }
}

fn start_log(format: LogFormat) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // Where standard error is closed there is nobody to tell of it either, and trying to would panic.
        .log_internal_errors(false);
    match format {
        LogFormat::Text => log.with_ansi(std::io::stderr().is_terminal()).init(),
        LogFormat::Json => log.json().init(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scripts give options of their own and then those of their caller.
    #[test]
    fn the_last_of_an_option_counts_and_tags_add_up() {
        let line =
            "photonfarm-worker --coordinator http://a --cache a --tag x --cache b --tag y --coordinator http://b";
        let options = Options::try_parse_from(line.split(' ')).unwrap();
        assert_eq!(options.cache.as_deref(), Some("b".as_ref()));
        assert_eq!(options.coordinator, "http://b");
        assert_eq!(options.tag, ["x", "y"]);
    }

    #[test]
    fn hours_and_others_are_understood_or_refused_with_a_reason() {
        let parse = |more: &[&str]| {
            let line = ["photonfarm-worker", "--coordinator", "http://a"];
            Options::try_parse_from(line.iter().chain(more)).map_err(|error| error.to_string())
        };
        let options = parse(&["--hours", "mon-fri 19:00-07:00", "--idle-only", "--memory", "2048"]).unwrap();
        assert_eq!((options.idle_only, options.memory), (Some(10.0), Some(2048)));
        assert_eq!(options.hours.unwrap().to_string(), "mon-fri 19:00-07:00");
        assert_eq!(parse(&["--idle-only=25.5"]).unwrap().idle_only, Some(25.5));
        for (option, reason) in [
            ("--hours=mon-fry 19:00-07:00", "\"fry\": it is no day"),
            ("--idle-only=100", "less than 100 percent"),
            ("--idle-only=NaN", "less than 100 percent"),
            ("--memory=0", "1..=16777216"),
        ] {
            let error = parse(&[option]).err().unwrap();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn the_log_has_the_formats_of_the_coordinators() {
        let parse = |format| {
            let line = [
                "photonfarm-worker",
                "--coordinator",
                "http://127.0.0.1:1",
                "--log-format",
                format,
            ];
            Options::try_parse_from(line).map(|options| options.log_format)
        };
        assert!(matches!(parse("text"), Ok(LogFormat::Text)));
        assert!(matches!(parse("json"), Ok(LogFormat::Json)));
        assert!(parse("human").is_err());
    }
}

//! `photonfarm-worker`: renders for a coordinator until it is told to stop.

use anyhow::Context;
use clap::{Parser, ValueEnum};
use photonfarm_worker::{CancellationToken, Credentials, Exporter, Worker, WorkerConfig};
use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
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
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    tokio::spawn(async move {
        loop {
            let code = tokio::select! {
                _ = terminate.recv() => 143,
                _ = interrupt.recv() => 130,
            };
            if drain.is_cancelled() {
                std::process::exit(code);
            }
            tracing::info!("told to stop; once more to stop at once");
            drain.cancel();
        }
    });
    Ok(())
}

fn host_name() -> String {
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

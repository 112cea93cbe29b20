//! The command line of `photonfarm serve`.

use crate::args::positive;
use clap::{Args, ValueEnum};
use photonfarm_coordinator::store::{BlobPlace, StatePlace};
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;

#[derive(Debug, Args)]
pub(crate) struct ServeArgs {
    /// Address and port to listen on
    #[arg(long, value_name = "ADDR")]
    pub(crate) listen: String,
    /// Folder for jobs and images; made if it is not there
    #[arg(long, value_name = "DIR", required_unless_present_all = ["state", "blobs"])]
    pub(crate) data: Option<PathBuf>,
    /// Where jobs are kept: sqlite:PATH or postgres://USER:PASSWORD@HOST/DATABASE [default: farm.sqlite in the data folder]
    #[arg(long, value_name = "URL", env = "PHOTONFARM_STATE", hide_env_values = true)]
    pub(crate) state: Option<StatePlace>,
    /// Where scenes and images are kept: file:PATH or s3://BUCKET/PREFIX [default: the data folder]
    #[arg(long, value_name = "URL", env = "PHOTONFARM_BLOBS")]
    pub(crate) blobs: Option<BlobPlace>,
    /// Certificate for encrypted connections, with those between it and its authority, as PEM
    #[arg(long, value_name = "FILE", requires = "tls_key", env = "PHOTONFARM_TLS_CERT")]
    pub(crate) tls_cert: Option<PathBuf>,
    /// Private key of the certificate, as PEM
    #[arg(long, value_name = "FILE", requires = "tls_cert", env = "PHOTONFARM_TLS_KEY")]
    pub(crate) tls_key: Option<PathBuf>,
    /// Have nodes of a worker repeated by another one until this many in a row are confirmed, and ever more rarely then;
    /// 10 suits machines of strangers, 0 repeats none
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) verify: u32,
    /// How long a lease should take (s): longer ones bring fewer images to take in, and a killed worker loses more
    #[arg(long, value_name = "S", default_value = "30")]
    pub(crate) lease_seconds: NonZeroU32,
    /// Requests a second that one token may send from one address
    #[arg(long, value_name = "N", default_value = "1000")]
    pub(crate) rate: NonZeroU32,
    /// Connections at once; more wait until one of them ends
    #[arg(long, value_name = "N", default_value = "4096")]
    pub(crate) connections: NonZeroUsize,
    /// Connections at once from one address; more are closed at once. A proxy in front is one address
    #[arg(long, value_name = "N", default_value = "1024")]
    pub(crate) connections_per_address: NonZeroUsize,
    /// Delete jobs that ended more than so many days ago [default: keep them]
    #[arg(long, value_name = "DAYS", value_parser = positive, env = "PHOTONFARM_KEEP_DAYS")]
    pub(crate) keep_days: Option<f64>,
    /// Delete the oldest jobs that have ended where such jobs take more room, with the scenes that only they name
    /// [default: keep them]
    #[arg(long, value_name = "GB", value_parser = positive, env = "PHOTONFARM_KEEP_GIGABYTES")]
    pub(crate) keep_gigabytes: Option<f64>,
    /// URL that is told whenever a job ends (repeatable); jobs may name others (docs/WEBHOOKS.md)
    #[arg(long, value_name = "URL", requires = "webhook_secret_file")]
    pub(crate) webhook: Vec<String>,
    /// File with the secret that webhooks are signed with; without it no URL is told
    #[arg(long, value_name = "FILE", env = "PHOTONFARM_WEBHOOK_SECRET_FILE")]
    pub(crate) webhook_secret_file: Option<PathBuf>,
    /// Let jobs name webhooks of this machine and of private networks
    #[arg(long)]
    pub(crate) webhook_private: bool,
    /// How others reach the farm, for links to jobs [default: where it listens]
    #[arg(long, value_name = "URL", env = "PHOTONFARM_PUBLIC_URL")]
    pub(crate) public_url: Option<String>,
    /// File to which each request is appended that changes something, as a line of JSON: who, what, when, and what became of it.
    /// SIGHUP opens it again [default: none]
    #[arg(long, value_name = "FILE", env = "PHOTONFARM_AUDIT_LOG")]
    pub(crate) audit_log: Option<PathBuf>,
    /// Send spans of the work on each job to this collector of OpenTelemetry, by OTLP over HTTP, such as http://127.0.0.1:4318
    #[arg(
        long,
        value_name = "URL",
        env = "OTEL_EXPORTER_OTLP_ENDPOINT",
        hide_env_values = true
    )]
    pub(crate) otlp: Option<String>,
    /// Format of the log; RUST_LOG chooses what it tells
    #[arg(long, value_enum, default_value_t = LogFormat::Text)]
    pub(crate) log_format: LogFormat,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    /// Lines for people
    Text,
    /// One JSON object a line
    Json,
}

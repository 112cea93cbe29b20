//! `photonfarm serve`: the coordinator of a farm.

use crate::say;
use crate::serve_args::ServeArgs;
use anyhow::{Context, Result, anyhow};
use photonfarm_coordinator::scheduler::SchedulerConfig;
use photonfarm_coordinator::service::Keep;
use photonfarm_coordinator::store::{BlobPlace, StatePlace};
use photonfarm_coordinator::{Config, Coordinator, TlsFiles, WebhookConfig, WebhookSecret};
use photonfarm_worker::Exporter;
use std::io::ErrorKind;
use std::path::Path;
use tokio::net::TcpListener;

/// Runs the command until it is told to stop.
pub(crate) fn run(args: ServeArgs) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(serve(args))
}

async fn serve(args: ServeArgs) -> Result<()> {
    let listener = TcpListener::bind(&args.listen)
        .await
        .map_err(|error| match error.kind() {
            ErrorKind::AddrInUse => anyhow!(
                "{} is in use: choose another port, or end what listens there",
                args.listen
            ),
            ErrorKind::PermissionDenied => anyhow!("{} is not allowed: choose a port above 1023", args.listen),
            _ => anyhow!(
                "cannot listen on {}: {error}; give an address and a port, such as 127.0.0.1:7800",
                args.listen
            ),
        })?;
    let stop = stop_signal()?;
    let otlp = args.otlp.filter(|url| !url.is_empty());
    let exporter = otlp.map(|url| Exporter::start(&url, "photonfarm-coordinator", &args.listen));
    let exporter = exporter.transpose()?;
    let mut config = Config {
        tls: args
            .tls_cert
            .zip(args.tls_key)
            .map(|(certificate, key)| TlsFiles { certificate, key }),
        rate: args.rate.get(),
        connections: args.connections.get(),
        connections_per_address: args.connections_per_address.get(),
        scheduler: SchedulerConfig {
            lease_target_ms: 1000 * u64::from(args.lease_seconds.get()),
            verify_until: args.verify,
            ..SchedulerConfig::default()
        },
        keep: Keep {
            longest_ms: args.keep_days.map(|days| (days * 86_400_000.0) as u64),
            most_bytes: args.keep_gigabytes.map(|count| (count * 1e9) as u64),
        },
        webhooks: WebhookConfig {
            secret: args.webhook_secret_file.as_deref().map(read_secret).transpose()?,
            urls: args.webhook,
            private_addresses: args.webhook_private,
            public_url: args.public_url,
            ..WebhookConfig::default()
        },
        audit_log: args.audit_log,
        tracer: exporter.as_ref().map(Exporter::tracer).unwrap_or_default(),
        ..Config::new(args.data.unwrap_or_default())
    };
    config.state = args.state.unwrap_or(config.state);
    config.blobs = args.blobs.unwrap_or(config.blobs);
    let place = format!("{} and {}", config.state, config.blobs);
    let is_local = matches!(config.state, StatePlace::Sqlite(_)) || matches!(config.blobs, BlobPlace::Folder(_));
    if cfg!(not(unix)) && is_local {
        return Err(anyhow!(
            "{place} cannot be kept safe on this system: run the coordinator on Linux"
        ));
    }
    let coordinator = Coordinator::start(config, listener)
        .await
        .with_context(|| format!("cannot serve {place} at {}", args.listen))?;
    match say::line(format_args!("listening on {}", coordinator.url())) {
        Err(error) if !error.is::<say::ReaderLeft>() => return Err(error),
        _ => {}
    }
    tokio::select! {
        () = stop => {}
        never = hang_up(&coordinator) => never?,
    }
    tracing::info!("stopping; jobs go on when the coordinator is started again with the same stores");
    coordinator.shutdown().await;
    if let Some(exporter) = exporter {
        exporter.finish().await;
    }
    Ok(())
}

fn read_secret(file: &Path) -> Result<WebhookSecret> {
    let secret = std::fs::read(file)
        .map_err(anyhow::Error::from)
        .and_then(|bytes| Ok(WebhookSecret::new(&bytes)?));
    secret.with_context(|| format!("--webhook-secret-file {}", file.display()))
}

/// Reads the certificate and opens the audit log again at every SIGHUP.
#[cfg(unix)]
async fn hang_up(coordinator: &Coordinator) -> Result<()> {
    let mut hangup = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::hangup())?;
    while hangup.recv().await.is_some() {
        coordinator.reopen_audit_log().await;
        match coordinator.renew_certificates() {
            Ok(true) => tracing::info!("the certificate was read again: new connections get it"),
            Ok(false) => tracing::info!("there is no certificate to read again"),
            Err(error) => tracing::error!("the certificate stays as it was: {error}"),
        }
    }
    std::future::pending().await
}

/// Files are opened again where there are signals to ask for it.
#[cfg(not(unix))]
async fn hang_up(_: &Coordinator) -> Result<()> {
    std::future::pending().await
}

/// Ends on Ctrl-C, or on SIGTERM where there is one.
fn stop_signal() -> Result<impl Future<Output = ()>> {
    #[cfg(unix)]
    let mut terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())?;
    Ok(async move {
        #[cfg(unix)]
        tokio::select! {
            _ = terminate.recv() => {}
            _ = tokio::signal::ctrl_c() => {}
        }
        #[cfg(not(unix))]
        let _ = tokio::signal::ctrl_c().await;
    })
}

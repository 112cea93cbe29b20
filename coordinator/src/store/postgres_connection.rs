//! Connections to PostgreSQL: how long the other side may be silent, and the one that hears of commits.

use super::{Sequence, StoreError};
use deadpool_postgres::{Object, Pool};
use futures_util::future::poll_fn;
use std::time::Duration;
use tokio::sync::watch;
use tokio_postgres::{AsyncMessage, Config};
use tokio_postgres_rustls::MakeRustlsConnect;

/// Longest wait for a connection, and for an answer about who leads.
pub(super) const CONNECT: Duration = Duration::from_secs(5);
/// Longest silence of the other side of a connection: packets that are not acknowledged end it, on either side.
const SILENCE: Duration = Duration::from_secs(20);
/// Time without traffic after which the other side is asked whether it is there, time between two such questions, and how
/// many of them without an answer end the connection.
const KEEPALIVE: (Duration, Duration, u32) = (Duration::from_secs(5), Duration::from_secs(5), 3);
/// What each session asks of the server: how long it waits for a lock, how long a statement may take, and for how long a
/// transaction may be left lying before it is undone and its locks are free \[ms\].
const SESSION: [(&str, u32); 3] = [
    ("lock_timeout", 10_000),
    ("statement_timeout", 20_000),
    ("idle_in_transaction_session_timeout", 10_000),
];
/// Longest time without a look for news.
pub(super) const POLL: Duration = Duration::from_secs(1);

/// Bounds how long the other side may be silent, at both ends, and what it may take.
pub(super) fn bound(config: &mut Config) {
    let (idle, interval, count) = KEEPALIVE;
    config
        .application_name("photonfarm")
        .connect_timeout(CONNECT)
        .tcp_user_timeout(SILENCE)
        .keepalives(true)
        .keepalives_idle(idle)
        .keepalives_interval(interval)
        .keepalives_retries(count);
    let mut options = config.get_options().unwrap_or_default().to_owned();
    for (name, value) in SESSION {
        options += &format!(" -c {name}={value}");
    }
    options += &format!(
        " -c tcp_user_timeout={} -c tcp_keepalives_idle={} -c tcp_keepalives_interval={} -c tcp_keepalives_count={count}",
        SILENCE.as_millis(),
        idle.as_secs(),
        interval.as_secs()
    );
    config.options(options.trim());
}

pub(super) async fn get(pool: &Pool) -> Result<Object, StoreError> {
    pool.get().await.map_err(|error| match error {
        deadpool_postgres::PoolError::Backend(error) => error.into(),
        deadpool_postgres::PoolError::Closed => StoreError::Stopped,
        other => StoreError::Connection(other.to_string()),
    })
}

/// Hears of commits for ever, on a connection of its own.
pub(super) async fn listen(config: Config, tls: MakeRustlsConnect, tell: watch::Sender<Sequence>) {
    loop {
        if let Err(error) = listen_once(&config, &tls, &tell).await {
            tracing::warn!(%error, "no news from the database; trying again");
        }
        tokio::time::sleep(POLL).await;
    }
}

async fn listen_once(
    config: &Config,
    tls: &MakeRustlsConnect,
    tell: &watch::Sender<Sequence>,
) -> Result<(), StoreError> {
    let (client, mut connection) = config.connect(tls.clone()).await?;
    let hear = async {
        while let Some(message) = poll_fn(|context| connection.poll_message(context)).await {
            if let AsyncMessage::Notification(notification) = message?
                && let Ok(sequence) = notification.payload().parse::<Sequence>()
            {
                tell.send_if_modified(|highest| {
                    let higher = sequence > *highest;
                    *highest = sequence.max(*highest);
                    higher
                });
            }
        }
        Ok(())
    };
    let ask = async {
        client.batch_execute("LISTEN photonfarm").await?;
        // Listens for as long as the connection lasts.
        std::future::pending::<Result<(), StoreError>>().await
    };
    tokio::select! {
        ended = hear => ended,
        ended = ask => ended,
    }
}

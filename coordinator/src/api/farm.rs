//! The whole farm as server-sent events.

use super::events::{NO_BUFFERING, RETRY};
use super::{ApiError, App};
use crate::store::JobFilter;
use axum::extract::State;
use axum::response::sse::{Event, KeepAlive};
use axum::response::{IntoResponse, Response, Sse};
use futures_util::stream;
use photonfarm_proto::api::{EVENT_FARM, FarmNews, WorkerStatus};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::problem::Problem;
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::watch;

/// Least time between two events.
const STEP: Duration = Duration::from_millis(500);
/// Workers fall silent without anything that happens.
const TICK: Duration = Duration::from_secs(5);
/// The newest jobs are told.
const JOBS: u32 = 100;

/// The newest 100 jobs and the workers, and then what changes of them: events `farm`, whose data is a `FarmNews`. The first one after a
/// connection is whole, so that whoever was cut off knows all again.
#[utoipa::path(
    get, path = "/v1/events", operation_id = "watch_farm",
    responses(
        (status = 200, content_type = "text/event-stream", description = "the data of each event is a `FarmNews` as JSON"),
        (status = "4XX", body = Problem)
    )
)]
pub(super) async fn events(State(service): State<App>) -> Result<Response, ApiError> {
    let mut watcher = Watcher {
        progress: service.progress(),
        stopping: service.stopping(),
        service,
        jobs: BTreeMap::new(),
        workers: Vec::new(),
        serial: 0,
    };
    let first = watcher.news().await?;
    let events = stream::unfold((watcher, Some(first)), |(mut watcher, first)| async move {
        let news = match first {
            Some(first) => first,
            None => watcher.next().await?,
        };
        watcher.serial += 1;
        let event = Event::default()
            .event(EVENT_FARM)
            .id(watcher.serial.to_string())
            .retry(RETRY);
        Some((Ok::<_, Infallible>(event.json_data(&news).ok()?), (watcher, None)))
    });
    let stream = Sse::new(events).keep_alive(KeepAlive::default());
    Ok(([NO_BUFFERING], stream).into_response())
}

struct Watcher {
    service: App,
    progress: watch::Receiver<u64>,
    stopping: watch::Receiver<bool>,
    /// What was told.
    jobs: BTreeMap<JobId, JobStatus>,
    workers: Vec<WorkerStatus>,
    serial: u64,
}

impl Watcher {
    /// Waits for news; none after the end of the service.
    async fn next(&mut self) -> Option<FarmNews> {
        loop {
            tokio::select! {
                changed = self.progress.changed() => changed.ok()?,
                () = tokio::time::sleep(TICK) => {}
                _ = self.stopping.wait_for(|stop| *stop) => return None,
            }
            tokio::time::sleep(STEP).await;
            self.progress.mark_unchanged();
            let news = self.news().await.ok()?;
            if !news.jobs.is_empty() || !news.gone.is_empty() || news.workers.is_some() {
                return Some(news);
            }
        }
    }

    /// What is not as it was told.
    async fn news(&mut self) -> Result<FarmNews, ApiError> {
        let page = self.service.list_jobs(JobFilter::default(), Some(JOBS)).await?;
        let workers = self.service.workers().await?;
        let now: BTreeMap<JobId, JobStatus> = page.jobs.into_iter().map(|job| (job.id, job)).collect();
        let changed = now.iter().filter(|(id, job)| self.jobs.get(id) != Some(job));
        let gone = self.jobs.keys().filter(|id| !now.contains_key(id));
        let whole = self.serial == 0;
        // How long a worker has been silent changes all the time.
        let heard = |worker: &WorkerStatus| WorkerStatus {
            silent_ms: worker.silent_ms / TICK.as_millis() as u64,
            ..worker.clone()
        };
        let compared: Vec<WorkerStatus> = workers.iter().map(heard).collect();
        let found = self.service.found_obstacles().into_iter();
        let news = FarmNews {
            pending_iterations: self.service.figures().await?.pending_iterations,
            obstacles: found.map(|(_, obstacle)| obstacle).collect(),
            whole,
            jobs: changed.map(|(_, job)| job.clone()).collect(),
            gone: gone.copied().collect(),
            workers: (whole || compared != self.workers).then_some(workers),
        };
        (self.jobs, self.workers) = (now, compared);
        Ok(news)
    }
}

//! Progress of a job as server-sent events.

use super::extract::Id;
use super::{ApiError, App};
use axum::extract::State;
use axum::response::Sse;
use axum::response::sse::{Event, KeepAlive};
use futures_util::Stream;
use futures_util::stream;
use photonfarm_proto::api::{EVENT_END, EVENT_STATUS};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::problem::Problem;
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::watch;

/// Least time between two events.
const STEP: Duration = Duration::from_millis(200);

/// The job's status whenever it changes: events `status`, and at last one `end`. The data is a `JobStatus`.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/events", params(("id" = JobId, Path)),
    responses(
        (status = 200, content_type = "text/event-stream", description = "the data of each event is a `JobStatus` as JSON"),
        (status = "4XX", body = Problem)
    )
)]
pub(super) async fn events(
    State(service): State<App>,
    Id(id): Id<JobId>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, ApiError> {
    let status = service.status(id).await?;
    let follower = Follower {
        progress: service.progress(),
        stopping: service.stopping(),
        service,
        id,
        next: Some(status),
        last: None,
    };
    let events = stream::unfold(follower, |mut follower| async move {
        let status = follower.next_status().await?;
        let name = if status.state.ended() { EVENT_END } else { EVENT_STATUS };
        let event = Event::default().event(name).json_data(&status).ok()?;
        follower.last = Some(status);
        Some((Ok(event), follower))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::default()))
}

struct Follower {
    service: App,
    id: JobId,
    progress: watch::Receiver<u64>,
    stopping: watch::Receiver<bool>,
    next: Option<JobStatus>,
    last: Option<JobStatus>,
}

impl Follower {
    /// The next status that differs; none after the end of the job or of the service.
    async fn next_status(&mut self) -> Option<JobStatus> {
        if let Some(first) = self.next.take() {
            return Some(first);
        }
        if self.last.as_ref().is_some_and(|last| last.state.ended()) {
            return None;
        }
        loop {
            tokio::select! {
                changed = self.progress.changed() => changed.ok()?,
                _ = self.stopping.wait_for(|stop| *stop) => return None,
            }
            tokio::time::sleep(STEP).await;
            self.progress.mark_unchanged();
            let status = self.service.status(self.id).await.ok()?;
            if self.last.as_ref() != Some(&status) {
                return Some(status);
            }
        }
    }
}

//! Progress of a job as server-sent events.

use super::extract::Id;
use super::{ApiError, App};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::sse::{Event, KeepAlive};
use axum::response::{IntoResponse, Response, Sse};
use futures_util::stream;
use photonfarm_proto::api::{EVENT_END, EVENT_STATUS};
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::problem::Problem;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Least time between two events.
const STEP: Duration = Duration::from_millis(200);
/// How long a client whose stream broke waits before it asks again.
pub(super) const RETRY: Duration = Duration::from_secs(1);
/// Says which event was the last that came; browsers send it when they ask again.
const LAST_EVENT_ID: &str = "last-event-id";
/// Keeps nginx, and what does as nginx does, from collecting events before it passes them on.
pub(super) const NO_BUFFERING: (HeaderName, HeaderValue) = (
    HeaderName::from_static("x-accel-buffering"),
    HeaderValue::from_static("no"),
);

/// The job's status whenever it changes: events `status`, and at last one `end`. The data is a `JobStatus`. Every event
/// has an id; who sends that of the last one as `Last-Event-ID` gets what is new, and 204 where nothing more will come.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/events", operation_id = "watch_job",
    params(
        ("id" = JobId, Path),
        ("Last-Event-ID" = Option<String>, Header, description = "the id of the last event that came")
    ),
    responses(
        (status = 200, content_type = "text/event-stream", description = "the data of each event is a `JobStatus` as JSON"),
        (status = 204, description = "the last event came already"),
        (status = "4XX", body = Problem)
    )
)]
pub(super) async fn events(
    State(service): State<App>,
    Id(id): Id<JobId>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let status = Arc::new(service.status(id).await?);
    let known = headers.get(LAST_EVENT_ID).and_then(|value| value.to_str().ok());
    let known = known.is_some_and(|known| known == event_id(&status));
    if known && status.state.ended() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let (next, last) = match known {
        true => (None, Some(status)),
        false => (Some(status), None),
    };
    let follower = Follower {
        progress: service.progress(),
        stopping: service.stopping(),
        service,
        id,
        next,
        last,
    };
    let events = stream::unfold(follower, |mut follower| async move {
        let status = follower.next_status().await?;
        let name = if status.state.ended() { EVENT_END } else { EVENT_STATUS };
        let event = Event::default().event(name).id(event_id(&status)).retry(RETRY);
        let event = event.json_data(&*status).ok()?;
        follower.last = Some(status);
        Some((Ok::<_, Infallible>(event), follower))
    });
    let stream = Sse::new(events).keep_alive(KeepAlive::default());
    Ok(([NO_BUFFERING], stream).into_response())
}

/// The same for the same status, whichever coordinator of a farm shows it.
fn event_id(status: &JobStatus) -> String {
    let text = serde_json::to_vec(status).unwrap_or_default();
    BlobHash::of(&text).to_string()[..16].to_owned()
}

struct Follower {
    service: App,
    id: JobId,
    progress: watch::Receiver<u64>,
    stopping: watch::Receiver<bool>,
    next: Option<Arc<JobStatus>>,
    last: Option<Arc<JobStatus>>,
}

impl Follower {
    /// The next status that differs; none after the end of the job or of the service.
    async fn next_status(&mut self) -> Option<Arc<JobStatus>> {
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
            let status = self.service.followed(self.id).await.ok()?;
            if self.last.as_ref() != Some(&status) {
                return Some(status);
            }
        }
    }
}

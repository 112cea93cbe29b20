//! URLs are told when jobs end.
//!
//! What is to be told is part of the commit with which a job ends, so that nothing is lost whenever a coordinator is killed. The one that
//! leads sends it until it is answered, or for a day; one that is killed before it has kept the answer sends it again.

use super::{Service, ServiceError};
use crate::scheduler::Farm;
use crate::scheduler::record::{Change, JobHead, Millis, Notice};
use crate::store::{NoticeRecord, StoreError};
use crate::webhook::Webhooks;
use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobState};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::webhook::{Delivery, DeliveryPage, DeliveryState, JobNotice};
use std::sync::Arc;
use std::time::Duration;

/// Deliveries under way at once.
const AT_ONCE: u32 = 32;
/// Longest time without a look for what is to be sent.
const POLL: Duration = Duration::from_secs(1);
/// How long deliveries that arrived or were given up are shown \[ms\].
const SHOWN: Millis = 7 * 24 * 3_600_000;
/// Deliveries on a page if the client does not say.
const DEFAULT_PAGE: u32 = 20;

impl Service {
    /// Refuses a job whose webhook this farm would not tell.
    pub(super) fn check_webhook(&self, spec: &JobSpec) -> Result<(), Problem> {
        match (&spec.webhook, &self.webhooks) {
            (None, _) => Ok(()),
            (Some(url), Some(webhooks)) => webhooks.check(url),
            (Some(_), None) => {
                let detail = "webhook: this farm tells no URLs: its operator has given no secret to sign with";
                Err(Problem::new(ErrorCode::Invalid, detail).at("webhook", None))
            }
        }
    }

    /// The changes, and what URLs are to be told of jobs that end with them.
    pub(super) fn with_notices(&self, farm: &Farm, mut changes: Vec<Change>) -> Result<Vec<Change>, StoreError> {
        let Some(webhooks) = &self.webhooks else {
            return Ok(changes);
        };
        let mut notices = Vec::new();
        for change in &changes {
            if let Change::JobEnded {
                job,
                state,
                failure,
                ended_ms,
            } = change
                && let Some(job) = farm.job(*job)
            {
                let end = (*state, failure.as_deref(), *ended_ms);
                notices.extend(self.notices_of(webhooks, job.head(), end)?);
            }
        }
        changes.extend(notices.into_iter().map(Change::NoticeAdded));
        Ok(changes)
    }

    /// What is to be told of the end of a job: once to each URL.
    fn notices_of(
        &self,
        webhooks: &Webhooks,
        head: &JobHead,
        (state, failure, ended_ms): (JobState, Option<&str>, Millis),
    ) -> Result<Vec<Notice>, StoreError> {
        let of_farm = webhooks.urls.iter().map(|url| (url, true));
        let of_job = head.spec.webhook.iter().filter(|url| !webhooks.urls.contains(url));
        let told = of_farm.chain(of_job.map(|url| (url, false)));
        let notice = |(url, trusted): (&String, bool)| {
            let id = format!("{ended_ms:012x}{:016x}", getrandom::u64()?);
            let notice = JobNotice {
                event: format!("job.{}", how(state)),
                delivery: id.clone(),
                farm: self.identity().farm,
                job: head.id,
                name: head.spec.name.clone(),
                labels: head.spec.labels.clone(),
                owner: head.owner.clone(),
                state,
                failure: failure.map(str::to_owned),
                at_ms: ended_ms,
                link: format!("{}/v1/jobs/{}", webhooks.farm_url, head.id),
            };
            let body = serde_json::to_string(&notice).map_err(|error| StoreError::Damaged(error.to_string()))?;
            Ok(Notice {
                id,
                job: head.id,
                url: url.clone(),
                trusted,
                body,
                created_ms: ended_ms,
            })
        };
        told.map(notice).collect()
    }

    /// Sends what is to be sent, until the service stops.
    pub(super) async fn tell(self: Arc<Self>) {
        let Some(webhooks) = &self.webhooks else { return };
        let mut unkept = Vec::new();
        loop {
            if self.leads()
                && let Err(error) = self.tell_all(webhooks, &mut unkept).await
            {
                tracing::warn!(%error, "URLs are told of jobs later");
            }
            let _either = tokio::time::timeout(POLL, self.told.notified()).await;
        }
    }

    /// Sends what is due. What became of attempts and could not be kept is `unkept`: nothing is sent before it is.
    async fn tell_all(&self, webhooks: &Webhooks, unkept: &mut Vec<NoticeRecord>) -> Result<(), StoreError> {
        let state = &self.stores.state;
        while let Some(record) = unkept.last() {
            state.keep_attempt(record.clone()).await?;
            unkept.pop();
        }
        let due = state.due_notices(self.clock.now(), AT_ONCE).await?;
        if due.len() == AT_ONCE as usize {
            self.told.notify_one();
        }
        let mut attempts: FuturesUnordered<_> = due.into_iter().map(|record| self.attempt(webhooks, record)).collect();
        let mut failed = None;
        while let Some(record) = attempts.next().await {
            if let Err(error) = state.keep_attempt(record.clone()).await {
                unkept.push(record);
                failed = Some(error);
            }
        }
        failed.map_or(Ok(()), Err)
    }

    /// Sends a notice, and says what is to become of it.
    async fn attempt(&self, webhooks: &Webhooks, mut record: NoticeRecord) -> NoticeRecord {
        let sent = webhooks.send(&record.notice, self.clock.now()).await;
        let (now, Notice { id, job, .. }) = (self.clock.now(), &record.notice);
        record.attempts += 1;
        match sent {
            Ok(()) => {
                tracing::debug!(%job, delivery = id, "a URL was told");
                (record.due_ms, record.ended_ms, record.error) = (None, Some(now), None);
            }
            Err(reason) => {
                let next = now + webhooks.retries.pause_ms(record.attempts);
                let last = record.notice.created_ms + webhooks.retries.within.as_millis() as Millis;
                let goes_on = next <= last;
                match goes_on {
                    true => tracing::info!(%job, delivery = id, "a URL was not told, and is to be again: {reason}"),
                    false => tracing::error!(
                        %job, delivery = id, attempts = record.attempts,
                        "a URL was not told of the end of the job, and is not tried again: {reason}"
                    ),
                }
                record.due_ms = goes_on.then_some(next);
                record.ended_ms = (!goes_on).then_some(now);
                record.error = Some(reason);
            }
        }
        self.counts.note_delivery(state(&record));
        record
    }

    /// Deliveries that arrived or were given up long ago are shown no more.
    pub(super) async fn forget_deliveries(&self) -> Result<(), ServiceError> {
        let before = self.clock.now().saturating_sub(SHOWN);
        self.stores.state.forget_notices(before).await?;
        Ok(())
    }

    /// A page of deliveries, newest first; of one job if it is named.
    pub(crate) async fn deliveries(
        &self,
        job: Option<JobId>,
        cursor: Option<String>,
        limit: Option<u32>,
    ) -> Result<DeliveryPage, ServiceError> {
        let limit = limit.unwrap_or(DEFAULT_PAGE);
        let mut records = self.stores.state.notices(job, cursor, limit + 1).await?;
        let more = records.len() > limit as usize;
        records.truncate(limit as usize);
        let next = records.last().filter(|_| more).map(|record| record.notice.id.clone());
        let deliveries = records.into_iter().map(shown).collect();
        Ok(DeliveryPage { deliveries, next })
    }
}

fn how(state: JobState) -> &'static str {
    match state {
        JobState::Done => "done",
        JobState::Cancelled => "cancelled",
        _ => "failed",
    }
}

fn state(record: &NoticeRecord) -> DeliveryState {
    match (record.due_ms, &record.error) {
        (Some(_), _) => DeliveryState::Pending,
        (None, None) => DeliveryState::Delivered,
        (None, Some(_)) => DeliveryState::GivenUp,
    }
}

fn shown(record: NoticeRecord) -> Delivery {
    Delivery {
        state: state(&record),
        id: record.notice.id,
        job: record.notice.job,
        url: record.notice.url,
        of_farm: record.notice.trusted,
        attempts: record.attempts,
        created_ms: record.notice.created_ms,
        due_ms: record.due_ms,
        ended_ms: record.ended_ms,
        error: record.error,
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::World;
    use super::*;
    use crate::scheduler::SchedulerConfig;
    use crate::store::StateStore;
    use crate::store::memory::NextCommit;
    use crate::webhook::{WebhookConfig, WebhookSecret};
    use photonfarm_proto::limits::Limits;
    use photonfarm_proto::trace::Tracer;

    /// Whatever becomes of the commit with which a job ends, it is told once if the job has ended, and not at all if it goes on.
    #[tokio::test]
    async fn a_job_is_to_be_told_of_if_and_only_if_it_has_ended() {
        for (next, ended) in [
            (NextCommit::Fails, false),
            (NextCommit::SucceedsUnnoticed, true),
            (NextCommit::SucceedsAndPanics, true),
        ] {
            let world = World::new(1).await;
            let config = WebhookConfig {
                secret: Some(WebhookSecret::new(&[7; 16]).unwrap()),
                urls: vec!["http://example.org/".into()],
                ..WebhookConfig::default()
            };
            let webhooks = Webhooks::new(config, "http://farm").unwrap();
            let stores = world.service.stores.clone();
            let service = Service::open(
                Limits::default(),
                SchedulerConfig::default(),
                stores,
                webhooks,
                Tracer::default(),
            )
            .await;
            let service = service.unwrap();
            let due = async || world.state.due_notices(Millis::MAX, 9).await.unwrap().len();
            *world.state.next.lock().unwrap() = next;
            assert!(service.cancel_job(world.job).await.is_err(), "{next:?}");
            assert_eq!(due().await, usize::from(ended), "{next:?}");
            assert_eq!(
                service.status(world.job).await.unwrap().state.ended(),
                ended,
                "{next:?}"
            );
            service.cancel_job(world.job).await.unwrap();
            assert_eq!(due().await, 1, "{next:?}");
        }
    }
}

//! What workers say: here I am, give me work, I am alive, it failed, I go.

use super::{Service, ServiceError, VERSION};
use crate::scheduler::record::{LeaseRecord, Millis, Origin};
use crate::scheduler::{Asked, Decision, Farm, Refusal, Skill};
use photonfarm_proto::api::WorkerStatus;
use photonfarm_proto::id::{JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{Attempt, FailureKind, JobSpec};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::schedule::{Schedule, check_tags};
use photonfarm_proto::version_of;
use photonfarm_proto::worker::{
    Assignment, FailureReport, Heartbeat, Lease, LeaseRequest, MOST_LEASES, NodeUpload, Register, Release, SceneReport,
};
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest wait for a lease in one request.
const LONGEST_POLL: Duration = Duration::from_secs(30);
/// How often a waiting worker is considered even if nobody woke it: time may have brought what only this one may do.
const POLL_STEP: Duration = Duration::from_secs(5);

impl Service {
    /// A worker introduces itself.
    pub async fn register(self: &Arc<Self>, register: Register, origin: Origin) -> Result<WorkerId, ServiceError> {
        let version = version_of(&register.renderer);
        if version != VERSION {
            let detail = format!("the worker has version {version}, this farm {VERSION}");
            return Err(Problem::new(ErrorCode::VersionMismatch, detail).into());
        }
        if register.name.len() > 255 || register.renderer.len() > 255 {
            return Err(Problem::new(ErrorCode::Invalid, "a worker's name has at most 255 bytes").into());
        }
        check_tags(&register.tags, "tags")?;
        self.transact(move |farm, now| farm.register(register.clone(), origin.clone(), now))
            .await
    }

    /// Refuses somebody who speaks for a worker that was registered with another token.
    pub(crate) async fn check_worker(self: &Arc<Self>, worker: WorkerId, token: &str) -> Result<(), ServiceError> {
        let mut cell = self.fresh_farm().await?;
        if !cell.farm.knows(worker) {
            self.catch_up(&mut cell).await?;
        }
        Ok(cell.farm.check_token(worker, token)?)
    }

    /// Time between heartbeats that workers are told.
    pub async fn heartbeat_ms(self: &Arc<Self>) -> Millis {
        (self.farm.lock().await.farm.config().lease_ttl_ms / 5).max(20)
    }

    /// A worker asks for work and waits for it.
    pub async fn lease(self: &Arc<Self>, request: LeaseRequest) -> Result<Option<Assignment>, ServiceError> {
        let deadline = Instant::now() + Duration::from_millis(request.wait_ms).min(LONGEST_POLL);
        let mut stopping = self.stopping();
        let mut was_woken = false;
        check_count(request.held.len())?;
        let asked = Asked {
            worker: request.worker,
            serial: request.serial,
            held: request.held,
        };
        let skill = self.hear(&asked).await?;
        let room = self.waiters.room(skill);
        loop {
            let mut woken = pin!(room.notified());
            woken.as_mut().enable();
            let wanted = asked.clone();
            let decide = move |farm: &Farm, now| {
                let decision = farm.lease(&wanted, now)?;
                let next = match (&decision.reply, decision.changes.is_empty()) {
                    (Some(lease), _) => Next::Assign(lease.clone()),
                    (None, false) => Next::AskAgain,
                    (None, true) => Next::Wait {
                        others_may: farm.wants_repeats(),
                    },
                };
                Ok(Decision {
                    reply: next,
                    changes: decision.changes,
                })
            };
            match self.transact(decide).await? {
                Next::Assign(lease) => {
                    // There may be more.
                    room.notify_one();
                    return self.assignment(&lease).await;
                }
                Next::AskAgain => continue,
                Next::Wait { others_may } => {
                    if others_may && was_woken {
                        room.notify_one();
                    }
                }
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() || *stopping.borrow() {
                return Ok(None);
            }
            tokio::select! {
                () = woken => was_woken = true,
                _ = stopping.changed() => {}
                () = tokio::time::sleep(left.min(POLL_STEP)) => was_woken = false,
            }
            self.hear(&asked).await?;
        }
    }

    /// The work of a lease; none if its job has ended meanwhile.
    async fn assignment(self: &Arc<Self>, record: &LeaseRecord) -> Result<Option<Assignment>, ServiceError> {
        let cell = self.fresh_farm().await?;
        let expires_in_ms = cell.farm.config().lease_ttl_ms;
        let LeaseRecord {
            token,
            job,
            node,
            worker,
            attempt,
            ..
        } = *record;
        let now = self.clock.now();
        Ok(cell.farm.job(job).map(|known| Assignment {
            lease: Lease {
                token,
                job,
                node,
                worker,
                attempt,
                expires_in_ms,
                ends_in_ms: known.ms_left(now),
            },
            // Workers need none of these, and those of older builds may know other forms of them.
            spec: JobSpec {
                name: String::new(),
                labels: Default::default(),
                after: None,
                webhook: None,
                schedule: Schedule::default(),
                ..known.spec()
            },
        }))
    }

    /// A worker asks for work, which is a sign of life. Replies with what it can do.
    async fn hear(self: &Arc<Self>, asked: &Asked) -> Result<Arc<Skill>, ServiceError> {
        let now = self.clock.now();
        let mut cell = self.fresh_farm().await?;
        while let Err(refusal) = cell.farm.asks(asked.worker, asked.serial, now) {
            if !self.catch_up(&mut cell).await? {
                return Err(refusal.into());
            }
        }
        self.note_beat(asked.worker, &[], now);
        let skill = cell.farm.skill_of(asked.worker);
        Ok(skill.ok_or(Refusal::UnknownWorker(asked.worker))?)
    }

    /// A sign of life; returns the leases that are lost.
    pub async fn heartbeat(self: &Arc<Self>, heartbeat: &Heartbeat) -> Result<Vec<LeaseToken>, ServiceError> {
        let (worker, leases) = (heartbeat.worker, heartbeat.leases.as_slice());
        check_count(leases.len())?;
        let mut cell = self.fresh_farm().await?;
        let lost = loop {
            let now = self.clock.now();
            let result = cell.farm.heartbeat(worker, leases, now);
            let sure = matches!(&result, Ok(lost) if lost.is_empty());
            if sure || !self.catch_up(&mut cell).await? {
                self.note_beat(worker, leases, now);
                break result?;
            }
        };
        let decision = cell.farm.reconnected(worker, self.clock.now());
        drop(cell);
        if !decision.changes.is_empty() {
            let worker = heartbeat.worker;
            self.transact(move |farm, now| Ok(farm.reconnected(worker, now)))
                .await?;
        }
        self.progress.send_modify(|version| *version += 1);
        Ok(lost)
    }

    /// A worker says what loading the scene of a job has shown.
    pub(crate) async fn report_scene(self: &Arc<Self>, report: SceneReport) -> Result<(), ServiceError> {
        let job = report.job;
        let reported = self.transact(move |farm, _| farm.report_scene(&report)).await;
        if let Err(ServiceError::Refusal(Refusal::Disagreement(_))) = &reported {
            self.note_disagreement(job);
        }
        reported
    }

    /// A worker could not render an iteration.
    pub async fn fail(self: &Arc<Self>, report: FailureReport) -> Result<(), ServiceError> {
        let FailureReport {
            token,
            worker,
            job,
            leaf,
            kind,
            message,
        } = report;
        if kind == FailureKind::Lost {
            return Err(Problem::new(ErrorCode::Invalid, "a worker cannot report itself lost").into());
        }
        let attempt = Attempt {
            worker,
            kind,
            message: photonfarm_proto::worker::cut_text(message),
            at_ms: self.clock.now(),
        };
        self.failed(job, token, leaf, attempt).await
    }

    async fn failed(
        self: &Arc<Self>,
        job: JobId,
        token: LeaseToken,
        leaf: u32,
        attempt: Attempt,
    ) -> Result<(), ServiceError> {
        self.transact(move |farm, now| farm.fail(job, token, leaf, attempt.clone(), now))
            .await?;
        self.transact(move |farm, now| Ok(farm.settle(job, now))).await
    }

    /// The image that a worker sent cannot be used: a failure of the worker at the node's first leaf.
    pub(super) async fn blame(self: &Arc<Self>, upload: &NodeUpload, reason: &str) -> Result<(), ServiceError> {
        let NodeUpload {
            token,
            worker,
            job,
            node,
            ..
        } = *upload;
        let Ok(leaf) = u32::try_from(node.first()) else {
            return Ok(());
        };
        let attempt = Attempt {
            worker,
            kind: FailureKind::Render,
            message: format!("worker {worker} sent node {node}, but {reason}"),
            at_ms: self.clock.now(),
        };
        self.failed(job, token, leaf, attempt).await
    }

    /// A worker gives a lease back.
    pub async fn release(self: &Arc<Self>, release: Release) -> Result<(), ServiceError> {
        let Release { token, worker, job } = release;
        self.transact(move |farm, _| Ok(farm.release(job, token, worker))).await
    }

    /// A worker ends.
    pub async fn leave(self: &Arc<Self>, worker: WorkerId) -> Result<(), ServiceError> {
        self.transact(move |farm, _| Ok(farm.leave(worker))).await
    }

    /// The workers heard of lately.
    pub async fn workers(self: &Arc<Self>) -> Result<Vec<WorkerStatus>, ServiceError> {
        Ok(self.fresh_farm().await?.farm.worker_statuses(self.clock.now()))
    }
}

/// What follows from a request for work.
enum Next {
    Assign(LeaseRecord),
    /// Leases ended of which the worker knows nothing.
    AskAgain,
    /// Nothing to do for this worker.
    Wait {
        /// Whether there is something that workers of others may do.
        others_may: bool,
    },
}

/// Refuses a message that names more leases than a worker may.
fn check_count(leases: usize) -> Result<(), Problem> {
    if leases <= MOST_LEASES {
        return Ok(());
    }
    let detail = format!("the message names {leases} leases, and a worker names at most {MOST_LEASES}");
    Err(Problem::new(ErrorCode::Limit, detail))
}

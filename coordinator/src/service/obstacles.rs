//! What keeps the whole farm from going on: a store that fails or does not answer, a disk that is full.
//!
//! Each use of a store says what became of it. An obstacle ends with the next use that succeeds, and is forgotten where
//! nothing was tried for long: workers try again within seconds.

use super::{Service, ServiceError};
use crate::scheduler::record::Millis;
use crate::scheduler::{Farm, Figures, Job};
use crate::store::{JobFilter, StoreError};
use photonfarm_proto::api::Obstacle;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::waiting::Waiting;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time after which an obstacle that nobody has met again is forgotten.
pub(super) const FORGOTTEN: Duration = Duration::from_secs(120);
/// Time between two looks at the state store.
const LOOK: Duration = Duration::from_secs(2);
/// How long the state store may take for it.
const PATIENCE: Duration = Duration::from_secs(5);

/// What of the stores is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    /// The state is read.
    Answers,
    /// The state is written.
    State,
    /// Images of nodes are written.
    Images,
    /// Files of scenes are written.
    Scenes,
}

impl Part {
    pub(crate) const ALL: [Self; 4] = [Self::Answers, Self::State, Self::Images, Self::Scenes];

    /// Its name in figures.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Answers => "answers",
            Self::State => "state",
            Self::Images => "images",
            Self::Scenes => "scenes",
        }
    }

    fn detail(self, reason: Waiting) -> &'static str {
        match (self, reason) {
            (Self::Answers, _) => "the state store does not answer",
            (Self::State, Waiting::DiskFull) => "the disk of the state is full",
            (Self::State, _) => "the state cannot be written",
            (Self::Images, Waiting::DiskFull) => "the disk of the images is full",
            (Self::Images, _) => "images cannot be stored",
            (Self::Scenes, Waiting::DiskFull) => "the disk of the scenes is full",
            (Self::Scenes, _) => "files of scenes cannot be stored",
        }
    }
}

/// What is known of a part.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    failing: Option<(Waiting, Instant)>,
    /// Failures by disks that were full, and others.
    failures: [u64; 2],
}

/// What is known of all parts.
#[derive(Debug, Default)]
pub(super) struct Obstacles {
    parts: Mutex<BTreeMap<Part, Known>>,
    /// When workers last disagreed about the settings that the scene of a job decides.
    disagreements: Mutex<BTreeMap<JobId, Instant>>,
    /// Jobs that wait, by the reason, when the state store was last looked at.
    jobs: Mutex<BTreeMap<Waiting, u64>>,
}

/// What a failure of a store means; nothing where the request is to blame.
fn reason(error: &StoreError) -> Option<Waiting> {
    let full = match error {
        StoreError::Io { source, .. } => matches!(source.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded),
        StoreError::Sqlite(error) => error.sqlite_error_code() == Some(rusqlite::ErrorCode::DiskFull),
        StoreError::Postgres(error) => error.code() == Some(&tokio_postgres::error::SqlState::DISK_FULL),
        _ => false,
    };
    match full {
        true => Some(Waiting::DiskFull),
        false => (error.retryable() && !matches!(error, StoreError::Stopped | StoreError::TooLate))
            .then_some(Waiting::StoreAway),
    }
}

impl Service {
    /// Remembers what became of a use of a store; failures of the state are the state's wherever they show.
    pub(crate) fn note<T>(&self, part: Part, result: &Result<T, ServiceError>) {
        let found = match result {
            Ok(_) => None,
            Err(ServiceError::Store(error)) => match reason(error) {
                None => return,
                found => found,
            },
            Err(_) => return,
        };
        let of_state = matches!(
            result,
            Err(ServiceError::Store(
                StoreError::Sqlite(_) | StoreError::Postgres(_) | StoreError::Connection(_)
            ))
        );
        let part = match of_state && part != Part::Answers {
            true => Part::State,
            false => part,
        };
        let mut parts = self.obstacles.parts.lock().unwrap_or_else(PoisonError::into_inner);
        let known = parts.entry(part).or_default();
        known.failing = found.map(|reason| (reason, Instant::now()));
        if let Some(reason) = found {
            known.failures[usize::from(reason != Waiting::DiskFull)] += 1;
        }
    }

    /// What keeps the farm from going on now.
    pub(crate) fn found_obstacles(&self) -> Vec<(Part, Obstacle)> {
        let parts = self.obstacles.parts.lock().unwrap_or_else(PoisonError::into_inner);
        let failing = parts.iter().filter_map(|(part, known)| {
            let (reason, at) = known.failing?;
            let obstacle = Obstacle {
                part: part.name().into(),
                reason,
                detail: part.detail(reason).into(),
            };
            (at.elapsed() < FORGOTTEN).then_some((*part, obstacle))
        });
        failing.collect()
    }

    /// How often a part failed since the start: by a disk that was full, and otherwise.
    pub(crate) fn failures(&self, part: Part) -> [u64; 2] {
        let parts = self.obstacles.parts.lock().unwrap_or_else(PoisonError::into_inner);
        parts.get(&part).copied().unwrap_or_default().failures
    }

    /// How many jobs waited when that was last looked at, by the reason.
    pub(crate) fn jobs_waiting(&self) -> BTreeMap<Waiting, u64> {
        let jobs = self.obstacles.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        jobs.clone()
    }

    /// Workers disagree about the settings that the scene of a job decides. They ask again within seconds, for as long as they
    /// disagree.
    pub(super) fn note_disagreement(&self, job: JobId) {
        let mut disagreements = self.disagreements();
        disagreements.retain(|_, at| at.elapsed() < FORGOTTEN);
        disagreements.insert(job, Instant::now());
        drop(disagreements);
        self.progress.send_modify(|version| *version += 1);
    }

    fn is_disputed(&self, job: JobId) -> bool {
        self.disagreements()
            .get(&job)
            .is_some_and(|at| at.elapsed() < FORGOTTEN)
    }

    fn disagreements(&self) -> MutexGuard<'_, BTreeMap<JobId, Instant>> {
        let disagreements = &self.obstacles.disagreements;
        disagreements.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The status of a job, with what keeps the whole farm from going on.
    pub(super) fn held_up(&self, mut status: JobStatus) -> JobStatus {
        if status.state.ended() || status.waiting_reason == Some(Waiting::Paused) {
            return status;
        }
        if let Some(obstacle) = self.obstacle_for_jobs() {
            (status.waiting, status.waiting_reason) = (Some(obstacle.detail), Some(obstacle.reason));
        } else if let Some(name) = self.missing_files.of_scene(status.spec.scene) {
            let detail = format!(
                "{name} of its scene is missing on the farm, or was damaged: submit the scene again, which sends it, and this job \
                 goes on"
            );
            (status.waiting, status.waiting_reason) = (Some(detail), Some(Waiting::Scene));
        } else if self.is_disputed(status.id) {
            let detail = "workers disagree about the settings that its scene decides: cancel it, and submit it with all settings, as \
                          `photonfarm submit` does";
            (status.waiting, status.waiting_reason) = (Some(detail.into()), Some(Waiting::Dispute));
        }
        status
    }

    /// The figures of all jobs, with what keeps the whole farm, or some of them, from going on.
    pub(super) fn all_held_up(&self, farm: &Farm, now: Millis) -> Figures {
        let mut figures = farm.figures(now);
        if let Some(obstacle) = self.obstacle_for_jobs() {
            figures.waiting.retain(|reason, _| *reason == Waiting::Paused);
            let paused: u64 = figures.waiting.values().sum();
            if figures.jobs > paused {
                figures.waiting.insert(obstacle.reason, figures.jobs - paused);
            }
            return figures;
        }
        for job in self.jobs_held_up(farm) {
            let status = farm.status(job, now);
            let before = status.waiting_reason;
            figures.recount(before, self.held_up(status).waiting_reason);
        }
        figures
    }

    /// The jobs that are kept from going on by what the scheduler does not know: files of their scenes are missing, or workers
    /// disagree about their settings. All jobs are looked at only while files are missing.
    fn jobs_held_up<'a>(&self, farm: &'a Farm) -> Vec<&'a Job> {
        let disputed = |job: &&Job| self.is_disputed(job.id());
        let lacks_files = |job: &&Job| self.missing_files.of_scene(job.head().spec.scene).is_some();
        match self.missing_files.is_empty() {
            true => {
                let ids: Vec<JobId> = self.disagreements().keys().copied().collect();
                let jobs = ids.into_iter().filter_map(|id| farm.job(id));
                jobs.filter(disputed).collect()
            }
            false => farm.jobs().filter(|job| disputed(job) || lacks_files(job)).collect(),
        }
    }

    /// What keeps every job from going on.
    fn obstacle_for_jobs(&self) -> Option<Obstacle> {
        let found = self.found_obstacles().into_iter();
        let found = found.filter(|(part, _)| *part != Part::Scenes);
        found.map(|(_, obstacle)| obstacle).next()
    }

    /// Looks at the state store and at the jobs now and then, so that whoever asks how the farm is costs nothing.
    pub(super) async fn look_around(self: Arc<Self>) {
        loop {
            let late = |_| Err(StoreError::Connection("it does not answer".into()));
            let answer = tokio::time::timeout(PATIENCE, self.stores.state.jobs(JobFilter::default(), 1)).await;
            self.note(Part::Answers, &answer.unwrap_or_else(late).map_err(ServiceError::from));
            if let Ok(figures) = self.figures().await {
                *self.obstacles.jobs.lock().unwrap_or_else(PoisonError::into_inner) = figures.waiting;
            }
            tokio::time::sleep(LOOK).await;
        }
    }
}

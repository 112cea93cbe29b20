//! A farm's public interface, as a test uses it.

use super::job::{Job, Reference};
use crate::processes::{Launch, http, printed, wait_for};
use photonfarm_proto::api::{Health, IDEMPOTENCY_KEY, JobPage, WorkerList};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobState, JobStatus};
use photonfarm_proto::problem::Problem;
use reqwest::Method;
use serde::de::DeserializeOwned;

/// Asks a farm.
#[derive(Clone, Debug)]
pub struct Client {
    /// Where it answers.
    pub url: String,
    token: Option<String>,
}

impl Client {
    /// Of a farm without tokens.
    #[must_use]
    pub fn new(url: &str) -> Self {
        Self {
            url: url.to_owned(),
            token: None,
        }
    }

    /// The same with a token.
    #[must_use]
    pub fn with_token(self, token: Option<&str>) -> Self {
        Self {
            token: token.map(str::to_owned),
            ..self
        }
    }

    /// The token.
    #[must_use]
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// Sends a request; nothing where no answer comes.
    #[must_use]
    pub fn send(&self, method: Method, path: &str, headers: &[(&str, &str)], body: Vec<u8>) -> Option<(u16, Vec<u8>)> {
        let bearer = self.token.as_ref().map(|token| format!("Bearer {token}"));
        let mut headers = headers.to_vec();
        headers.extend(bearer.as_deref().map(|bearer| ("authorization", bearer)));
        http(method, &format!("{}/v1/{path}", self.url), body, &headers)
    }

    /// Asks for JSON; nothing where the farm is away or has no such thing.
    #[must_use]
    pub fn get<T: DeserializeOwned>(&self, path: &str) -> Option<T> {
        let (status, body) = self.send(Method::GET, path, &[], Vec::new())?;
        (status == 200).then(|| serde_json::from_slice(&body).ok())?
    }

    /// Submits a job by the command line.
    ///
    /// # Panics
    /// Where it is refused.
    #[must_use]
    pub fn submit(&self, job: &Job) -> JobId {
        let mut arguments = vec!["submit".to_owned(), "--coordinator".into(), self.url.clone()];
        arguments.extend(job.options());
        let launch = match &self.token {
            Some(token) => Launch::with(&[("PHOTONFARM_TOKEN", token.clone())]),
            None => Launch::default(),
        };
        let output = launch
            .command("photonfarm", &arguments)
            .output()
            .expect("photonfarm starts");
        printed(&output).parse().expect("the job's number")
    }

    /// Submits a job under a key, again and again until it is accepted.
    ///
    /// # Panics
    /// Where it is refused for good.
    #[must_use]
    pub fn insist(&self, spec: &JobSpec, key: &str) -> JobId {
        let body = serde_json::to_vec(spec).expect("a job as JSON");
        let headers = [("content-type", "application/json"), (IDEMPOTENCY_KEY, key)];
        wait_for("a job to be accepted", || {
            let (status, answer) = self.send(Method::POST, "jobs", &headers, body.clone())?;
            let answer_text = String::from_utf8_lossy(&answer);
            assert!(matches!(status, 200 | 201 | 500 | 503), "{status}: {answer_text}");
            Some(serde_json::from_slice::<JobStatus>(&answer).ok()?.id)
        })
    }

    /// The status of a job, once `condition` holds.
    ///
    /// # Panics
    /// In the end, with `what`.
    pub fn when(&self, job: JobId, what: &str, condition: impl Fn(&JobStatus) -> bool) -> JobStatus {
        let path = format!("jobs/{job}");
        wait_for(what, || self.get::<JobStatus>(&path).filter(&condition))
    }

    /// Waits until so many of a job's iterations are in its image.
    ///
    /// # Panics
    /// In the end.
    pub fn when_done(&self, job: JobId, iterations: u64) -> JobStatus {
        self.when(job, "iterations", |status| {
            status.iterations_done >= iterations || status.state.ended()
        })
    }

    /// The job that was submitted last.
    ///
    /// # Panics
    /// Where the farm does not answer.
    #[must_use]
    pub fn newest_job(&self) -> Option<JobId> {
        let page: JobPage = self.get("jobs?limit=1").expect("an answer");
        page.jobs.first().map(|job| job.id)
    }

    /// The workers.
    #[must_use]
    pub fn workers(&self) -> Option<WorkerList> {
        self.get("workers")
    }

    /// A figure of `/metrics`, by its name without prefix and its labels; nothing where the farm is away or has none.
    #[must_use]
    pub fn figure(&self, series: &str) -> Option<u64> {
        let bearer = self.token.as_ref().map(|token| format!("Bearer {token}"));
        let headers: Vec<_> = bearer.iter().map(|bearer| ("authorization", bearer.as_str())).collect();
        let (_, text) = http(Method::GET, &format!("{}/metrics", self.url), Vec::new(), &headers)?;
        let prefix = format!("photonfarm_{series} ");
        let line = String::from_utf8(text).ok()?;
        line.lines().find_map(|line| line.strip_prefix(&prefix))?.parse().ok()
    }

    /// How the coordinator is, or the problem that it has.
    #[must_use]
    pub fn health(&self) -> Option<Result<Health, Problem>> {
        let (status, body) = self.send(Method::GET, "healthz", &[], Vec::new())?;
        match status {
            200 => Some(Ok(serde_json::from_slice(&body).ok()?)),
            _ => Some(Err(serde_json::from_slice(&body).ok()?)),
        }
    }

    /// The picture of a job as it stands.
    ///
    /// # Panics
    /// Where there is none in the end.
    #[must_use]
    pub fn picture(&self, job: JobId) -> Vec<u8> {
        let path = format!("jobs/{job}/image.exr");
        wait_for("a picture", || {
            let (status, picture) = self.send(Method::GET, &path, &[], Vec::new())?;
            (status == 200).then_some(picture)
        })
    }

    /// Waits for the end of a job, and compares it with the reference: state, counts, the picture's file.
    ///
    /// # Panics
    /// Where they differ.
    pub fn check(&self, id: JobId, reference: &Reference) {
        let job = self.when(id, "a job's end", |job| job.state.ended());
        assert_eq!(job.state, JobState::Done, "{job:?}");
        assert_eq!(job.iterations_done, u64::from(reference.job.iterations), "{job:?}");
        assert_eq!((job.poisoned.len(), job.failure.as_deref()), (0, None), "{job:?}");
        assert_eq!((job.workers, job.iterations_in_doubt), (0, 0), "{job:?}");
        assert_eq!(
            job.totals.counts, reference.counts,
            "not every iteration of job {id} counts once"
        );
        assert!(
            self.picture(id) == reference.picture,
            "the picture of job {id} is another one"
        );
    }

    /// Nothing is lent to anybody.
    ///
    /// # Panics
    /// Where something is, in the end.
    pub fn check_idle(&self) {
        wait_for("no lease to be held", || {
            let workers = self.workers()?.workers;
            workers.iter().all(|worker| worker.leases == 0).then_some(())
        });
    }
}

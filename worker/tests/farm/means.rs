//! Memory and rests of workers.

use super::sorted;
use super::support::Farm;
use photonfarm_proto::api::{WorkerList, WorkerStatus};
use photonfarm_proto::job::JobState;
use photonfarm_proto::rest::{RestReason, Resting};
use photonfarm_proto::schedule::Schedule;
use photonfarm_proto::waiting::Waiting;
use std::time::Duration;
use tokio::sync::watch;

const RESTING: Resting = Resting {
    reason: RestReason::Hours,
    until_ms: Some(4_000_000_000_000),
};

/// The worker of this name, once it is as the condition says.
async fn until_worker(farm: &Farm, name: &str, condition: impl Fn(&WorkerStatus) -> bool) -> WorkerStatus {
    loop {
        let reply = farm.http.get(farm.url("workers")).send().await.unwrap();
        let list: WorkerList = reply.json().await.unwrap();
        let mut found = list.workers.into_iter().filter(|worker| worker.name == name);
        if let Some(worker) = found.find(|worker| condition(worker)) {
            return worker;
        }
        tokio::task::yield_now().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hours_that_end_in_a_lease_cost_no_work() {
    let farm = Farm::start().await;
    let (hours, rest) = watch::channel(None);
    farm.stage.hold(6);
    let worker = farm.worker_with("a", |config| config.rest = rest);
    let job = farm.submit(b"good", 16).await;
    farm.stage.until_begun(6, 1).await;
    hours.send(Some(RESTING)).unwrap();
    farm.stage.release(6);
    let seen = until_worker(&farm, "a", |worker| worker.rest.is_some() && worker.leases == 0).await;
    assert_eq!(seen.rest, Some(RESTING));
    let status = farm
        .until(job, |status| status.waiting_reason == Some(Waiting::Resting))
        .await;
    // The worker may have begun another one before it noticed.
    let done = status.iterations_done as u32;
    assert!((6..16).contains(&done) && status.workers == 0, "{done}");
    farm.check_image(job, 1..=done).await;
    hours.send(None).unwrap();
    let status = farm.until_ended(job).await;
    assert_eq!((status.state, status.poisoned), (JobState::Done, vec![]));
    farm.check_image(job, 1..=16).await;
    let completed = farm.stage.completed.lock().unwrap().clone();
    assert_eq!(
        sorted(completed),
        (1..=16).collect::<Vec<u32>>(),
        "nothing is rendered twice"
    );
    assert_eq!(until_worker(&farm, "a", |_| true).await.rest, None);
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_iteration_that_goes_on_long_after_the_hours_is_given_up() {
    let farm = Farm::start().await;
    let (hours, rest) = watch::channel(None);
    farm.stage.hold(6);
    let first = farm.worker_with("a", |config| {
        config.rest = rest;
        config.drain = Duration::from_millis(100);
    });
    let job = farm.submit(b"good", 8).await;
    farm.stage.until_begun(6, 1).await;
    hours.send(Some(RESTING)).unwrap();
    until_worker(&farm, "a", |worker| worker.rest.is_some() && worker.leases == 0).await;
    let second = farm.worker("b");
    farm.stage.until_begun(6, 2).await;
    farm.stage.release(6);
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    farm.check_image(job, 1..=8).await;
    for worker in [first, second] {
        worker.drain().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_rests_from_the_start_is_there_and_comes_back_to_a_coordinator() {
    let mut farm = Farm::start().await;
    let (hours, rest) = watch::channel(Some(RESTING));
    let worker = farm.worker_with("a", |config| config.rest = rest);
    until_worker(&farm, "a", |worker| worker.rest == Some(RESTING)).await;
    farm.stop().await;
    farm.resume().await;
    let job = farm.submit(b"good", 2).await;
    let status = farm
        .until(job, |status| status.waiting_reason == Some(Waiting::Resting))
        .await;
    assert!(status.waiting.unwrap().contains("until 2096-10-02T07:06:40.000Z"));
    hours.send(None).unwrap();
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_job_takes_is_measured_and_it_goes_to_workers_that_have_that() {
    let mut farm = Farm::start().await;
    let sized = |farm: &Farm, name: &str, memory: u32| {
        farm.worker_with(name, |config| {
            config.memory_mb = Some(memory);
            config.watches_memory = true;
        })
    };
    let small = sized(&farm, "small", 1);
    assert_eq!(until_worker(&farm, "small", |_| true).await.memory_mb, Some(1));
    let schedule = Schedule {
        memory_mb: Some(2),
        ..Schedule::default()
    };
    let asking = farm.submit_scheduled(schedule, 2).await;
    let status = farm
        .until(asking, |status| status.waiting_reason == Some(Waiting::Memory))
        .await;
    assert_eq!(
        status.waiting.unwrap(),
        "it asks for 2 MiB of memory, and the largest worker that could do it has 1 MiB: start one with at least 2 MiB"
    );
    // Nothing is known of this one, until its first iteration arrives from a process of more than a mebibyte. It has more iterations than
    // the worker can have taken on until then.
    let job = farm.submit(b"good", 256).await;
    let status = farm
        .until(job, |status| status.waiting_reason == Some(Waiting::Memory))
        .await;
    let measured = status.memory_mb.unwrap();
    assert!(measured > 1 && status.iterations_done >= 1, "{measured}");
    farm.stop().await;
    farm.resume().await;
    assert!(farm.status(job).await.memory_mb >= Some(measured), "it is kept");
    let large = sized(&farm, "large", 1 << 20);
    for job in [asking, job] {
        assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    }
    farm.check_image(job, 1..=256).await;
    let figures = farm.http.get(farm.url("../metrics")).send().await.unwrap();
    let figures = figures.text().await.unwrap();
    for line in [
        "photonfarm_largest_worker_memory_bytes 1099511627776",
        "photonfarm_workers_resting 0",
        "photonfarm_jobs_waiting{reason=\"memory\"} 0",
        "photonfarm_failed_attempts_total{kind=\"out-of-memory\"} 0",
    ] {
        assert!(figures.contains(line), "{line}: {figures}");
    }
    for worker in [small, large] {
        worker.drain().await;
    }
}

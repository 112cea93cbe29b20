//! Coordinator and workers in one process, over real connections: whatever happens, the image has the bits of a
//! single process, and nothing is lost, counted twice or passed over in silence.

mod chains;
mod checks;
mod means;
mod support;
mod traces;

use photonfarm_proto::job::{FailureKind, JobState};
use photonfarm_proto::waiting::Waiting;
use photonfarm_test_servers::S3;
use std::time::Duration;
use support::{Farm, Fault};

fn sorted(mut iterations: Vec<u32>) -> Vec<u32> {
    iterations.sort_unstable();
    iterations
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn several_workers_give_the_bits_of_one_process() {
    let farm = Farm::start().await;
    let workers = ["a", "b", "c"].map(|name| farm.worker(name));
    for iterations in [1, 2, 7, 37] {
        let job = farm.submit(b"good", iterations).await;
        let status = farm.until_ended(job).await;
        assert_eq!(
            (status.state, status.iterations_done),
            (JobState::Done, u64::from(iterations))
        );
        assert_eq!(status.totals.counts.rays, 10 * u64::from(iterations));
        let bandwidth = status.totals.bandwidth.unwrap();
        assert_eq!(bandwidth.sigma, [1.0, 1.0 / iterations as f32]);
        farm.check_image(job, 1..=iterations).await;
    }
    for worker in workers {
        worker.drain().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_restart_of_the_coordinator_loses_nothing_and_renders_nothing_twice() {
    let mut farm = Farm::start().await;
    farm.stage.hold(6);
    let worker = farm.worker("a");
    let job = farm.submit(b"good", 13).await;
    farm.stage.until_begun(6, 1).await;
    farm.stop().await;
    farm.stage.release(6);
    farm.stage.until_begun(8, 1).await;
    farm.resume().await;
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    farm.check_image(job, 1..=13).await;
    let completed = farm.stage.completed.lock().unwrap().clone();
    assert_eq!(sorted(completed), (1..=13).collect::<Vec<u32>>());
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_work_of_a_lost_worker_is_done_by_another() {
    let farm = Farm::start_with_short_leases().await;
    farm.lose_a_worker(farm.submit(b"good", 9)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_draining_worker_delivers_what_it_has_and_gives_the_rest_back() {
    let farm = Farm::start().await;
    let job = farm.drain_during(6, farm.submit(b"good", 16)).await;
    let status = farm.status(job).await;
    assert_eq!((status.iterations_done, status.workers), (6, 0));
    farm.check_image(job, 1..=6).await;
    let second = farm.worker("second");
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    farm.check_image(job, 1..=16).await;
    let completed = farm.stage.completed.lock().unwrap().clone();
    assert_eq!(sorted(completed), (1..=16).collect::<Vec<u32>>());
    second.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn work_that_cannot_be_delivered_is_kept_and_counts_after_the_next_start() {
    let mut farm = Farm::start().await;
    farm.stage.hold(6);
    let first = farm.worker_that_drains("a", Duration::ZERO);
    let job = farm.submit(b"good", 13).await;
    farm.stage.until_begun(6, 1).await;
    farm.stop().await;
    farm.stage.release(6);
    // The lease ends with iteration 8, and there is nobody to take its work.
    farm.stage.until_completed(8).await;
    first.drain().await;
    assert!(farm.kept_by("a") > 0);
    farm.resume().await;
    let second = farm.worker("a");
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    farm.check_image(job, 1..=13).await;
    let completed = farm.stage.completed.lock().unwrap().clone();
    assert_eq!(
        sorted(completed),
        (1..=13).collect::<Vec<u32>>(),
        "nothing is rendered twice"
    );
    assert_eq!(farm.kept_by("a"), 0);
    second.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_iteration_without_end_is_given_up_when_a_drain_takes_too_long() {
    let farm = Farm::start().await;
    farm.stage.hold(6);
    let first = farm.worker_that_drains("a", Duration::from_millis(100));
    let job = farm.submit(b"good", 13).await;
    farm.stage.until_begun(6, 1).await;
    first.drain().await;
    let second = farm.worker("a");
    farm.stage.until_begun(6, 2).await;
    farm.stage.release(6);
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    farm.check_image(job, 1..=13).await;
    second.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn iterations_that_cannot_be_rendered_are_reported_and_the_rest_is_averaged() {
    let farm = Farm::start().await;
    farm.stage
        .faults
        .lock()
        .unwrap()
        .extend([(3, Fault::Panics), (6, Fault::IsNotFinite)]);
    let worker = farm.worker("a");
    let job = farm.submit(b"good", 8).await;
    let status = farm.until_ended(job).await;
    assert_eq!((status.state, status.iterations_done), (JobState::Failed, 6));
    let poisoned: Vec<(u32, usize)> = status
        .poisoned
        .iter()
        .map(|p| (p.iteration, p.attempts.len()))
        .collect();
    assert_eq!(poisoned, [(3, 3), (6, 3)]);
    let panic = &status.poisoned[0].attempts[0];
    assert_eq!(panic.kind, FailureKind::Panic);
    assert!(panic.message.contains("iteration 3 went wrong"), "{}", panic.message);
    assert_eq!(status.poisoned[1].attempts[0].kind, FailureKind::Render);
    assert!(status.failure.unwrap().contains("2 of 8"));
    farm.check_image(job, [1, 2, 4, 5, 7, 8]).await;
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_broken_scene_fails_its_job_at_once_and_the_farm_goes_on() {
    let farm = Farm::start().await;
    let worker = farm.worker("a");
    let broken = farm.submit(b"broken no such shape", 8).await;
    let status = farm.until_ended(broken).await;
    assert_eq!(status.state, JobState::Failed);
    assert_eq!(status.failure.as_deref(), Some("scene.xml:1: no such shape"));
    let good = farm.submit(b"good", 3).await;
    assert_eq!(farm.until_ended(good).await.state, JobState::Done);
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_damaged_scene_is_found_by_workers_and_repaired_by_sending_it_again() {
    for s3 in [None, Some(S3::start())] {
        let farm = Farm::start_on(s3).await;
        let job = farm.submit(b"good", 3).await;
        farm.damage_scene(b"good");
        let worker = farm.worker("a");
        let status = farm
            .until(job, |status| status.waiting_reason == Some(Waiting::Scene))
            .await;
        assert!(status.waiting.unwrap().contains("scene.xml"));
        let figures = farm.http.get(farm.url("../metrics")).send().await.unwrap().text().await;
        let figures = figures.unwrap();
        assert!(
            figures.contains("photonfarm_jobs_waiting{reason=\"scene\"} 1"),
            "{figures}"
        );
        // That the farm lacks the file is said to whoever submits the scene again, and he sends it.
        let again = farm.submit(b"good", 1).await;
        assert_eq!(farm.until_ended(again).await.state, JobState::Done);
        let status = farm.until_ended(job).await;
        assert_eq!(
            (status.state, status.poisoned),
            (JobState::Done, vec![]),
            "nobody is to blame"
        );
        assert_eq!(status.waiting_reason, None);
        farm.check_image(job, 1..=3).await;
        worker.drain().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cancelled_job_is_dropped_in_mid_iteration() {
    let farm = Farm::start_with_short_leases().await;
    farm.stage.hold(2);
    let worker = farm.worker("a");
    let job = farm.submit(b"good", 8).await;
    farm.stage.until_begun(2, 1).await;
    farm.until(job, |status| status.iterations_done == 1).await;
    let cancel = farm.http.post(farm.url(&format!("jobs/{job}/cancel")));
    let reply = cancel.send().await.unwrap();
    assert_eq!(reply.status(), 200);
    assert_eq!(farm.status(job).await.state, JobState::Cancelled);
    farm.check_image(job, [1]).await;
    let next = farm.submit(b"good", 1).await;
    assert_eq!(farm.until_ended(next).await.state, JobState::Done);
    assert_eq!(
        *farm.stage.completed.lock().unwrap(),
        [1, 1],
        "iteration 2 was abandoned"
    );
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_waits_for_its_coordinator() {
    let mut farm = Farm::start().await;
    farm.stop().await;
    let worker = farm.worker("early");
    farm.resume().await;
    let job = farm.submit(b"good", 2).await;
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn workers_put_images_into_an_object_store_that_may_be_away_for_a_while() {
    let mut farm = Farm::start_on(Some(S3::start())).await;
    farm.stage.hold(6);
    let workers = ["a", "b"].map(|name| farm.worker(name));
    let job = farm.submit(b"good", 13).await;
    farm.stage.until_begun(6, 1).await;
    farm.s3.as_mut().unwrap().stop();
    farm.stage.release(6);
    farm.stage.until_completed(6).await;
    farm.s3.as_mut().unwrap().restart();
    let status = farm.until_ended(job).await;
    assert_eq!((status.state, status.iterations_done), (JobState::Done, 13));
    assert_eq!(status.poisoned, []);
    farm.check_image(job, 1..=13).await;
    for worker in workers {
        worker.drain().await;
    }
    let nodes = std::fs::read_dir(farm.s3.as_ref().unwrap().file("nodes")).unwrap();
    let images = nodes.filter(|folder| folder.as_ref().unwrap().file_name() != "incoming");
    assert!(images.count() > 0, "images are objects");
}

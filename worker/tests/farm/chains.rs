//! Jobs whose iterations go on from each other: the renderer panics where one goes on from another than the one before.

use super::support::{Farm, Fault};
use photonfarm_proto::job::JobState;
use photonfarm_test_servers::S3;

/// Every iteration was rendered once, and in order.
fn check_order(farm: &Farm, iterations: u32) {
    let completed = farm.stage.completed.lock().unwrap().clone();
    assert_eq!(completed, (1..=iterations).collect::<Vec<u32>>());
}

async fn several_workers_render_one_chain(farm: Farm) {
    let workers = ["a", "b", "c"].map(|name| farm.worker(name));
    for iterations in [1, 2, 7, 37] {
        farm.stage.completed.lock().unwrap().clear();
        let job = farm.submit_chain(iterations).await;
        let status = farm.until_ended(job).await;
        assert_eq!(
            (status.state, status.iterations_done),
            (JobState::Done, u64::from(iterations)),
            "{:?}",
            status.failure
        );
        assert_eq!(status.totals.counts.rays, 10 * u64::from(iterations));
        farm.check_image(job, 1..=iterations).await;
        check_order(&farm, iterations);
    }
    for worker in workers {
        worker.drain().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn several_workers_render_one_chain_with_folders() {
    several_workers_render_one_chain(Farm::start().await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn several_workers_render_one_chain_with_an_object_store() {
    several_workers_render_one_chain(Farm::start_on(Some(S3::start())).await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_chain_goes_on_where_a_draining_worker_left_it_and_after_a_restart() {
    let mut farm = Farm::start().await;
    let job = farm.drain_during(7, farm.submit_chain(19)).await;
    assert_eq!(farm.status(job).await.iterations_done, 7);
    farm.stop().await;
    farm.resume().await;
    let second = farm.worker("second");
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    farm.check_image(job, 1..=19).await;
    check_order(&farm, 19);
    let reply = farm.http.post(farm.url(&format!("jobs/{job}/extend")));
    let reply = reply.json(&serde_json::json!({"iterations": 26})).send().await.unwrap();
    assert_eq!(reply.status(), 200);
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    farm.check_image(job, 1..=26).await;
    check_order(&farm, 26);
    second.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lost_worker_costs_a_chain_what_it_had_not_delivered() {
    let farm = Farm::start().await;
    farm.lose_a_worker(farm.submit_chain(9)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_chain_ends_where_an_iteration_cannot_be_rendered() {
    let farm = Farm::start().await;
    farm.stage.faults.lock().unwrap().insert(6, Fault::Panics);
    let worker = farm.worker("a");
    let job = farm.submit_chain(16).await;
    let status = farm.until_ended(job).await;
    assert_eq!((status.state, status.iterations_done), (JobState::Failed, 5));
    let failure = status.failure.unwrap();
    assert!(
        failure.contains("iteration 6") && failure.contains("go on from it"),
        "{failure}"
    );
    farm.check_image(job, 1..=5).await;
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_damaged_checkpoint_is_rendered_again() {
    let mut farm = Farm::start().await;
    let job = farm.drain_during(6, farm.submit_chain(8)).await;
    farm.stop().await;
    let files = farm.node_files();
    assert!(!files.is_empty());
    for file in files {
        let mut bytes = std::fs::read(&file).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&file, bytes).unwrap();
    }
    farm.resume().await;
    let second = farm.worker("second");
    let status = farm.until_ended(job).await;
    assert_eq!((status.state, status.iterations_done), (JobState::Done, 8));
    farm.check_image(job, 1..=8).await;
    let completed = farm.stage.completed.lock().unwrap().clone();
    assert_eq!(completed, (1..=6).chain(1..=8).collect::<Vec<u32>>());
    second.drain().await;
}

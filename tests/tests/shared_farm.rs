//! Two coordinators of one farm, on PostgreSQL and an S3-compatible store, behind a load balancer: one of them is
//! killed, and the picture is that of one process alone, with all of its layers.

use photonfarm_proto::job::{JobState, JobStatus};
use photonfarm_test_servers::{Postgres, S3};
use photonfarm_tests::farm::balance;
use photonfarm_tests::processes::{Process, get, jobs, photonfarm, printed, scene, serve_with, wait_for};

const ITERATIONS: u64 = 24;
const JOB: [&str; 24] = [
    "--iterations",
    "24",
    "--seed",
    "11",
    "-D",
    "res=48",
    "--set",
    "samples=4",
    "--integrator",
    "pppm",
    "--layer",
    "albedo",
    "--layer",
    "position",
    "--layer",
    "halves",
    "--layer",
    "lamp:*",
    "--layer",
    "cryptomatte:object",
    "--layer",
    "cryptomatte:material",
    "--crop",
    "5,3,40x44",
];

fn job(url: &str) -> Option<JobStatus> {
    jobs(url)?.into_iter().next()
}

#[test]
fn two_coordinators_share_a_farm_and_one_may_be_killed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scene = scene("environment.xml");
    let scene = scene.to_str().unwrap();
    let alone = path("alone.exr");
    printed(&photonfarm(
        &[["render", scene, "-o", &alone].as_slice(), &JOB].concat(),
    ));

    let (postgres, s3) = (Postgres::start(), S3::start());
    let (state, blobs) = (postgres.database(), s3.url("farm"));
    let serve = || {
        let stores = ["--state", &state, "--blobs", &blobs];
        serve_with(
            &s3.environment(),
            &[["serve", "--listen", "127.0.0.1:0"].as_slice(), &stores].concat(),
        )
    };
    let [(victim, first), (mut survivor, second)] = [serve(), serve()];
    let url = balance(&[&first, &second]);
    let cache = path("cache");
    let worker = ["--coordinator", &url, "--threads", "1", "--cache", &cache];
    let mut workers = [(); 3].map(|()| Process::start("photonfarm-worker", &worker));
    let picture = path("farm.exr");
    let submit = ["submit", scene, "--coordinator", &url, "--wait", "-o", &picture];
    let submission = Process::start("photonfarm", &[submit.as_slice(), &JOB].concat());

    let status = wait_for("some iterations", || {
        job(&second).filter(|job| job.iterations_done >= 3)
    });
    assert!(
        !status.state.ended(),
        "the job was over before a coordinator could be killed"
    );
    victim.kill();
    let (ended, _, errors) = submission.finish();
    assert!(ended.success(), "{errors}");
    let status = job(&second).unwrap();
    assert_eq!((status.state, status.iterations_done), (JobState::Done, ITERATIONS));
    assert_eq!(status.poisoned, []);
    assert!(survivor.is_running() && workers.iter_mut().all(Process::is_running));
    let [farm, alone] = [picture, alone].map(|path| std::fs::read(path).unwrap());
    assert!(farm == alone, "the pictures differ");

    let (again, third) = serve();
    let same: JobStatus = get(&format!("{third}/v1/jobs/{}", status.id)).unwrap();
    assert_eq!(
        same.iterations_done, ITERATIONS,
        "a coordinator that comes later knows all"
    );
    drop(again);
    assert!(s3.file("farm/nodes").is_dir() && s3.file("farm/scenes").is_dir());
}

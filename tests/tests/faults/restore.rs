//! A farm is saved while it runs, goes on, and is restored: nobody gets what is not theirs.

use photonfarm_tests::farm::{Farm, Job, Reference};
use photonfarm_tests::processes::{Process, photonfarm, printed, wait_for};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

fn job(iterations: u32) -> Arc<Reference> {
    let job = Job {
        scene: "environment",
        integrator: "path",
        size: 16,
        iterations,
        more: &["--set", "samples=1"],
    };
    job.alone()
}

fn copy(from: &Path, to: &Path) {
    let status = Command::new("cp").arg("-a").args([from, to]).status().unwrap();
    assert!(status.success());
}

#[test]
fn a_restored_farm_gives_no_number_twice_and_nobody_gets_the_picture_of_another() {
    let mut farm = Farm::start(&[]);
    let (data, saved) = (farm.folder().join("farm"), farm.folder().join("saved"));
    let saved_from = farm.client.health().unwrap().unwrap().farm;
    let small = job(4);
    farm.hire(1);
    let kept = farm.submit(&small);
    farm.client.check(kept, &small);

    printed(&photonfarm(&[
        "backup",
        "--data",
        data.to_str().unwrap(),
        saved.to_str().unwrap(),
    ]));

    // Jobs that the backup knows nothing of. Somebody waits for the second.
    let lost = farm.client.submit(&small.job);
    let picture = farm.folder().join("picture.exr");
    let url = farm.client.url.clone();
    farm.workers[0].stop();
    let mut arguments = vec!["submit".to_owned(), "--wait".into(), "--coordinator".into(), url];
    arguments.extend(["-o".into(), picture.to_str().unwrap().to_owned()]);
    arguments.extend(small.job.options());
    let waiting = Process::spawn(farm.servers[0].launch.command("photonfarm", &arguments));
    let awaited = wait_for("the second job", || farm.client.newest_job().filter(|id| *id != lost));
    assert!(lost > kept && awaited > lost);

    farm.servers[0].kill();
    std::fs::remove_dir_all(&data).unwrap();
    copy(&saved, &data);
    farm.servers[0].resume();
    farm.workers[0].resume();

    let mut numbers = vec![kept, lost, awaited];
    for _ in 0..3 {
        let new = farm.submit(&small);
        assert!(!numbers.contains(&new), "{new} was the number of another job");
        numbers.push(new);
    }
    let (status, _, errors) = waiting.finish();
    assert_eq!(status.code(), Some(6), "{errors}");
    assert!(errors.contains(&awaited.to_string()), "{errors}");
    assert!(!picture.exists(), "a picture of nobody knows which job");
    let restored = wait_for("the restored farm", || farm.client.health()?.ok()).farm;
    assert_eq!(restored.farm, saved_from.farm, "it is the same farm");
    assert!(restored.epoch > saved_from.epoch, "nobody is told that it was restored");
    let _logs = farm.settle();
}

//! Time of a job through a coordinator and two workers of one thread each, over the time of the same iterations in one
//! process with two threads that does nothing but render.
//!
//!     cargo bench -p photonfarm-tests --bench farm_overhead [-- SCENE]

use photonfarm_core::scene::SceneFolder;
use photonfarm_core::settings::{IntegratorSettings, PppmSettings};
use photonfarm_tests::processes::{Coordinator, photonfarm, scene};
use photonfarm_tests::{render, scenes};
use std::path::{Path, PathBuf};
use std::time::Instant;

const ITERATIONS: u32 = 64;

/// Pairs of measurements.
const ROUNDS: usize = 3;

fn main() {
    let path = std::env::args().nth(1).filter(|a| !a.starts_with('-'));
    let path = path.map_or_else(|| scene("../../scenes/still-life/scene.xml"), PathBuf::from);
    let mut ratios = Vec::new();
    for round in 1..=ROUNDS {
        let alone = alone(&path);
        let farm = farm(&path);
        println!(
            "round {round}: alone {alone:.2} s, farm {farm:.2} s, ratio {:.3}",
            farm / alone
        );
        ratios.push(farm / alone);
    }
    ratios.sort_by(f64::total_cmp);
    println!(
        "{ITERATIONS} iterations of {}: farm over alone {:.3} (median), {:.3} to {:.3}",
        path.display(),
        ratios[ROUNDS / 2],
        ratios[0],
        ratios[ROUNDS - 1]
    );
}

/// Seconds for the iterations alone, the scene being loaded.
fn alone(path: &Path) -> f64 {
    let files = SceneFolder::new(path.parent().expect("a folder")).expect("the folder is there");
    let name = path.file_name().and_then(|n| n.to_str()).expect("a UTF-8 name");
    let scene = scenes::load(&files, name, &[]).expect("the scene loads");
    let max_depth = scene.wishes.max_depth;
    let settings = IntegratorSettings::Pppm(PppmSettings {
        max_depth,
        ..Default::default()
    });
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("a pool");
    let started = Instant::now();
    pool.install(|| {
        for iteration in render::iterations(&scene, &settings, 0, ITERATIONS) {
            iteration.expect("the iteration renders");
        }
    });
    started.elapsed().as_secs_f64()
}

/// Seconds from `submit` to the picture, with the processes already running.
fn farm(path: &Path) -> f64 {
    let folder = tempfile::tempdir().expect("a folder");
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let workers = [coordinator.worker(), coordinator.worker()];
    coordinator.wait_for_workers(workers.len());
    let output = folder.path().join("image.exr");
    let (path, output) = (
        path.to_str().expect("a UTF-8 path"),
        output.to_str().expect("a UTF-8 path"),
    );
    let iterations = ITERATIONS.to_string();
    let mut arguments = vec![
        "submit",
        path,
        "--coordinator",
        &coordinator.url,
        "--wait",
        "-o",
        output,
    ];
    arguments.extend(["--integrator", "pppm", "--iterations", &iterations]);
    let started = Instant::now();
    let result = photonfarm(&arguments);
    let seconds = started.elapsed().as_secs_f64();
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
    seconds
}

//! Pictures that are gone on with, compared, and watched as they converge.

use crate::scene;
use photonfarm_tests::processes::{Process, photonfarm, printed, wait_for};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_render_that_was_killed_goes_on_by_the_same_command() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, output) = (scene("constant.xml"), folder.path().join("a.exr"));
    let kept = folder.path().join("a.partial.farm");
    let render = [
        "render",
        text(&scene),
        "-o",
        text(&output),
        "--threads",
        "1",
        "--iterations",
    ];
    let endless = [&render[..], &["1000000"]].concat();
    let first = Process::start("photonfarm", &endless);
    first.wait_for_error("rays/s");
    first.kill();
    assert!(kept.is_dir() && !output.exists());
    let second = Process::start("photonfarm", &endless);
    second.wait_for_error("going on after ");
    second.wait_for_error("rays/s");
    let errors = second.kill();
    assert!(!errors.contains("going on after 0 of"), "{errors}");
    let another = photonfarm(&[&render[..], &["3"]].concat());
    let errors = String::from_utf8_lossy(&another.stderr);
    assert!(another.status.success(), "{errors}");
    assert!(errors.contains("another picture, which is left out"), "{errors}");
    assert!(output.exists() && !kept.exists());
    let alone = folder.path().join("alone.exr");
    let again = ["render", text(&scene), "-o", text(&alone), "--iterations", "3"];
    printed(&photonfarm(&again));
    assert!(fs::read(output).unwrap() == fs::read(alone).unwrap());
}

#[test]
fn time_before_an_interruption_counts() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, output) = (scene("constant.xml"), folder.path().join("a.exr"));
    let render = |within| {
        let path = ["render", text(&scene), "-o", text(&output), "--threads", "1"];
        [&path[..], &["--iterations", "1000000", "--within", within]].concat()
    };
    let first = Process::start("photonfarm", &render("1h"));
    first.wait_for_error("rays/s");
    let spent = folder.path().join("a.partial.farm/spent.json");
    let seconds = || {
        let spent: Value = serde_json::from_slice(&fs::read(&spent).ok()?).ok()?;
        spent["seconds"].as_f64()
    };
    wait_for("a second of rendering", || seconds().filter(|seconds| *seconds >= 1.0));
    first.signal("INT");
    let (status, _, errors) = first.finish();
    assert_eq!(status.code(), Some(130), "{errors}");
    let before = seconds().unwrap();
    // What is left of an hour and a second is an hour still; of less than was spent nothing is left, and nothing more is rendered.
    let second = Process::start("photonfarm", &render("3601s"));
    second.wait_for_error("going on after ");
    wait_for("more time", || seconds().filter(|seconds| *seconds > before));
    second.kill();
    let third = photonfarm(&render("1s"));
    let errors = String::from_utf8_lossy(&third.stderr);
    assert!(third.status.success(), "{errors}");
    assert!(errors.contains("going on after "), "{errors}");
    assert!(output.exists() && !spent.exists());
}

#[test]
fn a_curve_that_was_killed_goes_on_by_the_same_command() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = scene("environment.xml");
    let settings = ["--integrator", "path", "--set", "samples=1", "-D", "res=16"];
    let reference = at("reference.exr");
    let render = [
        "render",
        text(&scene),
        "-o",
        text(&reference),
        "--iterations",
        "8",
        "--seed",
        "9",
    ];
    printed(&photonfarm(&[&render[..], &settings].concat()));
    let converge = |output: &Path, iterations: &'static str| {
        let path = output.to_str().unwrap().to_owned();
        let mut arguments: Vec<String> = ["converge", text(&scene), "--reference", text(&reference), "-o"]
            .map(str::to_owned)
            .to_vec();
        arguments.push(path);
        arguments.extend(["--iterations", iterations].map(str::to_owned));
        arguments.extend(settings.map(str::to_owned));
        arguments
    };
    let curve = at("a.csv");
    let first = Process::start("photonfarm", &converge(&curve, "1000000"));
    first.wait_for_error("\n8/1000000 iterations");
    first.kill();
    assert!(at("a.converge.farm").is_dir() && !curve.exists());
    let second = Process::start("photonfarm", &converge(&curve, "1000000"));
    second.wait_for_error("going on after ");
    let errors = second.errors();
    let said: u32 = errors
        .split("going on after ")
        .nth(1)
        .unwrap()
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap();
    assert!(said >= 4, "{errors}");
    second.wait_for_error(&format!("{}/1000000 iterations", 8 * said));
    second.signal("INT");
    let (status, _, errors) = second.finish();
    assert_eq!(status.code(), Some(130), "{errors}");
    assert!(errors.contains("give the same command again"), "{errors}");

    let whole = at("whole.csv");
    printed(&photonfarm(&converge(&whole, "8")));
    let lines = |path: &Path| -> Vec<Vec<String>> {
        let table = fs::read_to_string(path).unwrap();
        let rows = table.lines().skip(1).take(4);
        rows.map(|row| row.split(',').map(str::to_owned).collect()).collect()
    };
    let (pieced, whole) = (lines(&curve), lines(&whole));
    let errors = |row: &[String]| [0, 2, 3].map(|column| row[column].clone());
    assert_eq!(pieced.len(), 4);
    for (pieced, whole) in pieced.iter().zip(&whole) {
        assert_eq!(errors(pieced), errors(whole), "the same errors");
    }
    assert!(!at("whole.converge.farm").exists());
}

#[test]
fn the_error_falls_and_is_that_of_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = scene("environment.xml");
    let settings = ["--integrator", "path", "--set", "samples=1", "-D", "res=16"];
    let (reference, picture) = (at("reference.exr"), at("picture.exr"));
    for (path, options) in [
        (&reference, ["--iterations", "64", "--seed", "9"]),
        (&picture, ["--iterations", "6", "--seed", "0"]),
    ] {
        let render = ["render", text(&scene), "-o", text(path)];
        printed(&photonfarm(&[&render[..], &settings, &options].concat()));
    }
    let (table, plot) = (at("table.csv"), at("plot.png"));
    let converge = [
        "converge",
        text(&scene),
        "--reference",
        text(&reference),
        "--iterations",
        "6",
    ];
    let files = ["--probe", "3,5", "-o", text(&table), "--plot", text(&plot)];
    printed(&photonfarm(&[&converge[..], &settings, &files].concat()));
    let rows = fs::read_to_string(&table).unwrap();
    let rows: Vec<Vec<&str>> = rows.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(
        rows[0],
        [
            "iterations",
            "seconds",
            "mse",
            "relmse",
            "red_3_5",
            "green_3_5",
            "blue_3_5"
        ]
    );
    let iterations: Vec<&str> = rows[1..].iter().map(|row| row[0]).collect();
    assert_eq!(iterations, ["1", "2", "4", "6"]);
    let number = |text: &str| text.parse::<f64>().unwrap();
    assert!(number(rows[4][2]) < number(rows[1][2]), "{rows:?}");
    assert!(fs::read(&plot).unwrap().starts_with(b"\x89PNG"));

    let difference = at("difference.png");
    let compare = ["compare", text(&picture), text(&reference), "--json", "--difference"];
    let compared = printed(&photonfarm(&[&compare[..], &[text(&difference)]].concat()));
    let compared: Value = serde_json::from_str(&compared).unwrap();
    for (name, told) in [("mse", rows[4][2]), ("relmse", rows[4][3])] {
        let (compared, told) = (compared[name].as_f64().unwrap(), number(told));
        assert!((compared / told - 1.0).abs() < 1e-12, "{name}: {compared} and {told}");
    }
    assert!(compared["ssim"].as_f64().unwrap() > 0.1 && difference.exists());
    let png = |path: &Path| text(&path.with_extension("png")).to_owned();
    let same = printed(&photonfarm(&["compare", &png(&picture), &png(&picture)]));
    assert!(same.contains("SSIM    1.000000"), "{same}");

    let small = photonfarm(&[&converge[..], &["-D", "res=8"]].concat());
    let errors = String::from_utf8_lossy(&small.stderr);
    assert!(
        errors.contains("16 by 16 pixels and pictures of the scene 8 by 8"),
        "{errors}"
    );
}

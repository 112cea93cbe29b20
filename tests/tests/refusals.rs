//! What cannot work is refused with an error that says what to do, and leaves files as they were.

use photonfarm_core::film::Image;
use photonfarm_core::picture::{self, PictureMetadata};
use photonfarm_tests::processes::{Coordinator, Process, photonfarm, printed, scene, wait_for};
use std::fs;
use std::path::Path;

/// The error message of a command that must fail.
fn refusal(arguments: &[&str]) -> String {
    let output = photonfarm(arguments);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {errors}");
    assert!(
        errors.lines().any(|line| line.starts_with("error: ")) && !errors.contains("panicked"),
        "{arguments:?}: {errors}"
    );
    errors
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn files_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_rendering() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene("constant.xml");
    for (name, advice) in [("missing/a.exr", "mkdir -p"), ("a.png", "a.exr")] {
        let output = folder.path().join(name);
        // So many iterations that the test would not end if they were rendered.
        let errors = refusal(&["render", text(&scene), "-o", text(&output), "--iterations", "1000000"]);
        assert!(errors.contains(advice), "{errors}");
    }
    assert!(files_in(folder.path()).is_empty());
}

#[test]
fn windows_that_no_picture_has_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, output) = (scene("constant.xml"), folder.path().join("a.exr"));
    for (integrator, window, reason) in [
        (
            "path",
            "9,0,99999x1",
            "--crop: the window 9,0,99999x1 is not within the picture",
        ),
        ("sppm", "0,0,1x1", "--crop: sppm renders no windows"),
    ] {
        let render = ["render", text(&scene), "-o", text(&output), "--crop", window];
        let errors = refusal(&[&render[..], &["--integrator", integrator]].concat());
        assert!(errors.contains(reason), "{errors}");
    }
    assert!(files_in(folder.path()).is_empty());
}

/// `check` says what a scene holds, and fails where `render` would: with all errors, also as JSON.
#[test]
fn a_scene_is_checked_without_being_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let body = "<shape type='rectangle'/><subsurface type='dipole'/><sampler type='independent'/></scene>";
    fs::write(path("odd.xml"), format!("<scene version='3.0.0'>\n{body}")).unwrap();
    fs::write(
        path("bad.xml"),
        "<scene version='3.0.0'>\n<shape type='shpere'/>\n<shape type='cubee'/></scene>",
    )
    .unwrap();
    let odd = path("odd.xml");
    let output = photonfarm(&[
        "check",
        text(&odd),
        "--json",
        "--set",
        "samples=3",
        "--integrator",
        "path",
    ]);
    assert!(output.status.success());
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for (pointer, expected) in [
        ("/format", "Mitsuba XML".into()),
        ("/shapes/rectangle", 1.into()),
        ("/triangles", 2.into()),
        ("/integrator/samples", 3.into()),
        ("/bounds/1/0", 1.0.into()),
        ("/files/odd.xml", fs::metadata(&odd).unwrap().len().into()),
    ] {
        assert_eq!(report.pointer(pointer), Some(&expected), "{pointer}: {report}");
    }
    let warnings = report["warnings"].as_array().unwrap();
    assert!(
        warnings.iter().any(|warning| warning
            .as_str()
            .unwrap()
            .starts_with("odd.xml:2: <scene>: <subsurface>")),
        "{report}"
    );
    let said = String::from_utf8(photonfarm(&["check", text(&odd)]).stdout).unwrap();
    assert!(said.contains("shapes     1 (rectangle 1); 2 triangles"), "{said}");
    assert!(refusal(&["check", text(&odd), "--strict"]).contains("--strict"));
    let bad = path("bad.xml");
    assert!(refusal(&["check", text(&bad)]).contains("2 faults"));
    let output = photonfarm(&["check", text(&bad), "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let failure: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(
        failure["errors"][1].as_str().unwrap().starts_with("bad.xml:3: "),
        "{failure}"
    );
}

/// `--frame` is the definition of that name, which is not to be given twice.
#[test]
fn an_animated_scene_is_seen_at_a_frame() {
    let arm = scene("gltf/arm.glb");
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("a.exr");
    let render = [
        "render",
        text(&arm),
        "-o",
        text(&output),
        "--integrator",
        "path",
        "--iterations",
        "1",
        "-D",
        "width=16",
    ];
    let picture = |options: &[&str]| {
        printed(&photonfarm(&[&render, options].concat()));
        fs::read(folder.path().join("a.png")).unwrap()
    };
    let moved = picture(&["--frame", "6.5"]);
    assert!(moved == picture(&["-D", "frame=6.5"]), "the two say the same");
    assert!(moved != picture(&[]), "the arm moves");
    let twice = refusal(&["check", text(&arm), "--frame", "-1", "-D", "frame=2"]);
    assert!(twice.contains("frame is given twice"), "{twice}");
}

#[test]
fn bad_scenes_and_settings_leave_the_old_picture() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("a.exr");
    fs::write(&output, "old").unwrap();
    let good = scene("constant.xml");
    let with = |name: &str, element: &str| {
        let path = folder.path().join(name);
        let text = fs::read_to_string(&good)
            .unwrap()
            .replace("</scene>", &format!("{element}\n</scene>"));
        let line = text.lines().position(|line| line.contains(element)).unwrap() + 1;
        fs::write(&path, text).unwrap();
        (path, format!("{name}:{line}"))
    };
    let (broken, broken_at) = with("broken.xml", "<shape type=\"shpere\"/>");
    let shape = "<shape type=\"ply\"><string name=\"filename\" value=\"../secret.ply\"/></shape>";
    let (outside, outside_at) = with("outside.xml", shape);
    let (waxen, waxen_at) = with("waxen.xml", "<subsurface type=\"dipole\"/>");
    let missing = folder.path().join("missing.xml");
    let render = |scene: &Path, more: &[&str]| {
        let mut arguments = vec!["render", text(scene), "-o", text(&output)];
        arguments.extend(more);
        refusal(&arguments)
    };
    for (errors, expected) in [
        (render(&broken, &[]), [broken_at.as_str(), "shpere"]),
        (render(&outside, &[]), [outside_at.as_str(), "secret.ply"]),
        (render(&waxen, &["--strict"]), [waxen_at.as_str(), "--strict"]),
        (render(&missing, &[]), ["missing.xml", "not found"]),
        (render(folder.path(), &[]), ["3 scenes, name one of them", "broken.xml"]),
        (
            render(&good, &["--set", "photon=3", "--integrator", "pppm"]),
            ["--set photon", "photons"],
        ),
        (
            render(&good, &["--set", "alpha=3", "--integrator", "pcf"]),
            ["alpha", "3"],
        ),
        (
            render(&good, &["--set", "samples=2", "--set", "samples=3"]),
            ["--set samples", "twice"],
        ),
        (render(&good, &["-D", "res=2", "-D", "res=3"]), ["-D res", "twice"]),
        (render(&good, &["-D", "colour=red"]), ["colour", "constant.xml"]),
    ] {
        for part in expected {
            assert!(errors.contains(part), "no `{part}` in: {errors}");
        }
    }
    assert_eq!(fs::read(&output).unwrap(), b"old");
    assert_eq!(
        files_in(folder.path()),
        ["a.exr", "broken.xml", "outside.xml", "waxen.xml"]
    );
}

#[test]
fn an_interrupted_render_leaves_the_old_picture_and_keeps_a_partial_one() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("a.exr");
    fs::write(&output, "old").unwrap();
    let scratch = folder.path().join("scratch");
    fs::create_dir(&scratch).unwrap();
    let scene = scene("constant.xml");
    let process = Process::start_in(
        &scratch,
        "photonfarm",
        &[
            "render",
            text(&scene),
            "-o",
            text(&output),
            "--iterations",
            "1000000",
            "--threads",
            "1",
        ],
    );
    // Rays are counted once an iteration has arrived.
    process.wait_for_error("rays/s");
    process.signal("INT");
    let (status, _, errors) = process.finish();
    assert_eq!(status.code(), Some(130), "{errors}");
    assert_eq!(fs::read(&output).unwrap(), b"old");
    let kept = ["a.exr", "a.partial.exr", "a.partial.farm", "a.partial.png", "scratch"];
    assert_eq!(files_in(folder.path()), kept);
    let partial = folder.path().join("a.partial.exr");
    let metadata = picture::read_metadata(&fs::read(&partial).unwrap()).unwrap().unwrap();
    let done = metadata.iterations;
    assert!(done > 0 && metadata.iterations_asked == Some(1_000_000));
    assert!(errors.contains(&format!("after {done} of 1000000")), "{errors}");
    assert!(errors.contains(&format!("--from {}", partial.display())), "{errors}");
    assert!(
        files_in(&scratch).is_empty(),
        "temporary files were left: {:?}",
        files_in(&scratch)
    );
    // A render of the name that comes to its end leaves nothing of the one before.
    printed(&photonfarm(&[
        "render",
        text(&scene),
        "-o",
        text(&output),
        "--iterations",
        "2",
    ]));
    assert_eq!(files_in(folder.path()), ["a.exr", "a.png", "scratch"]);
}

/// `--preview` shows the picture in its place before it is done.
#[test]
fn a_picture_appears_while_it_is_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("a.exr");
    let scene = scene("constant.xml");
    let render = ["render", text(&scene), "-o", text(&output), "--iterations", "1000000"];
    let process = Process::start("photonfarm", &[&render[..], &["--preview", "0.1"]].concat());
    let shown = || {
        let picture = fs::read(&output).ok()?;
        picture::read_metadata(&picture)
            .unwrap()
            .map(|metadata| metadata.iterations)
    };
    let mut first = None;
    wait_for("two previews", || {
        let now = shown();
        first = first.or(now);
        (now > first).then_some(())
    });
    process.signal("INT");
    assert_eq!(process.finish().0.code(), Some(130));
    assert!(folder.path().join("a.png").exists() && shown() < Some(1_000_000));
}

#[test]
fn a_picture_is_repeated_and_what_cannot_repeat_it_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::copy(scene("constant.xml"), path("a.xml")).unwrap();
    let (first, again) = (path("a.exr"), path("b.exr"));
    let options = [
        "--iterations",
        "3",
        "--integrator",
        "path",
        "--seed",
        "9",
        "--set",
        "samples=2",
    ];
    let render = |output: &Path, more: &[&str]| {
        let scene = path("a.xml");
        let arguments = [&["render", text(&scene), "-o", text(output)], more].concat();
        printed(&photonfarm(&arguments));
    };
    render(&first, &options);
    render(&again, &["--from", text(&first)]);
    let bytes = fs::read(&first).unwrap();
    assert!(bytes == fs::read(&again).unwrap());

    let refused =
        |name: &str, from: &Path| refusal(&["render", text(&path(name)), "-o", text(&again), "--from", text(from)]);
    fs::copy(path("a.xml"), path("other.xml")).unwrap();
    let errors = refused("other.xml", &first);
    assert!(errors.contains("a picture of a.xml"), "{errors}");
    fs::write(path("no.exr"), "no picture").unwrap();
    let errors = refused("a.xml", &path("no.exr"));
    assert!(errors.contains("no.exr"), "{errors}");
    let decoded = picture::decode_exr(&bytes, 1 << 20).unwrap();
    let metadata = decoded.metadata.unwrap();
    let image = Image {
        width: decoded.width,
        height: decoded.height,
        iterations: metadata.iterations,
        odd_iterations: metadata.iterations.div_ceil(2),
        pixels: decoded.pixels,
        standard_error: decoded.standard_error,
    };
    for (renderer, said) in [("0.1.0+other", "rendered by 0.1.0+other"), ("", "did not note")] {
        let renderer = renderer.to_owned();
        let other = PictureMetadata {
            renderer,
            ..metadata.clone()
        };
        fs::write(
            path("old.exr"),
            picture::encode_exr(&image, Default::default(), &other).unwrap(),
        )
        .unwrap();
        let errors = refused("a.xml", &path("old.exr"));
        assert!(errors.contains(said), "{errors}");
    }
    let changed = fs::read_to_string(path("a.xml")).unwrap() + "\n";
    fs::write(path("a.xml"), changed).unwrap();
    let errors = refused("a.xml", &first);
    assert!(
        errors.contains("another scene") && errors.contains(&metadata.scene_hash),
        "{errors}"
    );
}

#[test]
fn addresses_and_folders_in_use_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("farm");
    let coordinator = Coordinator::start(&data);
    let address = coordinator.url.trim_start_matches("http://");
    let other = folder.path().join("other");
    let errors = refusal(&["serve", "--listen", address, "--data", text(&other)]);
    assert!(errors.contains(address) && errors.contains("in use"), "{errors}");
    let errors = refusal(&["serve", "--listen", "127.0.0.1:0", "--data", text(&data)]);
    assert!(errors.contains(text(&data)) && errors.contains("another"), "{errors}");
    let errors = refusal(&["serve", "--listen", "nowhere", "--data", text(&other)]);
    assert!(errors.contains("127.0.0.1:7800"), "{errors}");
    let errors = refusal(&["serve", "--listen", "0.0.0.0:0", "--data", text(&other)]);
    assert!(errors.contains("other machines"), "{errors}");
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let errors = refusal(&["serve", "--listen", "127.0.0.1:0", "--data", text(&file)]);
    assert!(errors.contains(text(&file)), "{errors}");
}

#[test]
fn a_stopped_coordinator_ends_in_peace() {
    let folder = tempfile::tempdir().unwrap();
    let mut coordinator = Coordinator::start(&folder.path().join("farm"));
    let worker = coordinator.worker();
    coordinator.wait_for_workers(1);
    worker.signal("TERM");
    let (status, _, errors) = worker.finish();
    assert!(status.success(), "{errors}");
    let process = coordinator.stop();
    let (status, _, errors) = process.finish();
    assert!(status.success(), "{errors}");
}

#[test]
fn coordinators_that_are_not_there_are_refused_with_advice() {
    let scene = scene("constant.xml");
    for (url, advice) in [("farm:7700", "http://HOST:PORT"), ("not a url", "http://HOST:PORT")] {
        let errors = refusal(&["submit", text(&scene), "--coordinator", url]);
        assert!(errors.contains(advice), "{errors}");
    }
    // A port that nobody listens on: taken and given back.
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let url = format!("http://127.0.0.1:{port}");
    let output = photonfarm(&["submit", text(&scene), "--coordinator", &url]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(5), "{errors}");
    assert!(errors.contains("photonfarm serve"), "{errors}");
}

//! Pictures and scenes over connections that break, and commands that are killed meanwhile.

use crate::{command, scene};
use photonfarm_proto::id::BlobHash;
use photonfarm_tests::processes::{Coordinator, Process, photonfarm, printed, wait_for};
use photonfarm_tests::proxy::{Cutter, UploadCutter, refuse_bodies_beyond};
use std::fs;
use std::path::{Path, PathBuf};

/// A picture of some hundred thousand bytes.
const JOB: [&str; 8] = [
    "--integrator",
    "path",
    "-D",
    "res=200",
    "--set",
    "samples=1",
    "--iterations",
    "1",
];
/// Bytes of an answer that pass.
const PASSED: u64 = 60_000;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A farm whose job 1 is done, and its picture as it is without obstacles.
fn done(folder: &Path) -> (Coordinator, PathBuf) {
    let coordinator = Coordinator::start(&folder.join("farm"));
    let _worker = coordinator.worker();
    let (scene, picture) = (scene("coated.xml"), folder.join("direct.exr"));
    let submit = ["submit", text(&scene), "--wait", "-o", text(&picture)];
    command(&coordinator, &[&submit[..], &JOB].concat());
    let bytes = fs::metadata(&picture).unwrap().len();
    assert!(bytes > 3 * PASSED, "a picture of {bytes} bytes breaks too seldom");
    (coordinator, picture)
}

fn fetch(url: &str, picture: &Path) -> Vec<String> {
    ["fetch", "1", "-o", text(picture), "--coordinator", url]
        .map(str::to_owned)
        .to_vec()
}

/// The heads of requests for the picture.
fn asked(cutter: &Cutter) -> Vec<String> {
    let heads = cutter.heads().into_iter();
    heads.filter(|head| head.contains("/image.exr")).collect()
}

fn check_same(found: &Path, expected: &Path) {
    for end in ["exr", "png"] {
        let [found, expected] = [found, expected].map(|path| fs::read(path.with_extension(end)).unwrap());
        assert!(found == expected, "the {end} is another");
    }
    let folder = fs::read_dir(found.parent().unwrap()).unwrap();
    let parts = folder.filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().ends_with(".part"));
    assert_eq!(parts.count(), 0);
}

#[test]
fn a_download_goes_on_where_its_connection_broke() {
    let folder = tempfile::tempdir().unwrap();
    let (coordinator, direct) = done(folder.path());
    let cutter = Cutter::start(&coordinator.url, PASSED, false);
    let picture = folder.path().join("pieces.exr");
    printed(&photonfarm(&fetch(&cutter.url, &picture)));
    check_same(&picture, &direct);
    let asked = asked(&cutter);
    assert!(asked.len() > 3, "{asked:?}");
    assert!(!asked[0].contains("range:"), "{}", asked[0]);
    for head in &asked[1..] {
        assert!(
            head.contains("\r\nrange: bytes=") && head.contains("\r\nif-range: \""),
            "{head}"
        );
    }
}

#[test]
fn a_download_that_was_killed_goes_on_by_the_same_command() {
    let folder = tempfile::tempdir().unwrap();
    let (coordinator, direct) = done(folder.path());
    let silent = Cutter::start(&coordinator.url, PASSED, true);
    let picture = folder.path().join("killed.exr");
    let first = Process::start("photonfarm", &fetch(&silent.url, &picture));
    let part = folder.path().join(".killed.exr.part");
    let arrived = || fs::metadata(&part).ok().filter(|part| part.len() > PASSED / 2);
    wait_for("a part of the picture", arrived);
    first.kill();
    assert!(!picture.exists());
    let watched = Cutter::start(&coordinator.url, u64::MAX, false);
    printed(&photonfarm(&fetch(&watched.url, &picture)));
    check_same(&picture, &direct);
    let heads = asked(&watched);
    let [head] = heads.as_slice() else { panic!("{heads:?}") };
    let from = head
        .split("\r\nrange: bytes=")
        .nth(1)
        .and_then(|range| range.split('-').next());
    let from: u64 = from.unwrap_or_else(|| panic!("{head}")).parse().unwrap();
    assert!(from > PASSED / 3, "{head}");
}

#[test]
fn files_that_have_arrived_are_not_sent_again() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let scene = scene("textures.xml");
    let submit = |url: &str| photonfarm(&["submit", text(&scene), "--iterations", "1", "--coordinator", url]);
    // Files go in the order of their hashes: the texture passes, and then the scene does not.
    let output = submit(&refuse_bodies_beyond(2000, &coordinator.url));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(errors.contains("cannot send textures.xml"), "{errors}");
    let watched = Cutter::start(&coordinator.url, u64::MAX, false);
    printed(&submit(&watched.url));
    let heads = watched.heads().into_iter();
    let sent: Vec<String> = heads.filter(|head| head.starts_with("PUT ")).collect();
    let hash = BlobHash::of(&fs::read(&scene).unwrap());
    assert_eq!(sent.len(), 1, "{sent:?}");
    assert!(sent[0].starts_with(&format!("PUT /v1/blobs/{hash} ")), "{sent:?}");
}

/// Bytes of a long scene that pass before its connection breaks.
const SENT: u64 = 3 << 20;

/// A scene of some megabytes, and its length.
fn long_scene(folder: &Path) -> (PathBuf, u64) {
    let text = fs::read_to_string(scene("coated.xml")).unwrap();
    let long = folder.join("long.xml");
    let padding = " ".repeat(1000) + "\n";
    fs::write(&long, text + &padding.repeat(5000)).unwrap();
    let bytes = fs::metadata(&long).unwrap().len();
    (long, bytes)
}

fn offset(head: &str) -> u64 {
    let after = head
        .split("\r\nupload-offset: ")
        .nth(1)
        .and_then(|rest| rest.lines().next());
    after.unwrap_or_else(|| panic!("{head}")).parse().unwrap()
}

/// How much of the file the second of two requests sent, which the first began.
fn sent_again(first: &(String, u64), second: &(String, u64), length: u64) {
    assert_eq!((offset(&first.0), first.1), (0, SENT));
    let (from, sent) = (offset(&second.0), second.1);
    assert!(from > 0 && from <= SENT, "it goes on from {from}");
    assert_eq!(from + sent, length, "from {from}: {sent}");
}

#[test]
fn an_upload_goes_on_where_its_connection_broke() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let (scene, length) = long_scene(folder.path());
    let cutter = UploadCutter::start(&coordinator.url, SENT, false);
    let submit = [
        "submit",
        text(&scene),
        "--iterations",
        "1",
        "--coordinator",
        &cutter.url,
    ];
    printed(&photonfarm(&submit));
    let sent = cutter.sent();
    let [first, second] = sent.as_slice() else {
        panic!("{sent:?}")
    };
    sent_again(first, second, length);
}

#[test]
fn an_upload_that_was_killed_goes_on_by_the_same_command() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let (scene, length) = long_scene(folder.path());
    let submit = |url: &str| ["submit", text(&scene), "--iterations", "1", "--coordinator", url].map(str::to_owned);
    let silent = UploadCutter::start(&coordinator.url, SENT, true);
    let killed = Process::start("photonfarm", &submit(&silent.url));
    let first = wait_for("a part of the scene", || silent.sent().into_iter().next());
    killed.kill();
    let watched = UploadCutter::start(&coordinator.url, u64::MAX, false);
    printed(&photonfarm(&submit(&watched.url)));
    let sent = watched.sent();
    let [second] = sent.as_slice() else { panic!("{sent:?}") };
    sent_again(&first, second, length);
}

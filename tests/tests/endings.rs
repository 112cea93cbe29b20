//! How programs end, and how work goes on after them: readers that leave early, waiting that is interrupted, farms that are
//! told to stop all at once, coordinators that come late.

use photonfarm_proto::api::Health;
use photonfarm_proto::job::JobState;
use photonfarm_tests::processes::{
    Coordinator, Launch, Process, get, jobs, photonfarm, printed, scene, serve, wait_for,
};
use photonfarm_tests::proxy::refuse_bodies_beyond;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Command, Output, Stdio};

const JOB: [&str; 10] = [
    "--integrator",
    "pppm",
    "--seed",
    "5",
    "-D",
    "res=32",
    "--set",
    "samples=2",
    "--set",
    "photons=10000",
];

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A pipe that nobody reads from.
fn broken_pipe() -> Stdio {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    writer.into()
}

fn command(arguments: &[&str]) -> Command {
    Launch::default().command("photonfarm", arguments)
}

/// Runs a command on a farm and returns what it prints.
fn on_farm(coordinator: &Coordinator, arguments: &[&str]) -> Output {
    photonfarm(&[arguments, &["--coordinator", &coordinator.url]].concat())
}

#[test]
fn readers_that_leave_early_are_no_failure() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("farm");
    let coordinator = Coordinator::start(&data);
    let scene = scene("constant.xml");
    let submit = [["submit", text(&scene), "--iterations", "1"].as_slice(), &JOB].concat();
    printed(&on_farm(&coordinator, &submit));
    for arguments in [
        &["jobs"] as &[&str],
        &["jobs", "--json"],
        &["jobs", "1"],
        &["pause", "1"],
        &["resume", "1", "--json"],
        &["priority", "1", "7"],
        &["extend", "1", "2"],
        &["workers"],
        &["workers", "--json"],
        &["token", "list"],
        &submit,
        &["cancel", "1"],
        &["resubmit", "1"],
        &["delete", "1"],
    ] {
        let arguments = [arguments, &["--coordinator", &coordinator.url]].concat();
        let output = command(&arguments).stdout(broken_pipe()).output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success() && !errors.contains("panicked"),
            "{arguments:?}: {errors}"
        );
    }
    // A full disk is no reader that has left.
    let full = || Stdio::from(std::fs::File::options().write(true).open("/dev/full").unwrap());
    let output = command(&["jobs", "--coordinator", &coordinator.url])
        .stdout(full())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("cannot write to standard output"));
}

#[test]
fn jobs_are_deleted_but_those_that_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let scene = scene("constant.xml");
    let submit = [["submit", text(&scene), "--iterations", "1"].as_slice(), &JOB].concat();
    for _ in 0..3 {
        printed(&on_farm(&coordinator, &submit));
    }
    for job in ["1", "3"] {
        printed(&on_farm(&coordinator, &["cancel", job]));
    }
    let output = on_farm(&coordinator, &["delete", "1", "2", "3"]);
    let (lines, errors) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert_eq!(lines, "job 1 is deleted\njob 3 is deleted\n");
    assert!(
        errors.contains("job 2 is not deleted") && errors.contains("cancel it first"),
        "{errors}"
    );
    let errors = on_farm(&coordinator, &["jobs", "1"]).stderr;
    assert!(String::from_utf8_lossy(&errors).contains("there is no job 1"));
    let listed = printed(&on_farm(&coordinator, &["jobs"]));
    let (_, job) = listed.split_once('\n').unwrap();
    let words: Vec<&str> = job.split_whitespace().collect();
    assert_eq!(words[..6], ["2", "constant", "queued", "0", "of", "1"], "{listed}");
}

#[test]
fn a_log_that_nobody_reads_stops_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("a.exr");
    let scene = scene("constant.xml");
    let render = [
        ["render", text(&scene), "-o", text(&picture), "--iterations", "2"].as_slice(),
        &JOB,
    ]
    .concat();
    let status = command(&render)
        .env("RUST_LOG", "debug")
        .stderr(broken_pipe())
        .status()
        .unwrap();
    assert!(status.success() && picture.exists());
}

#[test]
fn waiting_goes_on_after_an_interruption_and_a_named_submission_is_made_once() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let (scene, picture) = (scene("constant.xml"), folder.path().join("a.exr"));
    let submit = [
        ["submit", text(&scene), "--iterations", "3", "--key", "nightly"].as_slice(),
        &JOB,
    ]
    .concat();
    let waiting = [
        submit.as_slice(),
        &["--wait", "-o", text(&picture), "--coordinator", &coordinator.url],
    ]
    .concat();
    let process = Process::start("photonfarm", &waiting);
    let health: Health = get(&format!("{}/v1/healthz", coordinator.url)).unwrap();
    let again = format!(
        "photonfarm wait 1 --coordinator {} --farm {} -o {}",
        coordinator.url,
        health.farm.farm,
        picture.display()
    );
    process.wait_for_error("0/3 iterations");
    process.signal("INT");
    let (status, output, errors) = process.finish();
    assert_eq!((status.code(), output.as_str()), (Some(130), "1\n"), "{errors}");
    assert!(errors.ends_with(&format!("to go on waiting: {again}\n")), "{errors}");

    let _worker = coordinator.worker();
    let words: Vec<&str> = again.split(' ').skip(1).collect();
    printed(&photonfarm(&words));
    let stranger = on_farm(&coordinator, &["wait", "1", "--farm", "0123", "-o", text(&picture)]);
    let errors = String::from_utf8_lossy(&stranger.stderr);
    assert_eq!(stranger.status.code(), Some(1), "{errors}");
    assert!(errors.contains("another farm answers there"), "{errors}");
    let alone = folder.path().join("alone.exr");
    let render = [
        ["render", text(&scene), "-o", text(&alone), "--iterations", "3"].as_slice(),
        &JOB,
    ]
    .concat();
    printed(&photonfarm(&render));
    assert!(
        std::fs::read(&picture).unwrap() == std::fs::read(&alone).unwrap(),
        "the pictures differ"
    );

    assert_eq!(printed(&on_farm(&coordinator, &submit)), "1", "the same submission");
    let other = submit
        .iter()
        .map(|word| if *word == "nightly" { "another" } else { word });
    assert_eq!(printed(&on_farm(&coordinator, &other.collect::<Vec<_>>())), "2");
    let refused = on_farm(&coordinator, &[submit.as_slice(), &["--set", "alpha=0.5"]].concat());
    assert!(String::from_utf8_lossy(&refused.stderr).contains("asks for something else"));

    let output = on_farm(&coordinator, &["resubmit", "1"]);
    assert!(printed(&output).contains("\n3  "), "{output:?}");
    let output = on_farm(&coordinator, &["resubmit", "1"]);
    assert!(printed(&output).contains("\n3  "), "repetition is harmless: {output:?}");
    printed(&on_farm(&coordinator, &["wait", "3"]));
    assert_eq!(on_farm(&coordinator, &["wait", "99"]).status.code(), Some(6));
}

#[test]
fn a_job_that_goes_on_is_cancelled_when_it_is_submitted_again() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let scene = scene("constant.xml");
    let submit = [
        ["submit", text(&scene), "--priority", "7", "--within", "1h"].as_slice(),
        &JOB,
    ]
    .concat();
    assert_eq!(printed(&on_farm(&coordinator, &submit)), "1");
    printed(&on_farm(&coordinator, &["pause", "1"]));
    let output = on_farm(&coordinator, &["resubmit", "1"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        errors.contains("deadline") && errors.contains("job 2 takes its place"),
        "{errors}"
    );
    let found = jobs(&coordinator.url).unwrap();
    let states: Vec<_> = found
        .iter()
        .map(|job| (job.id.0, job.state, job.spec.schedule.paused))
        .collect();
    assert_eq!(states, [(2, JobState::Queued, false), (1, JobState::Cancelled, true)]);
    assert_eq!(found[0].spec.schedule.priority, 7);
    assert_eq!(
        on_farm(&coordinator, &["wait", "1"]).status.code(),
        Some(4),
        "it was cancelled"
    );
}

fn worker(url: &str, cache: &Path, more: &[&str]) -> Process {
    let arguments = ["--coordinator", url, "--threads", "1", "--cache", text(cache)];
    Process::start("photonfarm-worker", &[arguments.as_slice(), more].concat())
}

#[test]
fn a_farm_that_is_told_to_stop_all_at_once_ends_and_goes_on_later() {
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let mut coordinator = Coordinator::start_with(&folder.path().join("farm"), &["--lease-seconds", "1"]);
    let first = worker(&coordinator.url, &cache, &["--drain-seconds", "1"]);
    let scene = scene("environment.xml");
    let submit = [["submit", text(&scene), "--iterations", "60"].as_slice(), &JOB].concat();
    printed(&on_farm(&coordinator, &submit));
    let job = |url: &str| jobs(url)?.into_iter().next();
    wait_for("some iterations", || {
        job(&coordinator.url).filter(|job| job.iterations_done > 0)
    });
    coordinator.kill();
    // What it has finished cannot be delivered any more.
    first.wait_for_error("cannot reach the coordinator");
    first.signal("TERM");
    let (status, _, errors) = first.finish();
    assert!(status.success(), "{errors}");
    assert!(errors.contains("draining") && errors.contains("stopped"), "{errors}");
    let kept = errors.matches("finished work is kept for the next start").count();

    coordinator.restart();
    let second = worker(&coordinator.url, &cache, &[]);
    wait_for("the end", || {
        job(&coordinator.url).filter(|job| job.state == JobState::Done)
    });
    assert_eq!(
        second.errors().matches("delivering work of an earlier process").count(),
        kept
    );
    let [farm, alone] = ["farm.exr", "alone.exr"].map(|name| folder.path().join(name));
    printed(&on_farm(&coordinator, &["wait", "1", "-o", text(&farm)]));
    let render = [
        ["render", text(&scene), "-o", text(&alone), "--iterations", "60"].as_slice(),
        &JOB,
    ]
    .concat();
    printed(&photonfarm(&render));
    assert!(
        std::fs::read(farm).unwrap() == std::fs::read(alone).unwrap(),
        "the pictures differ"
    );
}

#[test]
fn a_worker_without_a_coordinator_says_why_and_waits() {
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let unknown = worker("http://farm.invalid:7800", &cache, &[]);
    unknown.wait_for_error("cannot reach the coordinator at http://farm.invalid:7800: its name is unknown");
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = free.local_addr().unwrap().to_string();
    drop(free);
    let mut early = worker(&format!("http://{address}"), &cache, &[]);
    early.wait_for_error("the connection was refused");
    // A proxy whose service is away has pages of its own.
    let page = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let stranger = format!("http://{}", page.local_addr().unwrap());
    std::thread::spawn(move || {
        for mut client in page.incoming().map_while(Result::ok) {
            let answer = b"HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\nconnection: close\r\n\r\n";
            let _head = client.read(&mut [0; 4096]);
            let _gone = client.write_all(answer);
        }
    });
    let mut misled = worker(&stranger, &cache, &[]);
    misled.wait_for_error("something answers there that is no coordinator: 404 Not Found");
    assert!(misled.is_running());
    let (_coordinator, _) = serve(&folder.path().join("farm"), &address, &[]);
    early.wait_for_error("registered");
    assert!(early.is_running());
}

#[test]
fn folders_that_cannot_be_written_are_refused_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    // Nobody can make files there, not even the superuser.
    let process = worker("http://127.0.0.1:1", Path::new("/proc/self"), &[]);
    let (status, _, errors) = process.finish();
    assert_eq!(status.code(), Some(1), "{errors}");
    assert!(
        errors.contains("/proc/self") && errors.contains("cannot be written"),
        "{errors}"
    );

    let data = folder.path().join("farm");
    let mut coordinator = Coordinator::start(&data);
    assert!(coordinator.stop().finish().0.success());
    let open = Command::new("chmod").args(["-R", "a+rX"]).arg(folder.path()).status();
    assert!(open.unwrap().success());
    let somebody_else = Launch {
        wrapper: ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
            .map(str::to_owned)
            .into(),
        ..Launch::default()
    };
    let output = somebody_else
        .command(
            "photonfarm",
            &["serve", "--listen", "127.0.0.1:0", "--data", text(&data)],
        )
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(
        errors.contains("cannot be written") && !errors.contains("in use"),
        "{errors}"
    );
    // The database alone is somebody else's.
    let open = Command::new("chmod").args(["-R", "a+rwX"]).arg(&data).status();
    assert!(open.unwrap().success());
    let shut = Command::new("chmod").arg("a-w").arg(data.join("farm.sqlite")).status();
    assert!(shut.unwrap().success());
    let output = somebody_else
        .command(
            "photonfarm",
            &["serve", "--listen", "127.0.0.1:0", "--data", text(&data)],
        )
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(errors.contains("farm.sqlite cannot be written"), "{errors}");
}

/// The commands of a section of the documentation of farms.
fn recipe(section: &str) -> String {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/FARM.md")).unwrap();
    let (_, rest) = page.split_once(&format!("### {section}\n")).unwrap();
    let (_, rest) = rest.split_once("```sh\n").unwrap();
    rest.split_once("```").unwrap().0.to_owned()
}

#[test]
fn certificates_that_are_not_trusted_are_explained_and_the_recipe_of_the_documentation_works() {
    let folder = tempfile::tempdir().unwrap();
    let shell = |script: &str| {
        let mut shell = Command::new("bash");
        shell.args(["-euc", script]).current_dir(folder.path());
        printed(&shell.output().unwrap());
    };
    shell(&recipe("A certificate of your own"));
    shell(
        "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -keyout ca.key -out ca.pem -subj /CN=localhost",
    );
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let encrypted = |name: &str| {
        let (certificate, key) = (path(&format!("{name}.pem")), path(&format!("{name}.key")));
        serve(
            &folder.path().join(format!("{name}.farm")),
            "127.0.0.1:0",
            &["--tls-cert", &certificate, "--tls-key", &key],
        )
    };
    let (_good, url) = encrypted("farm");
    let (_authority, wrong) = encrypted("ca");
    let certificate = path("farm.pem");
    let cache = folder.path().join("cache");
    let worker_of = |url: &str, more: &[&str]| worker(url, &cache, more);
    let named = url.replace("127.0.0.1", "localhost");
    assert_eq!(
        printed(&photonfarm(&["jobs", "--coordinator", &named, "--ca", &certificate])),
        ""
    );
    worker_of(&url, &["--ca", &certificate]).wait_for_error("registered");
    let plain = url.replace("https", "http");
    for (url, ca, reason) in [
        (url.as_str(), None, "give the authority's certificate with --ca"),
        (&wrong, Some("ca.pem"), "`CA:TRUE`, as `openssl req -x509` makes it"),
        (&plain, None, "write https:// instead of http://"),
    ] {
        let ca = ca.map(path);
        let trust: Vec<&str> = ca.iter().flat_map(|path| ["--ca", path.as_str()]).collect();
        let output = photonfarm(&[&["jobs", "--coordinator", url], trust.as_slice()].concat());
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(
            matches!(output.status.code(), Some(1 | 5)) && errors.contains(reason),
            "{errors}"
        );
        worker_of(url, &trust).wait_for_error(reason);
    }
}

#[test]
fn the_log_says_who_did_what_from_where_and_how_the_last_end_was() {
    let folder = tempfile::tempdir().unwrap();
    let (data, token) = (folder.path().join("farm"), folder.path().join("token"));
    let made = photonfarm(&["token", "create", "boss", "--role", "admin", "--data", text(&data)]);
    std::fs::write(&token, printed(&made)).unwrap();
    let scene = scene("constant.xml");
    let (first, url) = serve(&data, "127.0.0.1:0", &[]);
    let as_boss = ["--coordinator", &url, "--token-file", text(&token)];
    printed(&photonfarm(
        &[["submit", text(&scene), "--iterations", "3"].as_slice(), &JOB, &as_boss].concat(),
    ));
    printed(&photonfarm(&[["pause", "1"].as_slice(), &as_boss].concat()));
    printed(&photonfarm(&[["cancel", "1"].as_slice(), &as_boss].concat()));
    let log = first.kill();
    for line in [
        "boss at 127.0.0.1: POST /v1/jobs: 201 Created",
        "boss submitted a job of 3 iterations",
        "boss at 127.0.0.1: POST /v1/jobs/1/pause: 200 OK",
        "it is paused",
        "it was cancelled with 0 iterations",
    ] {
        assert!(log.contains(line), "no `{line}` in:\n{log}");
    }
    assert!(!log.contains("JobControl"), "a structure is dumped: {log}");
    let (second, _) = serve(&data, "127.0.0.1:0", &[]);
    second.signal("TERM");
    let (_, _, log) = second.finish();
    assert!(log.contains("was not closed last time"), "{log}");
    let (third, _) = serve(&data, "127.0.0.1:0", &[]);
    assert!(third.kill().contains("was closed properly last time"));
}

#[test]
fn whatever_refuses_large_bodies_on_the_way_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let scene = scene("constant.xml");
    let submit = [["submit", text(&scene), "--iterations", "2"].as_slice(), &JOB].concat();
    let narrow = refuse_bodies_beyond(1000, &coordinator.url);
    let output = photonfarm(&[submit.as_slice(), &["--coordinator", &narrow]].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(
        errors.contains("cannot send constant.xml") && errors.contains("client_max_body_size"),
        "{errors}"
    );

    // The scene passes, and the image of 32 by 32 pixels does not.
    let wide = refuse_bodies_beyond(10_000, &coordinator.url);
    let refused = worker(&wide, &folder.path().join("cache"), &[]);
    assert_eq!(
        printed(&photonfarm(&[submit.as_slice(), &["--coordinator", &wide]].concat())),
        "1"
    );
    let output = on_farm(&coordinator, &["wait", "1"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{errors}");
    assert!(
        errors.contains("413") && errors.contains("client_max_body_size"),
        "{errors}"
    );
    assert!(refused.errors().contains("413"), "{}", refused.errors());
}

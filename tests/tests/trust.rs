//! A farm that asks for tokens and encrypts its connections, by its real programs.

use photonfarm_proto::id::JobId;
use photonfarm_proto::token::Role;
use photonfarm_test_servers::Postgres;
use photonfarm_tests::farm::Client;
use photonfarm_tests::processes::{Launch, Process, photonfarm, printed, scene, serve, wait_for};
use std::path::{Path, PathBuf};
use std::process::Output;

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A stopped farm, its certificate, and what clients need.
struct Ground {
    folder: tempfile::TempDir,
}

impl Ground {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let ground = Self { folder };
        ground.certify();
        ground
    }

    /// Makes a certificate that takes the place of the one before.
    fn certify(&self) {
        let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
        std::fs::write(self.path("farm.pem"), made.cert.pem()).unwrap();
        std::fs::write(self.path("farm.key"), made.signing_key.serialize_pem()).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn name(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    /// Makes a token and keeps it in the file `NAME.token`.
    fn token(&self, name: &str, role: Role, place: &[&str]) -> String {
        let role = role.to_string();
        let arguments = [&["token", "create", name, "--role", &role], place].concat();
        let token = printed(&photonfarm(&arguments));
        std::fs::write(self.path(&format!("{name}.token")), &token).unwrap();
        token
    }
}

fn refused(output: &Output, reasons: &[&str]) {
    let message = text(&output.stderr);
    // By the program itself, or by the farm.
    assert!(matches!(output.status.code(), Some(1 | 6)), "{message}");
    for reason in reasons {
        assert!(message.contains(reason), "{reason:?} is not in {message:?}");
    }
}

#[test]
fn a_farm_with_tokens_and_a_certificate_renders() {
    let ground = Ground::new();
    let data = ground.name("farm");
    let boss = ground.token("boss", Role::Admin, &["--data", &data]);
    let (certificate, key) = (ground.name("farm.pem"), ground.name("farm.key"));
    let more = ["--tls-cert", &certificate, "--tls-key", &key];
    let (coordinator, url) = serve(Path::new(&data), "127.0.0.1:0", &more);
    assert!(url.starts_with("https://"), "{url}");

    refused(
        &photonfarm(&["token", "list", "--data", &data]),
        &["while a coordinator runs on it"],
    );
    let boss_file = ground.name("boss.token");
    let farm = ["--coordinator", &url, "--token-file", &boss_file, "--ca", &certificate];
    let rack = ground.token("rack", Role::Worker, &farm);
    let ann = ground.token("ann", Role::Submit, &[&farm[..], &["--most-iterations", "20"]].concat());
    let list = photonfarm(&[&["token", "list"], &farm[..]].concat());
    let list = text(&list.stdout);
    assert!(
        list.contains("ann  submit") && list.contains("iterations: 0 of 20"),
        "{list}"
    );

    let rack_file = ground.name("rack.token");
    let worker = [
        "--coordinator",
        &url,
        "--token-file",
        &rack_file,
        "--ca",
        &certificate,
        "--threads",
        "1",
    ];
    let cache = ground.name("cache");
    let worker = Process::start("photonfarm-worker", &[&worker[..], &["--cache", &cache]].concat());

    let (scene, picture, ann_file) = (
        scene("constant.xml"),
        ground.name("image.exr"),
        ground.name("ann.token"),
    );
    let submit = |token: &str, authority: &[&str], iterations: &str| {
        let job = [
            "submit",
            scene.to_str().unwrap(),
            "--coordinator",
            &url,
            "--token-file",
            token,
        ];
        let how = ["--iterations", iterations, "--wait", "-o", &picture];
        photonfarm(&[&job[..], authority, &how[..]].concat())
    };
    let trusted = ["--ca", &certificate];
    printed(&submit(&ann_file, &trusted, "8"));
    assert!(Path::new(&picture).exists());
    refused(
        &submit(&ann_file, &trusted, "13"),
        &["quota", "is 20; this would make 21", "--most-iterations"],
    );
    refused(
        &submit(&rack_file, &trusted, "1"),
        &["`submit`", "has the role `worker`"],
    );
    refused(&submit(&ann_file, &[], "1"), &["no coordinator answers"]);
    printed(&photonfarm(&[&["token", "revoke", "ann"], &farm[..]].concat()));
    refused(&submit(&ann_file, &trusted, "1"), &["not valid"]);

    let mut said = String::new();
    for process in [worker, coordinator] {
        process.signal("TERM");
        let (status, output, errors) = process.finish();
        assert!(status.success(), "{errors}");
        said += &format!("{output}{errors}");
    }
    assert!(said.contains("token revoked"), "{said}");
    for token in [boss, rack, ann] {
        assert!(token.starts_with("phf_") && token.len() == 68);
        assert!(!said.contains(&token[4..]), "a log shows a token");
    }
}

#[test]
fn a_farm_without_tokens_does_not_listen_for_other_machines() {
    let ground = Ground::new();
    let data = ground.name("farm");
    let output = photonfarm(&["serve", "--listen", "0.0.0.0:0", "--data", &data]);
    refused(&output, &["no token yet", "photonfarm token create"]);
}

#[test]
fn a_signal_has_the_certificate_read_again_and_one_that_cannot_be_used_changes_nothing() {
    let ground = Ground::new();
    let (data, certificate, key) = (ground.name("farm"), ground.name("farm.pem"), ground.name("farm.key"));
    let more = ["--tls-cert", &certificate, "--tls-key", &key];
    let (coordinator, url) = serve(Path::new(&data), "127.0.0.1:0", &more);
    let trusts = |authority: &str| {
        let output = photonfarm(&["jobs", "--coordinator", &url, "--ca", &ground.name(authority)]);
        output.status.success()
    };
    std::fs::copy(&certificate, ground.path("old.pem")).unwrap();
    assert!(trusts("old.pem"));

    std::fs::write(&certificate, "nonsense").unwrap();
    coordinator.signal("HUP");
    coordinator.wait_for_error(&certificate);
    assert!(trusts("old.pem"), "nonsense took the place of a certificate");

    ground.certify();
    assert!(!trusts("farm.pem"), "files are read without a signal");
    coordinator.signal("HUP");
    wait_for("the new certificate", || trusts("farm.pem").then_some(()));
    assert!(!trusts("old.pem"));
    coordinator.signal("TERM");
    let (status, _, errors) = coordinator.finish();
    assert!(status.success(), "{errors}");
}

#[test]
fn a_certificate_is_needed_whole() {
    let ground = Ground::new();
    let (data, certificate) = (ground.name("farm"), ground.name("farm.pem"));
    let serve = [
        "serve",
        "--listen",
        "127.0.0.1:0",
        "--data",
        &data,
        "--tls-cert",
        &certificate,
    ];
    let missing = ground.name("missing.key");
    let output = photonfarm(&[&serve[..], &["--tls-key", &missing]].concat());
    refused(&output, &["missing.key"]);
}

#[test]
fn a_worker_without_a_valid_token_says_why() {
    let ground = Ground::new();
    let data = ground.name("farm");
    ground.token("boss", Role::Admin, &["--data", &data]);
    let (_coordinator, url) = serve(Path::new(&data), "127.0.0.1:0", &[]);
    let cache = ground.name("cache");
    let worker = Process::start("photonfarm-worker", &["--coordinator", &url, "--cache", &cache]);
    let (status, _, errors) = worker.finish();
    assert!(
        !status.success() && errors.contains("`worker`") && errors.contains("Bearer"),
        "{errors}"
    );
}

/// PostgreSQL here refuses TCP connections that are not encrypted.
#[test]
fn connections_to_postgres_are_encrypted_where_the_url_asks_for_it_and_only_to_whom_the_system_trusts() {
    let ground = Ground::new();
    let read = |name| std::fs::read_to_string(ground.path(name)).unwrap();
    let cluster = Postgres::start();
    let database = cluster.database();
    let database = database.split(['/', '?']).nth(3).unwrap();
    let port = cluster.encrypt(&read("farm.pem"), &read("farm.key"));
    let place = |mode: &str| format!("postgres://photonfarm@127.0.0.1:{port}/{database}?sslmode={mode}");
    let make = |name: &str, mode: &str, trusted: &str| {
        let launch = Launch::with(&[("SSL_CERT_FILE", ground.name(trusted))]);
        let arguments = ["token", "create", name, "--role", "admin", "--state", &place(mode)];
        launch.command("photonfarm", &arguments).output().unwrap()
    };
    let other = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
    std::fs::write(ground.path("other.pem"), other.cert.pem()).unwrap();

    refused(&make("ann", "prefer", "farm.pem"), &["no encryption"]);
    refused(&make("ann", "disable", "farm.pem"), &["no encryption"]);
    refused(&make("ann", "require", "other.pem"), &["certificate"]);
    refused(&make("ann", "require", "missing.pem"), &["certificate", "missing.pem"]);
    printed(&make("ann", "require", "farm.pem"));
    refused(&make("ann", "require", "farm.pem"), &["ann"]);
}

/// Two requests at once and one a second: more than a scene of several files takes.
#[test]
fn a_worker_that_may_not_ask_so_often_waits_and_keeps_its_lease() {
    let ground = Ground::new();
    let data = ground.name("farm");
    let boss = ground.token("boss", Role::Admin, &["--data", &data]);
    ground.token("rack", Role::Worker, &["--data", &data]);
    let (_coordinator, url) = serve(Path::new(&data), "127.0.0.1:0", &["--rate", "1"]);
    let (scene, boss_file, rack_file) = (
        scene("environment.xml"),
        ground.name("boss.token"),
        ground.name("rack.token"),
    );
    let what = ["submit", scene.to_str().unwrap(), "-D", "res=8", "--iterations", "1"];
    printed(&photonfarm(
        &[&what[..], &["--coordinator", &url, "--token-file", &boss_file]].concat(),
    ));
    let cache = ground.name("cache");
    let farm = ["--coordinator", &url, "--token-file", &rack_file, "--cache", &cache];
    let _worker = Process::start("photonfarm-worker", &[&farm[..], &["--threads", "1"]].concat());
    let client = Client::new(&url).with_token(Some(&boss));
    client.when_done(JobId(1), 1);
    let leases = wait_for("a figure", || client.figure("leases_granted_total"));
    assert_eq!(leases, 1, "leases went back");
}

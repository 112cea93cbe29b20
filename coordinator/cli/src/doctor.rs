//! `photonfarm doctor`: looks at a deployment and says what is wrong with it.

use crate::client::{Client, Sighting};
use crate::farm_args::FarmArgs;
use crate::say;
use anyhow::{Result, bail};
use clap::Args;
use photonfarm_proto::api::{Health, StoreRoom, WorkerStatus};
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::token::Role;
use photonfarm_proto::waiting::Waiting;
use photonfarm_proto::{RENDERER, VERSION};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};
use x509_cert::Certificate;
use x509_cert::der::Decode;

pub(crate) const EXAMPLES: &str = "\
Examples:
  photonfarm doctor --coordinator https://farm.example:7800 --token-file ann.token
      Whether it answers, the versions, what the token may do, clocks, the certificate, the workers, the
      stores, and why jobs wait.
  photonfarm doctor --coordinator http://127.0.0.1:7800 --data farm
      On the coordinator's machine: the room on its disk as well.
  photonfarm doctor --json | jq '.[] | select(.grade != \"ok\")'
      For scripts and monitors.

It ends with 0 where nothing is an error; warnings are none. 1: something is an error. 5: nobody answers.
A token that may send scenes is used to store a file of some bytes, always the same one.";

/// Seconds that clocks may differ by: the coordinator's is told in whole seconds.
const SKEW_WARNED: u64 = 5;
const SKEW_WRONG: u64 = 60;
/// Days before its end that a certificate is warned about.
const LAST_DAYS: u64 = 14;
/// What is stored to see whether it can be.
const FILE: &[u8] = b"photonfarm doctor was here\n";

#[derive(Debug, Args)]
pub(crate) struct DoctorArgs {
    /// Data folder of the coordinator, where it is on this machine
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    farm: FarmArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Grade {
    Ok,
    Warn,
    Error,
}

/// What was looked at, and how it is.
#[derive(Debug, Serialize)]
struct Finding {
    grade: Grade,
    what: &'static str,
    detail: String,
    /// What to do next.
    #[serde(skip_serializing_if = "Option::is_none")]
    advice: Option<String>,
}

impl Finding {
    fn ok(what: &'static str, detail: impl Into<String>) -> Self {
        Self {
            grade: Grade::Ok,
            what,
            detail: detail.into(),
            advice: None,
        }
    }

    fn bad(grade: Grade, what: &'static str, detail: impl Into<String>, advice: impl Into<String>) -> Self {
        Self {
            grade,
            what,
            detail: detail.into(),
            advice: Some(advice.into()),
        }
    }

    fn text(&self) -> String {
        let grade = match self.grade {
            Grade::Ok => "ok",
            Grade::Warn => "warn",
            Grade::Error => "error",
        };
        let next = self
            .advice
            .as_ref()
            .map(|advice| format!("\n                    -> {advice}"));
        format!(
            "{grade:<6} {:<12} {}{}",
            self.what,
            self.detail,
            next.unwrap_or_default()
        )
    }
}

/// Runs the command.
pub(crate) fn run(args: DoctorArgs) -> Result<()> {
    let findings = tokio::runtime::Runtime::new()?.block_on(examine(&args))?;
    match args.json {
        true => say::json(&findings)?,
        false => findings.iter().try_for_each(|finding| say::line(finding.text()))?,
    }
    match findings.iter().filter(|finding| finding.grade == Grade::Error).count() {
        0 => Ok(()),
        errors => bail!("{errors} of {} findings are errors", findings.len()),
    }
}

async fn examine(args: &DoctorArgs) -> Result<Vec<Finding>> {
    let client = Client::new(&args.farm.coordinator, args.farm.credentials.load()?)?;
    let seen = client.look().await?;
    let mut found = vec![
        Finding::ok(
            "coordinator",
            format!(
                "answers at {} within {} ms",
                args.farm.coordinator,
                seen.took.as_millis()
            ),
        ),
        version(&seen.health),
    ];
    found.extend(seen.server_time.map(|server| clock(server, seen.local_time)));
    found.extend(seen.certificate.as_deref().map(|der| certificate(der, seen.local_time)));
    let role = match client.session().await {
        Ok(session) => {
            let who = match session.name.as_str() {
                "" => "the farm asks for none: whoever can connect may do everything".to_owned(),
                name => format!("{name:?} is accepted, with the role `{}`", session.role),
            };
            found.push(Finding::ok("token", who));
            Some(session.role)
        }
        Err(error) => {
            let advice = "give a token with --token-file or PHOTONFARM_TOKEN; an administrator makes one by \
                          `photonfarm token create NAME --role submit`";
            found.push(Finding::bad(Grade::Error, "token", say::causes(&error), advice));
            None
        }
    };
    if role.is_some() {
        found.extend(match client.workers().await {
            Ok(list) => workers(&list),
            Err(error) => vec![Finding::bad(
                Grade::Warn,
                "workers",
                say::causes(&error),
                "the role `read` may look at them",
            )],
        });
    }
    found.extend(stores(&seen));
    // A farm of an older version has no such figures.
    if matches!(role, Some(Role::Read | Role::Submit | Role::Admin))
        && let Ok(figures) = client.figures().await
    {
        found.extend(figures.stores.iter().map(room_of_part));
    }
    if matches!(role, Some(Role::Submit | Role::Admin)) {
        found.push(store_something(&client).await);
    }
    found.extend(waiting(&seen.health.waiting));
    found.extend(args.data.as_ref().map(room));
    Ok(found)
}

fn version(health: &Health) -> Finding {
    let theirs = &health.version;
    match theirs == VERSION {
        true => Finding::ok("version", format!("{theirs}, as this program")),
        false => Finding::bad(
            Grade::Warn,
            "version",
            format!("the coordinator has {theirs}, this program {VERSION}"),
            "use the same version on all machines; the coordinator's is best brought up to date first",
        ),
    }
}

fn clock(server: SystemTime, local: SystemTime) -> Finding {
    let skew = match server.duration_since(local) {
        Ok(ahead) => ahead,
        Err(behind) => behind.duration(),
    };
    let detail = format!("the coordinator's and this machine's differ by {} s", skew.as_secs());
    let advice = "deadlines are told by these clocks: have NTP set them (chrony, systemd-timesyncd)";
    match skew.as_secs() {
        0..=SKEW_WARNED => Finding::ok("clock", detail),
        s if s <= SKEW_WRONG => Finding::bad(Grade::Warn, "clock", detail, advice),
        _ => Finding::bad(Grade::Error, "clock", detail, advice),
    }
}

/// Whoever has connected has found the certificate to be valid now, and issued for this name.
fn certificate(der: &[u8], now: SystemTime) -> Finding {
    let advice = "renew it, then send SIGHUP to the coordinator, which reads it again";
    let Ok(certificate) = Certificate::from_der(der) else {
        return Finding::bad(Grade::Warn, "certificate", "it cannot be read", advice);
    };
    let end = certificate.tbs_certificate.validity.not_after.to_unix_duration();
    let left = end.saturating_sub(now.duration_since(UNIX_EPOCH).unwrap_or_default());
    let days = left.as_secs() / 86_400;
    let detail = format!("it is trusted, and valid for {days} more days");
    match days {
        ..=LAST_DAYS => Finding::bad(Grade::Warn, "certificate", detail, advice),
        _ => Finding::ok("certificate", detail),
    }
}

fn workers(list: &[WorkerStatus]) -> Vec<Finding> {
    if list.is_empty() {
        let advice = "start some: photonfarm-worker --coordinator URL, with a token of the role `worker` where the farm asks \
                      for tokens";
        return vec![Finding::bad(Grade::Warn, "workers", "none is connected", advice)];
    }
    let held = list.iter().filter(|worker| worker.quarantine.is_some()).count();
    let working = list.iter().filter(|worker| worker.leases > 0).count();
    let mut found = vec![Finding::ok(
        "workers",
        format!("{} are connected, {working} at work, {held} in quarantine", list.len()),
    )];
    for worker in list {
        if let Some(reason) = &worker.quarantine {
            let detail = format!("worker {} ({}) is in quarantine: {reason}", worker.id, worker.name);
            let advice = format!("look at its machine, then `photonfarm workers release {}`", worker.id);
            found.push(Finding::bad(Grade::Warn, "quarantine", detail, advice));
        }
    }
    let mut builds: BTreeMap<&str, usize> = BTreeMap::new();
    for worker in list {
        *builds.entry(&worker.renderer).or_default() += 1;
    }
    let told = |(build, count): (&&str, &usize)| format!("{build} ({count})");
    let all = builds.iter().map(told).collect::<Vec<_>>().join(", ");
    found.push(match builds.len() {
        1 if builds.contains_key(RENDERER) => Finding::ok("build", "all workers have that of this program"),
        1 => Finding::bad(
            Grade::Warn,
            "build",
            format!("workers have {all}, this program {RENDERER}"),
            "pictures may differ in their last bits from what `photonfarm render` makes here; use one build on all machines",
        ),
        _ => Finding::bad(
            Grade::Warn,
            "build",
            format!("workers differ: {all}"),
            "a job is bound to one of them, and the others do not help with it: use one build on all machines",
        ),
    });
    found
}

fn stores(seen: &Sighting) -> Vec<Finding> {
    let advice = "see the coordinator's log; a full disk is freed by `photonfarm delete` and `serve --keep-days`";
    let obstacles = &seen.health.obstacles;
    match obstacles.is_empty() {
        true => vec![Finding::ok("stores", "nothing fails")],
        false => obstacles
            .iter()
            .map(|obstacle| Finding::bad(Grade::Error, "stores", obstacle.detail.clone(), advice))
            .collect(),
    }
}

/// Sends a file that no job names, which is removed after a while.
async fn store_something(client: &Client) -> Finding {
    let entry = FileEntry::of(FILE);
    let manifest = BundleManifest {
        files: [("doctor.txt".to_owned(), entry)].into(),
    };
    let stored = async {
        client.announce(&manifest).await?;
        client.upload(entry.hash, &FILE.into(), |_| {}).await
    };
    match stored.await {
        Ok(()) => Finding::ok("storing", "a file was stored"),
        Err(error) => Finding::bad(
            Grade::Error,
            "storing",
            format!("a file cannot be stored: {}", say::causes(&error)),
            "see the coordinator's log, and whether its disk or bucket can be written",
        ),
    }
}

/// Jobs that wait for something that does not come by itself.
fn waiting(jobs: &BTreeMap<Waiting, u64>) -> Vec<Finding> {
    let advice = |reason: Waiting| match reason {
        Waiting::Tags => Some("start workers with these tags (photonfarm-worker --tag), see `photonfarm jobs`"),
        Waiting::Renderer => Some("start workers of the build that they are bound to, or `photonfarm resubmit` them"),
        Waiting::Memory => Some("start workers with more memory, see `photonfarm jobs`"),
        Waiting::Quarantine => Some("see `photonfarm workers`"),
        Waiting::Scene => Some("submit their scenes again, which sends what is missing"),
        Waiting::NoWorker => Some("start workers"),
        _ => None,
    };
    let waits = jobs
        .iter()
        .filter_map(|(reason, count)| Some((reason, count, advice(*reason)?)));
    waits
        .map(|(reason, count, advice)| Finding::bad(Grade::Warn, "jobs", format!("{count} wait: {reason}"), advice))
        .collect()
}

/// Room on the disk of a part of the stores, as the coordinator tells.
fn room_of_part(room: &StoreRoom) -> Finding {
    let StoreRoom {
        part,
        free_bytes,
        total_bytes,
        ..
    } = room;
    match (free_bytes, total_bytes) {
        (Some(free), Some(total)) => graded(
            *free,
            format!(
                "{part}: {:.1} GB of {:.1} GB are free",
                gigabytes(*free),
                gigabytes(*total)
            ),
        ),
        _ => Finding::ok(
            "disk",
            format!("{part}: the room in an object store or a database server is not known"),
        ),
    }
}

/// Whether so much room is enough.
fn graded(free: u64, detail: String) -> Finding {
    let advice = "free some: `photonfarm delete` ended jobs, or have `serve --keep-days` or `--keep-gigabytes` do so";
    match free {
        ..StoreRoom::WRONG => Finding::bad(Grade::Error, "disk", detail, advice),
        StoreRoom::WRONG..StoreRoom::WARNED => Finding::bad(Grade::Warn, "disk", detail, advice),
        _ => Finding::ok("disk", detail),
    }
}

fn gigabytes(bytes: u64) -> f64 {
    bytes as f64 / 1e9
}

/// Room on the disk of a folder.
#[cfg(unix)]
fn room(folder: &PathBuf) -> Finding {
    let name = folder.display();
    match rustix::fs::statvfs(folder) {
        Ok(disk) => {
            let free = disk.f_bavail.saturating_mul(disk.f_frsize);
            graded(free, format!("{:.1} GB are free for {name}", gigabytes(free)))
        }
        Err(error) => Finding::bad(
            Grade::Error,
            "disk",
            format!("{name} cannot be looked at: {error}"),
            "--data names the folder that `serve --data` has",
        ),
    }
}

#[cfg(not(unix))]
fn room(folder: &PathBuf) -> Finding {
    let detail = format!("the room for {} cannot be told on this system", folder.display());
    Finding::ok("disk", detail)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn worker(id: u64, renderer: &str, quarantine: Option<&str>) -> WorkerStatus {
        serde_json::from_value(serde_json::json!({
            "id": id, "name": "w", "threads": 1, "renderer": renderer, "silent_ms": 0, "leases": 0,
            "quarantine": quarantine}))
        .unwrap()
    }

    fn grades(found: &[Finding]) -> Vec<(Grade, &'static str)> {
        found.iter().map(|finding| (finding.grade, finding.what)).collect()
    }

    #[test]
    fn workers_are_held_against_each_other_and_this_program() {
        assert_eq!(grades(&workers(&[])), [(Grade::Warn, "workers")]);
        let same = [worker(1, RENDERER, None), worker(2, RENDERER, None)];
        assert_eq!(grades(&workers(&same)), [(Grade::Ok, "workers"), (Grade::Ok, "build")]);
        let others = [worker(1, RENDERER, None), worker(2, "0.0 x", Some("it lied"))];
        let found = workers(&others);
        assert_eq!(
            grades(&found),
            [
                (Grade::Ok, "workers"),
                (Grade::Warn, "quarantine"),
                (Grade::Warn, "build")
            ]
        );
        assert!(found[1].text().contains("workers release 2"), "{}", found[1].text());
        assert!(found[2].detail.contains("0.0 x (1)"), "{}", found[2].detail);
    }

    #[test]
    fn clocks_may_differ_by_little() {
        let now = UNIX_EPOCH + Duration::from_secs(784_111_777);
        let grade = |seconds| clock(now + Duration::from_secs(seconds), now).grade;
        assert_eq!(
            [0, 5, 30, 600].map(grade),
            [Grade::Ok, Grade::Ok, Grade::Warn, Grade::Error]
        );
        assert_eq!(clock(now, now + Duration::from_secs(600)).grade, Grade::Error);
    }

    #[test]
    fn jobs_that_wait_for_people_are_told() {
        let jobs = [(Waiting::Turn, 3), (Waiting::Tags, 2)].into();
        let found = waiting(&jobs);
        assert_eq!(grades(&found), [(Grade::Warn, "jobs")]);
        assert!(found[0].detail.contains("2 wait: tags"), "{}", found[0].detail);
    }

    #[test]
    fn little_room_is_warned_about() {
        let grade = |room| room_of_part(&StoreRoom::new("images", room)).grade;
        let total = 1 << 40;
        assert_eq!(
            [
                None,
                Some([StoreRoom::WARNED, total]),
                Some([StoreRoom::WARNED - 1, total]),
                Some([1 << 20, total])
            ]
            .map(grade),
            [Grade::Ok, Grade::Ok, Grade::Warn, Grade::Error]
        );
        let found = room_of_part(&StoreRoom::new("state", Some([2_500_000_000, 10_000_000_000])));
        assert!(
            found.text().contains("state: 2.5 GB of 10.0 GB are free"),
            "{}",
            found.text()
        );
    }

    #[test]
    #[cfg(unix)]
    fn the_room_of_a_folder_is_told() {
        assert!(room(&std::env::temp_dir()).detail.contains("GB are free"));
        assert_eq!(room(&"/nowhere/at/all".into()).grade, Grade::Error);
    }
}

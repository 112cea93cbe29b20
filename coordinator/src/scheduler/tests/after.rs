//! Jobs that come after others.

use super::*;
use photonfarm_proto::waiting::Waiting;

/// As the service does it: what follows for other jobs is committed with it.
fn commit_all<T>(farm: &mut Farm, now: Millis, decide: impl Fn(&Farm) -> Decision<T>) -> T {
    commit(farm, now, |farm| {
        let Decision { reply, changes } = decide(farm);
        let changes = farm.with_successors(changes, now);
        Decision { reply, changes }
    })
}

fn submit_after(farm: &mut Farm, first: Option<JobId>) -> JobId {
    let spec = JobSpec {
        after: first,
        ..spec(2)
    };
    commit_all(farm, 0, |farm| farm.submit(spec.clone(), String::new(), None, 0))
}

fn reason(farm: &Farm, job: JobId) -> Option<Waiting> {
    farm.job(job).and_then(|job| farm.status(job, 0).waiting_reason)
}

fn ask(farm: &mut Farm, worker: WorkerId, serial: u64) -> Option<JobId> {
    let asked = Asked {
        worker,
        serial,
        held: vec![],
    };
    commit_all(farm, 0, |farm| farm.lease(&asked, 0).unwrap()).map(|lease| lease.job)
}

#[test]
fn a_job_waits_until_the_one_before_it_is_done_and_a_restart_changes_nothing() {
    let mut farm = Farm::restore(SchedulerConfig::default(), Snapshot::default(), 0);
    let first = submit_after(&mut farm, None);
    let second = submit_after(&mut farm, Some(first));
    let third = submit_after(&mut farm, Some(second));
    let worker = hire(&mut farm, "a", 0);
    assert_eq!(reason(&farm, second), Some(Waiting::After));
    assert_eq!(farm.figures(0).waiting.get(&Waiting::After), Some(&2));
    commit_all(&mut farm, 0, |farm| farm.pause(first, true).unwrap());
    assert_eq!(ask(&mut farm, worker, 1), None, "nothing of the others is lent");

    let mut jobs: Vec<_> = [first, second, third]
        .map(|id| {
            let job = farm.job(id).unwrap();
            let record = record::JobRecord {
                head: job.head().clone(),
                control: job.control().clone(),
                share_ms: 0,
                state: JobState::Queued,
                failure: None,
                ended_ms: None,
                resolution: None,
                totals: Totals::default(),
                nodes: vec![],
                leases: vec![],
                failures: vec![],
            };
            serde_json::from_str(&serde_json::to_string(&record).unwrap()).unwrap()
        })
        .into();
    let snapshot = Snapshot {
        counters: Counters {
            job: 3,
            ..Counters::default()
        },
        workers: vec![],
        jobs: std::mem::take(&mut jobs),
    };
    let mut farm = Farm::restore(SchedulerConfig::default(), snapshot, 0);
    let worker = hire(&mut farm, "b", 0);
    assert_eq!(ask(&mut farm, worker, 1), None);
    let ended = Change::JobEnded {
        job: first,
        state: JobState::Done,
        failure: None,
        ended_ms: 5,
    };
    commit_all(&mut farm, 5, |_| Decision::new((), vec![ended.clone()]));
    assert_eq!(ask(&mut farm, worker, 2), Some(second));
    assert_eq!(reason(&farm, third), Some(Waiting::After));
    // One that is done already is waited for no more.
    let late = submit_after(&mut farm, Some(first));
    assert_ne!(reason(&farm, late), Some(Waiting::After));
    assert_eq!(farm.job(late).unwrap().spec().after, Some(first));
}

#[test]
fn what_comes_after_a_job_that_does_not_succeed_is_cancelled_with_the_reason() {
    let mut farm = Farm::restore(SchedulerConfig::default(), Snapshot::default(), 0);
    let first = submit_after(&mut farm, None);
    let second = submit_after(&mut farm, Some(first));
    let third = submit_after(&mut farm, Some(second));
    let alone = submit_after(&mut farm, None);
    let Decision { changes, .. } = farm.cancel(first, 7).unwrap();
    let changes = farm.with_successors(changes, 7);
    let ends: Vec<_> = changes
        .iter()
        .map(|change| match change {
            Change::JobEnded {
                job, state, failure, ..
            } => (*job, *state, failure.clone().unwrap_or_default()),
            _ => panic!("{change:?}"),
        })
        .collect();
    assert_eq!(
        ends,
        [
            (first, JobState::Cancelled, String::new()),
            (
                second,
                JobState::Cancelled,
                "job 1, which was to be done first, was cancelled".into()
            ),
            (
                third,
                JobState::Cancelled,
                "job 2, which was to be done first, was cancelled".into()
            ),
        ]
    );
    changes.iter().for_each(|change| farm.evolve(change, 7));
    assert_eq!(farm.jobs().map(Job::id).collect::<Vec<_>>(), [alone]);
}

#[test]
fn what_ends_by_itself_at_the_same_time_ends_once() {
    let mut farm = Farm::restore(SchedulerConfig::default(), Snapshot::default(), 0);
    let first = submit_after(&mut farm, None);
    let second = submit_after(&mut farm, Some(first));
    let end = |job| Change::JobEnded {
        job,
        state: JobState::Failed,
        failure: None,
        ended_ms: 1,
    };
    let both = vec![end(first), end(second)];
    assert_eq!(farm.with_successors(both.clone(), 1), both);
}

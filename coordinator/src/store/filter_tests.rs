//! Every store lists the same jobs.

use super::memory::MemoryStore;
use super::tests::{head, stores};
use super::*;
use crate::scheduler::record::JobControl;
use photonfarm_proto::api::ListedState;
use photonfarm_proto::job::JobState;

/// Job `id`, with a name, labels, and how it stands.
fn job(id: u64, name: &str, labels: &[(&str, &str)], state: JobState, paused: bool) -> Vec<Change> {
    let mut head = head(id, None);
    head.spec.name = name.into();
    head.spec.labels = labels
        .iter()
        .map(|(name, value)| ((*name).into(), (*value).into()))
        .collect();
    head.owner = if id.is_multiple_of(2) { "bea" } else { "ann" }.into();
    let (job, mut control) = (head.id, JobControl::of(&head.spec));
    let mut changes = vec![Change::JobSubmitted(head.into())];
    if paused {
        control.schedule.paused = true;
        changes.push(Change::JobChanged { job, control });
    }
    if state.ended() {
        changes.push(Change::JobEnded {
            job,
            state,
            failure: None,
            ended_ms: 1_800_000_000_000,
        });
    }
    changes
}

fn filters() -> Vec<JobFilter> {
    let all = JobFilter::default();
    let label = |name: &str, value: Option<&str>| (name.to_owned(), value.map(str::to_owned));
    let labelled = |labels: &[(String, Option<String>)]| JobFilter {
        labels: labels.to_vec(),
        ..JobFilter::default()
    };
    let named = |name: &str| JobFilter {
        name: Some(name.into()),
        ..JobFilter::default()
    };
    let mut filters: Vec<JobFilter> = ListedState::ALL
        .iter()
        .map(|(_, state)| JobFilter {
            states: [*state].into(),
            ..all.clone()
        })
        .collect();
    filters.extend([
        all.clone(),
        JobFilter {
            states: [ListedState::Done, ListedState::Paused].into(),
            owner: Some("ann".into()),
            ..all.clone()
        },
        labelled(&[label("shot", Some("7"))]),
        labelled(&[label("shot", None), label("draft", Some(""))]),
        labelled(&[label("sho", None)]),
        labelled(&[label("shot' OR 1=1 --", Some("%"))]),
        named("shot"),
        named("Shot"),
        named("100%"),
        named("_"),
        named("scene.xml"),
        named("' \u{1f600}"),
        JobFilter {
            created_after: Some(1_700_000_000_002),
            created_before: Some(1_700_000_000_006),
            ..all
        },
    ]);
    filters
}

#[tokio::test]
async fn every_store_lists_the_same_jobs_in_both_orders() {
    let (folder, model) = (tempfile::tempdir().unwrap(), MemoryStore::default());
    let jobs = [
        job(1, "shot 7", &[("shot", "7"), ("draft", "")], JobState::Queued, false),
        job(2, "shot 8", &[("shot", "8")], JobState::Done, false),
        job(3, "", &[], JobState::Queued, true),
        job(
            4,
            "100% \"paused\":true",
            &[("paused", "true")],
            JobState::Queued,
            false,
        ),
        job(5, "it' \u{1f600}_", &[("shot", "7")], JobState::Failed, true),
        job(6, "Shot", &[("draft", ""), ("shot", "")], JobState::Cancelled, false),
        job(7, "shot", &[], JobState::Done, false),
    ];
    let changes = jobs.concat();
    model.commit(0, changes.clone()).await.unwrap();
    let numbers = |jobs: Vec<JobRecord>| jobs.iter().map(|job| job.head.id.0).collect::<Vec<_>>();
    for store in stores(folder.path()).await {
        let (sequence, _) = store.load().await.unwrap();
        store.commit(sequence, changes.clone()).await.unwrap();
        let mut found = 0;
        for filter in filters() {
            for oldest_first in [false, true] {
                for (behind, limit) in [(None, 9), (None, 2), (Some(JobId(4)), 9), (Some(JobId(u64::MAX)), 9)] {
                    let filter = JobFilter {
                        oldest_first,
                        behind,
                        ..filter.clone()
                    };
                    let expected = numbers(model.jobs(filter.clone(), limit).await.unwrap());
                    found += expected.len();
                    assert_eq!(
                        numbers(store.jobs(filter.clone(), limit).await.unwrap()),
                        expected,
                        "{filter:?}"
                    );
                }
            }
        }
        assert!(found > 100, "{found}");
        let shots = JobFilter {
            name: Some("shot".into()),
            ..JobFilter::default()
        };
        assert_eq!(numbers(store.jobs(shots, 9).await.unwrap()), [7, 2, 1]);
    }
}

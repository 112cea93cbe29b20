//! Spans of a job on their way to a collector.

use crate::support::{Farm, SUBMITTER};
use photonfarm_proto::hex::Hex;
use photonfarm_proto::job::JobState;
use photonfarm_proto::trace::Context;
use photonfarm_test_servers::Collector;
use photonfarm_worker::Exporter;
use serde_json::Value;
use std::collections::BTreeSet;
use std::time::Duration;

fn exporters(url: &str) -> [Exporter; 2] {
    ["photonfarm-coordinator", "photonfarm-worker"].map(|service| Exporter::start(url, service, "test").unwrap())
}

/// A fact of a span.
fn fact<'a>(span: &'a Value, name: &str) -> &'a str {
    let attributes = span["attributes"].as_array().unwrap();
    let found = attributes.iter().find(|attribute| attribute["key"] == name);
    let value = &found.unwrap_or_else(|| panic!("{span} has no {name}"))["value"];
    let value = value.get("stringValue").or_else(|| value.get("intValue"));
    value.unwrap().as_str().unwrap()
}

fn named<'a>(spans: &'a [Value], name: &str) -> Vec<&'a Value> {
    spans.iter().filter(|span| span["name"] == name).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_is_one_trace_across_a_restart_of_the_coordinator() {
    let collector = Collector::start().await;
    let [coordinators, workers] = exporters(&collector.url());
    let mut farm = Farm::start_traced([coordinators.tracer(), workers.tracer()]).await;
    farm.stage.hold(6);
    let worker = farm.worker("a");
    let job = farm.submit(b"good", 13).await;
    farm.stage.until_begun(6, 1).await;
    farm.stop().await;
    farm.stage.release(6);
    farm.stage.until_begun(8, 1).await;
    farm.resume().await;
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    worker.drain().await;
    farm.stop().await;
    coordinators.finish().await;
    workers.finish().await;

    let spans = collector.spans();
    let root = Context::of_job(&farm.digits, job);
    let [trace, root] = [&root.trace[..], &root.span].map(|bytes| Hex(bytes).to_string());
    let ids: BTreeSet<&str> = spans.iter().map(|span| span["spanId"].as_str().unwrap()).collect();
    assert_eq!(ids.len(), spans.len(), "every span has a number of its own");
    for span in &spans {
        assert_eq!(span["traceId"], trace, "{span}");
        let nanoseconds = |name| span[name].as_str().unwrap().parse::<u64>().unwrap();
        assert!(
            nanoseconds("startTimeUnixNano") <= nanoseconds("endTimeUnixNano"),
            "{span}"
        );
        let at_worker = ["download", "load", "iteration", "upload"].contains(&span["name"].as_str().unwrap());
        let service = if at_worker {
            "photonfarm-worker"
        } else {
            "photonfarm-coordinator"
        };
        assert_eq!(span["service"], service, "{span}");
        if span["name"] != "submit" {
            assert!(ids.contains(span["parentSpanId"].as_str().unwrap()), "{span}");
        }
        assert!(span.get("status").is_none(), "{span}");
    }

    let submissions = named(&spans, "submit");
    let [submission] = submissions.as_slice() else {
        panic!("{submissions:?}")
    };
    assert_eq!(submission["spanId"], root);
    assert_eq!(submission.get("parentSpanId"), None);
    let link = &submission["links"][0];
    let (of, by) = (link["traceId"].as_str().unwrap(), link["spanId"].as_str().unwrap());
    assert_eq!(format!("00-{of}-{by}-01"), SUBMITTER);

    let leases = named(&spans, "lease");
    let mut lent = 0;
    for lease in &leases {
        assert_eq!(lease["parentSpanId"], root);
        assert_eq!(
            ["worker.name", "attempt", "outcome"].map(|name| fact(lease, name)),
            ["a", "1", "delivered"]
        );
        lent += fact(lease, "iterations").parse::<u32>().unwrap();
    }
    assert_eq!(lent, 13, "the lease of both coordinators is one");
    let within_a_lease = |span: &&Value| leases.iter().any(|lease| lease["spanId"] == span["parentSpanId"]);
    for (name, count) in [
        ("download", 1),
        ("load", 1),
        ("iteration", 13),
        ("upload", leases.len()),
    ] {
        let found = named(&spans, name);
        assert_eq!(found.len(), count, "{found:?}");
        assert!(found.iter().all(within_a_lease), "{found:?}");
    }
    let iterations = named(&spans, "iteration").into_iter();
    let iterations: BTreeSet<u32> = iterations
        .map(|span| fact(span, "iteration").parse().unwrap())
        .collect();
    assert_eq!(iterations, (1..=13).collect());

    let (uploads, commits) = (named(&spans, "upload"), named(&spans, "commit"));
    assert_eq!(commits.len(), uploads.len());
    for upload in uploads {
        let commit = commits.iter().find(|commit| commit["parentSpanId"] == upload["spanId"]);
        assert_eq!(fact(commit.unwrap(), "node"), fact(upload, "node"));
    }
    let merges = named(&spans, "merge");
    assert!(!merges.is_empty() && merges.iter().all(|merge| merge["parentSpanId"] == root));
    let ends = named(&spans, "job");
    assert_eq!(
        ends.iter()
            .map(|end| (fact(end, "state"), fact(end, "iterations")))
            .collect::<Vec<_>>(),
        [("done", "13")]
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn spans_arrive_while_the_farm_goes_on() {
    let collector = Collector::start().await;
    let [coordinators, workers] = exporters(&collector.url());
    let farm = Farm::start_traced([coordinators.tracer(), workers.tracer()]).await;
    let worker = farm.worker("a");
    farm.submit(b"broken for ever", 3).await;
    let failed = |spans: &[Value]| {
        spans
            .iter()
            .any(|span| span["name"] == "load" && span["status"]["code"] == 2)
    };
    let spans = collector.until(failed).await;
    let load = named(&spans, "load")[0];
    assert_eq!(load["status"]["message"], "scene.xml:1: for ever");
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_collector_that_never_answers_disturbs_nobody() {
    // It takes connections, and nothing of what comes in them.
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let [coordinators, workers] = exporters(&format!("http://{}", silent.local_addr().unwrap()));
    let farm = Farm::start_traced([coordinators.tracer(), workers.tracer()]).await;
    let worker = farm.worker("a");
    let job = farm.submit(b"good", 13).await;
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    farm.check_image(job, 1..=13).await;
    worker.drain().await;
    let finish = async { tokio::join!(coordinators.finish(), workers.finish()) };
    let finished = tokio::time::timeout(Duration::from_secs(8), finish).await;
    assert!(finished.is_ok(), "the end is not put off for long");
}

//! What travels between clients, coordinators and workers.

use photonfarm_proto::api::{BundleReply, Extend, Health, JobPage, Quarantine, SetPriority, WorkerList};
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::check::{CheckResult, CheckSpec, CheckStatus};
use photonfarm_proto::codec::{self, Message};
use photonfarm_proto::job::{JobSpec, JobStatus};
use photonfarm_proto::limits::Limits;
use photonfarm_proto::node::{decode_node, encode_node};
use photonfarm_proto::problem::Problem;
use photonfarm_proto::rest::Rest;
use photonfarm_proto::token::{NewToken, TokenList, TokenRequest};
use photonfarm_proto::worker::{
    Acknowledged, FailureReport, Heartbeat, HeartbeatReply, LeaseReply, LeaseRequest, Leave, NodePlace, NodeReply,
    NodeUpload, Register, Registered, Release, SceneReport, StatisticsRequest, read_statistics, statistics_body,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A message that is read survives being written and read again.
fn survives<M: Message>(bytes: &[u8]) {
    let Ok(message) = codec::decode::<M>(bytes) else { return };
    let once = codec::encode(&message).expect("what was read can be written");
    let again: M = codec::decode(&once).expect("what was written can be read");
    assert_eq!(codec::encode(&again).expect("it can be written again"), once);
}

/// A framed message of the worker protocol, read as each kind.
pub(super) fn message(bytes: &[u8]) {
    survives::<Register>(bytes);
    survives::<Registered>(bytes);
    survives::<LeaseRequest>(bytes);
    survives::<LeaseReply>(bytes);
    survives::<Heartbeat>(bytes);
    survives::<HeartbeatReply>(bytes);
    survives::<NodeUpload>(bytes);
    survives::<NodeReply>(bytes);
    survives::<FailureReport>(bytes);
    survives::<Release>(bytes);
    survives::<Acknowledged>(bytes);
    survives::<Leave>(bytes);
    survives::<NodePlace>(bytes);
    survives::<StatisticsRequest>(bytes);
    survives::<SceneReport>(bytes);
    survives::<Rest>(bytes);
    survives::<CheckResult>(bytes);
    let values = bytes.len().saturating_sub(32) / 4;
    if let Some(statistics) = read_statistics(bytes, values) {
        assert_eq!(statistics_body(&statistics), bytes);
    }
}

/// The image of a node: what is read has the bits that were there.
pub(super) fn node(bytes: &[u8]) {
    let limits = Limits {
        pixels: 1 << 16,
        ..Limits::default()
    };
    let Ok((job, node)) = decode_node(bytes, &limits) else {
        return;
    };
    let written = encode_node(job, &node);
    assert_eq!(written[8..], bytes[8..]);
    let (again, _) = decode_node(&written, &limits).expect("what was written can be read");
    assert_eq!(again, job);
}

/// JSON that is read survives being written and read again.
fn json<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let value: T = serde_json::from_slice(bytes).ok()?;
    let once = serde_json::to_string(&value).expect("what was read can be written");
    let again: T = serde_json::from_str(&once).unwrap_or_else(|error| panic!("{error} in {once}"));
    assert_eq!(serde_json::to_string(&again).expect("it can be written again"), once);
    Some(value)
}

/// The JSON bodies of requests: jobs, manifests, tokens.
pub(super) fn request(bytes: &[u8]) {
    let limits = Limits::default();
    let manifest = json::<BundleManifest>(bytes).unwrap_or_default();
    if limits.check_bundle(&manifest).is_ok() {
        let names = manifest.files.keys();
        assert!(
            names
                .clone()
                .all(|name| !name.starts_with('/') && !name.split('/').any(|part| part == ".."))
        );
        assert!(!manifest.blobs().is_empty());
    }
    if let Some(spec) = json::<JobSpec>(bytes) {
        let _ = spec.check(&limits, &manifest);
        let _ = spec.integrator.with_defaults().validate();
    }
    if let Some(check) = json::<CheckSpec>(bytes) {
        let _ = check.job().check(&limits, &manifest);
    }
    json::<Extend>(bytes);
    json::<Quarantine>(bytes);
    json::<SetPriority>(bytes);
    if let Some(token) = json::<TokenRequest>(bytes) {
        let _ = token.check();
    }
}

/// The JSON bodies that clients and workers read.
pub(super) fn reply(bytes: &[u8]) {
    json::<BundleReply>(bytes);
    json::<Health>(bytes);
    json::<JobPage>(bytes);
    json::<JobStatus>(bytes);
    json::<WorkerList>(bytes);
    json::<CheckStatus>(bytes);
    json::<Problem>(bytes);
    json::<NewToken>(bytes);
    json::<TokenList>(bytes);
}

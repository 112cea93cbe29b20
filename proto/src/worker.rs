//! The worker protocol: HTTP requests with framed bodies ([`crate::codec`]).
//!
//! | request | body | reply |
//! | --- | --- | --- |
//! | `POST /v1/worker/register` | [`Register`] | [`Registered`] |
//! | `POST /v1/worker/lease` | [`LeaseRequest`] | [`LeaseReply`] |
//! | `POST /v1/worker/rest` | [`Rest`] | [`Acknowledged`] |
//! | `POST /v1/worker/heartbeat` | [`Heartbeat`] | [`HeartbeatReply`] |
//! | `POST /v1/worker/nodes` | [`NodeUpload`] (see [`frame_upload`]), then the planes | [`NodeReply`] |
//! | `POST /v1/worker/nodes/place` | [`NodeUpload`] | [`NodePlace`] |
//! | `POST /v1/worker/nodes/stored` | [`NodeUpload`] | [`NodeReply`] |
//! | `POST /v1/worker/statistics` | [`StatisticsRequest`] | [`statistics_body`] |
//! | `POST /v1/worker/scene` | [`SceneReport`] | [`Acknowledged`] |
//! | `POST /v1/worker/check` | [`CheckResult`] | [`Acknowledged`] |
//! | `POST /v1/worker/failures` | [`FailureReport`] | [`Acknowledged`] |
//! | `POST /v1/worker/release` | [`Release`] | [`Acknowledged`] |
//! | `POST /v1/worker/leave` | [`Leave`] | [`Acknowledged`] |
//! | `GET /v1/bundles/{hash}` | | the manifest, JSON |
//! | `GET /v1/blobs/{hash}` | | the bytes, or a redirection to them |
//!
//! Errors are problem documents, as everywhere.

use crate::check::{CheckAssignment, CheckResult, Checking};
use crate::codec::{self, CodecError, Message};
use crate::id::{BlobHash, JobId, LeaseToken, WorkerId};
use crate::job::{FailureKind, JobSpec, Totals};
use crate::memory::Shortage;
use crate::node::{NodeHeader, NodeKey};
use crate::planes;
use crate::rest::Rest;
use crate::trace::Context;
use photonfarm_core::picture::SceneFacts;
use photonfarm_core::settings::IntegratorSettings;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Most bytes of a text that a worker sends; longer ones are cut.
pub const TEXT_BYTES: usize = 4096;

/// Most warnings about a scene that a worker sends; the scene itself tells fewer.
pub const MOST_WARNINGS: usize = 64;

/// Most leases that a worker names in a message. It holds fewer: some of them may have ended without its knowledge.
pub const MOST_LEASES: usize = 64;

/// A worker introduces itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Register {
    /// A name for people, such as the host's.
    pub name: String,
    /// Threads it renders with.
    pub threads: u32,
    /// Name of its renderer ([`crate::RENDERER`]): a job takes results of one renderer only.
    pub renderer: String,
    /// What it has: jobs may ask for it.
    pub tags: BTreeSet<String>,
    /// Memory that jobs may take of it, if it is known \[MiB\].
    pub memory_mb: Option<u32>,
}

/// The worker's name, and the rhythm expected of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Registered {
    /// Its number in all further messages.
    pub worker: WorkerId,
    /// Time between heartbeats \[ms\].
    pub heartbeat_ms: u64,
    /// Whether workers ask for a place in the object store and put nodes there themselves.
    pub stores: bool,
}

/// Asks for work.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseRequest {
    /// Who asks.
    pub worker: WorkerId,
    /// Counts the worker's requests for work. A request that is older than another one gets nothing, and says nothing about
    /// what was granted to a later one: it may have waited in a connection that died.
    pub serial: u64,
    /// The leases it holds, at most [`MOST_LEASES`]. Others that were granted to earlier requests of this worker, in replies
    /// that were lost, go back to the pool.
    pub held: Vec<LeaseToken>,
    /// How long to wait for work \[ms\]; the coordinator may answer sooner.
    pub wait_ms: u64,
}

/// A block of iterations, lent to one worker for a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lease {
    /// Fencing token.
    pub token: LeaseToken,
    /// The job.
    pub job: JobId,
    /// The node to deliver; any nodes within it that cover it will do.
    pub node: NodeKey,
    /// The worker.
    pub worker: WorkerId,
    /// Counts the leases of these leaves, from 1.
    pub attempt: u32,
    /// Time until it ends unless a heartbeat renews it \[ms\].
    pub expires_in_ms: u64,
    /// Time until the job's deadline, if it has one: nothing that arrives later counts \[ms\].
    pub ends_in_ms: Option<u64>,
    /// The span of the lease in the trace of the job: what its worker does is a part of it.
    #[serde(default)]
    pub trace: Context,
}

/// Work, if there is any.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeaseReply {
    /// The work.
    pub assignment: Option<Assignment>,
    /// A scene to be checked before that, or beside it.
    pub check: Option<CheckAssignment>,
}

/// Work: a lease and what to render.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Assignment {
    /// The lease.
    pub lease: Lease,
    /// The job's specification; JSON within bincode, which cannot carry tagged enums.
    #[serde(with = "json_text")]
    pub spec: JobSpec,
}

/// Sign of life within a lease.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Heartbeat {
    /// Who.
    pub worker: WorkerId,
    /// The leases it holds, at most [`MOST_LEASES`].
    pub leases: Vec<LeaseProgress>,
    /// What it does about checks.
    pub checking: Checking,
}

/// How far a lease has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseProgress {
    /// The lease.
    pub token: LeaseToken,
    /// Leaves rendered.
    pub leaves_done: u32,
}

/// Which leases are gone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeartbeatReply {
    /// Leases among those named that have expired or were revoked: their work is void.
    pub lost: Vec<LeaseToken>,
    /// A scene to be checked beside what it is at work on, since no other worker has the time.
    pub check: Option<CheckAssignment>,
}

/// Announces the image of a node; the planes follow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodeUpload {
    /// The lease under which it was rendered.
    pub token: LeaseToken,
    /// Who rendered it.
    pub worker: WorkerId,
    /// The job.
    pub job: JobId,
    /// The node: that of the lease, or one within it.
    pub node: NodeKey,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Hash of the node's image as stored: [`NodeHeader`] and planes.
    pub digest: BlobHash,
    /// What it took.
    pub totals: Totals,
    /// Most memory that the worker's process held while it worked on the lease, if that can be told \[MiB\].
    pub memory_mb: Option<u32>,
}

impl NodeUpload {
    /// The header of the image, with so many statistics of each pixel.
    #[must_use]
    pub fn header(&self, statistics: u16) -> NodeHeader {
        NodeHeader {
            job: self.job,
            key: self.node,
            width: self.width,
            height: self.height,
            statistics,
        }
    }
}

/// Where to put the image of a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum NodePlace {
    /// Nowhere: the node counts already.
    Known,
    /// Here: `POST /v1/worker/nodes`.
    Here,
    /// To the object store, by an HTTP PUT to this URL soon; then say so by `POST /v1/worker/nodes/stored`.
    Url(String),
}

/// The node counts: it is safe to forget it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeReply {
    /// Whether it had been counted before.
    pub duplicate: bool,
}

/// Asks for what a sequential integrator goes on from at the first leaf of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StatisticsRequest {
    /// The lease.
    pub token: LeaseToken,
    /// Who.
    pub worker: WorkerId,
    /// The job.
    pub job: JobId,
}

/// The reply to a [`StatisticsRequest`]: the hash of what follows, then the statistics of each pixel as little-endian
/// `f32`.
#[must_use]
pub fn statistics_body(statistics: &[f32]) -> Vec<u8> {
    let values: Vec<u8> = statistics.iter().flat_map(|value| value.to_le_bytes()).collect();
    [&BlobHash::of(&values).0[..], &values].concat()
}

/// Size of a reply to a [`StatisticsRequest`] with so many values.
#[must_use]
pub fn statistics_body_bytes(values: usize) -> usize {
    size_of::<BlobHash>() + 4 * values
}

/// The statistics of a reply; `None` if it is damaged, or has another number of values.
#[must_use]
pub fn read_statistics(body: &[u8], values: usize) -> Option<Vec<f32>> {
    if body.len() != statistics_body_bytes(values) {
        return None;
    }
    let (hash, bytes) = body.split_at(size_of::<BlobHash>());
    (BlobHash::of(bytes).0 == hash).then(|| planes::values(bytes))
}

/// What loading the scene of a job has shown: how it decides over settings that the job leaves to it, what it was warned about, and what
/// the picture's file says of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneReport {
    /// The lease.
    pub token: LeaseToken,
    /// Who.
    pub worker: WorkerId,
    /// The job.
    pub job: JobId,
    /// The integrator with all its settings; JSON within bincode, which cannot carry tagged enums.
    #[serde(with = "json_text")]
    pub integrator: IntegratorSettings,
    /// What is not rendered as it is written, each with its place: at most [`MOST_WARNINGS`], of at most [`TEXT_BYTES`] bytes each.
    pub warnings: Vec<String>,
    /// What the picture's file says of the scene, as JSON too.
    #[serde(with = "json_text")]
    pub facts: SceneFacts,
}

/// An iteration that could not be rendered. The lease ends.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FailureReport {
    /// The lease.
    pub token: LeaseToken,
    /// Who.
    pub worker: WorkerId,
    /// The job.
    pub job: JobId,
    /// The leaf at fault.
    pub leaf: u32,
    /// What happened; never [`FailureKind::Lost`], which the coordinator itself finds.
    pub kind: FailureKind,
    /// In words, at most [`TEXT_BYTES`] bytes.
    pub message: String,
    /// Of [`FailureKind::OutOfMemory`]: what the worker's process had.
    pub shortage: Option<Shortage>,
}

/// Gives a lease back, without blame. What was delivered counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Release {
    /// The lease.
    pub token: LeaseToken,
    /// Who.
    pub worker: WorkerId,
    /// The job.
    pub job: JobId,
}

/// The worker ends: whatever it holds goes back, without blame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leave {
    /// Who.
    pub worker: WorkerId,
}

/// Understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledged;

macro_rules! kinds {
    ($($message:ty = $kind:literal),* $(,)?) => {
        $(impl Message for $message {
            const KIND: u16 = $kind;
        })*
    };
}

kinds! {
    Register = 1,
    Registered = 2,
    LeaseRequest = 3,
    LeaseReply = 4,
    Heartbeat = 5,
    HeartbeatReply = 6,
    NodeUpload = 7,
    NodeReply = 8,
    FailureReport = 9,
    Release = 10,
    Acknowledged = 11,
    Leave = 12,
    NodePlace = 13,
    StatisticsRequest = 14,
    SceneReport = 15,
    CheckResult = 16,
    Rest = 20,
}

/// Most bytes of a framed [`NodeUpload`].
pub const UPLOAD_FRAME_BYTES: usize = 4096;

/// What precedes the planes in the body of an upload: the length of the frame (`u32`, little-endian), then the frame.
pub fn frame_upload(upload: &NodeUpload) -> Result<Vec<u8>, CodecError> {
    let frame = codec::encode(upload)?;
    let mut bytes = (frame.len() as u32).to_le_bytes().to_vec();
    bytes.extend_from_slice(&frame);
    Ok(bytes)
}

/// Cuts a text to at most [`TEXT_BYTES`] bytes, at a character.
#[must_use]
pub fn cut_text(mut text: String) -> String {
    cut_to(&mut text, TEXT_BYTES);
    text
}

/// Cuts a text to at most so many bytes, at a character.
pub(crate) fn cut_to(text: &mut String, most: usize) {
    if text.len() > most {
        let end = (0..=most).rev().find(|&i| text.is_char_boundary(i)).unwrap_or(0);
        text.truncate(end);
    }
}

pub(crate) mod json_text {
    use serde::de::{DeserializeOwned, Error as _};
    use serde::ser::Error as _;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(crate) fn serialize<T: Serialize, S: Serializer>(value: &T, serializer: S) -> Result<S::Ok, S::Error> {
        serde_json::to_string(value)
            .map_err(S::Error::custom)?
            .serialize(serializer)
    }

    pub(crate) fn deserialize<'de, T: DeserializeOwned, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
        serde_json::from_str(&String::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_core::settings::PcfSettings;

    fn assignment() -> LeaseReply {
        let lease = Lease {
            token: LeaseToken { number: 9, nonce: 5 },
            job: JobId(3),
            node: NodeKey { level: 2, index: 1 },
            worker: WorkerId(4),
            attempt: 1,
            expires_in_ms: 30_000,
            ends_in_ms: Some(5_000),
            trace: Context::of_job("farm", JobId(3)),
        };
        let spec = JobSpec {
            scene: BlobHash::of(b"scene"),
            main: "scene.xml".into(),
            defines: [("depth".to_owned(), "8".to_owned())].into(),
            sensor: Some("left".into()),
            integrator: IntegratorSettings::Pcf(PcfSettings::default()).into(),
            iterations: 64,
            seed: u64::MAX,
            schedule: Default::default(),
            layers: Vec::new(),
            crop: None,
            name: String::new(),
            labels: Default::default(),
            after: None,
            webhook: None,
        };
        LeaseReply {
            assignment: Some(Assignment { lease, spec }),
            check: None,
        }
    }

    #[test]
    fn an_assignment_survives_with_its_settings() {
        let bytes = codec::encode(&assignment()).unwrap();
        assert_eq!(codec::decode::<LeaseReply>(&bytes).unwrap(), assignment());
    }

    #[test]
    fn damaged_assignments_are_errors_or_other_assignments() {
        let bytes = codec::encode(&assignment()).unwrap();
        for length in 0..bytes.len() {
            assert!(codec::decode::<LeaseReply>(&bytes[..length]).is_err(), "{length}");
        }
        for bit in 0..bytes.len() * 8 {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            if let Ok(reply) = codec::decode::<LeaseReply>(&damaged) {
                assert_ne!(reply, assignment());
            }
        }
    }

    #[test]
    fn statistics_survive_their_bytes_and_damage_is_seen() {
        let statistics = [0.25, 3.5, f32::MIN_POSITIVE];
        let mut body = statistics_body(&statistics);
        assert_eq!(body.len(), statistics_body_bytes(3));
        assert_eq!(read_statistics(&body, 3).unwrap(), statistics);
        assert!(read_statistics(&body, 2).is_none() && read_statistics(&body[..40], 3).is_none());
        for bit in 0..body.len() * 8 {
            body[bit / 8] ^= 1 << (bit % 8);
            assert!(read_statistics(&body, 3).is_none(), "bit {bit}");
            body[bit / 8] ^= 1 << (bit % 8);
        }
    }

    #[test]
    fn an_upload_is_announced_within_its_bound() {
        let upload = NodeUpload {
            token: LeaseToken { number: 1, nonce: 5 },
            worker: WorkerId(2),
            job: JobId(3),
            node: NodeKey::leaf(4),
            width: 5,
            height: 6,
            digest: BlobHash::of(b""),
            totals: Totals {
                bandwidth: Some(crate::job::BandwidthRange::one(0.5, Some(0.1))),
                ..Totals::default()
            },
            memory_mb: Some(crate::memory::MOST_MEMORY_MB),
        };
        let bytes = frame_upload(&upload).unwrap();
        let length = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) as usize;
        assert_eq!(length, bytes.len() - 4);
        assert!(length <= UPLOAD_FRAME_BYTES);
        assert_eq!(codec::decode::<NodeUpload>(&bytes[4..]).unwrap(), upload);
    }

    #[test]
    fn long_texts_are_cut_at_a_character() {
        assert_eq!(cut_text("short".into()), "short");
        let long = "é".repeat(TEXT_BYTES);
        assert!(cut_text(format!("x{long}")).len() <= TEXT_BYTES);
    }
}

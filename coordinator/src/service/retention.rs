//! Jobs that have ended are deleted once they are old, or take too much room.

use super::{Service, ServiceError};
use crate::scheduler::Refusal;
use crate::scheduler::record::Millis;
use crate::store::EndedJob;
use photonfarm_proto::id::{BlobHash, JobId};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

const DAY_MS: f64 = 86_400_000.0;
const GIGABYTE: f64 = 1e9;

/// How long jobs that have ended are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Keep {
    /// Longest time since a job ended \[ms\]; none: for ever.
    pub longest_ms: Option<Millis>,
    /// Most bytes of all jobs that have ended, with the scenes that only they name; none: no limit.
    pub most_bytes: Option<u64>,
}

/// Files of scenes with their sizes, by the hash of the bundle.
type Scenes = BTreeMap<BlobHash, BTreeSet<(BlobHash, u64)>>;

impl Service {
    /// Deletes jobs that are not to be kept any longer.
    pub(super) async fn retain(self: &Arc<Self>, keep: Keep) -> Result<(), ServiceError> {
        if keep == Keep::default() {
            return Ok(());
        }
        let mut ended = self.stores.state.ended_jobs().await?;
        ended.sort_unstable_by_key(|job| (job.ended_ms, job.id));
        let now = self.clock.now();
        let (mut superfluous, rest) = too_old(&keep, &ended, now);
        if let Some(most) = keep.most_bytes {
            let scenes = self.scenes_of(rest.iter().map(|job| job.scene)).await?;
            let going_on: Vec<BlobHash> = self
                .fresh_farm()
                .await?
                .farm
                .jobs()
                .map(|job| job.head().spec.scene)
                .collect();
            let needed = self.scenes_of(going_on).await?;
            let needed = needed.into_values().flatten().map(|(blob, _)| blob).collect();
            superfluous.extend(too_much(most, rest, &scenes, &needed));
        }
        for (job, reason) in superfluous {
            match self.delete_job(job).await {
                Ok(()) => tracing::info!(%job, "it was deleted since {reason}"),
                // Somebody extended or deleted it meanwhile.
                Err(ServiceError::Refusal(Refusal::UnknownJob(_) | Refusal::JobGoesOn(_))) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    async fn scenes_of(&self, bundles: impl IntoIterator<Item = BlobHash>) -> Result<Scenes, ServiceError> {
        let mut scenes = Scenes::new();
        for bundle in bundles.into_iter().collect::<BTreeSet<_>>() {
            if let Some(manifest) = self.stores.state.bundle(bundle).await? {
                scenes.insert(bundle, manifest.blobs());
            }
        }
        Ok(scenes)
    }
}

/// The jobs that ended too long ago, with that as a reason, and the others; `ended` are ordered by their end.
fn too_old<'a>(keep: &Keep, ended: &'a [EndedJob], now: Millis) -> (Vec<(JobId, String)>, &'a [EndedJob]) {
    let longest = keep.longest_ms.unwrap_or(Millis::MAX);
    let (old, rest) = ended.split_at(ended.partition_point(|job| now.saturating_sub(job.ended_ms) > longest));
    let days = longest as f64 / DAY_MS;
    let reason = || format!("it ended more than {days} days ago");
    (old.iter().map(|job| (job.id, reason())).collect(), rest)
}

/// The oldest of the jobs, ordered by their end, that have to go so that the others have at most so many bytes. Files of
/// scenes count once, and not at all if jobs that go on need them.
fn too_much(most: u64, ended: &[EndedJob], scenes: &Scenes, needed: &BTreeSet<BlobHash>) -> Vec<(JobId, String)> {
    let files = |job: &EndedJob| {
        let files = scenes.get(&job.scene).into_iter().flatten();
        files.filter(|(blob, _)| !needed.contains(blob))
    };
    let mut users: BTreeMap<(BlobHash, u64), usize> = BTreeMap::new();
    let mut bytes = 0;
    for job in ended {
        bytes += job.bytes;
        for file in files(job) {
            let count = users.entry(*file).or_default();
            *count += 1;
            bytes += if *count == 1 { file.1 } else { 0 };
        }
    }
    let mut superfluous = Vec::new();
    for job in ended {
        if bytes <= most {
            break;
        }
        let [used, allowed] = [bytes, most].map(|bytes| bytes as f64 / GIGABYTE);
        let reason = format!("jobs that have ended took {used:.3} GB, more than {allowed:.3} GB");
        superfluous.push((job.id, reason));
        bytes -= job.bytes;
        for file in files(job) {
            let count = users.entry(*file).or_default();
            *count -= 1;
            bytes -= if *count == 0 { file.1 } else { 0 };
        }
    }
    superfluous
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ended(id: u64, ended_ms: Millis, scene: &[u8], bytes: u64) -> EndedJob {
        EndedJob {
            id: JobId(id),
            ended_ms,
            scene: BlobHash::of(scene),
            bytes,
        }
    }

    fn numbers(jobs: &[(JobId, String)]) -> Vec<u64> {
        jobs.iter().map(|(job, _)| job.0).collect()
    }

    #[test]
    fn jobs_are_kept_for_so_long_after_their_end() {
        let jobs = [ended(2, 100, b"", 0), ended(1, 200, b"", 0), ended(3, 300, b"", 0)];
        let keep = |longest_ms| Keep {
            longest_ms,
            most_bytes: None,
        };
        let (old, rest) = too_old(&keep(Some(100)), &jobs, 300);
        assert_eq!(
            (numbers(&old), rest.len()),
            (vec![2], 2),
            "just so long is not too long"
        );
        assert_eq!(numbers(&too_old(&keep(Some(0)), &jobs, 300).0), [2, 1]);
        assert_eq!(numbers(&too_old(&keep(None), &jobs, Millis::MAX).0), [0; 0]);
        assert_eq!(
            numbers(&too_old(&keep(Some(5)), &jobs, 0).0),
            [0; 0],
            "a clock that was set back"
        );
    }

    #[test]
    fn the_oldest_go_until_the_others_fit() {
        let jobs = [ended(1, 1, b"a", 10), ended(2, 2, b"ab", 10), ended(3, 3, b"b", 10)];
        let file = |name: &[u8], bytes| (BlobHash::of(name), bytes);
        let (large, small) = (file(b"large", 100), file(b"small", 5));
        let scenes: Scenes = [
            (BlobHash::of(b"a"), [large].into()),
            (BlobHash::of(b"ab"), [large, small].into()),
            (BlobHash::of(b"b"), [small].into()),
        ]
        .into();
        let go = |most, needed: &[BlobHash]| {
            let needed = needed.iter().copied().collect();
            numbers(&too_much(most, &jobs, &scenes, &needed))
        };
        assert_eq!(go(135, &[]), [0; 0], "files count once");
        assert_eq!(go(134, &[]), [1]);
        assert_eq!(go(124, &[]), [1, 2], "the large file is in the second's scene as well");
        assert_eq!(go(15, &[]), [1, 2], "it goes with it");
        assert_eq!(go(14, &[]), [1, 2, 3]);
        assert_eq!(
            go(35, &[large.0]),
            [0; 0],
            "what a job that goes on needs is not theirs"
        );
        assert_eq!(go(34, &[large.0]), [1]);
    }
}

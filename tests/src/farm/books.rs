//! The stores of a farm that has ended: every image that counts is there and whole, and nothing else is.

use photonfarm_coordinator::scheduler::record::BlobName;
use photonfarm_coordinator::store::{BlobPlace, BlobStore, ObjectBlobs, StatePlace, StateStore};
use photonfarm_proto::id::JobId;
use photonfarm_test_servers::{Postgres, S3};
use std::collections::BTreeSet;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

/// Where a farm keeps its state and its bytes.
#[derive(Clone, Debug)]
pub struct Stores {
    /// URL for `serve --state`.
    pub state: String,
    /// URL for `serve --blobs`.
    pub blobs: String,
    /// Variables by which programs reach them.
    pub environment: Vec<(String, String)>,
    /// Where the images of nodes lie as files, in the end.
    images: PathBuf,
}

impl Stores {
    /// A database file and a folder.
    #[must_use]
    pub fn folder(folder: &Path) -> Self {
        Self::folders(folder, folder)
    }

    /// A database file in one folder, and bytes in another.
    #[must_use]
    pub fn folders(state: &Path, bytes: &Path) -> Self {
        Self {
            state: format!("sqlite:{}/farm.sqlite", state.display()),
            blobs: format!("file:{}", bytes.display()),
            environment: Vec::new(),
            images: bytes.join("nodes"),
        }
    }

    /// A new database, and a bucket to which workers send nodes by signed URL.
    #[must_use]
    pub fn shared(postgres: &Postgres, s3: &S3) -> Self {
        Self {
            state: postgres.database(),
            blobs: s3.url("farm"),
            environment: s3.environment().map(|(name, value)| (name.to_owned(), value)).into(),
            images: s3.file("farm/nodes"),
        }
    }

    /// A database at a URL, and a folder that all coordinators reach.
    ///
    /// # Panics
    /// Where the folder has no UTF-8 name.
    #[must_use]
    pub fn database(url: &str, folder: &Path) -> Self {
        Self {
            state: url.to_owned(),
            ..Self::folder(folder)
        }
    }

    /// Two days pass for the images: those that nobody counted, and what a coordinator was writing when it was killed, are old enough
    /// then for a coordinator to remove them.
    ///
    /// # Panics
    /// Where the time of a file cannot be set.
    pub fn age(&self) {
        age(&self.images, SystemTime::now() - Duration::from_secs(2 * 24 * 3600));
    }

    /// Nobody uses the stores now. Every image that counts and every picture is whole and belongs to a known job, and there is
    /// nothing else.
    ///
    /// # Panics
    /// Where that is not so.
    pub fn check(&self, jobs: impl Iterator<Item = JobId>) {
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(async {
            let (state, nodes) = self.open().await;
            let live: BTreeSet<BlobName> = state.live_images().await.expect("the state").into_iter().collect();
            let mut named = BTreeSet::new();
            for id in jobs {
                let job = state
                    .job(id)
                    .await
                    .expect("the state")
                    .expect("a job that was submitted");
                assert_eq!(job.leases.len(), 0, "leases of job {id} are left");
                let counts = job.nodes.iter().filter(|(_, node)| node.live);
                named.extend(counts.map(|(_, node)| node.image()));
                named.extend(state.pictures(id).await.expect("the state"));
            }
            assert_eq!(live, named, "nodes of jobs that nobody sent");
            let there: BTreeSet<BlobName> = nodes
                .list()
                .await
                .expect("a list")
                .into_iter()
                .map(|(name, _)| name)
                .collect();
            let orphans: Vec<_> = there.difference(&live).collect();
            assert!(orphans.is_empty(), "images that nobody counts are left: {orphans:?}");
            for name in live {
                let read = nodes.read(name, u64::MAX).await;
                assert!(read.is_ok(), "an image that counts cannot be read: {:?}", read.err());
            }
            state.close().await;
        });
        if let Some(folder) = self.blobs.strip_prefix("file:") {
            for staging in ["scenes/staging", "nodes/staging"] {
                let left = std::fs::read_dir(Path::new(folder).join(staging))
                    .expect("the folder")
                    .count();
                assert_eq!(left, 0, "files are left in {staging}");
            }
        }
    }

    async fn open(&self) -> (Arc<dyn StateStore>, Arc<dyn BlobStore>) {
        let state: StatePlace = self.state.parse().expect("the URL of a state");
        let state = state.open().await.expect("a state that nobody uses");
        let nodes: Arc<dyn BlobStore> = match self.blobs.parse().expect("the URL of bytes") {
            BlobPlace::S3 { bucket, prefix } => {
                let all = ObjectBlobs::open_with(&bucket, &prefix, self.environment.iter().cloned()).await;
                Arc::new(all.expect("the bucket").below("nodes"))
            }
            folder @ BlobPlace::Folder(_) => {
                // Opening is not to remove anything.
                let [_, nodes] = folder.open(true).await.expect("the folder");
                nodes
            }
        };
        (state, nodes)
    }
}

fn age(folder: &Path, to: SystemTime) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            age(&path, to);
        } else {
            let file = File::options().append(true).open(&path).expect("a file of the store");
            file.set_modified(to).expect("the time of a file can be set");
        }
    }
}

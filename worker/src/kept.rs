//! Finished work on disk, for the next start of a worker that had to go before it could deliver.
//!
//! A file of the cache folder holds one lease: a line of JSON ([`Contents`]), then the images of its nodes. Whoever
//! delivers it holds its lock.

use crate::cache::Cache;
use crate::held::LeaseState;
use crate::parcel::{Farewell, Parcel, Upload};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::worker::{Lease, NodeUpload};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How the names of files begin that hold finished work.
const UNSENT: &str = "unsent-";

/// What is kept of a lease besides the images.
#[derive(Serialize, Deserialize)]
struct Contents {
    /// URL of the coordinator that lent it.
    coordinator: String,
    lease: Lease,
    /// Whether nodes go to the object store.
    stores: bool,
    /// The nodes, and how many bytes their images have.
    nodes: Vec<(NodeUpload, u64)>,
}

/// Work of an earlier process.
pub(crate) struct Kept {
    path: PathBuf,
    /// Locked until it is dropped.
    _file: File,
    pub(crate) parcel: Parcel,
}

impl Kept {
    /// It was delivered, or nobody wants it any more.
    pub(crate) fn remove(self) -> io::Result<()> {
        std::fs::remove_file(self.path)
    }
}

impl Cache {
    /// Keeps finished work of a coordinator.
    pub(crate) fn keep(&self, coordinator: &str, parcel: &Parcel) -> io::Result<PathBuf> {
        let node = |upload: &Upload| (upload.announced.clone(), upload.image.len() as u64);
        let contents = serde_json::to_vec(&Contents {
            coordinator: coordinator.to_owned(),
            lease: parcel.lease,
            stores: parcel.stores,
            nodes: parcel.uploads.iter().map(node).collect(),
        })?;
        let mut file = self.part()?;
        file.write_all(&contents)?;
        file.write_all(b"\n")?;
        for upload in &parcel.uploads {
            file.write_all(&upload.image)?;
        }
        file.as_file().sync_all()?;
        let path = self.root().join(format!("{UNSENT}{}", BlobHash::of(&contents)));
        file.persist(&path).map_err(|error| error.error)?;
        Ok(path)
    }

    /// Where finished work lies.
    pub(crate) fn unsent(&self) -> io::Result<Vec<PathBuf>> {
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(self.root())? {
            let entry = entry?;
            if entry.file_name().to_string_lossy().starts_with(UNSENT) {
                paths.push(entry.path());
            }
        }
        paths.sort();
        Ok(paths)
    }
}

/// Reads finished work; none where another process delivers it, or it is of another coordinator.
pub(crate) fn read(path: &Path, coordinator: &str) -> io::Result<Option<Kept>> {
    let damaged = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what.to_owned());
    let file = File::open(path)?;
    if file.try_lock().is_err() {
        return Ok(None);
    }
    let mut reader = BufReader::new(&file);
    let mut line = Vec::new();
    reader.read_until(b'\n', &mut line)?;
    let contents: Contents = serde_json::from_slice(&line)?;
    if contents.coordinator != coordinator {
        return Ok(None);
    }
    let mut uploads = Vec::new();
    for (announced, bytes) in contents.nodes {
        let mut image = Vec::new();
        reader.by_ref().take(bytes).read_to_end(&mut image)?;
        if BlobHash::of(&image) != announced.digest {
            return Err(damaged("an image in it is damaged"));
        }
        let image = image.into();
        uploads.push(Upload { announced, image });
    }
    let state = LeaseState::of(&contents.lease);
    state.set_rendered();
    Ok(Some(Kept {
        path: path.to_owned(),
        _file: file,
        parcel: Parcel {
            lease: contents.lease,
            state: Arc::new(state),
            uploads,
            farewell: Farewell::Release,
            stores: contents.stores,
        },
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_proto::id::{JobId, LeaseToken, WorkerId};
    use photonfarm_proto::job::Totals;
    use photonfarm_proto::node::NodeKey;
    use photonfarm_proto::trace::Context;

    fn parcel() -> Parcel {
        let lease = Lease {
            token: LeaseToken { number: 9, nonce: 8 },
            job: JobId(3),
            node: NodeKey { level: 1, index: 1 },
            worker: WorkerId(4),
            attempt: 1,
            expires_in_ms: 30_000,
            ends_in_ms: None,
            trace: Context::default(),
        };
        let upload = |index: u32| {
            let image = vec![index as u8; 100];
            Upload {
                announced: NodeUpload {
                    token: lease.token,
                    worker: lease.worker,
                    job: lease.job,
                    node: NodeKey { level: 0, index },
                    width: 4,
                    height: 2,
                    digest: BlobHash::of(&image),
                    totals: Totals::default(),
                    memory_mb: Some(700),
                },
                image: image.into(),
            }
        };
        Parcel {
            lease,
            state: Arc::new(LeaseState::of(&lease)),
            uploads: vec![upload(2), upload(3)],
            farewell: Farewell::Nothing,
            stores: false,
        }
    }

    #[test]
    fn work_is_read_as_it_was_kept_by_one_process_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 100).unwrap();
        let path = cache.keep("http://a/", &parcel()).unwrap();
        assert_eq!(cache.unsent().unwrap(), std::slice::from_ref(&path));
        assert!(read(&path, "http://b/").unwrap().is_none(), "of another coordinator");
        let kept = read(&path, "http://a/").unwrap().unwrap();
        assert_eq!(kept.parcel.lease, parcel().lease);
        for (kept, expected) in kept.parcel.uploads.iter().zip(parcel().uploads) {
            assert_eq!((&kept.announced, &kept.image), (&expected.announced, &expected.image));
        }
        assert!(
            read(&path, "http://a/").unwrap().is_none(),
            "another process delivers it"
        );
        kept.remove().unwrap();
        assert!(cache.unsent().unwrap().is_empty());
    }

    #[test]
    fn damage_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 100).unwrap();
        let path = cache.keep("http://a/", &parcel()).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.pop();
        std::fs::write(&path, bytes).unwrap();
        assert!(read(&path, "http://a/").is_err());
    }
}

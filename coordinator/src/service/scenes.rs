//! Files of scenes as workers fetch them. One that is damaged or missing is found when a worker asks for it; the jobs that need
//! it say so until somebody sends it again.

use super::obstacles::FORGOTTEN;
use super::{Service, ServiceError};
use crate::store::{self, BlobReader, StoreError};
use photonfarm_proto::id::BlobHash;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Where a file is.
pub(crate) enum SceneFile {
    /// In the object store, at this URL.
    At(String),
    /// Here: its length and its bytes.
    Here(u64, BlobReader),
}

/// Files that were asked for lately and are missing.
#[derive(Debug, Default)]
pub(super) struct MissingFiles {
    known: Mutex<BTreeMap<BlobHash, Missing>>,
    /// Held while a file is checked, and while one is put in its place.
    checking: tokio::sync::Mutex<()>,
}

#[derive(Debug)]
struct Missing {
    /// The scenes of jobs that need it, with its name there.
    scenes: BTreeMap<BlobHash, String>,
    /// When it was last asked for.
    asked: Instant,
}

impl MissingFiles {
    /// Held while a file becomes visible.
    pub(super) async fn placing(&self) -> tokio::sync::MutexGuard<'_, ()> {
        self.checking.lock().await
    }

    fn known(&self) -> std::sync::MutexGuard<'_, BTreeMap<BlobHash, Missing>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.known().is_empty()
    }

    /// Name of a file that a scene lacks.
    pub(super) fn of_scene(&self, scene: BlobHash) -> Option<String> {
        let known = self.known();
        let lately = known.values().filter(|missing| missing.asked.elapsed() < FORGOTTEN);
        let mut names = lately.filter_map(|missing| missing.scenes.get(&scene));
        names.next().cloned()
    }
}

impl Service {
    /// A file for whoever verifies its hash. A `suspect` file came with another one: it is checked here first, and is missing
    /// from then on if it is damaged.
    pub(crate) async fn scene_file(self: &Arc<Self>, hash: BlobHash, suspect: bool) -> Result<SceneFile, ServiceError> {
        let scenes = &self.stores.scenes;
        if suspect {
            self.remove_if_damaged(hash).await?;
        } else if let Some(url) = scenes.read_url(hash.into()).await? {
            return Ok(SceneFile::At(url));
        }
        match scenes.open(hash.into()).await {
            Ok((bytes, reader)) => Ok(SceneFile::Here(bytes, reader)),
            Err(error @ StoreError::NoBlob(_)) => {
                self.note_missing(hash).await?;
                Err(error.into())
            }
            Err(error) => Err(error.into()),
        }
    }

    async fn remove_if_damaged(&self, hash: BlobHash) -> Result<(), ServiceError> {
        let _nobody_replaces_it = self.missing_files.placing().await;
        let scenes = &self.stores.scenes;
        let found = match store::hash_of(&**scenes, hash.into()).await {
            Err(StoreError::NoBlob(_)) => return Ok(()),
            found => found?,
        };
        if found != hash {
            tracing::error!(%hash, "a file of a scene is damaged in the store, and is removed: it has to be sent again");
            scenes.remove(hash.into()).await?;
        }
        Ok(())
    }

    /// A worker asked for a file that is not there: the jobs that need it are to say so.
    async fn note_missing(self: &Arc<Self>, hash: BlobHash) -> Result<(), ServiceError> {
        if let Some(known) = self.missing_files.known().get_mut(&hash)
            && known.asked.elapsed() < FORGOTTEN
        {
            known.asked = Instant::now();
            return Ok(());
        }
        let cell = self.fresh_farm().await?;
        let needed: BTreeSet<BlobHash> = cell.farm.jobs().map(|job| job.head().spec.scene).collect();
        drop(cell);
        let mut scenes = BTreeMap::new();
        for scene in needed {
            let manifest = self.stores.state.bundle(scene).await?.unwrap_or_default();
            if let Some((name, _)) = manifest.files.into_iter().find(|(_, file)| file.hash == hash) {
                scenes.insert(scene, name);
            }
        }
        let asked = Instant::now();
        self.missing_files.known().insert(hash, Missing { scenes, asked });
        self.progress.send_modify(|version| *version += 1);
        Ok(())
    }

    /// A file was sent.
    pub(super) fn note_sent(&self, hash: BlobHash) {
        if self.missing_files.known().remove(&hash).is_some() {
            self.progress.send_modify(|version| *version += 1);
        }
    }
}

//! `--from OLD.exr`: a job that repeats a picture, or goes on with one that is partial, by what it says of how it was made.

use anyhow::{Context, Result, bail};
use photonfarm_core::picture::{self, PictureMetadata};
use photonfarm_proto::RENDERER;
use photonfarm_proto::id::BlobHash;
use std::path::{Path, PathBuf};

/// A picture to repeat.
#[derive(Debug)]
pub(crate) struct OldPicture {
    path: PathBuf,
    pub(crate) metadata: PictureMetadata,
}

impl OldPicture {
    /// Reads how a picture was made, and checks that this program makes the same bits.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let metadata = picture::read_metadata(&bytes).with_context(|| format!("cannot read {}", path.display()))?;
        let Some(metadata) = metadata else {
            bail!(
                "{} does not say how it was made: it is no picture of Photonfarm",
                path.display()
            );
        };
        let path = path.to_owned();
        let old = Self { path, metadata };
        old.check_renderer()?;
        Ok(old)
    }

    fn check_renderer(&self) -> Result<()> {
        let (path, metadata) = (self.path.display(), &self.metadata);
        if metadata.renderer.is_empty() || metadata.main.is_empty() {
            let version = &metadata.version;
            bail!("{path} cannot be repeated: version {version} did not note which build it was rendered by");
        }
        if metadata.renderer != RENDERER {
            let found = &metadata.renderer;
            bail!(
                "{path} was rendered by {found}, and this program is {RENDERER}: other builds may give other bits. \
                 Repeat it with that build, or give the settings in its attributes as options instead of --from"
            );
        }
        Ok(())
    }

    /// Checks that a scene is that of the picture.
    pub(crate) fn check_scene(&self, scene: &Path, main: &str, hash: BlobHash) -> Result<()> {
        let (path, metadata) = (self.path.display(), &self.metadata);
        if main != metadata.main {
            let expected = &metadata.main;
            bail!("{path} is a picture of {expected}, not of {}", scene.display());
        }
        if hash.to_string() != metadata.scene_hash {
            let expected = &metadata.scene_hash;
            bail!(
                "{path} is a picture of another scene than {}: that scene and the files that it names have the hash {expected}, \
                 these have {hash}",
                scene.display()
            );
        }
        Ok(())
    }

    /// Iterations of the whole picture.
    pub(crate) fn iterations(&self) -> Result<u32> {
        let averaged = u32::try_from(self.metadata.iterations)
            .ok()
            .filter(|averaged| *averaged > 0);
        let iterations = self.metadata.iterations_asked.or(averaged);
        iterations.with_context(|| format!("{} names no number of iterations", self.path.display()))
    }
}

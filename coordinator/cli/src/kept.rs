//! What an interrupted render leaves, so that it can go on: a partial picture, and beside it the folder of its farm, in which the
//! nodes of the tree are. An average alone could not be gone on from, bit for bit.

use crate::output::PictureFiles;
use anyhow::{Context, Result, bail};
use photonfarm_proto::id::BlobHash;
use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// What is in every folder of a farm.
const STATE: &str = "farm.sqlite";
/// How long the work in a folder took, as JSON.
const SPENT: &str = "spent.json";
/// How often that is noted: a process that is killed loses no more.
pub(crate) const NOTED_EVERY: Duration = Duration::from_secs(1);

/// The folder of a render's farm.
pub(crate) enum FarmFolder {
    /// It goes with the process.
    Temporary(TempDir),
    /// An earlier render left it.
    Kept(PathBuf),
}

impl FarmFolder {
    /// The folder that an interrupted render left beside its partial picture, if there is one; else a new one.
    pub(crate) fn beside(picture: Option<&Path>) -> Result<Self> {
        let kept = picture.filter(|picture| partial(picture) == **picture).map(folder_of);
        let kept = kept.filter(|folder| folder.join(STATE).is_file());
        match kept {
            Some(folder) => Ok(Self::Kept(folder)),
            None => Ok(Self::Temporary(temporary()?)),
        }
    }

    /// The folder of the render of a picture: what an earlier one left there is gone on from.
    pub(crate) fn of(output: &Path) -> Result<Self> {
        Self::at(folder_of(&partial(output)))
    }

    /// A folder in which an earlier command may have left its work.
    pub(crate) fn at(folder: PathBuf) -> Result<Self> {
        let empty = || fs::read_dir(&folder).is_ok_and(|mut entries| entries.next().is_none());
        if folder.exists() && !folder.join(STATE).is_file() && !empty() {
            bail!(
                "{} is in the way: no interrupted render left it; move it, or choose another name for what is to be written",
                folder.display()
            );
        }
        Ok(Self::Kept(folder))
    }

    pub(crate) fn path(&self) -> &Path {
        match self {
            Self::Temporary(folder) => folder.path(),
            Self::Kept(folder) => folder,
        }
    }

    /// Whether an earlier render left something in it.
    pub(crate) fn holds_earlier(&self) -> bool {
        matches!(self, Self::Kept(folder) if folder.join(STATE).is_file())
    }

    /// Removes the folder: the picture is complete.
    pub(crate) fn remove(self) -> Result<()> {
        match self {
            Self::Temporary(folder) => Ok(folder.close()?),
            Self::Kept(folder) => {
                fs::remove_dir_all(&folder).with_context(|| format!("cannot remove {}", folder.display()))
            }
        }
    }

    /// Keeps the folder beside a partial picture.
    pub(crate) fn keep(self, picture: &Path) -> Result<()> {
        let to = folder_of(picture);
        if self.path() == to {
            return Ok(());
        }
        let context = || format!("cannot keep what was rendered in {}", to.display());
        if to.exists() {
            if !to.join(STATE).is_file() {
                bail!("{} is in the way: no interrupted render left it", to.display());
            }
            fs::remove_dir_all(&to).with_context(context)?;
        }
        // A folder cannot be renamed into another file system.
        if fs::rename(self.path(), &to).is_err() {
            copy(self.path(), &to).with_context(context)?;
            return self.remove();
        }
        if let Self::Temporary(folder) = self {
            let _renamed = folder.keep();
        }
        Ok(())
    }
}

/// Time that goes into a piece of work, those of earlier commands included. It lies in the work's folder.
pub(crate) struct Spent {
    path: PathBuf,
    kept: SpentFile,
    since: Instant,
}

#[derive(Serialize, Deserialize)]
struct SpentFile {
    /// Hash of what is worked on: time that went into something else does not count.
    work: String,
    seconds: f64,
}

impl Spent {
    /// What earlier commands have spent on this `work` in the folder.
    pub(crate) fn on(folder: &Path, work: &impl Serialize) -> Result<Self> {
        let path = folder.join(SPENT);
        let work = BlobHash::of(&serde_json::to_vec(work)?).to_string();
        let read = || serde_json::from_slice::<SpentFile>(&fs::read(&path).ok()?).ok();
        let known = read().filter(|known| known.work == work && known.seconds >= 0.0);
        Ok(Self {
            kept: known.unwrap_or(SpentFile { work, seconds: 0.0 }),
            path,
            since: Instant::now(),
        })
    }

    /// How long earlier commands took.
    pub(crate) fn before(&self) -> Duration {
        Duration::try_from_secs_f64(self.kept.seconds).unwrap_or(Duration::MAX)
    }

    /// Notes how long it is by now. A folder that cannot be written shows soon enough by other means.
    pub(crate) fn note(&self) {
        let now = SpentFile {
            work: self.kept.work.clone(),
            seconds: self.kept.seconds + self.since.elapsed().as_secs_f64(),
        };
        if let Err(error) = write(&self.path, &now) {
            tracing::debug!("the time spent is not kept: {error:#}");
        }
    }

    /// Notes it again and again.
    pub(crate) async fn keep(&self) -> Infallible {
        loop {
            self.note();
            tokio::time::sleep(NOTED_EVERY).await;
        }
    }
}

/// Writes a value into a folder of work, whole or not at all.
pub(crate) fn write(path: &Path, value: &impl Serialize) -> Result<()> {
    let staged = path.with_extension("new");
    fs::write(&staged, serde_json::to_vec(value)?)?;
    Ok(fs::rename(staged, path)?)
}

/// A folder of this process.
pub(crate) fn temporary() -> Result<TempDir> {
    tempfile::tempdir().context("cannot make a temporary folder; TMPDIR says where")
}

/// Where the partial picture of an interrupted render goes.
pub(crate) fn partial(output: &Path) -> PathBuf {
    let is_partial = output
        .file_stem()
        .is_some_and(|stem| Path::new(stem).extension().is_some_and(|e| e == "partial"));
    match is_partial {
        true => output.to_owned(),
        false => output.with_extension("partial.exr"),
    }
}

/// Removes the partial picture that an interrupted render left, now that it has gone on to its end. Nothing else is removed.
pub(crate) fn remove_partial(picture: &Path) -> Result<()> {
    if partial(picture) != picture {
        return Ok(());
    }
    for file in [picture.to_owned(), picture.with_extension("png")] {
        match fs::remove_file(&file) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("cannot remove {}", file.display()));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Writes a partial picture and keeps its farm.
pub(crate) fn keep(farm: FarmFolder, picture: &Path, exr: &[u8], png: &[u8]) -> Result<()> {
    PictureFiles::check(picture)?.write(exr, png)?;
    farm.keep(picture)
}

fn folder_of(picture: &Path) -> PathBuf {
    picture.with_extension("farm")
}

fn copy(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        match entry.file_type()?.is_dir() {
            true => copy(&entry.path(), &target)?,
            false => _ = fs::copy(entry.path(), target)?,
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn farm(folder: &Path, content: &str) {
        fs::create_dir_all(folder.join("nodes")).unwrap();
        fs::write(folder.join(STATE), content).unwrap();
        fs::write(folder.join("nodes/a"), content).unwrap();
    }

    #[test]
    fn a_farm_is_kept_found_and_removed() {
        let folder = temporary().unwrap();
        let picture = partial(&folder.path().join("a.exr"));
        assert_eq!(picture, folder.path().join("a.partial.exr"));
        assert_eq!(partial(&picture), picture);
        for content in ["old", "new"] {
            let work = FarmFolder::beside(None).unwrap();
            farm(work.path(), content);
            work.keep(&picture).unwrap();
        }
        let found = FarmFolder::beside(Some(&picture)).unwrap();
        assert_eq!(fs::read(found.path().join("nodes/a")).unwrap(), b"new");
        found.keep(&picture).unwrap();
        let found = FarmFolder::beside(Some(&picture)).unwrap();
        assert_eq!(found.path(), folder.path().join("a.partial.farm"));
        let copied = folder.path().join("copy");
        copy(found.path(), &copied).unwrap();
        assert_eq!(fs::read(copied.join("nodes/a")).unwrap(), b"new");
        found.remove().unwrap();
        assert!(matches!(
            FarmFolder::beside(Some(&picture)).unwrap(),
            FarmFolder::Temporary(_)
        ));
    }

    #[test]
    fn the_folder_of_a_picture_lies_beside_it() {
        let folder = temporary().unwrap();
        let output = folder.path().join("a.exr");
        let found = FarmFolder::of(&output).unwrap();
        assert_eq!(found.path(), folder.path().join("a.partial.farm"));
        farm(found.path(), "x");
        found.keep(&partial(&output)).unwrap();
        FarmFolder::of(&output).unwrap().remove().unwrap();
        assert!(!folder.path().join("a.partial.farm").exists());
        fs::create_dir(folder.path().join("a.partial.farm")).unwrap();
        FarmFolder::of(&output).unwrap();
        fs::write(folder.path().join("a.partial.farm/mine"), "").unwrap();
        let error = FarmFolder::of(&output).err().unwrap().to_string();
        assert!(error.contains("in the way"), "{error}");
    }

    #[test]
    fn time_counts_for_the_same_work_alone() {
        let folder = temporary().unwrap();
        let first = Spent::on(folder.path(), &"picture").unwrap();
        assert_eq!(first.before(), Duration::ZERO);
        first.note();
        let second = Spent::on(folder.path(), &"picture").unwrap();
        assert!(second.before() > Duration::ZERO);
        second.note();
        assert!(Spent::on(folder.path(), &"picture").unwrap().before() > second.before());
        assert_eq!(Spent::on(folder.path(), &"another").unwrap().before(), Duration::ZERO);
        fs::write(folder.path().join(SPENT), "{").unwrap();
        assert_eq!(Spent::on(folder.path(), &"picture").unwrap().before(), Duration::ZERO);
    }

    #[test]
    fn a_folder_of_something_else_is_left_alone() {
        let folder = temporary().unwrap();
        let picture = folder.path().join("a.partial.exr");
        fs::create_dir(folder.path().join("a.partial.farm")).unwrap();
        let error = FarmFolder::beside(Some(&picture)).unwrap().keep(&picture).unwrap_err();
        assert!(error.to_string().contains("in the way"), "{error}");
    }
}

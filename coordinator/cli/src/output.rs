//! Files that appear whole or not at all.

use crate::download::Part;
use anyhow::{Context, Result, bail};
use exr::prelude::{Image, SpecificChannels, WritableImage};
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// A place for a file, checked before work starts.
#[derive(Debug)]
pub(crate) struct OutputFile {
    path: PathBuf,
}

/// The picture as OpenEXR, and the PNG beside it.
#[derive(Debug)]
pub(crate) struct PictureFiles {
    exr: OutputFile,
    png: OutputFile,
}

impl OutputFile {
    /// Checks that a file can be written at `path`; leaves what is there.
    pub(crate) fn check(path: &Path) -> Result<Self> {
        if path.is_dir() {
            bail!("{} is a folder: name a file in it", path.display());
        }
        let file = Self { path: path.to_owned() };
        let folder = file.folder();
        match folder.metadata() {
            Ok(metadata) if metadata.is_dir() => {}
            Ok(_) => bail!(
                "{} is not a folder: choose another place for {}",
                folder.display(),
                path.display()
            ),
            Err(error) => {
                let advice = format!("make the folder first: mkdir -p {}", folder.display());
                return Err(error).with_context(|| format!("cannot write {}; {advice}", path.display()));
            }
        }
        file.stage()?;
        Ok(file)
    }

    /// Puts `bytes` in place of what was there, in one step.
    pub(crate) fn write(&self, bytes: &[u8]) -> Result<()> {
        let mut staged = self.stage()?;
        let written = staged.write_all(bytes).and_then(|()| staged.as_file().sync_all());
        written.with_context(|| format!("cannot write {}", self.path.display()))?;
        staged
            .persist(&self.path)
            .with_context(|| format!("cannot write {}", self.path.display()))?;
        Ok(())
    }

    fn folder(&self) -> &Path {
        self.path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."))
    }

    fn stage(&self) -> Result<NamedTempFile> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(".photonfarm-");
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        builder.tempfile_in(self.folder()).with_context(|| {
            let path = self.path.display();
            format!("cannot write {path}: choose a folder that you may write to, with space left")
        })
    }
}

impl PictureFiles {
    /// Checks that `path`, a name that ends in `.exr`, and the PNG beside it can be written.
    pub(crate) fn check(path: &Path) -> Result<Self> {
        if path
            .extension()
            .is_none_or(|extension| !extension.eq_ignore_ascii_case("exr"))
        {
            bail!(
                "-o {}: pictures are OpenEXR files; name it {}",
                path.display(),
                path.with_extension("exr").display()
            );
        }
        Ok(Self {
            exr: OutputFile::check(path)?,
            png: OutputFile::check(&path.with_extension("png"))?,
        })
    }

    /// Writes both files.
    pub(crate) fn write(&self, exr: &[u8], png: &[u8]) -> Result<()> {
        self.exr.write(exr)?;
        self.png.write(png)
    }

    /// What has arrived of both, kept beside them.
    pub(crate) fn parts(&self) -> Result<[Part; 2]> {
        Ok([Part::beside(&self.exr.path)?, Part::beside(&self.png.path)?])
    }

    /// Both names, for messages.
    pub(crate) fn names(&self) -> String {
        format!("{} and {}", self.exr.path.display(), self.png.path.display())
    }
}

/// Red, green and blue of each pixel as OpenEXR, with no word of how they came about.
pub(crate) fn plain_exr(width: u32, height: u32, pixel: impl Fn(usize) -> [f32; 3] + Sync) -> Result<Vec<u8>> {
    let (width, height) = (width as usize, height as usize);
    let at = |position: exr::math::Vec2<usize>| {
        let [r, g, b] = pixel(position.y() * width + position.x());
        (r, g, b)
    };
    let mut file = Cursor::new(Vec::new());
    let picture = Image::from_channels((width, height), SpecificChannels::rgb(at));
    picture.write().non_parallel().to_buffered(&mut file)?;
    Ok(file.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn files_in(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_check_leaves_things_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        fs::write(&path, b"old").unwrap();
        PictureFiles::check(&path).unwrap();
        assert_eq!(files_in(folder.path()), ["a.exr"]);
        assert_eq!(fs::read(&path).unwrap(), b"old");
    }

    #[test]
    fn files_replace_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        fs::write(&path, b"old").unwrap();
        PictureFiles::check(&path).unwrap().write(b"new", b"picture").unwrap();
        assert_eq!(files_in(folder.path()), ["a.exr", "a.png"]);
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read(path.with_extension("png")).unwrap(), b"picture");
    }

    #[test]
    fn places_that_cannot_be_written_are_refused_with_advice() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("file"), b"").unwrap();
        fs::create_dir(folder.path().join("b.exr")).unwrap();
        for (name, advice) in [
            ("missing/a.exr", "mkdir -p"),
            ("file/a.exr", "file"),
            ("b.exr", "is a folder"),
            ("a.jpg", "a.exr"),
            ("a", "a.exr"),
        ] {
            let error = format!("{:#}", PictureFiles::check(&folder.path().join(name)).unwrap_err());
            assert!(error.contains(advice), "{name}: {error}");
        }
    }
}

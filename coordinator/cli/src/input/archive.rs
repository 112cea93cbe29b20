//! Archives of scenes: zip, tar, and tar within gzip. Nothing is written outside the folder that they are unpacked into, and
//! no more than a farm takes of a scene.

use anyhow::{Context, Result, bail, ensure};
use flate2::read::GzDecoder;
use photonfarm_proto::limits::Limits;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Component, Path};

/// How archives begin: the first file of a zip, or the end of an empty one.
const ZIP: [&[u8]; 2] = [b"PK\x03\x04", b"PK\x05\x06"];
const GZIP: &[u8] = &[0x1f, 0x8b];
/// What a tar has, and where (POSIX.1-1988, ustar).
const USTAR: &[u8] = b"ustar";
const USTAR_AT: usize = 257;

/// A kind of archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Zip,
    Tar,
    TarGz,
}

impl Kind {
    /// The kind of the file at `path`; nothing where it is none.
    pub(super) fn of(path: &Path) -> Result<Option<Self>> {
        let Ok(file) = File::open(path) else {
            // Whoever reads it as a scene says why it cannot be read.
            return Ok(None);
        };
        let mut head = Vec::new();
        file.take((USTAR_AT + USTAR.len()) as u64).read_to_end(&mut head)?;
        Ok(match () {
            () if ZIP.iter().any(|start| head.starts_with(start)) => Some(Self::Zip),
            () if head.starts_with(GZIP) => Some(Self::TarGz),
            () if head.get(USTAR_AT..) == Some(USTAR) => Some(Self::Tar),
            () => None,
        })
    }
}

/// Unpacks an archive into an empty folder.
pub(super) fn unpack(archive: &Path, kind: Kind, folder: &Path, limits: &Limits) -> Result<()> {
    let file = BufReader::new(File::open(archive)?);
    let mut room = Room {
        folder,
        limits,
        files: 0,
        bytes: 0,
    };
    match kind {
        Kind::Zip => unzip(file, &mut room),
        Kind::Tar => untar(file, &mut room),
        Kind::TarGz => untar(GzDecoder::new(file), &mut room),
    }
}

fn unzip(file: BufReader<File>, room: &mut Room) -> Result<()> {
    let mut archive = zip::ZipArchive::new(file)?;
    for index in 0..archive.len() {
        let entry = archive.by_index(index)?;
        let name = entry.name()?.into_owned();
        if entry.is_dir() {
            continue;
        }
        ensure!(entry.is_file(), "{name} is a link, and links are not unpacked");
        room.put(&name, entry)?;
    }
    Ok(())
}

fn untar(file: impl Read, room: &mut Room) -> Result<()> {
    for entry in tar::Archive::new(file).entries()? {
        let entry = entry?;
        let path = entry.path()?.into_owned();
        let name = path
            .to_str()
            .with_context(|| format!("{} is no name in UTF-8", path.display()))?;
        let kind = entry.header().entry_type();
        match kind {
            tar::EntryType::Directory | tar::EntryType::XGlobalHeader => {}
            tar::EntryType::Regular | tar::EntryType::Continuous => room.put(name, entry)?,
            _ => bail!("{name} is a link or a device, and only files are unpacked"),
        }
    }
    Ok(())
}

/// A folder, and how much may still come into it.
struct Room<'a> {
    folder: &'a Path,
    limits: &'a Limits,
    files: u64,
    bytes: u64,
}

impl Room<'_> {
    fn put(&mut self, name: &str, content: impl Read) -> Result<()> {
        let path = Path::new(name);
        let inside = |part: Component| matches!(part, Component::Normal(_) | Component::CurDir);
        ensure!(
            path.components().all(inside) && !name.contains('\\') && !name.is_empty(),
            "{name:?} leads out of the archive's folder"
        );
        self.files += 1;
        let most = self.limits.bundle_files;
        ensure!(
            self.files <= most,
            "it holds more than {most} files (limit `bundle_files`)"
        );
        let target = self.folder.join(path);
        if let Some(parent) = target.parent() {
            std::fs::create_dir_all(parent)?;
        }
        let mut file = File::create_new(&target).with_context(|| format!("cannot write {name}"))?;
        let left = self.limits.bundle_bytes - self.bytes;
        let most = left.min(self.limits.file_bytes);
        let copied = std::io::copy(&mut content.take(most + 1), &mut file);
        let copied = copied.with_context(|| format!("cannot unpack {name}"))?;
        ensure!(
            copied <= self.limits.file_bytes,
            "{name} has more than {} bytes (limit `file_bytes`)",
            self.limits.file_bytes
        );
        ensure!(
            copied <= left,
            "its files have more than {} bytes (limit `bundle_bytes`)",
            self.limits.bundle_bytes
        );
        self.bytes += copied;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn tar_of(files: &[(&str, &[u8])]) -> Vec<u8> {
        let mut archive = tar::Builder::new(Vec::new());
        for (name, content) in files {
            let mut header = tar::Header::new_ustar();
            // `set_path` refuses what is to be tested here.
            header.as_mut_bytes()[..name.len()].copy_from_slice(name.as_bytes());
            header.set_size(content.len() as u64);
            header.set_mode(0o644);
            header.set_cksum();
            archive.append(&header, *content).unwrap();
        }
        archive.into_inner().unwrap()
    }

    fn zip_of(files: &[(&str, &[u8])]) -> Vec<u8> {
        let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        for (name, content) in files {
            archive
                .start_file(*name, zip::write::SimpleFileOptions::default())
                .unwrap();
            archive.write_all(content).unwrap();
        }
        archive.finish().unwrap().into_inner()
    }

    fn gzip_of(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    fn unpacked(bytes: &[u8], limits: &Limits) -> Result<Vec<(String, Vec<u8>)>> {
        let folder = tempfile::tempdir().unwrap();
        let (archive, to) = (folder.path().join("archive"), folder.path().join("to"));
        std::fs::write(&archive, bytes).unwrap();
        std::fs::create_dir(&to).unwrap();
        let kind = Kind::of(&archive)?.expect("an archive");
        unpack(&archive, kind, &to, limits)?;
        let names = ["scene.xml", "meshes/a.ply"];
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            2,
            "something lies outside"
        );
        Ok(names
            .iter()
            .filter_map(|name| Some(((*name).to_owned(), std::fs::read(to.join(name)).ok()?)))
            .collect())
    }

    #[test]
    fn archives_of_all_kinds_give_their_files() {
        let files: [(&str, &[u8]); 2] = [("scene.xml", b"<scene/>"), ("meshes/a.ply", b"ply")];
        let expected = files.map(|(name, content)| (name.to_owned(), content.to_vec()));
        for bytes in [tar_of(&files), gzip_of(&tar_of(&files)), zip_of(&files)] {
            assert_eq!(unpacked(&bytes, &Limits::default()).unwrap(), expected);
        }
    }

    #[test]
    fn archives_that_do_harm_are_refused() {
        let limits = Limits {
            bundle_files: 2,
            file_bytes: 8,
            bundle_bytes: 10,
            ..Limits::default()
        };
        type Files<'a> = &'a [(&'a str, &'a [u8])];
        for (files, reason) in [
            (&[("../outside", b"x".as_slice())] as Files, "leads out of"),
            (&[("/tmp/outside", b"x")], "leads out of"),
            (&[("a/../../b", b"x")], "leads out of"),
            (&[("a\\..\\b", b"x")], "leads out of"),
            (&[("a", b"123456789")], "file_bytes"),
            (&[("a", b"12345678"), ("b", b"123")], "bundle_bytes"),
            (&[("a", b""), ("b", b""), ("c", b"")], "bundle_files"),
        ] {
            for bytes in [tar_of(files), zip_of(files)] {
                let error = format!("{:#}", unpacked(&bytes, &limits).unwrap_err());
                assert!(error.contains(reason), "{files:?}: {error}");
            }
        }
        let mut header = tar::Header::new_ustar();
        header.set_entry_type(tar::EntryType::Symlink);
        header.set_path("scene.xml").unwrap();
        header.set_link_name("/etc/passwd").unwrap();
        header.set_size(0);
        header.set_cksum();
        let mut archive = tar::Builder::new(Vec::new());
        archive.append(&header, std::io::empty()).unwrap();
        let error = unpacked(&archive.into_inner().unwrap(), &limits)
            .unwrap_err()
            .to_string();
        assert!(error.contains("only files"), "{error}");
    }

    #[test]
    fn damaged_archives_are_errors() {
        let files: [(&str, &[u8]); 2] = [("scene.xml", &[7; 3000]), ("meshes/a.ply", &[1; 2000])];
        for whole in [tar_of(&files), gzip_of(&tar_of(&files)), zip_of(&files)] {
            for length in (300..whole.len()).step_by(701) {
                let _ = unpacked(&whole[..length], &Limits::default());
            }
        }
    }
}

//! Where a scene comes from: a file, a folder with one scene in it, an archive of such a folder, or standard input.

mod archive;

use crate::kept;
use anyhow::{Context, Result, bail};
use bytes::Bytes;
use clap::ValueEnum;
use photonfarm_core::scene::{SceneError, SceneFiles, SceneFolder};
use photonfarm_proto::job::NAME_BYTES;
use photonfarm_proto::limits::Limits;
use std::ffi::OsStr;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// How a scene is called that comes from standard input.
const STDIN: &str = "-";
/// Bytes that are looked at to tell what a file is.
const HEAD_BYTES: usize = 1 << 16;
/// Folders within each other that are looked into for a scene, where each holds nothing else.
const DEPTH: usize = 8;
/// Scenes that are named where one is to be chosen.
const SHOWN: usize = 12;

/// A format of scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum SceneFormat {
    /// Mitsuba's XML
    Xml,
    /// pbrt
    Pbrt,
    /// glTF as JSON
    Gltf,
    /// glTF as one binary file
    Glb,
}

impl SceneFormat {
    /// The format of a file that begins so; `None` where it is none of these, or a part of a scene.
    fn of(head: &[u8]) -> Option<Self> {
        let text = String::from_utf8_lossy(head);
        let text = text.trim_start_matches('\u{feff}').trim_start();
        match () {
            () if head.starts_with(b"glTF") => Some(Self::Glb),
            () if text.starts_with('<') && text.contains("<scene") => Some(Self::Xml),
            () if text.starts_with('{') && text.contains("\"asset\"") => Some(Self::Gltf),
            () if text.lines().any(|line| line.trim_start().starts_with("WorldBegin")) => Some(Self::Pbrt),
            () => None,
        }
    }

    /// What names of such files end in.
    fn extension(self) -> &'static str {
        match self {
            Self::Xml => "xml",
            Self::Pbrt => "pbrt",
            Self::Gltf => "gltf",
            Self::Glb => "glb",
        }
    }
}

/// A scene with the files that it names.
pub(crate) struct Input {
    /// What it names is read from here.
    pub(crate) files: Box<dyn SceneFiles>,
    /// Name of the scene file there.
    pub(crate) main: String,
    /// A name for people.
    pub(crate) name: String,
    /// What an archive held; it goes with this.
    _unpacked: Option<TempDir>,
}

impl Input {
    /// The scene at `path`, or on standard input in the format that is given or that its content shows.
    pub(crate) fn open(path: &Path, format: Option<SceneFormat>) -> Result<Self> {
        if path == Path::new(STDIN) {
            return Self::of_stream(&mut std::io::stdin().lock(), format);
        }
        if path.is_dir() {
            return Self::of_file(&scene_in(path)?, None);
        }
        let archive = || -> Result<Option<TempDir>> {
            let Some(kind) = archive::Kind::of(path)? else {
                return Ok(None);
            };
            let folder = kept::temporary()?;
            archive::unpack(path, kind, folder.path(), &Limits::default())?;
            Ok(Some(folder))
        };
        match archive().with_context(|| format!("cannot unpack {}", path.display()))? {
            Some(folder) => {
                let scene = scene_in(folder.path()).with_context(|| format!("in the archive {}", path.display()))?;
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                let name = name.split('.').next().unwrap_or_default().to_owned();
                let input = Self::of_file(&scene, Some(folder))?;
                Ok(Self {
                    name: usable(name),
                    ..input
                })
            }
            None => Self::of_file(path, None),
        }
    }

    fn of_file(path: &Path, unpacked: Option<TempDir>) -> Result<Self> {
        let context = || format!("cannot load the scene {}", path.display());
        let main = path.file_name().and_then(OsStr::to_str);
        let main = main.with_context(|| format!("{} is no name of a scene file", path.display()))?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let files = SceneFolder::new(folder.unwrap_or(Path::new("."))).with_context(context)?;
        Ok(Self {
            files: Box::new(files),
            main: main.to_owned(),
            name: name_of(path),
            _unpacked: unpacked,
        })
    }

    fn of_stream(stream: &mut dyn Read, format: Option<SceneFormat>) -> Result<Self> {
        let most = Limits::default().file_bytes;
        let mut content = Vec::new();
        let read = stream.take(most + 1).read_to_end(&mut content);
        read.context("cannot read the scene from standard input")?;
        if content.len() as u64 > most {
            bail!("the scene on standard input has more than {most} bytes (limit `file_bytes`)");
        }
        let head = &content[..content.len().min(HEAD_BYTES)];
        let Some(format) = format.or_else(|| SceneFormat::of(head)) else {
            bail!(
                "standard input holds {} bytes, which do not begin as a scene of Mitsuba, pbrt or glTF does: \
                 --format says which it is",
                content.len()
            );
        };
        let main = format!("stdin.{}", format.extension());
        Ok(Self {
            files: Box::new(Stream {
                main: main.clone(),
                content: content.into(),
                folder: SceneFolder::new(Path::new("."))?,
            }),
            main,
            name: "stdin".to_owned(),
            _unpacked: None,
        })
    }
}

/// A scene file in memory, which names files of the current folder.
struct Stream {
    main: String,
    content: Bytes,
    folder: SceneFolder,
}

impl SceneFiles for Stream {
    fn read(&self, name: &str) -> Result<Bytes, SceneError> {
        match name == self.main {
            true => Ok(self.content.clone()),
            false => self.folder.read(name),
        }
    }
}

/// The one scene of a folder; where that holds none and only one folder, of that.
fn scene_in(folder: &Path) -> Result<PathBuf> {
    let mut at = folder.to_owned();
    for _ in 0..DEPTH {
        let (mut scenes, mut folders) = (Vec::new(), Vec::new());
        for entry in fs::read_dir(&at).with_context(|| format!("cannot read {}", at.display()))? {
            let path = entry?.path();
            let hidden = path
                .file_name()
                .is_some_and(|name| name.to_string_lossy().starts_with(['.', '_']));
            if path.is_dir() {
                folders.extend((!hidden).then_some(path));
            } else if is_scene(&path)? {
                scenes.push(path);
            }
        }
        scenes.sort();
        match (scenes.as_slice(), folders.as_slice()) {
            ([scene], _) => return Ok(scene.clone()),
            ([], [inner]) => at = inner.clone(),
            ([], _) => break,
            (several, _) => bail!(
                "{} holds {} scenes, name one of them: {}",
                at.display(),
                several.len(),
                listed(several)
            ),
        }
    }
    bail!(
        "{} holds no scene: expected one file that ends in xml, pbrt, gltf or glb",
        at.display()
    )
}

fn listed(scenes: &[PathBuf]) -> String {
    let names = scenes.iter().take(SHOWN).map(|scene| scene.display().to_string());
    let names = names.collect::<Vec<_>>().join(", ");
    match scenes.len() > SHOWN {
        true => names + ", ...",
        false => names,
    }
}

/// Whether a file is a scene by its name and by how it begins: files that scenes include are none.
fn is_scene(path: &Path) -> Result<bool> {
    let end = path.extension().map(|end| end.to_string_lossy().to_lowercase());
    let formats = SceneFormat::value_variants();
    let named = formats.iter().find(|format| end.as_deref() == Some(format.extension()));
    let Some(named) = named else { return Ok(false) };
    let mut content = Vec::new();
    let file = fs::File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
    // The directive by which scenes of pbrt are told from their parts may stand anywhere.
    let most = match named {
        SceneFormat::Pbrt => Limits::default().file_bytes,
        _ => HEAD_BYTES as u64,
    };
    file.take(most).read_to_end(&mut content)?;
    Ok(SceneFormat::of(&content) == Some(*named))
}

/// A name for a job that renders a scene file: the file's own, or its folder's where that says nothing.
fn name_of(scene: &Path) -> String {
    let part = |part: Option<&OsStr>| part.map(|part| part.to_string_lossy().into_owned());
    let file = part(scene.file_stem()).unwrap_or_default();
    let folder = scene.canonicalize().ok();
    let folder = folder.and_then(|scene| part(scene.parent()?.file_name()));
    usable(match file.as_str() {
        "scene" | "main" | "index" => folder.unwrap_or(file),
        _ => file,
    })
}

/// A name that a job may have.
fn usable(mut name: String) -> String {
    name.retain(|c| !c.is_control());
    while name.len() > NAME_BYTES {
        name.pop();
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENE: &str = r#"<?xml version="1.0"?><!-- a scene --><scene version="3.0.0"></scene>"#;

    #[test]
    fn jobs_are_called_as_their_scenes() {
        for (scene, name) in [
            ("glass.pbrt", "glass"),
            ("a/ring.xml", "ring"),
            ("a/b\u{7}.glb", "b"),
            ("/nowhere/scene.xml", "scene"),
        ] {
            assert_eq!(name_of(Path::new(scene)), name);
        }
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("kitchen/scene.xml");
        fs::create_dir(scene.parent().unwrap()).unwrap();
        fs::write(&scene, SCENE).unwrap();
        assert_eq!(name_of(&scene), "kitchen");
        assert_eq!(name_of(Path::new(&"ä".repeat(300))).len(), NAME_BYTES);
        let input = Input::open(scene.parent().unwrap(), None).unwrap();
        assert_eq!((input.main.as_str(), input.name.as_str()), ("scene.xml", "kitchen"));
    }

    #[test]
    fn formats_are_told_by_content() {
        for (content, format) in [
            (SCENE, Some(SceneFormat::Xml)),
            ("\u{feff}\n <scene/>", Some(SceneFormat::Xml)),
            ("LookAt 0 0 0 1 1 1 0 0 1\nWorldBegin\n", Some(SceneFormat::Pbrt)),
            ("Shape \"sphere\"", None),
            ("{\"asset\": {\"version\": \"2.0\"}}", Some(SceneFormat::Gltf)),
            ("glTF\u{2}", Some(SceneFormat::Glb)),
            ("<svg/>", None),
            ("", None),
        ] {
            assert_eq!(SceneFormat::of(content.as_bytes()), format, "{content}");
        }
        let read = |text: &str, format| Input::of_stream(&mut text.as_bytes(), format);
        let input = read(SCENE, None).unwrap();
        assert_eq!(input.main, "stdin.xml");
        assert_eq!(input.files.read("stdin.xml").unwrap(), SCENE);
        let error = read("nothing", None).err().unwrap().to_string();
        assert!(error.contains("--format"), "{error}");
        assert_eq!(read("nothing", Some(SceneFormat::Pbrt)).unwrap().main, "stdin.pbrt");
    }

    #[test]
    fn the_one_scene_of_a_folder_is_found_and_several_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let error = scene_in(folder.path()).unwrap_err().to_string();
        assert!(error.contains("holds no scene"), "{error}");
        fs::create_dir_all(at("inner/textures")).unwrap();
        fs::create_dir(at("__MACOSX")).unwrap();
        fs::write(at("inner/a.xml"), SCENE).unwrap();
        fs::write(at("inner/part.xml"), "<bsdf/>").unwrap();
        fs::write(at("inner/part.pbrt"), "Shape \"sphere\"").unwrap();
        assert_eq!(scene_in(folder.path()).unwrap(), at("inner/a.xml"));
        fs::write(at("inner/b.pbrt"), "WorldBegin").unwrap();
        let error = scene_in(folder.path()).unwrap_err().to_string();
        assert!(
            error.contains("2 scenes") && error.contains("a.xml, ") && error.contains("b.pbrt"),
            "{error}"
        );
    }
}

//! Scenes that tests render.

use anyhow::{Context, Result, anyhow};
use photonfarm_core::scene::{Limits, Scene, SceneFolder};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A scene from its XML text; it has no other files.
///
/// # Errors
/// What is wrong with it, with the text.
pub fn of_text(xml: &str) -> Result<Scene> {
    let files = BTreeMap::from([("scene.xml".to_owned(), xml.as_bytes().to_vec())]);
    Scene::load(&files, "scene.xml", &BTreeMap::new(), &Limits::default())
        .map_err(|faults| anyhow!("{faults}\nin the scene\n{xml}"))
}

/// The folder `tests/scenes`.
#[must_use]
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes")
}

/// The scene `name`.xml of `tests/scenes`, `size` pixels across and down.
///
/// # Errors
/// What is wrong with it.
pub fn named(name: &str, size: usize) -> Result<Scene> {
    let defines = BTreeMap::from([("res".to_owned(), size.to_string())]);
    let files = SceneFolder::new(&folder()).with_context(|| format!("cannot open {}", folder().display()))?;
    Scene::load(&files, &format!("{name}.xml"), &defines, &Limits::default()).map_err(|faults| anyhow!("{faults}"))
}

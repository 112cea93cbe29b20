//! The scenes that tests of integrators render.

use crate::scene::{Limits, Scene, SceneFolder};
use std::collections::BTreeMap;
use std::path::Path;

/// A scene of the tests' folder by its name, `resolution` pixels wide.
pub(super) fn load(name: &str, resolution: u32) -> Scene {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/scenes");
    let defines = BTreeMap::from([("res".to_owned(), resolution.to_string())]);
    let files = SceneFolder::new(&folder).unwrap();
    Scene::load(&files, &format!("{name}.xml"), &defines, &Limits::default()).unwrap()
}

//! The scenes of `tests/scenes` in the workspace, which tests and benches of this crate render.

use photonfarm_core::scene::{Limits, Scene, SceneFolder};
use std::collections::BTreeMap;
use std::path::Path;

/// The scene `name`.xml, `size` pixels across and down.
///
/// # Panics
/// Where it cannot be loaded.
pub(crate) fn named(name: &str, size: u32) -> Scene {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/scenes");
    let files = SceneFolder::new(&folder).expect("the folder of scenes is there");
    let defines = BTreeMap::from([("res".to_owned(), size.to_string())]);
    Scene::load(&files, &format!("{name}.xml"), &defines, &Limits::default()).expect("the scene loads")
}

//! Scenes that tests and measurements render.

use anyhow::{Context, Result, anyhow};
use photonfarm_core::scene::{Limits, Scene, SceneFiles, SceneFolder};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The scene of the file `main`, with numbers for its `<default>` parameters.
///
/// # Errors
/// What is wrong with it.
pub fn load(files: &dyn SceneFiles, main: &str, defines: &[(&str, u32)]) -> Result<Scene> {
    let defines = defines
        .iter()
        .map(|(name, value)| ((*name).to_owned(), value.to_string()));
    Scene::load(files, main, &defines.collect(), &Limits::default()).map_err(|faults| anyhow!("{faults}"))
}

/// A scene from its XML text; it has no other files.
///
/// # Errors
/// What is wrong with it, with the text.
pub fn of_text(xml: &str) -> Result<Scene> {
    let files = BTreeMap::from([("scene.xml".to_owned(), xml.as_bytes().to_vec())]);
    load(&files, "scene.xml", &[]).with_context(|| format!("in the scene\n{xml}"))
}

/// What a camera without a lens sees, through a box filter.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Where it stands [scene units], as scene files write points.
    pub origin: &'a str,
    /// What it looks at [scene units].
    pub target: &'a str,
    /// What is up.
    pub up: &'a str,
    /// Field of view across \[degrees\].
    pub fov: f32,
    /// Pixels across and down.
    pub resolution: [u32; 2],
}

/// A scene of `objects`, written in XML, and the camera that sees them.
///
/// # Errors
/// What is wrong with it, with its text.
pub fn seen(view: &View, objects: &str) -> Result<Scene> {
    let View {
        origin,
        target,
        up,
        fov,
        resolution: [width, height],
    } = view;
    of_text(&format!(
        r#"<scene version="3.0.0">
            <sensor type="perspective">
                <float name="fov" value="{fov}"/>
                <transform name="to_world"><lookat origin="{origin}" target="{target}" up="{up}"/></transform>
                <film type="hdrfilm">
                    <integer name="width" value="{width}"/><integer name="height" value="{height}"/><rfilter type="box"/>
                </film>
            </sensor>
            {objects}
        </scene>"#
    ))
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
    let files = SceneFolder::new(&folder()).with_context(|| format!("cannot open {}", folder().display()))?;
    load(&files, &format!("{name}.xml"), &[("res", size as u32)])
}

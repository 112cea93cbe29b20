//! Scenes and the files that they name.

use photonfarm_core::integrator::{Unobserved, render_iteration};
use photonfarm_core::picture::decode_exr;
use photonfarm_core::scene::{Limits, Scene, SceneError};
use photonfarm_core::settings::{IntegratorSettings, PathSettings};
use photonfarm_core::spectrum::Spectrum;
use std::collections::BTreeMap;

/// Small enough that the slowest input takes milliseconds.
fn limits() -> Limits {
    Limits {
        texels: 1 << 14,
        triangles: 1 << 10,
        vertices: 1 << 12,
        shapes: 1 << 6,
        texture_bytes: 1 << 22,
        ..Limits::default()
    }
}

/// Pixels of an image that is rendered to see whether it can be.
const PIXELS: u32 = 64;

/// Loads the scene; an error names its file.
fn load(main: &[u8], file: Option<(&str, &[u8])>) -> Option<Scene> {
    load_named("main.xml", main, file)
}

/// As [`load`], of a file whose name says its format.
fn load_named(name: &str, main: &[u8], file: Option<(&str, &[u8])>) -> Option<Scene> {
    let mut files = BTreeMap::from([(name.to_owned(), main.to_vec())]);
    files.extend(file.map(|(name, bytes)| (name.to_owned(), bytes.to_vec())));
    load_from(&files, name, &BTreeMap::new())
}

fn load_from(files: &BTreeMap<String, Vec<u8>>, main: &str, defines: &BTreeMap<String, String>) -> Option<Scene> {
    match Scene::load(files, main, defines, &limits()) {
        Ok(scene) => Some(scene),
        Err(faults) => {
            faults.all().iter().for_each(check);
            None
        }
    }
}

fn check(error: &SceneError) {
    let message = error.to_string();
    assert!(
        !error.file().is_empty() && message.starts_with(&error.place().to_string()),
        "{message}"
    );
}

/// A scene file. What loads can be rendered: no panic, and no pixel that is not a number.
pub(super) fn scene(bytes: &[u8]) {
    if let Some(scene) = load(bytes, None) {
        render(&scene);
    }
}

/// As [`scene`], in the format of pbrt.
pub(super) fn pbrt(bytes: &[u8]) {
    if let Some(scene) = load_named("main.pbrt", bytes, None) {
        render(&scene);
    }
}

/// A glTF file, as JSON or binary.
pub(super) fn gltf(bytes: &[u8]) {
    let files = BTreeMap::from([("main.gltf".to_owned(), bytes.to_vec())]);
    let defines = [("width", "8"), ("frame", "12"), ("shutter", "1")];
    let defines = defines.map(|(name, value)| (name.to_owned(), value.to_owned()));
    if let Some(scene) = load_from(&files, "main.gltf", &BTreeMap::from(defines)) {
        render(&scene);
    }
}

/// Renders a scene that is small enough.
fn render(scene: &Scene) {
    let [width, height] = scene.film.resolution;
    if u64::from(width) * u64::from(height) > u64::from(PIXELS) {
        return;
    }
    let settings = IntegratorSettings::Path(PathSettings {
        samples: 1,
        max_depth: Some(6),
        ..PathSettings::default()
    });
    if let Ok(iteration) = render_iteration(scene, &settings, 1, 1, &Unobserved) {
        let finite = |pixel: &Spectrum| pixel.to_rgb().iter().all(|value| value.is_finite() && *value >= 0.0);
        assert!(iteration.pixels.iter().all(finite), "a pixel is not finite");
    }
}

/// A scene that uses one file.
fn user(element: &str) -> Vec<u8> {
    let scene = "<scene version='3.0.0'><sensor type='perspective'/><shape type='sphere'/><emitter type='point'/>";
    format!("{scene}{element}</scene>").into_bytes()
}

fn mesh(kind: &str, bytes: &[u8]) {
    let shape = format!("<shape type='{kind}'><string name='filename' value='a.{kind}'/></shape>");
    load(&user(&shape), Some((&format!("a.{kind}"), bytes)));
}

pub(super) fn obj(bytes: &[u8]) {
    mesh("obj", bytes);
}

pub(super) fn ply(bytes: &[u8]) {
    mesh("ply", bytes);
}

pub(super) fn serialized(bytes: &[u8]) {
    mesh("serialized", bytes);
}

/// OpenEXR as an environment, and as one of our own pictures.
pub(super) fn openexr(bytes: &[u8]) {
    let light = "<emitter type='envmap'><string name='filename' value='a.exr'/></emitter>";
    load(&user(light), Some(("a.exr", bytes)));
    let _ = decode_exr(bytes, 1 << 14);
}

/// PNG, JPEG, BMP, TGA and HDR, told apart by their content.
pub(super) fn image(bytes: &[u8]) {
    let texture = "<texture name='reflectance' type='bitmap'><string name='filename' value='a.png'/></texture>";
    load(
        &user(&format!("<bsdf type='diffuse'>{texture}</bsdf>")),
        Some(("a.png", bytes)),
    );
    let light = "<emitter type='envmap'><string name='filename' value='a.tga'/></emitter>";
    load(&user(light), Some(("a.tga", bytes)));
}

/// Mitsuba's volumes, and those of OpenVDB and NanoVDB, told apart by their content.
pub(super) fn volume(bytes: &[u8]) {
    let volume = "<volume name='sigma_t' type='gridvolume'><string name='filename' value='a.vol'/></volume>";
    let medium = format!("<medium name='interior' type='heterogeneous'>{volume}</medium>");
    load(
        &user(&format!("<shape type='cube'><bsdf type='null'/>{medium}</shape>")),
        Some(("a.vol", bytes)),
    );
}

pub(super) fn spectrum(bytes: &[u8]) {
    let metal = "<bsdf type='conductor'><spectrum name='eta' filename='a.spd'/></bsdf>";
    load(&user(metal), Some(("a.spd", bytes)));
}

//! Files written here and by Blender (`tests/compare/make_gltf.py`), and what becomes of them.

mod files;
mod materials;
mod solids;

use super::*;
use crate::math::{Transform, Vec3};
use crate::scene::description::Object;
use crate::scene::mesh::RawMesh;
use crate::scene::{Limits, Scene, SceneFaults};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::path::Path;
use std::sync::Arc;

type Files = BTreeMap<String, Vec<u8>>;

fn defines(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
    pairs
        .iter()
        .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
        .collect()
}

/// A description with its warnings.
struct Described {
    description: Description,
    warnings: Vec<String>,
}

impl Described {
    fn of(files: &Files, main: &str, pairs: &[(&str, &str)]) -> Result<Self, SceneError> {
        let limits = Limits::default();
        let mut loader = Loader::new(files, &limits);
        let file = loader.open(&Place::whole(main), &[String::new()], main)?;
        let (faults, warnings) = (Rc::default(), Rc::default());
        let description = read(&mut loader, &file, &defines(pairs), &faults, &warnings)?;
        let first = faults.settle(Ok(Some(())), &Warnings::default());
        first.map_err(|faults| faults.first().clone())?;
        let warnings = warnings.take().iter().map(ToString::to_string).collect();
        Ok(Self { description, warnings })
    }

    fn all(&self, kind: Kind) -> Vec<&Object> {
        self.description
            .objects
            .iter()
            .filter(|object| object.kind == kind)
            .collect()
    }

    fn mesh(&self, number: usize) -> Arc<RawMesh> {
        match &self.all(Kind::Shape)[number].properties["mesh"].value {
            Value::Mesh(mesh) => mesh.get(),
            other => panic!("{other:?}"),
        }
    }

    fn named(&self, part: &str) -> usize {
        let shapes = self.all(Kind::Shape);
        let found = shapes
            .iter()
            .position(|shape| shape.written.as_deref().is_some_and(|name| name.contains(part)));
        found.unwrap_or_else(|| panic!("there is no {part}"))
    }

    /// The bounds of a shape in the world.
    fn bounds(&self, part: &str) -> (Vec3, Vec3) {
        let number = self.named(part);
        let to_world = still(&self.all(Kind::Shape)[number].properties["to_world"].value);
        let mesh = self.mesh(number);
        let points = mesh.positions.iter().map(|p| to_world.point(*p));
        points.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| {
            (low.min(p), high.max(p))
        })
    }
}

fn still(value: &Value) -> Transform {
    match value {
        Value::Transform(still) => **still,
        other => panic!("{other:?}"),
    }
}

fn float(object: &Object, name: &str) -> f64 {
    match object.properties[name].value {
        Value::Float(value) => value,
        ref other => panic!("{other:?}"),
    }
}

fn rgb(object: &Object, name: &str) -> [f64; 3] {
    match object.properties[name].value {
        Value::Rgb(value) => value,
        ref other => panic!("{other:?}"),
    }
}

fn near(found: &[f64], expected: &[f64], tolerance: f64) {
    let close = found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= tolerance);
    assert!(close && found.len() == expected.len(), "{found:?} is not {expected:?}");
}

/// The files that Blender made.
fn blender(name: &str) -> (Files, String) {
    let main = format!("{name}.glb");
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/scenes/gltf")
        .join(&main);
    (BTreeMap::from([(main.clone(), std::fs::read(path).unwrap())]), main)
}

fn of_blender(name: &str, pairs: &[(&str, &str)]) -> Described {
    let (files, main) = blender(name);
    Described::of(&files, &main, pairs).unwrap()
}

const PLACES: [[f32; 3]; 5] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [1.0, 1.0, 0.0],
    [2.0, 2.0, 0.0],
];

/// A buffer: five places, then the indices 0 to 4 as bytes, then bytes 255, 128, 0, 51, and the place (7, 8, 9).
fn buffer() -> Vec<u8> {
    let floats = |all: &[[f32; 3]]| all.iter().flatten().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    [
        floats(&PLACES),
        vec![0, 1, 2, 3, 4, 0, 0, 0],
        vec![255, 128, 0, 51],
        floats(&[[7.0, 8.0, 9.0]]),
    ]
    .concat()
}

/// A triangle in a file; what `changes` find in its text is replaced.
fn text(changes: &[(&str, &str)]) -> String {
    let uri = format!("data:application/octet-stream;base64,{}", STANDARD.encode(buffer()));
    let mut text = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
"nodes": [{"mesh": 0, "name": "Thing", "children": [1, 2]}, {"name": "Child"}, {"camera": 0}],
"meshes": [{"name": "Triangle", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
"materials": [{"name": "Paint", "pbrMetallicRoughness": {"metallicFactor": 0}}],
"cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1, "aspectRatio": 2}}],
"accessors": [{"bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3"},
{"bufferView": 1, "componentType": 5121, "count": 3, "type": "SCALAR"}],
"bufferViews": [{"buffer": 0, "byteLength": 60}, {"buffer": 0, "byteOffset": 60, "byteLength": 8},
{"buffer": 0, "byteOffset": 68, "byteLength": 16}],
"buffers": [{"byteLength": 84, "uri": "URI"}]}"#
        .to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    text.replace("URI", &uri)
}

fn described(changes: &[(&str, &str)]) -> Result<Described, SceneError> {
    let files = BTreeMap::from([("a.gltf".to_owned(), text(changes).into_bytes())]);
    Described::of(&files, "a.gltf", &[])
}

fn loaded(files: &Files, main: &str, pairs: &[(&str, &str)]) -> Result<Scene, SceneFaults> {
    Scene::load(files, main, &defines(pairs), &Limits::default())
}

#[test]
fn lists_strips_and_fans_cover_the_same() {
    let mode = |number: u32, count: u32| {
        let primitive = format!(r#""indices": 1, "mode": {number}"#);
        let accessor = format!(r#""componentType": 5121, "count": {count}"#);
        described(&[
            (r#""indices": 1"#, &primitive),
            (r#""componentType": 5121, "count": 3"#, &accessor),
        ])
    };
    assert_eq!(mode(4, 3).unwrap().mesh(0).triangles, [[0, 1, 2]]);
    assert_eq!(mode(5, 4).unwrap().mesh(0).triangles, [[0, 1, 2], [1, 3, 2]]);
    assert_eq!(mode(6, 4).unwrap().mesh(0).triangles, [[1, 2, 0], [2, 3, 0]]);
    let points = mode(0, 3).unwrap();
    assert!(points.all(Kind::Shape).is_empty());
    let told = r#"a.gltf: meshes[0] "Triangle" primitive 0: points and lines are left out; there are triangles"#;
    assert_eq!(points.warnings, [told]);
}

#[test]
fn accessors_may_be_sparse_strided_and_normalised() {
    let sparse = r#""type": "VEC3", "sparse": {"count": 1, "indices": {"bufferView": 1, "byteOffset": 2,
        "componentType": 5121}, "values": {"bufferView": 2, "byteOffset": 4}}"#;
    let mesh = described(&[(r#""type": "VEC3""#, sparse)]).unwrap().mesh(0);
    let mut expected = PLACES.map(Vec3::from_array);
    expected[2] = Vec3::new(7.0, 8.0, 9.0);
    assert_eq!(mesh.positions, expected);
    // The same bytes as normalised numbers, one byte apart: 255, 128, 0 and 128, 0, 51.
    let quantised = [
        (
            r#"{"bufferView": 0, "componentType": 5126, "count": 5"#,
            r#"{"bufferView": 2, "componentType": 5121, "normalized": true, "count": 3"#,
        ),
        (
            r#""byteOffset": 68, "byteLength": 16"#,
            r#""byteOffset": 67, "byteLength": 5, "byteStride": 1"#,
        ),
    ];
    let mesh = described(&quantised).unwrap().mesh(0);
    assert_eq!(mesh.positions[1], Vec3::new(1.0, 128.0 / 255.0, 0.0));
    assert_eq!(mesh.positions[2], Vec3::new(128.0 / 255.0, 0.0, 51.0 / 255.0));
}

#[test]
fn buffers_may_lie_beside_the_file_and_in_a_glb() {
    let folder = text(&[("URI", "a%20b.bin")]);
    let files = BTreeMap::from([
        ("in/a.gltf".to_owned(), folder.into_bytes()),
        ("in/a b.bin".to_owned(), buffer()),
    ]);
    let beside = Described::of(&files, "in/a.gltf", &[]).unwrap();
    let mut json = text(&[(r#", "uri": "URI""#, "")]).into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF".to_vec();
    let chunk = |glb: &mut Vec<u8>, kind: &[u8; 4], content: &[u8]| {
        glb.extend((content.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(content);
    };
    glb.extend(2_u32.to_le_bytes());
    glb.extend(0_u32.to_le_bytes());
    chunk(&mut glb, b"JSON", &json);
    chunk(&mut glb, b"BIN\0", &buffer());
    let within = Described::of(&BTreeMap::from([("a".to_owned(), glb)]), "a", &[]).unwrap();
    let plain = described(&[]).unwrap();
    assert_eq!(*plain.mesh(0), *beside.mesh(0));
    assert_eq!(*plain.mesh(0), *within.mesh(0));
}

#[test]
fn an_extension_that_is_required_and_not_known_is_told() {
    let required = described(&[(
        r#""scene": 0"#,
        r#""extensionsRequired": ["EXT_unheard_of"], "scene": 0"#,
    )])
    .unwrap();
    assert_eq!(required.warnings.len(), 1, "{:?}", required.warnings);
    assert!(required.warnings[0].contains("EXT_unheard_of is not known here"));
}

/// Candela and lux are watts of 683 lumens, as Blender exports them: 300 W of a point in all directions are 300 / (4 pi) a steradian.
#[test]
fn lights_of_blender_have_its_watts_again() {
    let scene = of_blender("point", &[]);
    let per_steradian = 300.0 / (4.0 * std::f64::consts::PI);
    near(
        &rgb(scene.all(Kind::Emitter)[0], "intensity"),
        &[per_steradian; 3],
        1e-4,
    );
    let scene = of_blender("sun", &[]);
    near(&rgb(scene.all(Kind::Emitter)[0], "irradiance"), &[3.0; 3], 1e-5);
    // It shines along -z of its node, and Blender's z is the y of glTF.
    let to_world = still(&scene.all(Kind::Emitter)[0].properties["to_world"].value);
    let direction = to_world.vector(Vec3::Z);
    assert!(
        direction.y < -0.7 && (direction.length() - 1.0).abs() < 1e-6,
        "{direction}"
    );
    let scene = of_blender("spot", &[]);
    let spot = scene.all(Kind::Emitter)[0];
    near(
        &[float(spot, "cutoff_angle"), float(spot, "beam_width")],
        &[0.6_f64.to_degrees(), 0.588_f64.to_degrees()],
        1e-4,
    );
}

#[test]
fn the_camera_is_that_of_blender_and_its_picture_is_as_wide_as_asked() {
    let (files, main) = blender("point");
    let scene = loaded(&files, &main, &[]).unwrap();
    assert_eq!(scene.film.resolution, [768, 576]);
    let ray = scene
        .sensor
        .ray(crate::math::Vec2::new(384.0, 288.0), crate::math::Vec2::ZERO);
    // From (0, -6.5, 2.5) to (0, 0, 1) in Blender, whose (x, y, z) is (x, z, -y) in glTF.
    let expected = Vec3::new(0.0, -1.5, -6.5).normalize();
    assert!((ray.direction - expected).length() < 1e-4, "{ray:?}");
    let right = scene
        .sensor
        .ray(crate::math::Vec2::new(768.0, 288.0), crate::math::Vec2::ZERO)
        .direction;
    // 36 mm of film behind 35 mm.
    let half = libm::atanf(18.0 / 35.0);
    assert!(
        right.x > 0.0 && (right.angle_between(expected) - half).abs() < 1e-4,
        "{right}"
    );
    assert_eq!(
        loaded(&files, &main, &[("width", "160")]).unwrap().film.resolution,
        [160, 120]
    );
}

#[test]
fn definitions_that_do_not_exist_or_are_no_numbers_are_refused() {
    let (files, main) = blender("point");
    for (name, value, told) in [
        ("frames", "1", "unknown parameter `frames`; did you mean `frame`?"),
        ("frame", "one", "definitions `frame`: `one` is not a number"),
        ("width", "0", "definitions `width`: `0` is not a number"),
        ("shutter", "-1", "definitions `shutter`: `-1` is not a number"),
    ] {
        let error = loaded(&files, &main, &[(name, value)]).unwrap_err().to_string();
        assert!(error.contains(told), "{error}");
    }
}

/// Heights of the bent bar and of the cube with a shape key, and the place of the ball, as Blender has them at the frames.
#[test]
fn skins_shape_keys_and_nodes_are_those_of_the_frame() {
    let top = |frame: &str, part: &str| f64::from(of_blender("arm", &[("frame", frame)]).bounds(part).1.y);
    near(
        &[top("0", "Box"), top("12", "Box"), top("24", "Box")],
        &[1.0, 1.5, 2.0],
        2e-3,
    );
    assert!((top("0", "Bar") - 2.4).abs() < 1e-3);
    assert!(top("24", "Bar") < 2.2);
    let left = |frame: &str| {
        let (low, high) = of_blender("arm", &[("frame", frame)]).bounds("Ball");
        f64::from(0.5 * (low.x + high.x))
    };
    near(&[left("0"), left("24"), left("99")], &[0.3, 1.8, 1.8], 1e-3);
}

#[test]
fn an_open_shutter_blurs_what_moves() {
    let scene = of_blender("arm", &[("frame", "12"), ("shutter", "2")]);
    let moving = |part: &str| {
        let shape = scene.all(Kind::Shape)[scene.named(part)];
        matches!(shape.properties["to_world"].value, Value::Animation(_))
    };
    assert!(moving("Ball") && !moving("Plane"));
    let sensor = scene.all(Kind::Sensor)[0];
    near(
        &[float(sensor, "shutter_open"), float(sensor, "shutter_close")],
        &[11.0 / 24.0, 13.0 / 24.0],
        1e-12,
    );
    assert!(
        scene.warnings.iter().any(|told| told.contains("only places blur")),
        "{:?}",
        scene.warnings
    );
    let (files, main) = blender("arm");
    let built = loaded(&files, &main, &[("frame", "12"), ("shutter", "2")]).unwrap();
    assert!(built.motion.is_some());
}

#[test]
fn all_files_of_blender_load() {
    for (name, shapes, lamps) in [
        ("diffuse-box", 8, 2),
        ("lights", 3, 0),
        ("point", 2, 0),
        ("sun", 2, 0),
        ("spot", 2, 0),
        ("dielectrics", 7, 2),
        ("metals", 7, 2),
        ("glass", 7, 2),
        ("textures", 7, 2),
        ("normal-map", 6, 2),
        ("instances", 14, 2),
        ("arm", 7, 2),
    ] {
        let (files, main) = blender(name);
        let scene = loaded(&files, &main, &[]).unwrap_or_else(|faults| panic!("{name}: {faults}"));
        let found = scene.bindings.iter().filter(|binding| binding.light.is_some()).count();
        assert_eq!((scene.bindings.len(), found), (shapes, lamps), "{name}");
    }
}

#[test]
fn a_mesh_of_several_nodes_is_one_group() {
    let scene = of_blender("instances", &[]);
    let of_type = |plugin: &str| {
        scene
            .all(Kind::Shape)
            .iter()
            .filter(|shape| shape.plugin == plugin)
            .count()
    };
    assert_eq!((of_type("shapegroup"), of_type("instance"), of_type("mesh")), (1, 9, 5));
}

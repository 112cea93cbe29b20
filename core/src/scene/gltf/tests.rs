//! Files written here and by Blender (`tests/compare/make_gltf.py`), and what becomes of them.

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

/// What is wrong is told with its place in the JSON.
#[test]
fn broken_files_are_refused_with_the_place_in_the_json() {
    for (from, to, told) in [
        (r#""2.0""#, r#""1.0""#, "asset.version: version 1.0"),
        (
            r#""count": 5"#,
            r#""count": "five""#,
            "a.gltf:6: accessors[0].count: invalid type",
        ),
        (r#""count": 5"#, r#""count": 6"#, "accessors[0]: 6 elements of 12 bytes"),
        (
            r#""count": 5"#,
            r#""count": 18446744073709551615"#,
            "number of vertices of the scene: 18446744073709551615 is over",
        ),
        (
            r#""count": 3"#,
            r#""count": 4294967295"#,
            "accessors[1]: 4294967295 elements of 1 bytes",
        ),
        (
            r#""type": "VEC3""#,
            r#""type": "VEC2""#,
            "accessors[0].type: type VEC2 does not fit",
        ),
        (
            r#""type": "VEC3""#,
            r#""type": "VEC5""#,
            "accessors[0].type: there is no type `VEC5`",
        ),
        (
            r#""componentType": 5126"#,
            r#""componentType": 5124"#,
            "there is no component type 5124",
        ),
        (
            r#""POSITION": 0"#,
            r#""POSITION": 9"#,
            "meshes[0].primitives[0]: there is no accessor 9; the file has 2",
        ),
        (r#""indices": 1"#, r#""indices": 0"#, "takes single unsigned integers"),
        (
            r#""bufferView": 0,"#,
            r#""bufferView": 7,"#,
            "there is no buffer view 7",
        ),
        (
            r#""byteLength": 60"#,
            r#""byteLength": 6000"#,
            "bufferViews[0]: bytes 0 and 6000 more reach beyond",
        ),
        (
            r#""buffer": 0, "byteLength": 60"#,
            r#""buffer": 3, "byteLength": 60"#,
            "bufferViews[0]: there is no buffer 3",
        ),
        (
            r#""byteLength": 84"#,
            r#""byteLength": 85"#,
            "buffers[0].byteLength: it tells 85 bytes, and there are 84",
        ),
        (
            r#""children": [1, 2]"#,
            r#""children": [1, 5]"#,
            "nodes[0].children: there is no node 5; the file has 3",
        ),
        (
            r#""children": [1, 2]"#,
            r#""children": [0]"#,
            "nodes[0]: the node has two parents or is its own ancestor",
        ),
        (
            r#""children": [1, 2]"#,
            r#""children": [1, 1]"#,
            "nodes[1]: the node has two parents",
        ),
        (
            r#"{"name": "Child"}"#,
            r#"{"children": [0]}"#,
            "nodes[0]: the node has two parents or is its own ancestor",
        ),
        (
            r#""nodes": [0]"#,
            r#""nodes": [8]"#,
            "scenes[0].nodes: there is no node 8",
        ),
        (r#""scene": 0"#, r#""scene": 4"#, "scene: there is no scene 4"),
        (r#""mesh": 0"#, r#""mesh": 2"#, "nodes[0].mesh: there is no mesh 2"),
        (
            r#""material": 0"#,
            r#""material": 2"#,
            "meshes[0].primitives[0].material: there is no material 2",
        ),
        (
            r#""camera": 0"#,
            r#""camera": 2"#,
            "nodes[2].camera: there is no camera 2",
        ),
        (
            r#""camera": 0"#,
            r#""mesh": 0, "skin": 3"#,
            "nodes[2].skin: there is no skin 3",
        ),
        (
            r#""metallicFactor": 0"#,
            r#""baseColorTexture": {"index": 0}"#,
            "there is no texture 0",
        ),
        ("base64,", "base65,", "buffers[0].uri: a data URI must be"),
        ("base64,", "base64,*", "buffers[0].uri: broken base64"),
        (r#"{"asset""#, r#""asset""#, "a.gltf:1: not glTF"),
        (
            r#""name": "Child""#,
            r#""matrix": [0,0,0,1,0,0,0,1,0,0,0,1,0,0,0,2]"#,
            "nodes[1].matrix: the last row",
        ),
    ] {
        let content = text(&[]);
        assert!(content.contains(from), "{from}");
        let files = BTreeMap::from([("a.gltf".to_owned(), content.replace(from, to).into_bytes())]);
        let error = Described::of(&files, "a.gltf", &[])
            .err()
            .unwrap_or_else(|| panic!("{to} is taken"));
        assert!(error.to_string().contains(told), "{error}\n{told}");
    }
}

/// A ball as Blender exports it, and the same compressed: Draco rounds places to 14 bits and normals to 10, and reorders vertices.
#[test]
fn compressed_meshes_are_those_that_were_compressed() {
    let [plain, meshopt, draco] = ["packed", "packed-meshopt", "packed-draco"].map(|name| {
        let described = of_blender(name, &[]);
        assert_eq!(described.warnings, [""; 0]);
        described.mesh(0)
    });
    assert_eq!(meshopt.positions, plain.positions);
    assert_eq!(meshopt.normals, plain.normals);
    assert_eq!(meshopt.uvs, plain.uvs);
    assert_eq!(meshopt.triangles.len(), plain.triangles.len());
    // The corners of a triangle may be turned round.
    for (a, b) in meshopt.triangles.iter().zip(&plain.triangles) {
        assert!(
            (0..3).any(|turn| [0, 1, 2].map(|i| a[(i + turn) % 3]) == *b),
            "{a:?} {b:?}"
        );
    }
    assert_eq!(draco.triangles.len(), plain.triangles.len());
    assert_eq!(draco.positions.len(), plain.positions.len());
    for (i, position) in draco.positions.iter().enumerate() {
        let same = |j: &usize| {
            (plain.positions[*j] - *position).length() < 3e-4
                && (plain.normals[*j] - draco.normals[i]).length() < 5e-3
                && (plain.uvs[*j] - draco.uvs[i]).length() < 1e-3
        };
        assert!((0..plain.positions.len()).any(|j| same(&j)), "vertex {i}");
    }
    let area = |mesh: &RawMesh| {
        let areas = mesh.triangles.iter().map(|corners| {
            let [a, b, c] = corners.map(|corner| mesh.positions[corner as usize]);
            0.5 * (b - a).cross(c - a).length()
        });
        areas.sum::<f32>()
    };
    assert!((area(&draco) / area(&plain) - 1.0).abs() < 1e-3);
}

/// Whatever is cut off or changed in compressed data, the file is read or refused, and what it is refused for is said.
#[test]
fn broken_compressed_meshes_are_refused() {
    for name in ["packed-draco", "packed-meshopt"] {
        let (files, main) = blender(name);
        let whole = &files[&main];
        let json = u32::from_le_bytes([whole[12], whole[13], whole[14], whole[15]]) as usize;
        let mut refused = 0;
        for at in (28 + json..whole.len()).step_by(7) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x5a;
            let files = BTreeMap::from([(main.clone(), bytes)]);
            if let Err(error) = Described::of(&files, &main, &[]) {
                assert!(error.to_string().starts_with(&main), "{error}");
                refused += 1;
            }
        }
        assert!(refused > 10, "{name}: {refused}");
    }
    let (files, main) = blender("packed-meshopt");
    let changed = |from: &str, to: &str| {
        let text = files[&main].clone();
        let at = text.windows(from.len()).position(|part| part == from.as_bytes());
        let at = at.unwrap_or_else(|| panic!("{from}"));
        let mut bytes = text;
        bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
        let files = BTreeMap::from([(main.clone(), bytes)]);
        Described::of(&files, &main, &[]).err().map(|error| error.to_string())
    };
    for (from, to, told) in [
        (
            "ATTRIBUTES",
            "attributes",
            "there is no mode `attributes`; allowed: ATTRIBUTES, TRIANGLES, INDICES",
        ),
        (
            "\"byteStride\":12",
            "\"byteStride\":13",
            "bufferViews[0].EXT_meshopt_compression: its data cannot be unpacked",
        ),
        (
            "\"mode\":\"TRIANGLES\"",
            "\"node\":\"TRIANGLES\"",
            "missing field `mode`",
        ),
    ] {
        let error = changed(from, to).unwrap_or_else(|| panic!("{to} is taken"));
        assert!(error.contains(told), "{error}\n{told}");
    }
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

#[test]
fn colours_of_vertices_are_linear_and_multiply_the_base_colour() {
    let coloured = [
        (r#""POSITION": 0"#, r#""POSITION": 0, "COLOR_0": 2"#),
        (
            r#""count": 3, "type": "SCALAR"}"#,
            r#""count": 3, "type": "SCALAR"},
{"bufferView": 2, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC4"}"#,
        ),
        (
            r#""componentType": 5126, "count": 5"#,
            r#""componentType": 5126, "count": 3"#,
        ),
    ];
    let scene = described(&coloured).unwrap();
    let attribute = &scene.mesh(0).attributes[0];
    assert_eq!(attribute.name, "vertex_color");
    let first = attribute.values[0].to_rgb();
    assert_eq!(first, [1.0, 128.0 / 255.0, 0.0]);
    let textures: Vec<&str> = scene
        .all(Kind::Texture)
        .iter()
        .map(|texture| texture.plugin.as_str())
        .collect();
    assert_eq!(textures, ["mesh_attribute", "scale"]);
}

/// Plugins by the material: clear glass and smooth metal have their own.
#[test]
fn materials_become_the_plugins_that_are_made_for_them() {
    let plugins = |changes: &str, extensions: &str| {
        let material = format!(r#"{{"name": "Paint", {extensions} "pbrMetallicRoughness": {{{changes}}}}}"#);
        let found = described(&[(
            r#"{"name": "Paint", "pbrMetallicRoughness": {"metallicFactor": 0}}"#,
            &material,
        )]);
        let found = found.unwrap();
        let mut names: Vec<String> = found.all(Kind::Bsdf).iter().map(|bsdf| bsdf.plugin.clone()).collect();
        names.extend(found.all(Kind::Emitter).iter().map(|emitter| emitter.plugin.clone()));
        names.join(" ")
    };
    let glass =
        r#""extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {}},"#;
    let pane = r#""extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}},"#;
    let matt = r#""extensions": {"KHR_materials_specular": {"specularFactor": 0}},"#;
    let unlit = r#""extensions": {"KHR_materials_unlit": {}},"#;
    for (changes, extensions, expected) in [
        (r#""metallicFactor": 0"#, "", "principled twosided"),
        ("", "", "principled twosided"),
        (r#""metallicFactor": 0"#, matt, "diffuse twosided"),
        (r#""roughnessFactor": 0"#, "", "conductor twosided"),
        (r#""metallicFactor": 0, "roughnessFactor": 0"#, glass, "dielectric"),
        (r#""metallicFactor": 0"#, glass, "roughdielectric"),
        (r#""metallicFactor": 0"#, pane, "principledthin"),
        ("", unlit, "diffuse twosided area"),
        ("", r#""emissiveFactor": [1, 0, 0],"#, "principled twosided area"),
        (
            r#""baseColorFactor": [1, 1, 1, 0.5]"#,
            r#""alphaMode": "BLEND","#,
            "principled twosided mask",
        ),
        (
            r#""baseColorFactor": [1, 1, 1, 0.5]"#,
            r#""alphaMode": "MASK","#,
            "principled twosided",
        ),
        (r#""baseColorFactor": [1, 1, 1, 0.5]"#, "", "principled twosided"),
    ] {
        assert_eq!(plugins(changes, extensions), expected, "{changes} {extensions}");
    }
}

/// The cutoff of MASK, and the scale of a normal texture, are worked into the image.
#[test]
fn masks_are_cut_and_normals_steepened_in_the_image() {
    let (files, main) = blender("textures");
    let json = String::from_utf8_lossy(&files[&main]).into_owned();
    assert!(json.contains(r#""alphaMode":"BLEND""#));
    let mut bytes = files[&main].clone();
    let at = json.find(r#""alphaMode":"BLEND""#).unwrap();
    bytes[at..at + 19].copy_from_slice(br#""alphaMode":"MASK" "#);
    let scene = Described::of(&BTreeMap::from([(main.clone(), bytes)]), &main, &[]).unwrap();
    let mask = scene
        .all(Kind::Bsdf)
        .into_iter()
        .find(|bsdf| bsdf.plugin == "mask")
        .unwrap();
    let opacity = mask
        .children
        .iter()
        .find(|child| child.name.as_deref() == Some("opacity"))
        .unwrap();
    let Value::File(file) = &scene.description.objects[opacity.target].properties["filename"].value else {
        panic!("{mask:?}");
    };
    // Blender's leaf is opaque in its middle and clear at its corners.
    let levels = image::load_from_memory(&file.bytes).unwrap().into_luma8();
    assert_eq!((levels.get_pixel(16, 16).0, levels.get_pixel(0, 0).0), ([255], [0]));
    let steeper = texture::Change::Steeper { scale: 2.0 };
    // A slope of 3/4 in x, and of 0 in y, becomes one of 3/2.
    let encoded = |c: f64| ((0.5 * c + 0.5) * 65535.0).round() as u16;
    let [x, y, z, _] = steeper.pixel([encoded(0.6), encoded(0.0), encoded(0.8), 9]);
    let length = libm::sqrt(1.5 * 1.5 + 1.0);
    let expected = [1.5 / length, 0.0, 1.0 / length].map(encoded);
    near(&[x, y, z].map(f64::from), &expected.map(f64::from), 2.0);
}

/// A turn of the coordinates is against the clock as the picture is seen: u' = c u + s v and v' = c v - s u, as Blender's importer and the
/// sample viewer of Khronos have it.
#[test]
fn texture_coordinates_are_scaled_turned_and_moved() {
    let transform = document::TextureTransform {
        offset: [0.25, 0.5],
        rotation: std::f64::consts::FRAC_PI_2,
        scale: [2.0, 3.0],
        tex_coord: None,
    };
    let map = texture::to_uv(&transform).unwrap();
    let at = map.point(Vec3::new(1.0, 1.0, 0.0));
    assert!((at - Vec3::new(3.25, -1.5, 0.0)).length() < 1e-6, "{at}");
}

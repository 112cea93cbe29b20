//! Files that are broken, and files that are compressed.

use super::*;

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

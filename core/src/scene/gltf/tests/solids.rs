//! Solids within each other.

use super::*;
use crate::medium::tests::{agrees, estimate, path};

/// Eight corners of a cube from -1 to 1 as floats, and the corners of twelve triangles as bytes.
fn cube() -> Vec<u8> {
    let corners =
        (0..8).flat_map(|corner| (0..3).map(move |axis| if corner >> axis & 1 == 0 { -1.0_f32 } else { 1.0 }));
    let triangles: [u8; 36] = [
        0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5,
    ];
    corners.flat_map(f32::to_le_bytes).chain(triangles).collect()
}

/// A block of glass that holds a drink with two pieces of ice, of which there is one mesh, all of an index, seen along a line through them.
fn drink(index: f64) -> String {
    let colors = ["[0.9, 0.5, 0.8]", "[0.5, 0.6, 0.7]", "[0.8, 0.9, 0.6]"];
    let materials = colors.map(|color| {
        format!(
            r#"{{"pbrMetallicRoughness": {{"metallicFactor": 0, "roughnessFactor": 0}}, "extensions": {{
            "KHR_materials_transmission": {{"transmissionFactor": 1}}, "KHR_materials_ior": {{"ior": {index}}},
            "KHR_materials_volume": {{"thicknessFactor": 1, "attenuationDistance": 1, "attenuationColor": {color}}}}}}}"#
        )
    });
    let meshes = [0, 1, 2].map(|material| {
        format!(r#"{{"primitives": [{{"attributes": {{"POSITION": 0}}, "indices": 1, "material": {material}}}]}}"#)
    });
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0, 1, 2, 3, 4]}}],
"nodes": [{{"mesh": 0}}, {{"mesh": 1, "scale": [0.8, 0.8, 0.8]}},
{{"mesh": 2, "scale": [0.2, 0.3, 0.2], "translation": [0, 0, 0.4]}}, {{"mesh": 2, "scale": [0.2, 0.2, 0.2], "translation": [0.1, 0, -0.3]}},
{{"camera": 0, "translation": [0.02, 0.03, 5]}}],
"meshes": [{}], "materials": [{}],
"cameras": [{{"type": "perspective", "perspective": {{"yfov": 0.0001, "znear": 0.1, "aspectRatio": 1}}}}],
"accessors": [{{"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3", "min": [-1, -1, -1], "max": [1, 1, 1]}},
{{"bufferView": 1, "componentType": 5121, "count": 36, "type": "SCALAR"}}],
"bufferViews": [{{"buffer": 0, "byteLength": 96}}, {{"buffer": 0, "byteOffset": 96, "byteLength": 36}}],
"buffers": [{{"byteLength": 132, "uri": "data:application/octet-stream;base64,{}"}}]}}"#,
        meshes.join(","),
        materials.join(","),
        STANDARD.encode(cube())
    )
}

/// Beer's law by the lengths of the line in each, and where there is an index, what the glass reflects: between solids of one index is no surface.
#[test]
fn the_inner_of_solids_holds() {
    let lengths = [0.4, 0.8, 0.8];
    let colors = [[0.9, 0.5, 0.8], [0.5, 0.6, 0.7], [0.8, 0.9, 0.6_f64]];
    for index in [1.0, 1.5] {
        let files = BTreeMap::from([("a.gltf".to_owned(), drink(index).into_bytes())]);
        let scene = loaded(&files, "a.gltf", &[("width", "1")]).unwrap();
        assert_eq!(scene.media.as_ref().unwrap().bodies.len(), 3);
        // By paths that go straight through, or are reflected by the first surface.
        let found = estimate(&scene, &path(1 << 12, Some(3)), 16);
        let reflected: f64 = ((index - 1.0) / (index + 1.0)).powi(2);
        for (channel, found) in found.into_iter().enumerate() {
            let passed: f64 = (0..3)
                .map(|solid| colors[solid][channel].powf(lengths[solid]))
                .product();
            let expected = reflected + (1.0 - reflected).powi(2) * passed;
            agrees(&format!("index {index}, channel {channel}"), found, expected, 1e-3);
        }
    }
}

/// Solids that stand apart are ordinary boundaries.
#[test]
fn solids_that_stand_apart_are_no_bodies() {
    let text = drink(1.5).replace(r#""nodes": [0, 1, 2, 3, 4]"#, r#""nodes": [2, 3, 4]"#);
    let files = BTreeMap::from([("a.gltf".to_owned(), text.into_bytes())]);
    let scene = loaded(&files, "a.gltf", &[]).unwrap();
    assert!(scene.media.as_ref().unwrap().bodies.is_empty());
    assert!(scene.bindings.iter().any(|binding| binding.boundary.is_some()));
}

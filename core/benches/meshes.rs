//! Reading large meshes.
//!
//!     cargo bench -p photonfarm-core --bench meshes
//!
//! `divan` prints bytes per second of one thread and the most memory that was taken besides the file. Each scene names a file that is not there after its mesh, so that
//! loading ends before the hierarchy is built. The mesh is a square of triangles, as many as the environment variable `TRIANGLES` says.

use bytes::Bytes;
use divan::counter::BytesCount;
use divan::{AllocProfiler, Bencher};
use photonfarm_core::scene::{Limits, Scene};
use std::collections::BTreeMap;
use std::fmt::Write;

#[global_allocator]
static ALLOCATED: AllocProfiler = AllocProfiler::system();

const FORMATS: [&str; 4] = ["ply", "binary.ply", "obj", "pbrt"];

fn main() {
    divan::main();
}

/// Vertices and triangles of a wavy square.
fn square() -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let triangles: f64 = std::env::var("TRIANGLES").map_or(1e6, |text| text.parse().expect("a number"));
    let side = (triangles / 2.0).sqrt() as u32;
    let place = |at: u32| [at % (side + 1), at / (side + 1)];
    let vertices = (0..(side + 1) * (side + 1)).map(|at| {
        let [x, y] = place(at).map(|step| step as f32 / side as f32);
        [x, y, x * y * (1.0 - x) * (1.0 - y)]
    });
    let triangles = (0..side * side).flat_map(|cell| {
        let at = cell % side + cell / side * (side + 1);
        [[at, at + 1, at + side + 1], [at + 1, at + side + 2, at + side + 1]]
    });
    (vertices.collect(), triangles.collect())
}

/// A scene of the mesh in a format, its main file and the bytes that are read.
fn scene(format: &str) -> (BTreeMap<String, Bytes>, String, usize) {
    let (vertices, triangles) = square();
    let mut text = String::new();
    let lines = |text: &mut String, before: &str, rows: &mut dyn Iterator<Item = [String; 3]>| {
        rows.for_each(|row| writeln!(text, "{before}{}", row.join(" ")).expect("text grows"));
    };
    let mut points = vertices
        .iter()
        .map(|vertex| vertex.map(|number| format!("{number:.6}")));
    let mut corners = triangles.iter().map(|triangle| triangle.map(|index| index.to_string()));
    let header = |encoding| {
        format!(
            "ply\nformat {encoding} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {}\nproperty list uchar int vertex_indices\nend_header\n",
            vertices.len(),
            triangles.len()
        )
    };
    let mut bytes = Vec::new();
    match format {
        "obj" => {
            lines(&mut text, "v ", &mut points);
            let from_1 = |triangle: &[u32; 3]| triangle.map(|index| (index + 1).to_string());
            lines(&mut text, "f ", &mut triangles.iter().map(from_1));
        }
        "ply" => {
            text = header("ascii");
            lines(&mut text, "", &mut points);
            lines(&mut text, "3 ", &mut corners);
        }
        "pbrt" => {
            text = "WorldBegin\nShape \"trianglemesh\" \"point3 P\" [\n".to_owned();
            lines(&mut text, "", &mut points);
            text += "] \"integer indices\" [\n";
            lines(&mut text, "", &mut corners);
            text += "]\nShape \"plymesh\" \"string filename\" \"missing.ply\"\n";
        }
        _ => {
            bytes = header("binary_little_endian").into_bytes();
            bytes.extend(vertices.iter().flatten().flat_map(|number| number.to_le_bytes()));
            for triangle in &triangles {
                bytes.push(3);
                bytes.extend(triangle.iter().flat_map(|index| index.to_le_bytes()));
            }
        }
    }
    bytes.extend(text.into_bytes());
    let (length, main) = (bytes.len(), if format == "pbrt" { "mesh.pbrt" } else { "scene.xml" });
    let mut files = BTreeMap::from([(format!("mesh.{format}"), bytes.into())]);
    if main == "scene.xml" {
        let plugin = if format == "obj" { "obj" } else { "ply" };
        let shape = |file: &str| {
            format!(
                "<shape type=\"{plugin}\"><string name=\"filename\" value=\"{file}\"/>\
                 <boolean name=\"face_normals\" value=\"true\"/></shape>"
            )
        };
        let xml = format!(
            "<scene version=\"3.0.0\">{}{}</scene>",
            shape(&format!("mesh.{format}")),
            shape("missing")
        );
        files.insert(main.to_owned(), xml.into());
    }
    (files, main.to_owned(), length)
}

/// Reads the mesh; items are bytes of its file.
#[divan::bench(args = FORMATS, sample_count = 5, sample_size = 1)]
fn read(bencher: Bencher, format: &str) {
    let (files, main, length) = scene(format);
    bencher.counter(BytesCount::new(length)).bench_local(|| {
        let faults = Scene::load(&files, &main, &BTreeMap::new(), &Limits::default()).err();
        assert!(
            faults.is_some_and(|faults| faults.first().to_string().contains("missing")),
            "only the missing file is a fault"
        );
    });
}

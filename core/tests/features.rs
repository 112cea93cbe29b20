//! What of each format is rendered: `features.txt` writes every feature in the formats that have it, and the table in docs/SCENES.md is
//! what the program says to these scenes.
//!
//!     UPDATE=1 cargo test --release -p photonfarm-core --test features
//!
//! writes the table anew.

use flate2::Compression;
use flate2::write::GzEncoder;
use photonfarm_core::scene::{Limits, Scene};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// The formats, in the order of the table's columns.
const FORMATS: [&str; 3] = ["mitsuba", "pbrt", "gltf"];

/// A feature, written in each format that has it.
struct Feature<'a> {
    name: &'a str,
    written: [Option<&'a str>; 3],
}

/// What the program says to a scene.
#[derive(Debug, PartialEq)]
enum Answer {
    /// Nothing: it is rendered as it is written.
    Rendered,
    /// Warnings, none of which says that something is left out.
    Approximated(String),
    /// Warnings, of which one says so.
    LeftOut(String),
    /// That it cannot be rendered.
    Refused(String),
}

/// The rooms of the list with their features.
fn features(text: &str) -> Vec<(&str, Vec<Feature<'_>>)> {
    let mut rooms: Vec<(&str, Vec<Feature>)> = Vec::new();
    for line in text.lines().filter(|line| !line.is_empty() && !line.starts_with("# ")) {
        if let Some(room) = line.strip_prefix("== ") {
            rooms.push((room, Vec::new()));
            continue;
        }
        let features = &mut rooms.last_mut().expect("a room begins before its features").1;
        if let Some(name) = line.strip_prefix("-- ") {
            features.push(Feature {
                name,
                written: [None; 3],
            });
            continue;
        }
        let (format, written) = line.split_once(": ").expect("a format, a colon and a scene");
        let column = FORMATS.iter().position(|known| *known == format);
        let feature = features.last_mut().expect("a name stands before its scenes");
        feature.written[column.expect(line)] = Some(written);
    }
    rooms
}

/// Files that scenes name.
fn files() -> BTreeMap<String, Vec<u8>> {
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
               property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let obj = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n";
    let ies = "IESNA:LM-63-1995\nTILT=NONE\n1 1000 1 2 1 1 2 0 0 0\n1 1 50\n0 90\n0\n100 50\n";
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(2, 2, image::Rgb([128; 3]))
        .write_to(&mut png, image::ImageFormat::Png)
        .unwrap();
    let pfm = |width: usize, height: usize| {
        let mut bytes = format!("PF\n{width} {height}\n-1.0\n").into_bytes();
        bytes.extend((0..width * height * 3).flat_map(|_| 0.5_f32.to_le_bytes()));
        bytes
    };
    let mut lattice = b"VOL\x03".to_vec();
    lattice.extend([1, 1, 1, 1, 1].iter().flat_map(|number: &i32| number.to_le_bytes()));
    let numbers = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.5_f32];
    lattice.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(ply.as_bytes()).unwrap();
    // Three positions, the indices 0, 1 and 2, and the times 0 to 2.
    let positions = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut triangle: Vec<u8> = positions.iter().flat_map(|x| x.to_le_bytes()).collect();
    triangle.extend([0_u16, 1, 2, 0].iter().flat_map(|i| i.to_le_bytes()));
    triangle.extend([0.0_f32, 1.0, 2.0].iter().flat_map(|t| t.to_le_bytes()));
    [
        (
            "part.xml",
            "<scene version='3.0.0'><shape type='sphere'/></scene>"
                .as_bytes()
                .to_vec(),
        ),
        ("part.pbrt", b"Shape \"sphere\"".to_vec()),
        ("mesh.ply", ply.into()),
        ("mesh.ply.gz", packed.finish().unwrap()),
        ("mesh.obj", obj.into()),
        ("curve.txt", b"0 0 0 0.1\n0 0 1 0.1\n0 1 1 0.1\n1 1 1 0.1\n".to_vec()),
        ("image.pfm", pfm(4, 2)),
        ("square.pfm", pfm(2, 2)),
        ("image.png", png.into_inner()),
        ("fog.vol", lattice),
        // What is packed is unpacked when it is read.
        (
            "fog.vdb",
            include_bytes!("../src/scene/volume/tests/fog.vdb.gz").to_vec(),
        ),
        (
            "fog.nvdb",
            include_bytes!("../src/scene/volume/tests/fog-zip.nvdb.gz").to_vec(),
        ),
        ("lamp.ies", ies.into()),
        ("triangle.bin", triangle),
    ]
    .map(|(name, bytes)| (name.to_owned(), bytes))
    .into()
}

/// A scene of Mitsuba around something: a BSDF gets a shape, a texture a BSDF, a film a sensor.
fn mitsuba(written: &str) -> String {
    let film = "<film type='hdrfilm'><integer name='width' value='8'/><integer name='height' value='8'/></film>";
    let light = if written == "-" { "" } else { "<emitter type='point'/>" };
    let (sensor, rest) = if written.starts_with("<sensor") {
        (written.to_owned(), String::new())
    } else if ["<film", "<sampler"].iter().any(|part| written.starts_with(part)) {
        (format!("<sensor type='perspective'>{written}</sensor>"), String::new())
    } else if written.starts_with("<rfilter") {
        let film = format!("<film type='hdrfilm'>{written}</film>");
        (format!("<sensor type='perspective'>{film}</sensor>"), String::new())
    } else if written.contains("meter'") {
        (String::new(), written.to_owned())
    } else {
        let rest = match written {
            _ if written.starts_with("<bsdf") && !written.contains("<shape") => {
                format!("<shape type='disk'>{written}</shape>")
            }
            _ if written.starts_with("<texture") => {
                format!("<shape type='disk'><bsdf type='diffuse'>{written}</bsdf></shape>")
            }
            "-" => String::new(),
            _ => written.to_owned(),
        };
        (format!("<sensor type='perspective'>{film}</sensor>"), rest)
    };
    format!("<scene version='3.0.0'>{sensor}{light}<shape type='sphere'/>{rest}</scene>")
}

/// A scene of pbrt around something, which ends with `WorldBegin` where it stands before the world.
fn pbrt(written: &str) -> String {
    let film = "Film \"rgb\" \"integer xresolution\" 8 \"integer yresolution\" 8";
    let light = if written == "-" { "" } else { "LightSource \"point\"" };
    let camera = if written.contains("Camera") {
        ""
    } else {
        "Camera \"perspective\""
    };
    let (before, world) = match written.strip_suffix("WorldBegin") {
        Some(before) => (before, ""),
        None => ("", written.trim_start_matches('-')),
    };
    format!(
        "{film}\n{before}\n{camera}\nWorldBegin\n{light}\nTexture \"t\" \"float\" \"constant\"\n{world}\nShape \"sphere\"\n"
    )
}

/// A glTF file with `changes`: members of objects are set, and everything else takes the place of what was there.
fn gltf(changes: &str) -> String {
    let mut scene = json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [{"mesh": 0}, {"camera": 0}, {"extensions": {"KHR_lights_punctual": {"light": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0}}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point"}]}},
        "extensionsUsed": ["KHR_lights_punctual"],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "SCALAR", "min": [0], "max": [2]},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 44, "byteLength": 12}],
        "buffers": [{"uri": "triangle.bin", "byteLength": 56}],
    });
    let changes: Map<String, Value> = serde_json::from_str(changes).expect(changes);
    let whole = scene.as_object_mut().unwrap();
    for (member, value) in changes {
        match (whole.get_mut(&member).and_then(Value::as_object_mut), value) {
            (Some(object), Value::Object(changes)) => object.extend(changes),
            (_, value) => drop(whole.insert(member, value)),
        }
    }
    scene.to_string()
}

/// What it says to all scenes of a feature: what it says to the worst of them, with all its words.
fn answers(format: usize, written: &str) -> Answer {
    let answers: Vec<Answer> = written.split(" ;; ").map(|scene| answer(format, scene)).collect();
    let mut said: Vec<&str> = Vec::new();
    for answer in &answers {
        if let Answer::Approximated(words) | Answer::LeftOut(words) | Answer::Refused(words) = answer
            && !said.contains(&words.as_str())
        {
            said.push(words);
        }
    }
    let said = said.join("; ");
    let any = |is: fn(&Answer) -> bool| answers.iter().any(is);
    if any(|answer| matches!(answer, Answer::Refused(_))) {
        Answer::Refused(said)
    } else if any(|answer| matches!(answer, Answer::LeftOut(_))) {
        Answer::LeftOut(said)
    } else if said.is_empty() {
        Answer::Rendered
    } else {
        Answer::Approximated(said)
    }
}

fn answer(format: usize, written: &str) -> Answer {
    let (main, text) = match format {
        0 => ("main.xml", mitsuba(written)),
        1 => ("main.pbrt", pbrt(written)),
        _ => ("main.gltf", gltf(written)),
    };
    let mut files = files();
    files.insert(main.to_owned(), text.into_bytes());
    let defines = match (format, written.contains("$size")) {
        (0, true) => BTreeMap::from([("size".to_owned(), "2".to_owned())]),
        _ => BTreeMap::new(),
    };
    match Scene::load(&files, main, &defines, &Limits::default()) {
        Err(faults) => {
            let error = faults.first().to_string();
            Answer::Refused(
                error
                    .split_once(": ")
                    .map_or(error.clone(), |(_, reason)| reason.to_owned()),
            )
        }
        Ok(scene) => {
            let said: Vec<&str> = scene.warnings.iter().map(|warning| warning.message.as_str()).collect();
            let left_out = |message: &&str| message.contains("left out");
            match (said.is_empty(), said.iter().any(left_out)) {
                (true, _) => Answer::Rendered,
                (false, false) => Answer::Approximated(said.join("; ")),
                (false, true) => Answer::LeftOut(said.join("; ")),
            }
        }
    }
}

/// The table, and below it what the program says.
fn table() -> String {
    let mut table = String::new();
    let mut notes: Vec<String> = Vec::new();
    for (room, features) in features(include_str!("features.txt")) {
        write!(table, "| {room} | Mitsuba | pbrt | glTF |\n| --- | --- | --- | --- |\n").unwrap();
        for feature in features {
            write!(table, "| {} |", feature.name).unwrap();
            for (format, written) in feature.written.iter().enumerate() {
                let Some(written) = written else {
                    table.push_str(" |");
                    continue;
                };
                let mut noted = |said: String| {
                    let number = notes.iter().position(|note| *note == said);
                    number.unwrap_or_else(|| {
                        notes.push(said);
                        notes.len() - 1
                    }) + 1
                };
                match answers(format, written) {
                    Answer::Rendered => table.push_str(" rendered |"),
                    Answer::Approximated(said) => write!(table, " approximated ({}) |", noted(said)).unwrap(),
                    Answer::LeftOut(said) => write!(table, " left out ({}) |", noted(said)).unwrap(),
                    Answer::Refused(said) => write!(table, " refused ({}) |", noted(said)).unwrap(),
                }
            }
            table.push('\n');
        }
        table.push('\n');
    }
    for (number, note) in notes.iter().enumerate() {
        writeln!(table, "{}. {note}", number + 1).unwrap();
    }
    table
}

#[test]
fn the_table_of_features_is_what_the_program_says() {
    const MARKS: [&str; 2] = [
        "<!-- The table is made by core/tests/features.rs. -->\n",
        "<!-- Here it ends. -->\n",
    ];
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/SCENES.md");
    let text = std::fs::read_to_string(&page).unwrap();
    let (before, rest) = text.split_once(MARKS[0]).expect("the page has a place for the table");
    let (there, after) = rest.split_once(MARKS[1]).expect("the table ends");
    let table = table();
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&page, [before, MARKS[0], &table, MARKS[1], after].concat()).unwrap();
        return;
    }
    for (there, made) in there.lines().zip(table.lines()) {
        assert_eq!(there, made, "docs/SCENES.md; UPDATE=1 writes it anew");
    }
    assert_eq!(there, table, "docs/SCENES.md; UPDATE=1 writes it anew");
}

//! Broken meshes and images: each gives an error that names the file, and no damage makes the loader panic or hang.

use exr::prelude::WritableImage;
use flate2::{Compression, write::ZlibEncoder};
use image::{DynamicImage, ImageFormat, Rgb, Rgb32FImage, RgbImage};
use photonfarm_core::random::{PathRandom, Stream};
use photonfarm_core::scene::{Limits, Scene, SceneError};
use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::time::{Duration, Instant};

/// A scene that uses the file `name`.
fn scene_with(name: &str) -> String {
    let filename = format!("<string name='filename' value='{name}'/>");
    let user = match name.rsplit_once('.').map_or("", |(_, extension)| extension) {
        mesh @ ("obj" | "ply" | "serialized") => format!(
            "<shape type='{mesh}'>{filename}<bsdf type='diffuse'>\
             <texture type='vertexcolors' name='reflectance'/></bsdf></shape>"
        ),
        curve @ ("bsplinecurve" | "linearcurve" | "hair") => format!("<shape type='{curve}'>{filename}</shape>"),
        "spd" => "<bsdf type='conductor'><spectrum name='eta' filename='a.spd'/></bsdf>".into(),
        "exr" | "hdr" => format!("<emitter type='envmap'>{filename}</emitter>"),
        _ => format!("<bsdf type='diffuse'><texture name='reflectance' type='bitmap'>{filename}</texture></bsdf>"),
    };
    format!(
        "<scene version='3.0.0'><sensor type='perspective'/><shape type='sphere'/>\n\
         <emitter type='point'/>{user}</scene>"
    )
}

fn small() -> Limits {
    Limits {
        texels: 1 << 16,
        triangles: 1 << 12,
        vertices: 1 << 14,
        ..Limits::default()
    }
}

fn load(name: &str, bytes: Vec<u8>) -> Result<Scene, SceneError> {
    let mut files = BTreeMap::from([(name.to_owned(), bytes)]);
    files
        .entry("main.xml".into())
        .or_insert_with(|| scene_with(name).into_bytes());
    Scene::load(&files, "main.xml", &BTreeMap::new(), &small()).map_err(|faults| faults.first().clone())
}

fn image_of(format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let image = match format {
        ImageFormat::Hdr => {
            DynamicImage::ImageRgb32F(Rgb32FImage::from_fn(9, 5, |x, y| Rgb([x as f32, y as f32, 0.5])))
        }
        _ => DynamicImage::ImageRgb8(RgbImage::from_fn(9, 5, |x, y| Rgb([x as u8 * 20, y as u8 * 40, 7]))),
    };
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn exr_of(size: (usize, usize), value: f32) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let pixels =
        move |at: exr::math::Vec2<usize>| (at.x() as f32, at.y() as f32, if at.x() == 1 { value } else { 1.0 });
    let image = exr::prelude::Image::from_channels(size, exr::prelude::SpecificChannels::rgb(pixels));
    image.write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

fn serialized(version: u16) -> Vec<u8> {
    let mut content = 0x1002_u32.to_le_bytes().to_vec();
    if version == 4 {
        content.extend(b"name\0");
    }
    content.extend(4_u64.to_le_bytes());
    content.extend(2_u64.to_le_bytes());
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0_f32];
    content.extend(
        corners
            .iter()
            .chain(&corners[..8])
            .flat_map(|value| value.to_le_bytes()),
    );
    content.extend([0, 1, 2, 0, 2, 3_u32].iter().flat_map(|index| index.to_le_bytes()));
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(&content).unwrap();
    let mut bytes = [0x041c_u16.to_le_bytes(), version.to_le_bytes()].concat();
    bytes.extend(encoder.finish().unwrap());
    bytes.extend(if version == 4 { vec![0; 8] } else { vec![0; 4] });
    bytes.extend(1_u32.to_le_bytes());
    bytes
}

const PLY: &str = "ply\nformat ascii 1.0\ncomment small\nelement vertex 4\nproperty float x\nproperty float y\n\
    property float z\nproperty float nx\nproperty float ny\nproperty float nz\nelement face 2\n\
    property list uchar int vertex_indices\nproperty uchar tag\nend_header\n";

fn ply_text() -> Vec<u8> {
    format!("{PLY}0 0 0 0 0 1\n1 0 0 0 0 1\n1 1 0 0 0 1\n0 1 0 0 0 1\n3 0 1 2 9\n4 0 1 2 3 9\n").into_bytes()
}

fn ply_binary() -> Vec<u8> {
    let mut bytes = PLY.replace("ascii", "binary_big_endian").into_bytes();
    for [x, y] in [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0_f32]] {
        bytes.extend([x, y, 0.0, 0.0, 0.0, 1.0].iter().flat_map(|value| value.to_be_bytes()));
    }
    for face in [&[0, 1, 2][..], &[0, 1, 2, 3_i32]] {
        bytes.push(face.len() as u8);
        bytes.extend(face.iter().flat_map(|index| index.to_be_bytes()));
        bytes.push(9);
    }
    bytes
}

const OBJ: &[u8] = b"# square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\n\
    g a\nf 1/1/1 2/2/1 3/1/1\nf 1//1 -2//1 4//1\nf 1 2 3 4\n";

const SCENE: &str = "<?xml version='1.0'?>\n<scene version='3.0.0'>\n<default name='r' value='2'/>\n\
    <integrator type='pcf'><float name='theta1' value='9'/></integrator>\n\
    <sensor type='thinlens'><float name='aperture_radius' value='0.1'/><transform name='toWorld'>\
    <lookat origin='0,0,5' target='0 0 0' up='0 1 0'/><rotate y='1' angle='10'/></transform>\
    <film type='hdrfilm'><integer name='width' value='8'/><rfilter type='tent'/></film></sensor>\n\
    <bsdf type='twosided' id='grey'><bsdf type='diffuse'><rgb name='reflectance' value='.5, .4, .3'/></bsdf></bsdf>\n\
    <shape type='sphere'><float name='radius' value='$r'/><ref id='grey'/><emitter type='area'>\
    <spectrum name='radiance' value='400:1, 700:2'/></emitter></shape>\n<!-- end -->\n</scene>\n";

/// A valid file of each format.
fn hair_binary() -> Vec<u8> {
    let mut bytes = b"BINARY_HAIR\x04\0\0\0".to_vec();
    let infinity = f32::INFINITY;
    let numbers = [
        infinity, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0, infinity, 1.0, 0.0, 3.0, 2.0, 0.0, 3.0,
    ];
    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    bytes
}

fn valid_files() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("main.xml", SCENE.as_bytes().to_vec()),
        ("a.obj", OBJ.to_vec()),
        (
            "a.bsplinecurve",
            b"0 0 0 1\n0 1 2 1\n1 0 3 .5\n2 1 4 0.2\n3 1 4 0\n\n# two\n0 0 0 1\n1 0 0 1\n2 0 0 1\n2 2 0 1\n".to_vec(),
        ),
        (
            "a.linearcurve",
            b"0 0 0 1\n0 1 2 1\n1 0 3 .5\n\n4 4 4 1\n4 4 5 1e-3\n".to_vec(),
        ),
        ("text.hair", b"0 0 0\n0 1 2\n\n1 0 3\n2 0 3\n".to_vec()),
        ("binary.hair", hair_binary()),
        ("text.ply", ply_text()),
        ("binary.ply", ply_binary()),
        ("three.serialized", serialized(3)),
        ("four.serialized", serialized(4)),
        ("a.png", image_of(ImageFormat::Png)),
        ("a.jpg", image_of(ImageFormat::Jpeg)),
        ("a.bmp", image_of(ImageFormat::Bmp)),
        ("a.tga", image_of(ImageFormat::Tga)),
        ("a.hdr", image_of(ImageFormat::Hdr)),
        ("a.exr", exr_of((9, 5), 2.0)),
        ("a.spd", b"# copper\n400 1.2\n500 1.1\n700 0.2\n".to_vec()),
    ]
}

#[test]
fn the_valid_files_load() {
    for (name, bytes) in valid_files() {
        load(name, bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
    }
}

/// Truncations, changed bytes and doubled pieces; every fourth time several at once.
fn damage(bytes: &[u8], random: &mut PathRandom) -> Vec<u8> {
    let mut damaged = bytes.to_vec();
    let below = |random: &mut PathRandom, limit: usize| ((random.next_1d() * limit as f32) as usize).min(limit - 1);
    let rounds = [1, 1, 1, 4][below(random, 4)];
    for _ in 0..rounds {
        let at = below(random, damaged.len());
        match below(random, 6) {
            0 => damaged.truncate(at.max(1)),
            1 => damaged[at] = below(random, 256) as u8,
            2 => damaged[at] ^= 1 << below(random, 8),
            3 => damaged[at] = [0, 0x7f, 0x80, 0xff, b'-', b'9'][below(random, 6)],
            4 => {
                let piece = damaged[at..(at + 8).min(damaged.len())].to_vec();
                damaged.splice(at..at, piece);
            }
            _ => {
                let end = (at + 4).min(damaged.len());
                damaged[at..end].fill(0xff);
            }
        }
    }
    damaged
}

#[test]
fn no_damage_makes_the_loader_panic_or_hang() {
    const ROUNDS: u64 = 500;
    let (mut refused, mut slowest) = (0, Duration::ZERO);
    for (index, (name, bytes)) in valid_files().into_iter().enumerate() {
        for round in 0..ROUNDS {
            let mut random = PathRandom::new(5, index as u32, Stream::Camera, round);
            let damaged = damage(&bytes, &mut random);
            let start = Instant::now();
            let result = std::panic::catch_unwind(|| load(name, damaged.clone()).map(|_| ()));
            slowest = slowest.max(start.elapsed());
            match result {
                Ok(Ok(())) => {}
                Ok(Err(error)) => {
                    refused += 1;
                    assert!(!error.file().is_empty() && error.to_string().starts_with(&error.place().to_string()));
                }
                Err(_) => panic!("{name}, round {round}: the loader panicked on {damaged:?}"),
            }
        }
    }
    assert!(
        refused > ROUNDS * 5,
        "only {refused} damaged files were refused: the damage is too small to test anything"
    );
    assert!(
        slowest < Duration::from_secs(20),
        "a file of a few hundred bytes took {slowest:?}"
    );
}

#[test]
fn every_truncation_of_a_binary_file_is_refused_or_read() {
    for (name, bytes) in valid_files() {
        for length in 0..bytes.len() {
            if let Err(error) = load(name, bytes[..length].to_vec()) {
                assert!(!error.to_string().is_empty(), "{name}, {length}");
            }
        }
    }
}

#[test]
fn broken_images_name_their_file() {
    let png = image_of(ImageFormat::Png);
    let mut huge_png = png.clone();
    // The width in the header, which has its own checksum behind it.
    huge_png[16..20].copy_from_slice(&0x7fff_ffff_u32.to_be_bytes());
    let checksum = crc32(&huge_png[12..29]);
    huge_png[29..33].copy_from_slice(&checksum.to_be_bytes());
    let hdr = image_of(ImageFormat::Hdr);
    let huge_hdr = String::from_utf8_lossy(&hdr[..])
        .replace("-Y 5 +X 9", "-Y 99999 +X 99999")
        .into_bytes();
    let exr = exr_of((9, 5), 2.0);
    for (name, bytes, kind, fragment) in [
        ("a.png", png[..40].to_vec(), "Data", "broken Png image"),
        ("a.png", huge_png, "Limit", "number of texels"),
        ("a.png", b"GIF89a".to_vec(), "Data", "allowed: OpenEXR, PFM, PNG"),
        ("a.png", Vec::new(), "Data", "allowed: OpenEXR, PFM, PNG"),
        (
            "a.jpg",
            image_of(ImageFormat::Jpeg)[..30].to_vec(),
            "Data",
            "broken Jpeg image",
        ),
        (
            "a.bmp",
            image_of(ImageFormat::Bmp)[..60].to_vec(),
            "Data",
            "broken Bmp image",
        ),
        (
            "a.tga",
            image_of(ImageFormat::Tga)[..30].to_vec(),
            "Data",
            "broken Tga image",
        ),
        ("a.hdr", hdr[..hdr.len() - 3].to_vec(), "Data", "broken Hdr image"),
        ("a.hdr", huge_hdr, "Limit", "number of texels"),
        ("a.exr", exr[..exr.len() - 3].to_vec(), "Data", "broken OpenEXR image"),
        ("a.exr", exr[..100].to_vec(), "Data", "broken OpenEXR image"),
        ("a.exr", exr_of((9, 5), f32::NAN), "Data", "texel (1, 0)"),
        ("a.exr", exr_of((9, 5), f32::INFINITY), "Data", "texel (1, 0)"),
        ("a.exr", exr_of((9, 5), -1.0), "Data", "texel (1, 0)"),
        (
            "a.exr",
            exr_of((1000, 1000), 1.0),
            "Limit",
            "number of texels: 1000000 is over the limit of 65536",
        ),
    ] {
        let error = load(name, bytes).expect_err(fragment);
        let message = error.to_string();
        assert!(format!("{error:?}").starts_with(kind), "{message}");
        assert_eq!((error.file(), error.line()), (name, None), "{message}");
        assert!(message.contains(fragment), "expected `{fragment}` in: {message}");
    }
}

/// Files of each format with several faults, which are told together with those of the scene.
#[test]
fn all_faults_of_a_file_are_told_with_those_of_the_scene() {
    let ply = String::from_utf8(ply_text()).unwrap();
    let ply = ply.replace("\n1 0 0", "\n1 x 0").replace("4 0 1 2 3", "4 0 -1 2 7");
    let floats = |count: usize| {
        let pixels = |at: exr::math::Vec2<usize>| (-(at.x() as f32), 1.0_f32, 1.0_f32);
        let mut bytes = Cursor::new(Vec::new());
        let image = exr::prelude::Image::from_channels((count + 1, 1), exr::prelude::SpecificChannels::rgb(pixels));
        image.write().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    };
    for (name, bytes, expected) in [
        (
            "a.obj",
            b"v 0 0 x\nvw 1\nv 1 0 0\nf 1 2\n".to_vec(),
            &[
                "a.obj:1: `v`: `x`",
                "a.obj:2: unknown statement `vw`",
                "a.obj:4: a face has",
            ][..],
        ),
        (
            "a.ply",
            ply.into_bytes(),
            &["a.ply:16: `x` is not", "a.ply:20: face 1: -1", "a.ply: vertex index 7"],
        ),
        (
            "a.spd",
            b"400 1 1\n500 x\n".to_vec(),
            &["a.spd:1: expected a wavelength", "a.spd:2: `x` is not a number"],
        ),
        (
            "a.exr",
            floats(2),
            &["a.exr: texel (1, 0) is [-1.0, 1.0, 1.0]", "a.exr: texel (2, 0)"],
        ),
        (
            "b.exr",
            floats(13),
            &[
                "b.exr: texel (1, 0)",
                "b.exr: texel (2, 0)",
                "b.exr: texel (3, 0)",
                "b.exr: texel (4, 0)",
                "b.exr: texel (5, 0)",
                "b.exr: texel (6, 0)",
                "b.exr: texel (7, 0)",
                "b.exr: texel (8, 0)",
                "b.exr: texel (9, 0)",
                "b.exr: texel (10, 0)",
                "b.exr: and 3 more faults",
            ],
        ),
    ] {
        let scene = scene_with(name)
            .replace("a.spd", name)
            .replace("</scene>", "<shape type='spheer'/></scene>");
        let files = BTreeMap::from([("main.xml".to_owned(), scene.into_bytes()), (name.to_owned(), bytes)]);
        let faults = Scene::load(&files, "main.xml", &BTreeMap::new(), &small()).unwrap_err();
        let mut told: Vec<String> = faults.all().iter().map(ToString::to_string).collect();
        let other = "main.xml:2: <shape>: unknown type `spheer`; did you mean `sphere`?";
        let place = told.iter().position(|fault| fault.starts_with(other));
        told.remove(place.unwrap_or_else(|| panic!("{faults}")));
        assert_eq!(told.len(), expected.len(), "{faults}");
        for (fault, start) in told.iter().zip(expected) {
            assert!(fault.starts_with(start), "{start} in {faults}");
        }
    }
}

/// CRC-32 as PNG has it (ISO 3309), bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            if crc & 1 == 1 {
                (crc >> 1) ^ 0xedb8_8320
            } else {
                crc >> 1
            }
        })
    })
}

#[test]
fn images_that_cannot_serve_their_purpose_are_refused_at_their_use() {
    let error = load("a.exr", exr_of((1, 1), 1.0)).unwrap_err();
    assert_eq!((error.file(), error.line()), ("main.xml", Some(2)), "{error}");
    assert!(error.to_string().contains("2 x 2 texels"), "{error}");
    let mut files = BTreeMap::from([("a.exr".to_owned(), exr_of((9, 5), 1.0))]);
    files.insert(
        "main.xml".into(),
        scene_with("a.png").replace("a.png", "a.exr").into_bytes(),
    );
    // What a surface cannot reflect is cut off, with a warning.
    let scene = Scene::load(&files, "main.xml", &BTreeMap::new(), &small()).unwrap();
    assert!(
        scene.warnings[0].to_string().contains("above 1 counts as 1"),
        "{:?}",
        scene.warnings
    );
}

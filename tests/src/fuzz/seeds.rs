//! Valid inputs, made by code.

use flate2::{Compression, bufread::GzDecoder, write::ZlibEncoder};
use image::{DynamicImage, ImageFormat, Rgb, Rgb32FImage, RgbImage};
use photonfarm_core::film::Node;
use photonfarm_core::spectrum::Spectrum;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::check::{
    CheckAnswer, CheckAssignment, CheckError, CheckFailure, CheckResult, CheckToken, Checking,
};
use photonfarm_proto::codec::{Message, encode};
use photonfarm_proto::id::{BlobHash, CheckId, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{BandwidthRange, FailureKind, JobSpec, Totals};
use photonfarm_proto::memory::Shortage;
use photonfarm_proto::node::{NodeKey, encode_node};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::rest::{Rest, RestReason};
use photonfarm_proto::trace::Context;
use photonfarm_proto::worker::{
    Assignment, FailureReport, Heartbeat, Lease, LeaseProgress, LeaseReply, LeaseRequest, NodeUpload, Register,
};
use serde_json::json;
use std::io::{Cursor, Read, Write};

fn job_json() -> serde_json::Value {
    json!({
        "scene": BlobHash::of(b"scene"), "main": "scene.xml", "defines": {"depth": "8"}, "iterations": 64, "seed": 7,
        "integrator": {"type": "pcf", "photons": 1000, "samplers": ["bsdf", "camera", "importon"], "theta1": 10.5,
            "lookup_vertex": "auto", "sigma_by_length": [0.5, 1.0], "kernel": "epanechnikov"},
    })
}

fn check_json() -> serde_json::Value {
    json!({"scene": BlobHash::of(b"scene"), "main": "scene.xml", "sensor": "left", "layers": ["albedo"],
        "integrator": {"type": "pppm", "photons": 1000}})
}

fn message<M: Message>(message: &M) -> Vec<u8> {
    encode(message).expect("a message can be written")
}

pub(super) fn messages() -> Vec<Vec<u8>> {
    let (token, worker, job) = (LeaseToken { number: 9, nonce: 8 }, WorkerId(4), JobId(3));
    let node = NodeKey { level: 2, index: 1 };
    let check = CheckToken {
        id: CheckId(5),
        nonce: 6,
    };
    let error = CheckError::of_request(Some("layers"), "there is no lamp `a`");
    let spec: JobSpec = serde_json::from_value(job_json()).expect("a valid job");
    let lease = Lease {
        token,
        job,
        node,
        worker,
        attempt: 1,
        expires_in_ms: 30_000,
        ends_in_ms: Some(5_000),
        trace: Context::of_job("farm", job),
    };
    vec![
        message(&Register {
            name: "host".into(),
            threads: 8,
            renderer: "1".into(),
            tags: ["gpu".to_owned()].into(),
            memory_mb: Some(2048),
        }),
        message(&LeaseRequest {
            worker,
            serial: 6,
            held: vec![token, LeaseToken { number: 10, nonce: 9 }],
            wait_ms: 20_000,
        }),
        message(&LeaseReply {
            assignment: Some(Assignment { lease, spec }),
            check: Some(CheckAssignment {
                token: check,
                spec: serde_json::from_value(check_json()).expect("a check"),
            }),
        }),
        message(&Heartbeat {
            worker,
            leases: vec![LeaseProgress { token, leaves_done: 3 }; 2],
            checking: Checking::At(check),
        }),
        message(&NodeUpload {
            token,
            worker,
            job,
            node,
            width: 3,
            height: 2,
            digest: BlobHash::of(b""),
            totals: Totals {
                bandwidth: Some(BandwidthRange::one(0.5, Some(0.1))),
                ..Totals::default()
            },
            memory_mb: Some(100),
        }),
        message(&FailureReport {
            token,
            worker,
            job,
            leaf: 5,
            kind: FailureKind::Render,
            message: "pixel (1, 2) is not finite".into(),
            shortage: Some(Shortage {
                held_mb: Some(700),
                has_mb: None,
            }),
        }),
        message(&Rest {
            worker,
            serial: 7,
            held: vec![token],
            reason: RestReason::Hours,
            until_ms: Some(1_764_529_200_000),
        }),
        message(&CheckResult {
            token: check,
            worker,
            answer: CheckAnswer::Failure(CheckFailure::one(error)),
        }),
    ]
}

pub(super) fn nodes() -> Vec<Vec<u8>> {
    let node = Node::leaf(5, 3, 2, &[Spectrum::splat(0.5); 6]).expect("a valid node");
    vec![encode_node(JobId(3), &node)]
}

pub(super) fn requests() -> Vec<Vec<u8>> {
    let manifest = BundleManifest {
        files: [("a/b.obj".to_owned(), FileEntry::of(b"x"))].into(),
    };
    let other = json!({"scene": BlobHash::of(b""), "main": "m", "iterations": 1, "integrator": {"type": "path"}});
    let token = json!({"name": "ann", "role": "submit", "expires_in_s": 60, "quota": {"jobs": 3}});
    let manifest = serde_json::to_value(manifest).expect("a manifest can be written");
    let bodies = [job_json(), check_json(), other, manifest, token];
    bodies.iter().map(|body| body.to_string().into_bytes()).collect()
}

pub(super) fn replies() -> Vec<Vec<u8>> {
    let problem = Problem::new(ErrorCode::TooManyRequests, "wait")
        .after(2)
        .at("a.b", Some(3));
    let bodies = [
        json!(problem),
        json!({"bundle": BlobHash::of(b"a"), "missing": [BlobHash::of(b"b")]}),
        json!({"token": "phf_0", "status": {"name": "a", "role": "read", "created_ms": 1, "expires_ms": null,
            "quota": {}, "usage": {"jobs": 0, "bundle_bytes": 0, "iterations": 0}}}),
        json!({"jobs": [], "next": "7"}),
        json!({"workers": []}),
        json!({"id": 5, "state": "waiting", "waiting": "no worker is connected", "waiting_reason": "no-worker"}),
    ];
    bodies.iter().map(|body| body.to_string().into_bytes()).collect()
}

pub(super) fn pbrt() -> Vec<Vec<u8>> {
    let view = "Film \"rgb\" \"integer xresolution\" 4 \"integer yresolution\" [4]\nLookAt 0 0 -5 0 0 0 0 1 0\n\
        Camera \"perspective\" \"float fov\" 40 Sampler \"halton\" \"integer pixelsamples\" 1\nWorldBegin\n";
    let glowing = "AttributeBegin AreaLightSource \"diffuse\" \"blackbody L\" 3000 \"float power\" 10\n\
        Translate 0 2 0 Shape \"sphere\" \"float radius\" 0.5 AttributeEnd\n\
        Shape \"trianglemesh\" \"point3 P\" [-1 -1 0 1 -1 0 0 1 0] \"integer indices\" [0 1 2] # a comment\n";
    let textured = "LightSource \"infinite\" \"rgb L\" [1 2 3]\nTexture \"t\" \"float\" \"constant\" \"float value\" 0.2\n\
        MakeNamedMaterial \"m\" \"string type\" \"conductor\" \"texture roughness\" \"t\" \"spectrum eta\" [400 1 700 2]\n\
        NamedMaterial \"m\" Rotate 30 1 0 0 Shape \"disk\" \"float innerradius\" 0.3\n\
        Material \"dielectric\" \"float eta\" 1.3 Shape \"bilinearmesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0 1 1 1]\n";
    let objects = "ObjectBegin \"o\" Shape \"loopsubdiv\" \"integer levels\" 1 \"point3 P\" [0 0 0 1 0 0 0 1 0]\n\
        \"integer indices\" [0 1 2] ObjectEnd ActiveTransform EndTime Translate 1 0 0 ActiveTransform All\n\
        Transform [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1] Shape \"cylinder\" LightSource \"distant\"\n";
    let scene = |content: &str| format!("{view}{content}").into_bytes();
    let misty = "MakeNamedMedium \"m\" \"string type\" \"uniformgrid\" \"integer nx\" 2 \"float density\" [1 2] \"rgb sigma_a\" [1 2 3]\n\
        \"float temperature\" [900 3000] \"float Lescale\" [1 2] LightSource \"point\"\n\
        MakeNamedMedium \"c\" \"string type\" \"rgbgrid\" \"rgb sigma_a\" [1 2 3] \"rgb Le\" [1 1 1] \"point3 p1\" [2 1 1]\n\
        AttributeBegin MediumInterface \"m\" \"\" Material \"interface\" Shape \"sphere\" AttributeEnd\n\
        MediumInterface \"c\" Material \"dielectric\" Shape \"sphere\" \"float radius\" 0.3\n";
    vec![scene(glowing), scene(textured), scene(objects), scene(misty)]
}

pub(super) fn scenes() -> Vec<Vec<u8>> {
    let sensor = "<sensor type='thinlens'><float name='aperture_radius' value='0.1'/><transform name='toWorld'>\
        <lookat origin='0,0,5' target='0 0 0' up='0 1 0'/><rotate y='1' angle='10'/></transform>\
        <film type='hdrfilm'><integer name='width' value='8'/><integer name='height' value='4'/>\
        <rfilter type='tent'/></film></sensor>";
    let glowing = "<default name='r' value='2'/><integrator type='pcf'><float name='theta1' value='9'/></integrator>\
        <bsdf type='twosided' id='grey'><bsdf type='diffuse'><rgb name='reflectance' value='.5, .4, .3'/></bsdf>\
        </bsdf><shape type='sphere'><float name='radius' value='$r'/><ref id='grey'/><emitter type='area'>\
        <spectrum name='radiance' value='400:1, 700:2'/></emitter></shape>";
    let glass = "<shape type='cube'><transform name='to_world'><scale value='0.5'/><translate x='1'/></transform>\
        <bsdf type='roughdielectric'><float name='alpha' value='0.2'/></bsdf></shape><shape type='rectangle'>\
        <bsdf type='roughconductor'><string name='material' value='Au'/></bsdf></shape><emitter type='point'>\
        <point name='position' value='0 2 3'/><rgb name='intensity' value='5'/></emitter>\
        <emitter type='constant'><rgb name='radiance' value='0.2'/></emitter>";
    let scene = |content: &str| format!("<scene version='3.0.0'>{sensor}{content}</scene>").into_bytes();
    let moving = "<shape type='disk'><animation name='to_world'><transform time='0'/><transform time='1'>\
        <rotate y='1' angle='40'/><translate x='1'/></transform></animation></shape><emitter type='projector'>\
        <float name='fov' value='30'/><rgb name='irradiance' value='1, 2, 3'/></emitter>";
    let misty = "<medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.2 0.4 0.8'/><float name='scale' value='2'/>\
        <phase type='blendphase'><float name='weight' value='0.3'/><phase type='hg'><float name='g' value='0.6'/></phase>\
        <phase type='tabphase'><string name='values' value='0.5, 1, 1.5'/></phase></phase></medium><shape type='sphere'>\
        <bsdf type='null'/><ref name='interior' id='fog'/></shape><emitter type='point'/>";
    let old = "<scene version='0.6.0'><shape type='sphere'><medium name='interior' type='homogeneous'>\
        <string name='material' value='skin1'/><float name='scale' value='0.1'/></medium></shape></scene>";
    vec![scene(glowing), scene(glass), scene(moving), scene(misty), old.into()]
}

/// A triangle with a skin, a morph target, an animation, a texture, a camera and a light, as JSON; the buffer is all zeros but for the places.
pub(super) fn gltf() -> Vec<Vec<u8>> {
    let json = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 2, 3]}], "nodes": [
{"mesh": 0, "children": [1], "translation": [0, 0, -2], "weights": [0.5]}, {"rotation": [0, 0, 0.6, 0.8], "mesh": 1, "skin": 0},
{"camera": 0, "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,3,1]}, {"extensions": {"KHR_lights_punctual": {"light": 0}}}],
"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0, "targets": [{"POSITION": 0}]}]},
{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}, "indices": 3, "mode": 5, "material": 1}]}],
"skins": [{"joints": [1]}], "cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1, "aspectRatio": 2}}],
"animations": [{"channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
"samplers": [{"input": 4, "output": 5, "interpolation": "LINEAR"}]}],
"materials": [{"emissiveFactor": [1, 0.5, 0], "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.4}},
{"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.5, 0.2, 0.5], "roughnessFactor": 0},
"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_ior": {"ior": 1.4},
"KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 0.5, "attenuationColor": [0.9, 0.5, 0.1]},
"KHR_materials_volume_scatter": {"multiscatterColor": [0.1, 0.5, 0.9], "scatterAnisotropy": 0.2}}}],
"extensions": {"KHR_lights_punctual": {"lights": [{"type": "spot", "intensity": 900, "spot": {"outerConeAngle": 0.6}}]}},
"accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "sparse": {"count": 1,
"indices": {"bufferView": 1, "componentType": 5121}, "values": {"bufferView": 0, "byteOffset": 24}}},
{"bufferView": 1, "byteOffset": 4, "componentType": 5121, "count": 3, "type": "VEC4"}, {"bufferView": 0, "byteOffset": 14, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC4"},
{"bufferView": 1, "byteOffset": 12, "componentType": 5121, "count": 3, "type": "SCALAR"}, {"bufferView": 0, "byteOffset": 8, "componentType": 5126, "count": 2, "type": "SCALAR"},
{"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"}],
"bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 24, "byteStride": 4}],
"buffers": [{"byteLength": 60, "uri": "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAgAAAAAAAAAAAAAAAAAAAAEAAAACAAAA"}]}"#;
    let file = include_bytes!("../../scenes/gltf/textures.glb").to_vec();
    vec![json.into(), file]
}

pub(super) fn obj() -> Vec<Vec<u8>> {
    let square = "# square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\n\
        g a\nf 1/1/1 2/2/1 3/1/1\nf 1//1 -2//1 4//1\nf 1 2 3 4\n";
    vec![square.into()]
}

pub(super) fn ply() -> Vec<Vec<u8>> {
    let header = "ply\nformat ascii 1.0\ncomment small\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nelement face 2\nproperty list uchar int vertex_indices\nproperty uchar tag\nend_header\n";
    let text = format!("{header}0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 9\n4 0 1 2 3 9\n");
    let mut binary = header.replace("ascii", "binary_little_endian").into_bytes();
    for [x, y] in [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0_f32]] {
        binary.extend([x, y, 0.0].iter().flat_map(|value| value.to_le_bytes()));
    }
    for face in [&[0, 1, 2][..], &[0, 1, 2, 3_i32]] {
        binary.push(face.len() as u8);
        binary.extend(face.iter().flat_map(|index| index.to_le_bytes()));
        binary.push(9);
    }
    vec![text.into_bytes(), binary]
}

pub(super) fn serialized() -> Vec<Vec<u8>> {
    let mut content = 0x1000_u32.to_le_bytes().to_vec();
    content.extend(b"name\0");
    content.extend([3_u64, 1].iter().flat_map(|count| count.to_le_bytes()));
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0_f32];
    content.extend(corners.iter().flat_map(|value| value.to_le_bytes()));
    content.extend([0, 1, 2_u32].iter().flat_map(|index| index.to_le_bytes()));
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::none());
    let packed = encoder.write_all(&content).and_then(|()| encoder.finish());
    let mut bytes = [0x041c_u16.to_le_bytes(), 4_u16.to_le_bytes()].concat();
    bytes.extend(packed.expect("memory takes bytes"));
    bytes.extend([0; 8]);
    bytes.extend(1_u32.to_le_bytes());
    vec![bytes]
}

pub(super) fn openexr() -> Vec<Vec<u8>> {
    use exr::prelude::{Encoding, Image, SpecificChannels, WritableImage};
    let pixels = |at: exr::math::Vec2<usize>| (at.x() as f32, at.y() as f32, 1.0_f32);
    let image = |encoding| {
        let mut bytes = Cursor::new(Vec::new());
        let layer = exr::prelude::Layer::new(
            (5, 4),
            exr::prelude::LayerAttributes::default(),
            encoding,
            SpecificChannels::rgb(pixels),
        );
        let written = Image::from_layer(layer).write().to_buffered(&mut bytes);
        written.expect("memory takes bytes");
        bytes.into_inner()
    };
    vec![
        image(Encoding::UNCOMPRESSED),
        image(Encoding::FAST_LOSSLESS),
        image(Encoding::SMALL_LOSSLESS),
    ]
}

pub(super) fn images() -> Vec<Vec<u8>> {
    let formats = [
        ImageFormat::Png,
        ImageFormat::Jpeg,
        ImageFormat::Bmp,
        ImageFormat::Tga,
        ImageFormat::Hdr,
    ];
    let image = |format| {
        let colour = |x, y| Rgb([x as u8 * 20, y as u8 * 40, 7]);
        let light = |x, y| Rgb([x as f32, y as f32, 0.5]);
        let image = match format {
            ImageFormat::Hdr => DynamicImage::ImageRgb32F(Rgb32FImage::from_fn(9, 5, light)),
            _ => DynamicImage::ImageRgb8(RgbImage::from_fn(9, 5, colour)),
        };
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).expect("memory takes bytes");
        bytes.into_inner()
    };
    let floats = [0.5_f32, 1.0, 2.0, 4.0, 8.0, 0.25].map(f32::to_le_bytes).concat();
    let float_map = [b"PF\n2 1\n-1.0\n".as_slice(), &floats].concat();
    formats.into_iter().map(image).chain([float_map]).collect()
}

/// A lattice of Mitsuba, and trees of OpenVDB's own programs, compressed by Blosc and by zlib (`core/src/scene/volume/tests.rs` says of what).
pub(super) fn volumes() -> Vec<Vec<u8>> {
    let mut lattice = b"VOL\x03".to_vec();
    lattice.extend([1, 2, 3, 1, 1].iter().flat_map(|number: &i32| number.to_le_bytes()));
    let numbers = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.5, 1.0, 2.0, 0.0, 3.0, 1.0_f32];
    lattice.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    let trees = [
        include_bytes!("../../../core/src/scene/volume/tests/fog.vdb.gz").as_slice(),
        include_bytes!("../../../core/src/scene/volume/tests/fog-zip.nvdb.gz"),
        include_bytes!("../../../core/src/scene/volume/tests/fog-blosc.nvdb.gz"),
    ];
    let unpacked = |packed: &[u8]| {
        let mut bytes = Vec::new();
        let read = GzDecoder::new(packed).read_to_end(&mut bytes);
        read.expect("the files are whole");
        bytes
    };
    std::iter::once(lattice).chain(trees.map(unpacked)).collect()
}

pub(super) fn spectra() -> Vec<Vec<u8>> {
    vec![b"# copper\n400 1.2\n500 1.1\n700 0.2\n".to_vec()]
}

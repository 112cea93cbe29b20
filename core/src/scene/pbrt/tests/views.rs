//! Cameras, films, transforms and the state.

use super::{describe, describe_with, load, near};
use crate::film::Filter;
use crate::math::{Vec2, Vec3};
use crate::scene::description::{Kind, Value};
use crate::settings::IntegratorSettings;
use flate2::{Compression, write::GzEncoder};
use glam::DVec3;
use std::io::Write;

/// What every scene needs besides.
const WORLD: &str = "WorldBegin LightSource \"infinite\" Shape \"sphere\"";

/// The directions of the rays through the middle, the right edge and the upper edge of the picture.
fn rays(text: &str) -> [Vec3; 3] {
    let scene = load(text);
    let [width, height] = scene.sensor.resolution.map(|side| side as f32);
    let at = |x: f32, y: f32| scene.sensor.ray(Vec2::new(x * width, y * height), Vec2::ZERO).direction;
    [at(0.5, 0.5), at(1.0, 0.5), at(0.5, 0.0)]
}

fn close(actual: Vec3, expected: Vec3) {
    assert!(
        (actual - expected.normalize()).length() < 1e-5,
        "{actual} is not along {expected}"
    );
}

/// +x of the camera is right in the picture and +y is up, and the angle is that of the shorter side.
#[test]
fn the_camera_looks_along_z_with_x_to_the_right() {
    let film = "Film \"rgb\" \"integer xresolution\" 200 \"integer yresolution\" [100]";
    let [middle, right, up] = rays(&format!("{film} Camera \"perspective\" \"float fov\" [90] {WORLD}"));
    close(middle, Vec3::Z);
    close(right, Vec3::new(2.0, 0.0, 1.0));
    close(up, Vec3::new(0.0, 1.0, 1.0));
    let tall = "Film \"rgb\" \"integer xresolution\" 100 \"integer yresolution\" [200]";
    let [_, right, up] = rays(&format!("{tall} Camera \"perspective\" {WORLD}"));
    close(right, Vec3::new(1.0, 0.0, 1.0));
    close(up, Vec3::new(0.0, 2.0, 1.0));
    // From +x towards the origin with z up, right is +y in the left-handed world.
    let [middle, right, up] = rays(&format!(
        "{film} LookAt 5 0 0  0 0 0  0 0 1 Camera \"perspective\" {WORLD}"
    ));
    close(middle, Vec3::NEG_X);
    close(right, Vec3::new(-1.0, -2.0, 0.0));
    close(up, Vec3::new(-1.0, 0.0, 1.0));
    // A matrix of rounded numbers, as exporters write it: a rotation to their precision.
    let matrix = "[0.00502469 -0.00467005 -0.999977 -0 -0 0.999989 -0.00467011 -0 -0.999987 -0.0000233837 -0.00500703 -0 -0.07 -3.9 16.2 1]";
    let [middle, right, _] = rays(&format!("{film} Transform {matrix} Camera \"perspective\" {WORLD}"));
    assert!(
        (middle - Vec3::new(-0.999_977, -0.004_670, -0.005_007)).length() < 1e-4,
        "{middle}"
    );
    assert!(right.z < -0.8, "{right}");
    // A scale of the camera's space changes nothing, and its mirroring mirrors.
    let [_, right, _] = rays(&format!(
        "{film} Scale -3 3 3 Camera \"perspective\" \"float fov\" [90] {WORLD}"
    ));
    close(right, Vec3::new(-2.0, 0.0, 1.0));
}

#[test]
fn a_screen_window_moves_and_zooms() {
    let film = "Film \"rgb\" \"integer xresolution\" 100 \"integer yresolution\" [100]";
    let window = "\"float screenwindow\" [0 0.5 -0.25 0.25]";
    let [middle, right, up] = rays(&format!(
        "{film} Camera \"perspective\" \"float fov\" [90] {window} {WORLD}"
    ));
    close(middle, Vec3::new(0.25, 0.0, 1.0));
    close(right, Vec3::new(0.5, 0.0, 1.0));
    close(up, Vec3::new(0.25, 0.25, 1.0));
    let scene = load(&format!(
        "{film} Translate 0 0 4 Camera \"orthographic\" \"float screenwindow\" [0 6 -3 3] {WORLD}"
    ));
    let start = |x: f32, y: f32| scene.sensor.ray(Vec2::new(x, y), Vec2::ZERO).origin;
    assert!(
        (start(100.0, 50.0) - Vec3::new(6.0, 0.0, -4.0)).length() < 1e-3,
        "{}",
        start(100.0, 50.0)
    );
    assert!(
        (start(0.0, 0.0) - Vec3::new(0.0, 3.0, -4.0)).length() < 1e-3,
        "{}",
        start(0.0, 0.0)
    );
}

#[test]
fn a_lens_and_the_defaults_of_film_and_filter() {
    let lens = "Camera \"perspective\" \"float lensradius\" [0.5] \"float focaldistance\" [7]";
    let described = describe(&format!("{lens} {WORLD}"));
    let sensor = described.the(Kind::Sensor, "thinlens");
    assert_eq!(
        (sensor.number("aperture_radius"), sensor.number("focus_distance")),
        (0.5, 7.0)
    );
    let scene = load(&format!("Camera \"perspective\" {WORLD}"));
    assert_eq!(scene.film.resolution, [1280, 720]);
    assert_eq!(scene.film.filter, Filter::Gaussian { stddev: 0.5 });
    for (written, filter) in [
        (
            "\"box\" \"float xradius\" 0.7 \"float yradius\" 0.7",
            Filter::Box { radius: 0.7 },
        ),
        ("\"triangle\"", Filter::Tent { radius: 2.0 }),
        ("\"gaussian\" \"float sigma\" 0.4", Filter::Gaussian { stddev: 0.4 }),
        ("\"gaussian\" \"float alpha\" 2", Filter::Gaussian { stddev: 0.5 }),
    ] {
        let scene = load(&format!("PixelFilter {written} Camera \"perspective\" {WORLD}"));
        assert_eq!(scene.film.filter, filter, "{written}");
    }
}

/// Depths of pbrt count what scatters; ours count edges.
#[test]
fn integrators_and_samplers() {
    let load = |text: &str| load(&format!("{text} Camera \"perspective\" {WORLD}"));
    let wishes =
        load("Integrator \"path\" \"integer maxdepth\" [7] Sampler \"halton\" \"integer pixelsamples\" [64]").wishes;
    assert!(matches!(&wishes.integrator, Some(IntegratorSettings::Path(path)) if path.max_depth == Some(8)));
    assert_eq!((wishes.max_depth, wishes.sample_count), (Some(8), Some(64)));
    assert_eq!(load("Integrator \"volpath\"").wishes.max_depth, Some(6));
    let sppm = load("Integrator \"sppm\" \"float radius\" 0.25 \"integer photonsperiteration\" [5000]").wishes;
    assert!(matches!(sppm.integrator, Some(IntegratorSettings::Sppm(_))), "{sppm:?}");
    assert!(matches!(
        load("Integrator \"bdpt\"").wishes.integrator,
        Some(IntegratorSettings::Bdpt(_))
    ));
    assert_eq!(load("Integrator \"ao\"").wishes.integrator, None);
    assert_eq!(
        load("Sampler \"stratified\" \"integer xsamples\" 3 \"integer ysamples\" 5")
            .wishes
            .sample_count,
        Some(15)
    );
}

/// Translations and rotations apply to what follows; matrices are written by columns.
#[test]
fn transforms_and_their_stack() {
    let corners = |text: &str| {
        describe(&format!("WorldBegin {text} Shape \"sphere\""))
            .the(Kind::Shape, "sphere")
            .corners()
    };
    let [origin, x, _, _] = corners("Translate 1 2 3 Scale 2 2 2");
    assert_eq!((origin, x), (DVec3::new(1.0, 2.0, 3.0), DVec3::new(3.0, 2.0, 3.0)));
    let [_, x, y, _] = corners("Rotate 90 0 0 1");
    assert!(
        (x - DVec3::Y).length() < 1e-12 && (y + DVec3::X).length() < 1e-12,
        "{x} {y}"
    );
    let matrix = "[0 1 0 0  0 0 1 0  1 0 0 0  5 6 7 1]";
    let [origin, x, y, z] = corners(&format!("Translate 9 9 9 Transform {matrix}"));
    let expected = [[5.0, 6.0, 7.0], [5.0, 7.0, 7.0], [5.0, 6.0, 8.0], [6.0, 6.0, 7.0]];
    assert_eq!([origin, x, y, z].map(|corner| corner.to_array()), expected);
    assert_eq!(
        corners(&format!("Translate 1 0 0 ConcatTransform {matrix}"))[0],
        DVec3::new(6.0, 6.0, 7.0)
    );
    assert_eq!(corners("Translate 9 9 9 Identity Translate 1 0 0")[0], DVec3::X);
    let saved = "Translate 0 4 0 CoordinateSystem \"there\" Identity Translate 1 0 0 CoordSysTransform \"there\"";
    assert_eq!(corners(saved)[0], DVec3::Y * 4.0);
    assert_eq!(
        corners("Translate 1 0 0 AttributeBegin Translate 5 5 5 AttributeEnd TransformBegin Scale 3 3 3 TransformEnd")
            [0],
        DVec3::X
    );
    assert_eq!(corners("LookAt 0 0 3  0 0 0  0 1 0")[0], DVec3::Z * 3.0);
}

#[test]
fn two_transforms_are_motion() {
    let text = "TransformTimes 1 3 Camera \"perspective\" \"float shutteropen\" 1 \"float shutterclose\" 3 WorldBegin
        ActiveTransform EndTime Translate 2 0 0 ActiveTransform All Translate 0 1 0 Shape \"sphere\"";
    let described = describe(text);
    let Value::Animation(motion) = described.the(Kind::Shape, "sphere").value("to_world") else {
        panic!("the sphere stands still");
    };
    let at = |time: f64| motion.at(time).point(Vec3::ZERO).to_array();
    assert_eq!(
        [at(0.0), at(1.0), at(2.0), at(3.0)],
        [[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [2.0, 1.0, 0.0]]
    );
    let sensor = described.the(Kind::Sensor, "perspective");
    assert_eq!(
        (sensor.number("shutter_open"), sensor.number("shutter_close")),
        (1.0, 3.0)
    );
}

/// `Attribute` sets what directives leave out, within its block.
#[test]
fn attributes_are_defaults() {
    let radii = |text: &str| {
        let described = describe(&format!("WorldBegin {text}"));
        let spheres = described.objects.iter().filter(|object| object.plugin == "sphere");
        spheres.map(|sphere| sphere.number("radius")).collect::<Vec<_>>()
    };
    let text =
        "AttributeBegin Attribute \"shape\" \"float radius\" 4 Shape \"sphere\" Shape \"sphere\" \"float radius\" 2
        AttributeEnd Shape \"sphere\"";
    assert_eq!(radii(text), [4.0, 2.0, 1.0]);
    let (described, warnings) = describe_with(
        "WorldBegin Attribute \"material\" \"rgb reflectance\" [1 0 0] Material \"diffuse\" Shape \"sphere\"
        Attribute \"shape\" \"float radius\" 4 Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0]",
        &[],
    );
    assert_eq!(described.the(Kind::Bsdf, "diffuse").rgb("reflectance"), [1.0, 0.0, 0.0]);
    assert!(
        warnings.is_empty(),
        "what an attribute sets may be of no use: {warnings:?}"
    );
}

/// An include is text in its place, an import keeps its state to itself; either may be packed.
#[test]
fn files_within_files() {
    let packed = {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(b"Translate 0 0 9 Shape \"sphere\"").unwrap();
        encoder.finish().unwrap()
    };
    let text = "WorldBegin Include \"parts/a.pbrt\" Shape \"sphere\" Import \"b.pbrt.gz\" Shape \"sphere\"";
    let others: [(&str, &[u8]); 3] = [
        ("parts/a.pbrt", b"Translate 1 0 0\nInclude \"c.pbrt\""),
        ("parts/c.pbrt", b"Scale 2 2 2"),
        ("b.pbrt.gz", &packed),
    ];
    let (described, warnings) = describe_with(text, &others);
    let spheres = described.objects.iter().filter(|object| object.plugin == "sphere");
    let places: Vec<_> = spheres
        .map(|sphere| {
            sphere.corners()[..2]
                .iter()
                .map(|corner| corner.to_array())
                .collect::<Vec<_>>()
        })
        .collect();
    assert_eq!(
        places,
        [
            [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]],
            [[1.0, 0.0, 18.0], [3.0, 0.0, 18.0]],
            [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]],
        ]
    );
    assert!(warnings.is_empty(), "{warnings:?}");
}

#[test]
fn objects_are_groups_and_their_instances() {
    let text = "WorldBegin Translate 0 1 0 ObjectBegin \"tree\" Material \"dielectric\" Translate 1 0 0 Shape \"sphere\" ObjectEnd
        Shape \"disk\" Translate 0 0 5 ObjectInstance \"tree\" ObjectBegin \"nothing\" ObjectEnd ObjectInstance \"nothing\"";
    let (described, warnings) = describe_with(text, &[]);
    let instance = described.the(Kind::Shape, "instance");
    let group = described.child(instance, None);
    assert_eq!(group.plugin, "shapegroup");
    assert_eq!(described.child(group, None).plugin, "sphere");
    assert_eq!(described.child(group, None).corners()[0], DVec3::new(1.0, 1.0, 0.0));
    // What is placed is the group as it stands where it is defined.
    assert_eq!(instance.corners()[0], DVec3::new(0.0, 1.0, 5.0));
    let in_scene: Vec<_> = described.objects[0]
        .children
        .iter()
        .map(|child| &*described.objects[child.target].plugin)
        .collect();
    assert_eq!(in_scene, ["disk", "instance"]);
    assert!(warnings.is_empty(), "{warnings:?}");
}

#[test]
fn crops_of_the_film() {
    let film = |parameters: &str| {
        let text = format!(
            "Film \"rgb\" \"integer xresolution\" 100 \"integer yresolution\" 50 {parameters} Camera \"perspective\""
        );
        let described = describe(&text);
        let film = described.the(Kind::Film, "hdrfilm");
        ["crop_offset_x", "crop_offset_y", "crop_width", "crop_height"]
            .map(|name| film.properties.contains_key(name).then(|| film.number(name)))
    };
    assert_eq!(film("\"float cropwindow\" [0 1 0 1]"), [None; 4]);
    assert_eq!(
        film("\"float cropwindow\" [0.101 0.5 0 0.5]"),
        [11.0, 0.0, 39.0, 25.0].map(Some)
    );
    assert_eq!(
        film("\"integer pixelbounds\" [10 30 5 45]"),
        [10.0, 5.0, 20.0, 40.0].map(Some)
    );
}

#[test]
fn a_spherical_camera_begins_at_x_and_goes_to_z() {
    let described = describe("Translate 0 0 2 Camera \"spherical\" \"string mapping\" \"equirectangular\"");
    let [origin, x, y, z] = described.the(Kind::Sensor, "spherical").corners();
    near(origin.to_array(), [0.0, 0.0, -2.0]);
    // Ours begins at -z and goes to +x.
    near((origin - z).to_array(), [1.0, 0.0, 0.0]);
    near((x - origin).to_array(), [0.0, 0.0, 1.0]);
    near((y - origin).to_array(), [0.0, 1.0, 0.0]);
}

//! How bright lights are, in what colour, and where they shine.

use super::{Description, describe, describe_with, load, load_with, near, seen};
use crate::geometry::Ray;
use crate::math::Vec3;
use crate::scene::description::{Kind, Value};
use crate::spectrum::Spectrum;
use std::f64::consts::PI;

/// The colour of a light of the plugin in the world of a text.
fn colour_of(text: &str, plugin: &str, name: &str) -> [f64; 3] {
    describe(text).the(Kind::Emitter, plugin).rgb(name)
}

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.212_671 * r + 0.715_160 * g + 0.072_169 * b
}

/// `rgb` comes out as written; other spectra have luminance 1, times `scale`.
#[test]
fn spectra_of_lights_have_luminance_one() {
    let point = |parameters: &str| colour_of(&format!("LightSource \"point\" {parameters}"), "point", "intensity");
    assert_eq!(point("\"rgb I\" [3 2 1]"), [3.0, 2.0, 1.0]);
    assert_eq!(point("\"rgb I\" [3 2 1] \"float scale\" 10"), [30.0, 20.0, 10.0]);
    assert_eq!(point("\"spectrum I\" \"stdillum-D65\""), [1.0; 3]);
    assert_eq!(point(""), [1.0; 3]);
    for spectrum in [
        "\"blackbody I\" 2800",
        "\"blackbody I\" [6500]",
        "\"spectrum I\" [400 7 500 9 700 3]",
        "\"spectrum I\" \"stdillum-A\"",
    ] {
        let colour = point(spectrum);
        assert!((luminance(colour) - 1.0).abs() < 2e-3, "{spectrum}: {colour:?}");
        near(
            point(&format!("{spectrum} \"float scale\" 5")),
            colour.map(|channel| 5.0 * channel),
        );
    }
    let [r, _, b] = point("\"blackbody I\" 2800");
    assert!(r > 3.0 * b, "incandescent light is yellow");
    // The black body of 6500 K is nearly the white of D65.
    let white = point("\"blackbody I\" 6504");
    assert!(white.iter().all(|channel| (channel - 1.0).abs() < 0.06), "{white:?}");
}

/// pbrt-v3 writes a scale besides the temperature, for a spectrum whose largest value is 1.
#[test]
fn black_bodies_of_pbrt_v3_have_their_own_scale() {
    let point = |parameters: &str| colour_of(&format!("LightSource \"point\" {parameters}"), "point", "intensity");
    // At 5220 K the peak is that of the eye, 555 nm, and the spectrum is nearly 1 where it sees.
    let colour = point("\"blackbody I\" [5220 1]");
    assert!((0.97..1.0).contains(&luminance(colour)), "{colour:?}");
    near(point("\"blackbody I\" [5220 7]"), colour.map(|channel| 7.0 * channel));
    let old = "Film \"image\" LightSource \"point\" \"spectrum I\" [300 2 900 2]";
    // The equal-energy white of twice the brightness.
    near(colour_of(old, "point", "intensity"), [2.409_766, 1.896_458, 1.818_534]);
}

#[test]
fn the_film_exposes() {
    let ratio = |before: &str| {
        colour_of(
            &format!("{before} WorldBegin LightSource \"point\""),
            "point",
            "intensity",
        )[1]
    };
    assert_eq!(ratio("Camera \"perspective\" Film \"rgb\""), 1.0);
    assert_eq!(ratio("Film \"rgb\" \"float iso\" 400"), 4.0);
    assert_eq!(
        ratio("Film \"rgb\" \"float iso\" 400 Camera \"perspective\" \"float shutterclose\" 0.5"),
        2.0
    );
    assert_eq!(
        ratio("Camera \"perspective\" \"float shutteropen\" 2 \"float shutterclose\" 2.25"),
        0.25
    );
    assert_eq!(
        ratio("Film \"image\" \"float scale\" 3 Camera \"perspective\" \"float shutterclose\" 0.5"),
        3.0
    );
    let (_, warnings) = describe_with(
        "Film \"rgb\" \"string sensor\" \"canon_eos_100d\" Camera \"perspective\"",
        &[],
    );
    assert!(
        warnings.len() == 1 && warnings[0].contains("canon_eos_100d"),
        "{warnings:?}"
    );
}

/// Power over what a light of intensity 1 emits.
#[test]
fn power_is_shared_by_all_directions() {
    near(
        colour_of("LightSource \"point\" \"float power\" 100", "point", "intensity"),
        [100.0 / (4.0 * PI); 3],
    );
    let spot = "LightSource \"spot\" \"float power\" 100 \"float coneangle\" 60 \"float conedeltaangle\" 0";
    near(colour_of(spot, "spot", "intensity"), [100.0 / PI; 3]);
    near(
        colour_of(
            "LightSource \"distant\" \"float illuminance\" 7 \"rgb L\" [1 2 3]",
            "directional",
            "irradiance",
        ),
        [7.0, 14.0, 21.0],
    );
    near(
        colour_of(
            "LightSource \"infinite\" \"float illuminance\" 7",
            "constant",
            "radiance",
        ),
        [7.0 / PI; 3],
    );
}

/// The power of area lights is found out where their area is known.
#[test]
fn power_of_area_lights_is_shared_by_their_area() {
    let ply = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
        property list uchar int vertex_indices\nend_header\n-1 -1 0\n1 -1 0\n1 1 0\n-1 1 0\n3 0 1 2\n3 0 2 3\n";
    let mut dark = image(2, 1);
    let light = dark.len() - 12;
    dark[light..].copy_from_slice(&[0.5_f32; 3].map(f32::to_le_bytes).concat());
    let others: [(&str, &[u8]); 2] = [("square.ply", ply), ("half.pfm", &dark)];
    let shines = |light: &str, shape: &str| {
        let text = format!("WorldBegin AreaLightSource \"diffuse\" \"float power\" 10 {light} {shape}");
        let scene = load_with(&text, &others).unwrap_or_else(|faults| panic!("{faults}"));
        f64::from(seen(&scene, Vec3::new(-0.5, -0.5, 100.0), Vec3::new(-0.5, -0.5, 0.0))[1])
    };
    let close =
        |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-4, "{found}, expected {expected}");
    close(
        shines("", "Scale 3 3 3 Shape \"sphere\" \"float radius\" 2"),
        10.0 / (PI * 4.0 * PI * 36.0),
    );
    close(
        shines("\"bool twosided\" true", "Shape \"disk\" \"float radius\" 2"),
        10.0 / (PI * 8.0 * PI),
    );
    let ring = "Translate -1.5 0 0 Shape \"disk\" \"float radius\" 2 \"float innerradius\" 0.1";
    assert!((shines("", ring) / (10.0 / (PI * 3.99 * PI)) - 1.0).abs() < 1e-3);
    // Each triangle is a light of the whole power, and each patch.
    let square = "\"point3 P\" [-1 -1 0 1 -1 0 1 1 0 -1 1 0] \"integer indices\" [0 1 2 0 2 3]";
    close(
        shines("", &format!("Shape \"trianglemesh\" {square}")),
        10.0 / (PI * 2.0),
    );
    close(
        shines("", "Scale 2 2 1 Shape \"plymesh\" \"string filename\" \"square.ply\""),
        10.0 / (PI * 8.0),
    );
    close(
        shines("", "Shape \"bilinearmesh\" \"point3 P\" [-1 -1 0 1 -1 0 -1 1 0 1 1 0]"),
        10.0 / (PI * 4.0),
    );
    // The image's mean is 3/4, and where it is seen its value is 1: the scale multiplies as in pbrt.
    let seen = shines(
        "\"string filename\" \"half.pfm\" \"float scale\" 2",
        "Shape \"bilinearmesh\" \"point3 P\" [-1 -1 0 1 -1 0 -1 1 0 1 1 0]",
    );
    close(seen, 2.0 * 10.0 / (PI * 4.0 * 0.75));
}

#[test]
fn lights_stand_and_point_where_they_are_written() {
    let described = describe("WorldBegin Translate 1 0 0 LightSource \"point\" \"point3 from\" [0 2 0]");
    near(
        described.the(Kind::Emitter, "point").corners()[0].to_array(),
        [1.0, 2.0, 0.0],
    );
    let described =
        describe("WorldBegin Scale 2 2 2 LightSource \"spot\" \"point3 from\" [1 0 0] \"point3 to\" [1 5 0]");
    let [origin, x, _, z] = described.the(Kind::Emitter, "spot").corners();
    near(origin.to_array(), [2.0, 0.0, 0.0]);
    near((z - origin).to_array(), [0.0, 1.0, 0.0]);
    assert!(((x - origin).length() - 1.0).abs() < 1e-12, "scales are left out");
    let described =
        describe("WorldBegin Rotate 90 0 0 1 LightSource \"distant\" \"point3 from\" [3 0 0] \"point3 to\" [0 0 0]");
    let Value::Vector(direction) = described.the(Kind::Emitter, "directional").value("direction") else {
        panic!("a direction is a vector");
    };
    near(direction.to_array(), [0.0, -3.0, 0.0]);
    let described = describe("WorldBegin LightSource \"spot\" \"float coneangle\" 40 \"float conedeltaangle\" 10");
    let spot = described.the(Kind::Emitter, "spot");
    assert_eq!((spot.number("cutoff_angle"), spot.number("beam_width")), (40.0, 30.0));
}

/// A portable float map of `width` times `height` pixels.
fn image(width: usize, height: usize) -> Vec<u8> {
    let mut bytes = format!("PF\n{width} {height}\n-1\n").into_bytes();
    bytes.extend((0..width * height * 3).flat_map(|_| 1.0_f32.to_le_bytes()));
    bytes
}

/// Light of the background along a direction.
fn sky(parameters: &str, image: &[u8]) -> impl Fn([f32; 3]) -> f32 + use<> {
    let text = format!("WorldBegin {parameters} Shape \"sphere\"");
    let others: [(&str, &[u8]); 1] = [("sky.pfm", image)];
    let scene = load_with(&text, &others).unwrap_or_else(|faults| panic!("{faults}"));
    move |direction| scene.lights.background(Vec3::from_array(direction).normalize())[1]
}

/// An image whose value is the number of its texel, from the upper left.
fn numbered(width: usize, height: usize) -> Vec<u8> {
    let mut bytes = format!("PF\n{width} {height}\n-1\n").into_bytes();
    for row in (0..height).rev() {
        for column in 0..width {
            let value = (row * width + column) as f32;
            bytes.extend([value; 3].map(f32::to_le_bytes).concat());
        }
    }
    bytes
}

/// Square images are of equal areas about +z; others are those of pbrt-v3, from +x over +y about +z.
#[test]
fn images_of_all_directions() {
    let square = sky(
        "LightSource \"infinite\" \"string filename\" \"sky.pfm\" \"float scale\" 3",
        &numbered(3, 3),
    );
    assert_eq!(square([0.0, 0.0, 1.0]), 12.0, "the middle is +z");
    let turned = sky(
        "Rotate 90 0 1 0 LightSource \"infinite\" \"string filename\" \"sky.pfm\"",
        &numbered(3, 3),
    );
    assert_eq!(turned([1.0, 0.0, 0.0]), 4.0);
    // A matrix whose translation stands in the wrong place, as some files have it.
    let projects = "ConcatTransform [1 0 0 8 0 1 0 0 0 0 1 0 0 0 0 1]";
    let image = numbered(3, 3);
    let projected = sky(
        &format!("AttributeBegin {projects} LightSource \"infinite\" \"string filename\" \"sky.pfm\" AttributeEnd"),
        &image,
    );
    assert_eq!(projected([0.0, 0.0, 1.0]), 4.0);
    let wide = sky(
        "LightSource \"infinite\" \"string mapname\" \"sky.pfm\" \"rgb scale\" [1 2 3]",
        &numbered(8, 4),
    );
    // The rows of texels lie at 0, 60, 120 and 180 degrees from the pole, the columns begin at +x.
    let at = |theta: f64, phi: f64| {
        let ((sin_theta, cos_theta), (sin_phi, cos_phi)) =
            (libm::sincos(theta.to_radians()), libm::sincos(phi.to_radians()));
        [sin_theta * cos_phi, sin_theta * sin_phi, cos_theta].map(|x| x as f32)
    };
    for (theta, phi, texel) in [
        (60.0, 22.5, 8.0),
        (60.0, 67.5, 9.0),
        (120.0, 337.5, 23.0),
        // The pole has the longitude 0, between the last column and the first.
        (0.0, 0.0, 3.5),
    ] {
        let found = wide(at(theta, phi));
        assert!((found - 2.0 * texel).abs() < 1e-3, "{theta} {phi}: {found}");
    }
}

/// As pbrt-v4 has it: under a sky of radiance 1 it finds half of pi.
#[test]
fn illuminance_of_an_image() {
    let even = sky(
        "LightSource \"infinite\" \"string filename\" \"sky.pfm\" \"float illuminance\" 10 \"float scale\" 2",
        &image(64, 64),
    );
    let (found, expected) = (f64::from(even([0.0, 1.0, 0.0])), 2.0 * 10.0 / (0.5 * PI));
    assert!((found / expected - 1.0).abs() < 1e-3, "{found}, expected {expected}");
}

#[test]
fn goniometric_and_projection_lights() {
    let (described, warnings) = describe_with(
        "WorldBegin LightSource \"goniometric\" \"string filename\" \"g.pfm\" \"rgb I\" [4 2 1]
        LightSource \"projection\" \"string filename\" \"p.png\" \"float fov\" 30 \"float scale\" 2",
        &[],
    );
    assert!(warnings.is_empty(), "{warnings:?}");
    let light = described.the(Kind::Emitter, "goniometric");
    assert_eq!(
        (light.text("mapping"), light.rgb("intensity")),
        ("pbrt", [4.0, 2.0, 1.0])
    );
    let [_, _, y, z] = light.corners();
    near(y.to_array(), [0.0, 0.0, 1.0]);
    near(z.to_array(), [0.0, 1.0, 0.0]);
    let light = described.the(Kind::Emitter, "projector");
    assert_eq!(
        (
            light.number("fov"),
            light.text("fov_axis"),
            light.number("scale"),
            light.text("even")
        ),
        (30.0, "smaller", 2.0, "directions")
    );
    near(light.corners()[1].to_array(), [-1.0, 0.0, 0.0]);
    assert_eq!(described.child(light, Some("irradiance")).text("filename"), "p.png");
}

/// The light that arrives 1 before a lamp that throws an image.
fn thrown(parameters: &str, at: [f32; 3]) -> f64 {
    let image = image(64, 64);
    let text = format!("WorldBegin LightSource {parameters} Translate 0 0 50 Shape \"sphere\"");
    let scene = load_with(&text, &[("i.pfm", &image)]).unwrap_or_else(|faults| panic!("{faults}"));
    let sample = scene
        .lights
        .sample_direct(&scene.geometry, Vec3::from_array(at), 0.5, [0.5; 2].into());
    sample.map_or(0.0, |sample| {
        f64::from(sample.radiance[1] * sample.distance * sample.distance)
    })
}

/// The power of white images: over all directions, and over the pyramid of the image.
#[test]
fn power_of_images_is_shared_by_their_directions() {
    let lamp = "\"goniometric\" \"string filename\" \"i.pfm\" \"float power\" 10 \"rgb I\" [2 2 2]";
    let (found, expected) = (thrown(lamp, [0.1, 0.2, 1.0]), 2.0 * 10.0 / (4.0 * PI));
    assert!((found / expected - 1.0).abs() < 1e-4, "{found}, expected {expected}");
    let slide = "\"projection\" \"string filename\" \"i.pfm\" \"float power\" 10 \"float scale\" 2";
    // The pyramid with half angles of 45 degrees is a sixth of all directions.
    let expected = 2.0 * 10.0 / (4.0 * PI / 6.0);
    for at in [[0.0, 0.0, 1.0], [0.9, -0.7, 1.0]] {
        let found = thrown(slide, at);
        assert!(
            (found / expected - 1.0).abs() < 1e-3,
            "{at:?}: {found}, expected {expected}"
        );
    }
    assert_eq!(thrown(slide, [1.1, 0.0, 1.0]), 0.0);
}

/// Half-way between the cosines of the cone and of where it begins to fade: half in pbrt-v4, a sixteenth in pbrt-v3.
#[test]
fn spots_fade_as_in_pbrt() {
    let cos = 0.5 * (libm::cos(30.0_f64.to_radians()) + libm::cos(20.0_f64.to_radians()));
    let at = [(1.0 - cos * cos).sqrt() as f32, 0.0, cos as f32];
    let spot = "\"spot\" \"float coneangle\" 30 \"float conedeltaangle\" 10 \"rgb I\" [8 8 8]";
    assert!((thrown(spot, at) - 4.0).abs() < 1e-4);
    let old = format!("\"infinite\" \"rgb L\" [0 0 0] Film \"image\" LightSource {spot}");
    assert!((thrown(&old, at) - 0.5).abs() < 1e-4);
}

/// From which side a light is seen to shine.
#[test]
fn lights_shine_from_their_outer_side() {
    let triangle = "\"point3 P\" [-1 -1 0 1 -1 0 0 2 0]";
    let both_sides = |before: &str, shape: &str| {
        let scene = load(&format!(
            "WorldBegin AreaLightSource \"diffuse\" {before} Shape {shape}"
        ));
        [1.0, -1.0].map(|z| seen(&scene, Vec3::new(0.1, 0.1, 9.0 * z), Vec3::new(0.1, 0.1, 0.0)) == Spectrum::ONE)
    };
    let [up, down] = [[true, false], [false, true]];
    let mesh = format!("\"trianglemesh\" {triangle}");
    assert_eq!(both_sides("", &mesh), up, "counter-clockwise from +z");
    assert_eq!(both_sides("ReverseOrientation", &mesh), down);
    assert_eq!(
        both_sides("Scale -1 1 1", &mesh),
        up,
        "a mirroring turns the winding, and the normal back"
    );
    assert_eq!(both_sides("Scale -1 1 1 ReverseOrientation", &mesh), down);
    assert_eq!(both_sides("Scale 1 1 -1", &mesh), down);
    let with_normals = format!("{mesh} \"normal N\" [0 0 -1 0 0 -1 0 0 -1]");
    assert_eq!(both_sides("", &with_normals), down, "normals of the mesh decide");
    assert_eq!(both_sides("ReverseOrientation", &with_normals), up);
    assert_eq!(both_sides("Scale -1 1 1", &with_normals), down);
    assert_eq!(both_sides("\"bool twosided\" \"true\"", &mesh), [true, true]);
    assert_eq!(both_sides("", "\"disk\""), up);
    assert_eq!(both_sides("ReverseOrientation", "\"disk\""), down);
    assert_eq!(both_sides("", "\"disk\" \"float phimax\" 350"), up);
    assert_eq!(
        both_sides("Scale -1 1 1", "\"disk\""),
        down,
        "the normal is turned, and the winding with it"
    );
    assert_eq!(both_sides("Scale -1 1 1", "\"disk\" \"float phimax\" 350"), down);
    let patch = "\"bilinearmesh\" \"point3 P\" [-1 -1 0 1 -1 0 -1 1 0 1 1 0]";
    assert_eq!(both_sides("", patch), up);
    assert_eq!(both_sides("ReverseOrientation", patch), down);
    assert_eq!(both_sides("", "\"sphere\""), [true, true], "outwards");
    assert_eq!(both_sides("ReverseOrientation", "\"sphere\""), [false, false]);
    assert_eq!(
        both_sides("Scale -1 1 1", "\"sphere\""),
        [false, false],
        "as in pbrt, a mirroring turns it inwards"
    );
    assert_eq!(both_sides("Scale 1 2 1", "\"sphere\""), [true, true]);
    assert_eq!(
        both_sides(
            "",
            "\"loopsubdiv\" \"point3 P\" [-5 -5 0 5 -5 0 0 5 0] \"integer indices\" [0 1 2]"
        ),
        up
    );
}

#[test]
fn area_lights_belong_to_the_block_and_not_to_objects() {
    let emitters = |described: &Description| {
        described
            .objects
            .iter()
            .filter(|object| object.plugin == "area")
            .count()
    };
    let text = "WorldBegin AttributeBegin AreaLightSource \"diffuse\" \"bool twosided\" true Shape \"sphere\" AttributeEnd Shape \"sphere\"";
    let (described, warnings) = describe_with(text, &[]);
    assert_eq!(emitters(&described), 1);
    assert!(described.the(Kind::Emitter, "area").is_set("two_sided") && warnings.is_empty());
    let text =
        "WorldBegin ObjectBegin \"a\" AreaLightSource \"diffuse\" Shape \"sphere\" ObjectEnd ObjectInstance \"a\"";
    let (described, warnings) = describe_with(text, &[]);
    assert_eq!(emitters(&described), 0);
    assert!(
        warnings.len() == 1 && warnings[0].contains("objects do not shine"),
        "{warnings:?}"
    );
    let image = "WorldBegin AreaLightSource \"diffuse\" \"string filename\" \"a.png\" \"float scale\" 3 Shape \"disk\"";
    let described = describe(image);
    let scaled = described.child(described.the(Kind::Emitter, "area"), Some("radiance"));
    assert_eq!((scaled.plugin.as_str(), scaled.number("scale")), ("scale", 3.0));
    assert_eq!(described.child(scaled, Some("tex")).text("filename"), "a.png");
}

/// The corners are in world space whatever the transform is, and light comes from the side of (d - a) x (b - a) alone.
#[test]
fn portals_stand_in_world_space_and_open_to_one_side() {
    let at = |light: &str, direction: Vec3| {
        let text =
            format!("WorldBegin Rotate 30 1 2 3 Translate 5 6 7 LightSource \"infinite\" {light} Shape \"sphere\"");
        let scene = load_with(&text, &[("sky.pfm", &image(2, 2))]).unwrap_or_else(|faults| panic!("{faults}"));
        let warned = scene.warnings.iter().any(|warning| warning.message.contains("portal"));
        assert!(!warned, "{:?}", scene.warnings);
        let ray = Ray {
            origin: Vec3::new(0.9, 1.9, 2.0),
            direction,
            max_distance: f32::INFINITY,
        };
        let found = scene.lights.beyond(&ray);
        found.map(|beyond| beyond.radiance(direction)).sum::<Spectrum>()[1]
    };
    let up = "\"point3 portal\" [0 0 3 1 0 3 1 2 3 0 2 3]";
    let down = "\"point3 portal\" [0 0 3 0 2 3 1 2 3 1 0 3]";
    let image = "\"string filename\" \"sky.pfm\" \"float scale\" 2";
    for (light, radiance) in [(image, 2.0), ("\"rgb L\" [5 5 5]", 5.0), ("", 1.0)] {
        let seen = |portal: &str, direction| at(&format!("{light} {portal}"), direction);
        // (d - a) x (b - a) is y x x, which is -z, and turned round +z.
        assert_eq!(seen(down, Vec3::Z), radiance);
        assert_eq!(seen(up, Vec3::Z), 0.0, "from the other side");
        assert_eq!(seen(down, Vec3::NEG_Z), 0.0, "behind");
        assert_eq!(seen(down, Vec3::new(0.6, 0.0, 0.8)), 0.0, "beside it");
    }
    // As an image of one texel, whose illuminance pbrt counts as twice what it is.
    let lit = at(&format!("\"rgb L\" [3 3 3] \"float illuminance\" 7 {down}"), Vec3::Z);
    assert!((f64::from(lit) - 7.0 / (2.0 * PI)).abs() < 1e-5, "{lit}");
}

//! How bright lights are, in what colour, and where they shine.

use super::{Description, describe, describe_with, load, near, seen};
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
    let area = |shape: &str| {
        colour_of(
            &format!("WorldBegin AreaLightSource \"diffuse\" \"float power\" 10 {shape}"),
            "area",
            "radiance",
        )
    };
    near(
        area("Scale 3 3 3 Shape \"sphere\" \"float radius\" 2"),
        [10.0 / (PI * 4.0 * PI * 36.0); 3],
    );
    near(
        area("Shape \"disk\" \"float radius\" 2 \"float innerradius\" 1"),
        [10.0 / (PI * 3.0 * PI); 3],
    );
    // Each triangle is a light of the whole power.
    near(
        area(
            "Scale 2 2 1 Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 1 1 0 0 1 0] \"integer indices\" [0 1 2 0 2 3]",
        ),
        [10.0 / (PI * 2.0); 3],
    );
    near(
        area("Shape \"bilinearmesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0 1 1 0]"),
        [10.0 / PI; 3],
    );
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

/// Square images are of equal areas about +z; others are those of pbrt-v3, from +x over +y about +z.
#[test]
fn images_of_all_directions() {
    let square = image(4, 4);
    let others: [(&str, &[u8]); 1] = [("sky.pfm", &square)];
    let text = "WorldBegin Rotate 90 0 0 1 LightSource \"infinite\" \"string filename\" \"sky.pfm\" \"float scale\" 3";
    let (described, warnings) = describe_with(text, &others);
    let light = described.the(Kind::Emitter, "envmap");
    assert_eq!((light.text("mapping"), light.number("scale")), ("equalarea", 3.0));
    near(light.corners()[1].to_array(), [0.0, 1.0, 0.0]);
    assert!(warnings.is_empty(), "{warnings:?}");
    let wide = image(8, 4);
    let others: [(&str, &[u8]); 1] = [("sky.pfm", &wide)];
    let (described, _) = describe_with(
        "WorldBegin LightSource \"infinite\" \"string mapname\" \"sky.pfm\"",
        &others,
    );
    let light = described.the(Kind::Emitter, "envmap");
    assert!(!light.properties.contains_key("mapping"));
    // Our image begins at -z and goes to +x, with its upper edge at +y.
    let [_, x, y, z] = light.corners();
    near((-z).to_array(), [1.0, 0.0, 0.0]);
    near(x.to_array(), [0.0, 1.0, 0.0]);
    near(y.to_array(), [0.0, 0.0, 1.0]);
}

#[test]
fn goniometric_and_projection_lights() {
    let (described, _) = describe_with(
        "WorldBegin LightSource \"goniometric\" \"string filename\" \"g.pfm\" \"rgb I\" [4 2 1]
        LightSource \"projection\" \"string filename\" \"p.png\" \"float fov\" 30 \"float scale\" 2",
        &[],
    );
    let light = described.the(Kind::Emitter, "goniometric");
    assert_eq!(
        (light.text("mapping"), light.rgb("intensity")),
        ("equalarea", [4.0, 2.0, 1.0])
    );
    let [_, _, y, z] = light.corners();
    near(y.to_array(), [0.0, 0.0, 1.0]);
    near(z.to_array(), [0.0, 1.0, 0.0]);
    let light = described.the(Kind::Emitter, "projector");
    assert_eq!((light.number("fov"), light.text("fov_axis")), (30.0, "smaller"));
    assert!((light.number("scale") - 2.0 / PI).abs() < 1e-12);
    near(light.corners()[1].to_array(), [-1.0, 0.0, 0.0]);
    assert_eq!(described.child(light, Some("irradiance")).text("filename"), "p.png");
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
    assert!(
        warnings.len() == 1 && warnings[0].contains("`twosided`: the shape shines from its outer side"),
        "{warnings:?}"
    );
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

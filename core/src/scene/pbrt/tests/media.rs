//! Media.

use super::super::heat::{Heat, LUMINANCE_OF_ONE};
use super::*;
use crate::medium::{Extinction, Grid};
use std::sync::Arc;

const BALL: &str =
    "WorldBegin AttributeBegin MediumInterface \"m\" \"\" Material \"interface\" Shape \"sphere\" AttributeEnd";

/// What a medium of these parameters becomes, in front of a ball that holds it, and what is warned about.
fn medium_with(parameters: &str, others: &[(&str, &[u8])]) -> (Description, Vec<String>) {
    describe_with(&format!("MakeNamedMedium \"m\" {parameters} {BALL}"), others)
}

fn medium(parameters: &str) -> Description {
    let (description, warnings) = medium_with(parameters, &[]);
    assert_eq!(warnings, Vec::<String>::new());
    description
}

/// The lattice of a medium, and its factor.
fn volume<'d>(description: &'d Description, name: &str) -> (&'d Arc<Grid>, [f64; 3]) {
    let medium = description.the(Kind::Medium, "heterogeneous");
    let volume = description.child(medium, Some(name));
    match volume.value("grid") {
        Value::Grid(grid) => (grid, volume.rgb("factor")),
        other => panic!("{other:?}"),
    }
}

fn near(found: [f32; 3], expected: [f64; 3]) {
    for (found, expected) in found.into_iter().zip(expected) {
        assert!(
            (f64::from(found) - expected).abs() <= 1e-5 * expected.abs() + 1e-9,
            "{found} is not {expected}"
        );
    }
}

/// pbrt-v4 takes 1 for what is not written, pbrt-v3 milk; a substance comes before what is written in pbrt-v4.
#[test]
fn coefficients_of_even_media() {
    let of = |parameters: &str| {
        let description = medium(&format!("\"string type\" \"homogeneous\" {parameters}"));
        let medium = description.the(Kind::Medium, "homogeneous");
        (medium.rgb("sigma_a"), medium.rgb("sigma_s"))
    };
    assert_eq!(of(""), ([1.0; 3], [1.0; 3]));
    assert_eq!(
        of("\"rgb sigma_a\" [1 2 3] \"spectrum sigma_s\" [400 0 800 0] \"float scale\" 2"),
        ([2.0, 4.0, 6.0], [0.0; 3])
    );
    assert_eq!(
        of("\"string preset\" \"Skin1\" \"rgb sigma_a\" [1 2 3] \"float scale\" 10"),
        (
            [0.032 * 10.0, 0.17 * 10.0, 0.48 * 10.0],
            [0.74 * 10.0, 0.88 * 10.0, 1.01 * 10.0]
        )
    );
    let description = medium(
        "\"string type\" \"homogeneous\" \"rgb sigma_a\" [1 2 3] \"rgb Le\" [4 2 1] \"float Lescale\" 0.5 \"float g\" 0.3",
    );
    let medium = description.the(Kind::Medium, "homogeneous");
    assert_eq!(medium.rgb("emission"), [2.0, 2.0, 1.5]);
    assert_eq!(description.child(medium, None).number("g"), 0.3);
}

#[test]
fn lattices_of_densities() {
    let v4 = medium(
        "\"string type\" \"uniformgrid\" \"integer nx\" 2 \"integer nz\" 2 \"float density\" [0 1 2 -3] \"point3 p1\" [2 2 2]",
    );
    let (grid, factor) = volume(&v4, "sigma_t");
    assert_eq!((grid.size(), factor), ([2, 1, 2], [2.0; 3]));
    let values = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]].map(|voxel| grid.voxel(voxel)[0]);
    assert_eq!(values, [0.0, 1.0, 2.0, 0.0]);
    assert_eq!(v4.the(Kind::Medium, "heterogeneous").rgb("albedo"), [0.5; 3]);
    let v3 =
        medium("\"string type\" \"heterogeneous\" \"float density\" 3 \"point p0\" [-1 -1 -1] \"point p1\" [1 1 1]");
    let (grid, factor) = volume(&v3, "sigma_t");
    assert_eq!(grid.voxel([0; 3])[0], 3.0);
    assert_eq!(factor, [2.55 + 0.0011, 3.21 + 0.0024, 3.77 + 0.014]);
    let scene = load(&format!(
        "Film \"rgb\" \"integer xresolution\" 4 \"integer yresolution\" 4 Camera \"perspective\" \
         MakeNamedMedium \"m\" \"string type\" \"heterogeneous\" \"float density\" 3 {BALL}"
    ));
    assert!(matches!(
        scene.media.unwrap().media[0].extinction,
        Extinction::Varying(_)
    ));
    for (parameters, expected) in [
        (
            "\"integer nx\" 3 \"float density\" [1 2]",
            "`density`: 2 numbers, not the 3 of 3 x 1 x 1",
        ),
        (
            "\"float density\" 1 \"float temperature\" [1 2]",
            "`temperature`: 2 numbers, not the 1 of 1 x 1 x 1",
        ),
        (
            "\"integer nx\" 0 \"float density\" 1",
            "`nx`: 0 is out of range; allowed: 1 and above",
        ),
    ] {
        let text = format!("MakeNamedMedium \"m\" \"string type\" \"uniformgrid\" {parameters} {BALL}");
        let faults = load_with(&text, &[]).unwrap_err().to_string();
        assert!(faults.contains(expected), "{faults}");
    }
}

/// Emission is density, absorption and `Le`, or the black body of a temperature (pbrt-v4, `GridMedium::SamplePoint`).
#[test]
fn lattices_glow() {
    let grid = "\"string type\" \"uniformgrid\" \"integer nx\" 2 \"float density\" [2 3] \"rgb sigma_a\" [1 2 4]";
    let even = medium(&format!("{grid} \"rgb Le\" [4 2 1]"));
    let (emission, factor) = volume(&even, "emission");
    assert!(Arc::ptr_eq(emission, volume(&even, "sigma_t").0));
    assert_eq!(factor, [4.0; 3]);
    let scaled = medium(&format!("{grid} \"rgb Le\" [4 2 1] \"float Lescale\" [0 5]"));
    let (emission, factor) = volume(&scaled, "emission");
    assert_eq!(factor, [4.0; 3]);
    near(emission.voxel([0; 3]).to_rgb(), [0.0; 3]);
    near(emission.voxel([1, 0, 0]).to_rgb(), [15.0; 3]);
    let hot = medium(&format!(
        "{grid} \"float temperature\" [10 40] \"float temperatureoffset\" 10 \"float temperaturescale\" 100 \"float Lescale\" [1 2]"
    ));
    let (emission, factor) = volume(&hot, "emission");
    assert_eq!(factor, [1.0, 2.0, 4.0]);
    near(emission.voxel([0; 3]).to_rgb(), [0.0; 3]);
    near(
        emission.voxel([1, 0, 0]).to_rgb(),
        Heat::new().at(3000.0).map(|channel| 6.0 * channel),
    );
}

#[test]
fn lattices_of_colours() {
    let description = medium(
        "\"string type\" \"rgbgrid\" \"integer ny\" 2 \"rgb sigma_a\" [1 2 3 0 0 0] \"rgb sigma_s\" [3 2 1 0 4 0] \"float scale\" 2 \
         \"rgb Le\" [1 1 2 1 1 1] \"float Lescale\" 0.5",
    );
    let (extinction, factor) = volume(&description, "sigma_t");
    assert_eq!(factor, [2.0; 3]);
    near(extinction.voxel([0; 3]).to_rgb(), [4.0; 3]);
    near(extinction.voxel([0, 1, 0]).to_rgb(), [0.0, 4.0, 0.0]);
    let (albedo, _) = volume(&description, "albedo");
    near(albedo.voxel([0; 3]).to_rgb(), [0.75, 0.5, 0.25]);
    near(albedo.voxel([0, 1, 0]).to_rgb(), [0.0, 1.0, 0.0]);
    let (emission, factor) = volume(&description, "emission");
    assert_eq!(factor, [1.0; 3]);
    near(
        emission.voxel([0; 3]).to_rgb(),
        [1.0, 2.0, 6.0].map(|channel| channel * LUMINANCE_OF_ONE),
    );
    // What is not written is 1.
    let absorbing = medium("\"string type\" \"rgbgrid\" \"rgb sigma_a\" [1 2 3]");
    near(volume(&absorbing, "sigma_t").0.voxel([0; 3]).to_rgb(), [2.0, 3.0, 4.0]);
    let none = load_with(
        &format!("MakeNamedMedium \"m\" \"string type\" \"rgbgrid\" {BALL}"),
        &[],
    );
    assert!(
        none.unwrap_err()
            .to_string()
            .contains("a grid of colours needs `sigma_a` or `sigma_s`")
    );
}

/// A cloud is dense at y = 0 and thins out towards y = 1.
#[test]
fn clouds_thin_out_upwards() {
    let description = medium(
        "\"string type\" \"cloud\" \"point3 p0\" [0 0 0] \"point3 p1\" [2 1 0.5] \"float frequency\" 3 \"rgb sigma_a\" [0 0 0]",
    );
    let (grid, factor) = volume(&description, "sigma_t");
    assert_eq!((grid.size(), factor), ([160, 80, 40], [1.0; 3]));
    let row = |y: u32| {
        let voxels = (0..160 * 40).map(|index| grid.voxel([index % 160, y, index / 160])[0]);
        voxels.map(f64::from).sum::<f64>() / 6400.0
    };
    assert!(row(0) > 0.98 && row(79) < 0.05, "{} {}", row(0), row(79));
    let middle: Vec<f32> = (0..160).map(|x| grid.voxel([x, 50, 20])[0]).collect();
    assert!(middle.contains(&0.0) && middle.iter().any(|value| *value > 0.1));
    assert!(middle.iter().all(|value| (0.0..=1.0).contains(value)));
}

/// Files of voxels that OpenVDB's own programs wrote (`scene/volume/tests.rs` says how), with temperatures by the densities' coordinates.
#[test]
fn files_of_voxels() {
    let all = crate::scene::volume_files();
    for (name, bytes) in all
        .iter()
        .filter(|(name, _)| !name.contains("-8") && !name.contains("-N"))
    {
        let parameters = format!(
            "\"string type\" \"nanovdb\" \"string filename\" \"{name}\" \"rgb sigma_a\" [1 2 4] \"float scale\" 2 \"float Lescale\" 3"
        );
        let (description, warnings) = medium_with(&parameters, &[(name, bytes)]);
        assert_eq!(warnings, Vec::<String>::new());
        let (density, factor) = volume(&description, "sigma_t");
        assert_eq!(factor, [4.0, 6.0, 10.0]);
        let first = [8, 0, 0];
        // The first voxel of the lattice has the coordinates (-8, 0, 0).
        let at = |voxel: [i32; 3]| std::array::from_fn(|axis| (voxel[axis] + first[axis]) as u32);
        assert_eq!(density.voxel(at([2, 1, 5]))[0], 1.0 + 1.5 + 0.5 + 0.625, "{name}");
        let (emission, factor) = volume(&description, "emission");
        assert_eq!(factor, [2.0, 4.0, 8.0]);
        let expected = Heat::new().at(1016.0).map(|channel| 3.0 * 3.625 * channel);
        near(emission.voxel(at([2, 1, 5])).to_rgb(), expected);
        // Nothing is said of the temperature there.
        near(emission.voxel(at([2, 3, 5])).to_rgb(), [0.0; 3]);
    }
    let (name, bytes) = &all[0];
    for (parameters, expected) in [
        (
            "\"string gridname\" \"smoke\"",
            "the file has no grid `smoke`; it has: density, temperature",
        ),
        ("\"string filename\" \"main.pbrt\"", "broken grid volume"),
    ] {
        let text = format!(
            "MakeNamedMedium \"m\" \"string type\" \"nanovdb\" \"string filename\" \"{name}\" {parameters} {BALL}"
        );
        let faults = load_with(&text, &[(name, bytes)]).unwrap_err().to_string();
        assert!(faults.contains(expected), "{faults}");
    }
    let nothing = load_with(
        &format!("MakeNamedMedium \"m\" \"string type\" \"nanovdb\" {BALL}"),
        &[],
    );
    assert!(
        nothing
            .unwrap_err()
            .to_string()
            .contains("`filename`: the medium names no file")
    );
}

//! Media as the readers describe them: what files leave out, and what they say in other ways.

use super::{LIGHT, warnings};
use crate::material::Material;
use crate::medium::{Extinction, Medium, Phase, Volume};
use crate::scene::{Limits, Scene, SceneFaults};
use crate::spectrum::Spectrum;
use std::collections::BTreeMap;

fn load(version: &str, body: &str) -> Result<Scene, SceneFaults> {
    let text = format!("<scene version='{version}'>\n<sensor type='perspective'/>{LIGHT}{body}</scene>");
    let files = BTreeMap::from([("main.xml".to_owned(), text.into_bytes())]);
    Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default())
}

/// The scene of a ball that holds a medium, and what is warned about.
fn ball(version: &str, medium: &str, bsdf: &str) -> (Scene, Vec<String>) {
    let body = format!("<shape type='sphere'>{bsdf}<medium name='interior' {medium}</medium></shape>");
    let scene = load(version, &body).unwrap_or_else(|faults| panic!("{body}\n{faults}"));
    let warnings = warnings(&scene);
    (scene, warnings)
}

fn medium(version: &str, medium: &str) -> (Medium, Vec<String>) {
    let (scene, warnings) = ball(version, medium, "");
    (scene.media.unwrap().media[0].clone(), warnings)
}

/// Extinction and albedo of a medium that is the same everywhere.
fn even(medium: &Medium) -> ([f32; 3], [f32; 3]) {
    match (&medium.extinction, &medium.albedo) {
        (Extinction::Uniform(sigma_t), Volume::Constant(albedo)) => (sigma_t.to_rgb(), albedo.to_rgb()),
        other => panic!("{other:?}"),
    }
}

fn near(found: [f32; 3], expected: [f32; 3]) {
    for (found, expected) in found.into_iter().zip(expected) {
        assert!((found - expected).abs() <= 1e-5 * expected, "{found} is not {expected}");
    }
}

/// `print(scene.shapes()[0].bsdf())` of Mitsuba 3.9.1 is `SmoothDiffuse`; Mitsuba 0.6 takes `null` (`Shape::configure`).
#[test]
fn bounds_without_a_bsdf_are_seen_by_mitsuba_3_alone() {
    let of = |version: &str, bsdf: &str| {
        let (scene, _) = ball(version, "type='homogeneous'>", bsdf);
        scene.materials[scene.bindings[0].material as usize].clone()
    };
    assert!(matches!(of("3.0.0", ""), Material::Diffuse { .. }));
    assert!(matches!(of("0.6.0", ""), Material::Null));
    assert!(matches!(
        of("0.6.0", "<bsdf type='diffuse'/>"),
        Material::Diffuse { .. }
    ));
    assert!(matches!(
        of("0.6.0", "<emitter type='area'/>"),
        Material::Diffuse { .. }
    ));
}

/// What a medium leaves out is that of skin in Mitsuba 0.6, times 100 (`materials.h`), and sigma_t = 1, albedo = 0.75 in Mitsuba 3.
#[test]
fn media_of_mitsuba_0_6_are_substances() {
    let (sigma_s, sigma_a) = ([74.0, 88.0, 101.0_f32], [3.2, 17.0, 48.0_f32]);
    let sum = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|i| a[i] + b[i]);
    let ratio = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|i| a[i] / b[i]);
    let sigma_t: [f32; 3] = sum(sigma_s, sigma_a);
    let milk: [f32; 3] = sum([2.55, 3.21, 3.77], [0.0011, 0.0024, 0.014]);
    for (version, body, expected, albedo) in [
        ("3.0.0", "", [1.0; 3], [0.75; 3]),
        ("0.6.0", "", sigma_t, ratio(sigma_s, sigma_t)),
        (
            "0.5.0",
            "<spectrum name='sigmaS' value='2'/>",
            sum([2.0; 3], sigma_a),
            ratio([2.0; 3], sum([2.0; 3], sigma_a)),
        ),
        (
            "0.6.0",
            "<spectrum name='sigmaS' value='2'/><spectrum name='sigmaA' value='1'/><float name='g' value='0.5'/>",
            [2.0; 3],
            [0.5; 3],
        ),
        (
            "0.6.0",
            "<spectrum name='sigmaT' value='2'/><float name='scale' value='3'/>",
            [6.0; 3],
            ratio(sigma_s, sigma_t),
        ),
        (
            "0.3.0",
            "<spectrum name='sigmaT' value='2'/><spectrum name='albedo' value='0.25'/><float name='densityMultiplier' value='3'/>",
            [6.0; 3],
            [0.25; 3],
        ),
        (
            "0.6.0",
            "<string name='material' value='Whole Milk'/><float name='scale' value='0.01'/>",
            milk,
            ratio([2.55, 3.21, 3.77], milk),
        ),
    ] {
        let (medium, warnings) = medium(version, &format!("type='homogeneous'>{body}"));
        let (found_t, found_albedo) = even(&medium);
        near(found_t, expected);
        near(found_albedo, albedo);
        assert_eq!(warnings, Vec::<String>::new(), "{body}");
    }
    let faults = load(
        "0.6.0",
        "<shape type='sphere'><medium name='interior' type='homogeneous'><string name='material' value='skin3'/></medium></shape>",
    );
    let message = faults.unwrap_err().to_string();
    assert!(
        message.contains("`material`: there is no such substance: Apple, "),
        "{message}"
    );
    assert!(message.contains("did you mean `Skin1`?"), "{message}");
}

#[test]
fn particles_are_round() {
    let orientation = "<volume name='orientation' type='constvolume'><vector name='value' x='0' y='0' z='1'/></volume>";
    let (medium, warned) = medium(
        "0.6.0",
        &format!(
            "type='heterogeneous'><volume name='density' type='constvolume'><float name='value' value='2'/></volume>\
             <volume name='albedo' type='constvolume'><spectrum name='value' value='0.5'/></volume>{orientation}\
             <phase type='microflake'><float name='stddev' value='0.2'/></phase>"
        ),
    );
    assert_eq!(even(&medium), ([2.0; 3], [0.5; 3]));
    assert!(matches!(medium.phase, Phase::Isotropic));
    let expected = [
        "<phase type=\"microflake\">: particles are round here: they scatter evenly in all directions",
        "<medium type=\"heterogeneous\">: `orientation` is left out: particles are round here",
    ];
    assert_eq!(warned.len(), 2, "{warned:#?}");
    for (warning, expected) in warned.iter().zip(expected) {
        assert!(warning.ends_with(expected), "{warning}");
    }
}

/// The faults of a volume in blocks, whose table and blocks are files beside the scene.
#[test]
fn faults_of_blocks_are_told() {
    let text = "<scene version='0.6.0'><sensor type='perspective'/><shape type='sphere'><medium name='interior' type='heterogeneous'>\
                <volume name='density' type='hgridvolume'><string name='filename' value='table'/></volume></medium></shape></scene>";
    let table = |numbers: &[i32]| -> Vec<u8> {
        let corners = [0.0_f32, 0.0, 0.0, 1.0, 1.0, 1.0];
        let corners = corners.iter().flat_map(|number| number.to_le_bytes());
        corners
            .chain(numbers.iter().flat_map(|number| number.to_le_bytes()))
            .collect()
    };
    for (numbers, expected) in [
        (
            &[1, 1][..],
            "table: broken hgridvolume file: it ends at byte 32, where 4 more are expected after byte 32",
        ),
        (
            &[1, 1, 1, 0, 0, 1],
            "table: broken hgridvolume file: it names a block [0, 0, 1], and there are [1, 1, 1] along the axes",
        ),
        (&[1, 1, 1], "`filename`: the file names no block"),
        (&[1, 1, 1, 0, 0, 0], "file `000_000_000` was not found"),
    ] {
        let files = BTreeMap::from([
            ("main.xml".to_owned(), text.as_bytes().to_vec()),
            ("table".to_owned(), table(numbers)),
        ]);
        let faults = Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap_err();
        assert!(faults.to_string().contains(expected), "{faults}");
    }
}

#[test]
fn volumes_within_volumes_end_somewhere() {
    let nested = "<volume type='volcache'>".repeat(40) + &"</volume>".repeat(40);
    let faults = load(
        "0.6.0",
        &format!(
            "<shape type='sphere'><medium name='interior' type='heterogeneous'><volume name='density' type='volcache'>{nested}</volume></medium></shape>"
        ),
    );
    let message = faults.unwrap_err().to_string();
    assert!(
        message.contains("volumes lie within each other more than 16 deep"),
        "{message}"
    );
    let (medium, _) = medium("3.0.0", "type='heterogeneous'>");
    assert_eq!(even(&medium), ([1.0; 3], [0.75; 3]));
    assert!(matches!(medium.emission, Volume::Constant(none) if none == Spectrum::ZERO));
}

/// What is not closed has no inside; two boxes that touch are bodies, and one that stands apart is none.
#[test]
fn bodies_are_closed_and_overlap() {
    let shape = |plugin: &str, x: f64| {
        format!(
            "<shape type='{plugin}'><integer name='priority' value='1'/><transform name='to_world'><translate x='{x}'/></transform></shape>"
        )
    };
    let of = |shapes: &[(&str, f64)]| {
        let body: String = shapes.iter().map(|(plugin, x)| shape(plugin, *x)).collect();
        let scene = load("3.0.0", &body).unwrap();
        let bodies = scene.bindings.iter().filter(|binding| binding.body.is_some()).count();
        (bodies, warnings(&scene))
    };
    assert_eq!(of(&[("cube", 0.0), ("sphere", 1.5)]), (2, vec![]));
    assert_eq!(of(&[("cube", 0.0), ("sphere", 2.5)]), (0, vec![]));
    assert_eq!(of(&[("cube", 0.0), ("rectangle", 2.5)]), (0, vec![]));
    for open in ["rectangle", "disk", "cylinder"] {
        let (bodies, told) = of(&[("cube", 0.0), (open, 1.5), ("sphere", 1.5)]);
        assert_eq!((bodies, told.len()), (2, 1), "{open}: {told:?}");
        assert!(told[0].contains("it is not closed"), "{told:?}");
    }
}

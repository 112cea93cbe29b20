//! What scenes of other ages and programs say, and what becomes of what does not exist here.

use super::{BALL, LIGHT, load, warnings};
use crate::film::Filter;
use crate::material::Material;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

fn scene(body: &str) -> Scene {
    load(body, None).unwrap_or_else(|faults| panic!("{body}\n{faults}"))
}

/// The material of a ball and what is warned about.
fn material(bsdf: &str) -> (Material, Vec<String>) {
    let scene = scene(&format!(
        "{LIGHT}<sensor type='perspective'/><shape type='sphere'>{bsdf}</shape>"
    ));
    let index = scene.bindings[0].material as usize;
    (scene.materials[index].clone(), warnings(&scene))
}

/// The radiance of the environment, which `radiance` gives.
fn radiance(radiance: &str) -> [f32; 3] {
    let light = format!("<emitter type='constant'>{radiance}</emitter>");
    let scene = scene(&format!("{light}{BALL}"));
    scene.lights.background(crate::math::Vec3::X).to_rgb()
}

fn near(actual: [f32; 3], expected: [f32; 3], within: f32) {
    for (a, e) in actual.iter().zip(expected) {
        assert!((a - e).abs() <= within * e, "{actual:?} is not {expected:?}");
    }
}

/// A film, a sampler and an integrator as scenes for Mitsuba 0.4 to 0.6 have them: nothing of it changes the picture.
#[test]
fn what_changes_no_picture_is_taken_without_a_word() {
    let body = format!(
        "<integrator type='photonmapper'><integer name='maxDepth' value='7'/><boolean name='strictNormals' value='true'/></integrator>\n\
         <sensor type='perspective'><sampler type='lhs'><integer name='sampleCount' value='9'/><float name='x' value='2'/></sampler>\n\
         <film type='ldrfilm'><integer name='width' value='30'/><integer name='height' value='20'/>\n\
         <boolean name='banner' value='false'/><float name='gamma' value='2.2'/><string name='fileFormat' value='jpeg'/>\n\
         <float name='exposure' value='1'/><boolean name='highQualityEdges' value='true'/><rfilter type='box'/></film></sensor>\n\
         {LIGHT}{BALL}"
    );
    let scene = scene(&body);
    assert_eq!(warnings(&scene), Vec::<String>::new());
    assert_eq!(scene.film.resolution, [30, 20]);
    assert_eq!(scene.film.filter, Filter::Box { radius: 0.5 });
    assert_eq!((scene.wishes.max_depth, scene.wishes.sample_count), (Some(7), Some(9)));
}

/// What changes it is told, each with its line, and once however often it is said.
#[test]
fn what_changes_the_picture_is_warned_about() {
    for (body, expected) in [
        (
            "<integrator type='magic'/>",
            "main.xml:3: <integrator type=\"magic\">: there is no integrator of this type",
        ),
        (
            "<integrator type='pppm'><float name='alhpa' value='0.5'/></integrator>",
            "main.xml:3: <integrator type=\"pppm\">: property `alhpa` is not known here and left out; did you mean `alpha`?",
        ),
        (
            "<sensor type='perspective'><film type='hdrfilm'><rfilter type='mitchell'/></film></sensor>",
            "main.xml:3: <rfilter type=\"mitchell\">: type `mitchell`: its negative lobes",
        ),
        (
            "<shape type='sphere'><float name='radius' value='1'/>\n<float name='radius' value='2'/></shape>",
            "main.xml:4: `radius`: it is given twice; this value counts",
        ),
        (
            "<medium type='homogeneous' id='fog'><rgb name='sigmaT' value='1'/><phase type='hg'/></medium>",
            "main.xml:3: <scene>: <medium> is left out: space is empty",
        ),
        ("<mode type='final'/>", "main.xml:3: <mode> is left out"),
        (
            "<shape type='sphere'><float name='radios' value='1'/></shape>",
            "main.xml:3: <shape type=\"sphere\">: property `radios` is not known here and left out; did you mean `radius`?",
        ),
        (
            "<emitter type='point'><texture name='glow' type='bitmap'/></emitter>",
            "main.xml:3: <emitter type=\"point\">: nested object `<texture name=\"glow\">` is not known here and left out;",
        ),
    ] {
        let sensor = if body.contains("<sensor") {
            ""
        } else {
            "<sensor type='perspective'/>"
        };
        let scene = scene(&format!("{LIGHT}{body}{sensor}{BALL}"));
        let warnings = warnings(&scene);
        assert!(
            warnings.len() == 1 && warnings[0].starts_with(expected),
            "{body}\n{warnings:?}"
        );
    }
    let many = "<shape type='sphere'><float name='radios' value='1'/></shape>\n".repeat(3);
    let scene = scene(&format!("{LIGHT}<sensor type='perspective'/>\n{many}"));
    let warnings = warnings(&scene);
    assert_eq!(warnings.len(), 1);
    assert!(
        warnings[0].starts_with("main.xml:4: ") && warnings[0].ends_with("(and at 2 more places)"),
        "{warnings:?}"
    );
}

#[test]
fn warnings_are_bounded() {
    let many: String = (0..80).map(|i| format!("<float name='p{i}' value='1'/>\n")).collect();
    let scene = scene(&format!(
        "{LIGHT}<sensor type='perspective'/><shape type='sphere'>{many}</shape>"
    ));
    let warnings = warnings(&scene);
    assert_eq!(warnings.len(), 51);
    assert!(
        warnings[50].ends_with("from here on there are 30 more warnings"),
        "{warnings:?}"
    );
}

#[test]
fn a_scene_without_a_light_has_a_white_environment() {
    let scene = scene(&format!("<sensor type='perspective'/>{BALL}"));
    assert_eq!(scene.lights.background(crate::math::Vec3::Y), Spectrum::ONE);
    let warnings = warnings(&scene);
    assert!(
        warnings.len() == 1 && warnings[0].starts_with("main.xml:1: the scene has no <emitter>"),
        "{warnings:?}"
    );
}

/// Materials that do not exist: the nearest one, and a warning that says what the picture lacks.
#[test]
fn stand_ins_are_the_nearest_materials() {
    let rgb = "<rgb name='diffuseReflectance' value='0.25'/>";
    for (bsdf, lost) in [
        (format!("<bsdf type='pplastic'>{rgb}</bsdf>"), "as `plastic`"),
        (format!("<bsdf type='hk'>{rgb}</bsdf>"), "as `diffuse`"),
        (
            "<bsdf type='measured'><rgb name='base_color' value='0.25'/></bsdf>".to_owned(),
            "as `diffuse`",
        ),
    ] {
        let (material, warnings) = material(&bsdf);
        let reflectance = match material {
            Material::Diffuse { reflectance } => reflectance,
            Material::Plastic {
                diffuse_reflectance, ..
            } => diffuse_reflectance,
            other => panic!("{bsdf}: {other:?}"),
        };
        assert_eq!(reflectance.mean(), Spectrum::splat(0.25), "{bsdf}");
        assert!(
            warnings.len() == 1 && warnings[0].contains(lost),
            "{bsdf}\n{warnings:?}"
        );
    }
    let (polarizer, warnings) = material("<bsdf type='polarizer'/>");
    assert!(matches!(polarizer, Material::Null) && warnings[0].contains("not polarised"));
}

/// A conductor's index is relative to what is outside, and roughness of old distributions is Beckmann's.
#[test]
fn conductors_of_the_old_dialect() {
    let of = |more: &str| {
        let (material, warnings) = material(&format!(
            "<bsdf type='roughconductor'><rgb name='eta' value='1'/><rgb name='k' value='3'/>{more}</bsdf>"
        ));
        match material {
            Material::RoughConductor { eta, k, .. } => (eta.mean()[0], k.mean()[0], warnings),
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(of("<float name='extEta' value='2'/>"), (0.5, 1.5, vec![]));
    let (_, _, warnings) = of("<string name='distribution' value='phong'/>");
    assert!(warnings.len() == 1 && warnings[0].contains("`beckmann` of the same roughness"));
    let (_, _, warnings) = of("<integer name='distribution' value='1'/>");
    assert!(
        warnings.len() == 1 && warnings[0].contains("a number names no choice here"),
        "{warnings:?}"
    );
}

/// Three numbers of a spectrum are red, green and blue, as in builds of Mitsuba 0.x for RGB; `srgb` is encoded.
#[test]
fn colours_of_the_old_dialect() {
    assert_eq!(radiance("<spectrum name='radiance' value='1, 2, 3'/>"), [1.0, 2.0, 3.0]);
    near(
        radiance("<srgb name='radiance' value='#ff8000'/>"),
        [1.0, 0.215_861, 0.0],
        1e-5,
    );
    near(radiance("<srgb name='radiance' value='0.5'/>"), [0.214_041; 3], 1e-5);
    assert!(
        load(
            &format!("{BALL}<emitter type='constant'><spectrum name='radiance' value='1, 2'/></emitter>"),
            None
        )
        .is_err()
    );
}

/// Of 6500 K: the integral of Planck's law times the CIE 1931 observer as Mitsuba 3.9.1 tabulates it (`mi.cie1931_xyz`), by the trapezoid
/// rule in steps of 0.5 nm with numpy.
const BODY_6500: [f32; 3] = [43_962.6, 41_448.68, 43_626.32];

/// Our rule for spectra, which is Mitsuba's, is one of a thousand samples and off by a thousandth.
#[test]
fn black_bodies_shine_by_the_law_of_planck() {
    let of = |temperature: &str, scale: &str| {
        radiance(&format!(
            "<blackbody name='radiance' temperature='{temperature}' scale='{scale}'/>"
        ))
    };
    near(of("6500K", "1"), BODY_6500, 1.5e-3);
    near(of("6500", "0.5"), BODY_6500.map(|channel| 0.5 * channel), 1.5e-3);
    let broken = |attributes: &str| {
        let light = format!("<emitter type='constant'><blackbody name='radiance' {attributes}/></emitter>");
        load(&format!("{BALL}{light}"), None).unwrap_err().to_string()
    };
    assert!(broken("temperature='50'").contains("100 to 1000000"));
    assert!(broken("scale='1'").contains("attribute `temperature` is missing"));
}

/// Integrators that write statistics have another one render; a circle of references ends.
#[test]
fn the_innermost_integrator_counts() {
    let path = "<integrator type='path'><integer name='max_depth' value='2'/></integrator>";
    let scene_of = |integrator: &str| scene(&format!("<sensor type='perspective'/>{LIGHT}{BALL}{integrator}"));
    let nested = scene_of(&format!(
        "<integrator type='moment'><integrator type='aov'><string name='aovs' value='dd.y:depth'/>{path}</integrator></integrator>"
    ));
    assert_eq!((nested.wishes.max_depth, warnings(&nested)), (Some(2), vec![]));
    assert!(nested.wishes.integrator.is_some());
    let circle = scene_of("<integrator type='aov' id='a'><ref id='a'/></integrator>");
    assert!(circle.wishes.integrator.is_none());
}

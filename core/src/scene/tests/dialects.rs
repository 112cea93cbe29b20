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

/// What was taken without a word is listed for those who ask, once for each kind of object.
#[test]
fn what_changes_no_picture_is_listed() {
    let body = format!(
        "<default name='spp' value='9'/><integrator type='moment'><integrator type='volpath'/></integrator>\n\
         <sensor type='perspective'><sampler type='lhs'/><film type='ldrfilm'><boolean name='banner' value='false'/>\
         <float name='gamma' value='2.2'/></film></sensor>\n\
         {LIGHT}{BALL}"
    );
    let notes: Vec<String> = scene(&body).notes.iter().map(ToString::to_string).collect();
    for expected in [
        "the parameter `spp` is used nowhere",
        "main.xml:2: <integrator type=\"moment\">: the integrator within it makes the picture",
        "main.xml:2: <integrator type=\"volpath\">: of this integrator only `max_depth` is read",
        "main.xml:3: <film type=\"ldrfilm\">: the picture is written in this program's own formats",
        "main.xml:3: <film type=\"ldrfilm\">: `banner`, `gamma` change nothing in the picture",
        "main.xml:3: <sampler type=\"lhs\">: the renderer has its own random numbers: only `sample_count` is read",
    ] {
        assert!(
            notes.iter().any(|note| note.contains(expected)),
            "{expected}: {notes:#?}"
        );
    }
    assert_eq!(notes.len(), 6, "{notes:#?}");
    assert!(scene(&format!("{LIGHT}{BALL}")).notes.is_empty());
}

/// What programs beside Mitsuba write, and builds of it that have more: it is left out or replaced, with a word.
#[test]
fn what_other_programs_write_is_left_out_or_replaced() {
    let film = |plugin: &str| format!("<sensor type='perspective'><film type='{plugin}'/></sensor>");
    for (body, expected) in [
        (
            "<viewer><float name='zoom' value='2'/></viewer>",
            "the element <viewer> is not known here and left out",
        ),
        ("MATERIAL", "the text `MATERIAL` within <scene> is left out"),
        (
            "<shape type='sphere'><bsdf type='bigbtf'><rgb name='reflectance' value='0.2'/></bsdf></shape>",
            "<bsdf>: the type `bigbtf` is not known here: it is rendered as `diffuse`",
        ),
        (
            "<shape type='torusknot'/>",
            "<shape>: the type `torusknot` is not known here: the shape is left out",
        ),
        (
            "<emitter type='firefly'/>",
            "<emitter>: the type `firefly` is not known here: the light is left out",
        ),
        (
            "<shape type='sphere'><bsdf type='diffuse'><texture type='voronoi' name='reflectance'/></bsdf></shape>",
            "<texture>: the type `voronoi` is not known here: an even grey of 0.5",
        ),
        (
            &film("transient_hdr_film"),
            "<film>: the type `transient_hdr_film` is not known here: the picture is",
        ),
        (
            "<emitter type='area'/>",
            "<emitter type=\"area\">: no shape uses this area light, which is left out",
        ),
        (
            "<shape type='sphere'><bsdf type='diffuse'><rgb name='reflectance' value='1.5 0.5 0'/></bsdf></shape>",
            "`reflectance`: no surface reflects more than arrives: what is above 1 counts as 1",
        ),
    ] {
        let camera = match body.contains("<sensor") {
            true => "",
            false => "<sensor type='perspective'/>",
        };
        let warned = warnings(&scene(&format!("{body}{camera}{LIGHT}{BALL}")));
        assert!(
            warned.len() == 1 && warned[0].contains(expected),
            "{expected}: {warned:?}"
        );
    }
    // Misspelt names are told as errors: what they stand for can be had.
    for wrong in [
        "<shpae type='sphere'/>",
        "<shape type='shpere'/>",
        "<emitter type='piont'/>",
    ] {
        let faults = load(&format!("{wrong}{LIGHT}{BALL}"), None).unwrap_err();
        assert!(faults.to_string().contains("did you mean"), "{faults}");
    }
    let capital = format!("<sensor type='Perspective'/>{LIGHT}<shape type='Sphere'/>");
    assert!(warnings(&scene(&capital)).is_empty());
}

/// Mitsuba 2 and 3 write spectra as objects, too: they are what the properties are.
#[test]
fn spectra_may_be_objects() {
    for (object, property) in [
        (
            "<spectrum type='d65' name='radiance'><float name='scale' value='3'/></spectrum>",
            "<rgb name='radiance' value='3'/>",
        ),
        (
            "<spectrum type='blackbody' name='radiance'><float name='temperature' value='4000'/></spectrum>",
            "<blackbody name='radiance' temperature='4000'/>",
        ),
        (
            "<texture type='irregular' name='radiance'><string name='wavelengths' value='400, 500, 700'/>\
             <string name='values' value='1, 3, 2'/></texture>",
            "<spectrum name='radiance' value='400:1, 500:3, 700:2'/>",
        ),
        (
            "<spectrum type='regular' name='radiance'><float name='wavelength_min' value='400'/>\
             <integer name='wavelength_max' value='700'/><string name='values' value='1 2 4'/></spectrum>",
            "<spectrum name='radiance' value='400:1, 550:2, 700:4'/>",
        ),
    ] {
        assert_eq!(radiance(object), radiance(property), "{object}");
    }
    let (grey, warned) = material(
        "<bsdf type='diffuse'><spectrum type='checkerboard' name='reflectance'><rgb name='color0' value='0.3'/></spectrum></bsdf>",
    );
    assert!(
        matches!(grey, Material::Diffuse { .. }) && warned.is_empty(),
        "{warned:?}"
    );
    for (wrong, expected) in [
        (
            "<spectrum type='blackbody' name='radiance'/>",
            "<spectrum type=\"blackbody\"> `temperature`: it is missing",
        ),
        (
            "<spectrum type='irregular' name='radiance'><string name='wavelengths' value='400 500'/><string name='values' value='1'/></spectrum>",
            "`values`: there are 1 for 2 wavelengths",
        ),
    ] {
        let faults = load(&format!("<emitter type='constant'>{wrong}</emitter>{BALL}"), None).unwrap_err();
        assert!(faults.to_string().contains(expected), "{faults}");
    }
}

/// Films and samplers that stand in the scene are for sensors to refer to.
#[test]
fn parts_of_sensors_may_stand_in_the_scene() {
    let scene = scene(&format!(
        "<film type='hdrfilm' id='film'><integer name='width' value='9'/></film><sampler type='independent' id='sampler'/>\
         <sensor type='perspective'><ref id='film'/><ref id='sampler'/></sensor>{LIGHT}{BALL}"
    ));
    assert_eq!((warnings(&scene), scene.film.resolution), (Vec::new(), [9, 576]));
}

/// Files from before 0.4 have lights and cameras by other names, and pictures that are mirrored.
#[test]
fn scenes_from_before_0_4_are_brought_up_to_date() {
    let old = "<camera type='perspective'><transform name='toWorld'><translate x='1'/></transform></camera>\
               <luminaire type='constant'><rgb name='intensity' value='0.5'/></luminaire>";
    let new = "<sensor type='perspective'><string name='fovAxis' value='smaller'/>\
               <transform name='toWorld'><scale x='-1'/><translate x='1'/></transform></sensor>\
               <emitter type='constant'><rgb name='radiance' value='0.5'/></emitter>";
    let [old, new] = [old, new].map(|body| scene(&format!("{body}{BALL}")));
    assert_eq!(warnings(&old), Vec::<String>::new());
    assert_eq!(old.sensor.to_world.matrix(), new.sensor.to_world.matrix());
    let projection = |scene: &Scene| format!("{:?}", scene.sensor.projection);
    assert_eq!(projection(&old), projection(&new));
    let seen = |scene: &Scene| scene.lights.background(crate::math::Vec3::X).to_rgb();
    assert_eq!(seen(&old), seen(&new));
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
            "<medium type='homogeneous' id='fog'><rgb name='sigmaT' value='1'/><phase type='hg'><float name='f' value='0.5'/></phase></medium>",
            "main.xml:3: <phase type=\"hg\">: property `f` is not known here and left out; known: g",
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

//! What loading decides for a scene's author, and what it warns about.

mod dialects;
mod images;
mod layered;
mod lights;
mod lobes;
mod media;
mod sensors;
mod shapes;
mod textures;

use super::{Limits, Scene, SceneFaults};
use crate::film::Filter;
use crate::geometry::Ray;
use crate::material::Material;
use crate::math::warp::square_to_sphere;
use crate::math::{DVec2, Vec2, Vec3};
use crate::random::{PathRandom, Stream};
use crate::sensor::{Projection, Sensor};
use crate::settings::{
    BdptSettings, DirectionSampler, IntegratorSettings, LookupVertex, PathSettings, PcfSettings, PppmSettings,
};
use std::collections::BTreeMap;

const LIGHT: &str = "<emitter type='constant'/>\n";
const BALL: &str = "<shape type='sphere'><point name='center' value='1 2 3'/></shape>\n";

/// A scene of `body`, which begins in line 2, seen through a sensor.
fn load(body: &str, sensor: Option<&str>) -> Result<Scene, SceneFaults> {
    let text = format!("<scene version='3.0.0'>\n{body}</scene>");
    let files = BTreeMap::from([("main.xml".to_owned(), text.into_bytes())]);
    Scene::load_sensor(&files, "main.xml", &BTreeMap::new(), sensor, &Limits::default())
}

fn warnings(scene: &Scene) -> Vec<String> {
    scene.warnings.iter().map(ToString::to_string).collect()
}

/// Mitsuba 3 refuses to render a scene without a sensor (3.9.1 and 3.0.1 were asked), so this view is our own.
#[test]
fn a_scene_without_a_sensor_is_seen_whole() {
    let scene = load(&format!("{LIGHT}{BALL}"), None).unwrap();
    assert_eq!(scene.film.resolution, [768, 576]);
    let warnings = warnings(&scene);
    assert!(
        warnings.len() == 1 && warnings[0].starts_with("main.xml:1: the scene has no <sensor>"),
        "{warnings:?}"
    );
    // Of the bounds (0, 1, 2) to (2, 3, 4), the face at z = 2 is as wide as the field of view: the eye lies 1 / tan 22.5 degrees before it.
    let middle = scene.sensor.ray(Vec2::new(384.0, 288.0), Vec2::ZERO);
    assert!((middle.direction - Vec3::Z).length() < 1e-6, "{middle:?}");
    let eye = middle.origin - middle.direction * scene.sensor.clip[0];
    assert!((eye - Vec3::new(1.0, 2.0, 2.0 - 2.414_213_6)).length() < 1e-5, "{eye}");
    let left = scene.sensor.ray(Vec2::new(0.0, 288.0), Vec2::ZERO).direction;
    assert!((left.angle_between(Vec3::Z).to_degrees() - 22.5).abs() < 1e-4);
    assert!((scene.sensor.clip[1] - 12.414_213).abs() < 1e-4);
}

/// The horizontal field of view in degrees, of a perspective sensor.
fn x_fov(sensor: &Sensor) -> f32 {
    match sensor.projection {
        Projection::Perspective { fov_x, .. } => fov_x.to_degrees(),
        _ => panic!("{sensor:?}"),
    }
}

/// The numbers were printed by Mitsuba 3.9.1 (`scalar_rgb`): `print(mi.load_dict({'type': 'perspective'}))` for what is left out, the same
/// with `thinlens` and `orthographic`, and `mi.traverse(mi.load_dict(...))['x_fov']` of a sensor with a field of view.
#[test]
fn what_a_sensor_leaves_out_is_as_in_mitsuba() {
    let view = |sensor: &str| load(&format!("{sensor}\n{LIGHT}{BALL}"), None).unwrap();
    for (plugin, inside) in [
        ("perspective", ""),
        ("thinlens", "<float name='aperture_radius' value='0.1'/>"),
        ("orthographic", ""),
    ] {
        let scene = view(&format!("<sensor type='{plugin}'>{inside}</sensor>"));
        assert_eq!(scene.film.resolution, [768, 576]);
        assert_eq!(scene.film.filter, Filter::Gaussian { stddev: 0.5 });
        assert_eq!(scene.sensor.clip, [0.01, 10000.0]);
        match scene.sensor.projection {
            Projection::Perspective {
                lens, principal_point, ..
            } => {
                assert!((x_fov(&scene.sensor) - 38.184_84).abs() < 1e-4);
                assert_eq!(principal_point, Vec2::ZERO);
                assert!(lens.is_none_or(|lens| lens.focus_distance == 10000.0));
            }
            Projection::Orthographic => assert_eq!(plugin, "orthographic"),
            other => panic!("{other:?}"),
        }
        // Mitsuba takes 4 samples a pixel where `sample_count` is left out; here that is the integrator's choice.
        assert_eq!(scene.wishes.sample_count, None);
    }
    let filter = |filter: &str| {
        let film = format!("<film type='hdrfilm'><rfilter type='{filter}'/></film>");
        view(&format!("<sensor type='perspective'>{film}</sensor>")).film.filter
    };
    assert_eq!(filter("box"), Filter::Box { radius: 0.5 });
    assert_eq!(filter("tent"), Filter::Tent { radius: 1.0 });
    assert_eq!(filter("gaussian"), Filter::Gaussian { stddev: 0.5 });
    for ([width, height], property, expected) in [
        ([768, 576], "<float name='fov' value='50'/>", 50.0),
        ([300, 600], "<float name='fov' value='50'/>", 50.0),
        (
            [768, 576],
            "<float name='fov' value='50'/><string name='fov_axis' value='y'/>",
            63.742_03,
        ),
        (
            [300, 600],
            "<float name='fov' value='50'/><string name='fov_axis' value='y'/>",
            26.248_537,
        ),
        (
            [768, 576],
            "<float name='fov' value='50'/><string name='fov_axis' value='diagonal'/>",
            40.915_672,
        ),
        (
            [300, 600],
            "<float name='fov' value='50'/><string name='fov_axis' value='diagonal'/>",
            23.559_177,
        ),
        (
            [768, 576],
            "<float name='fov' value='50'/><string name='fov_axis' value='smaller'/>",
            63.742_03,
        ),
        (
            [300, 600],
            "<float name='fov' value='50'/><string name='fov_axis' value='smaller'/>",
            50.0,
        ),
        (
            [768, 576],
            "<float name='fov' value='50'/><string name='fov_axis' value='larger'/>",
            50.0,
        ),
        (
            [300, 600],
            "<float name='fov' value='50'/><string name='fov_axis' value='larger'/>",
            26.248_537,
        ),
        ([768, 576], "<string name='focal_length' value='35'/>", 52.622_543),
        ([300, 600], "<string name='focal_length' value='50mm'/>", 21.902_138),
        ([300, 600], "", 21.902_138),
    ] {
        let size = format!("<integer name='width' value='{width}'/><integer name='height' value='{height}'/>");
        let film = format!("<film type='hdrfilm'>{size}</film>");
        let scene = view(&format!("<sensor type='perspective'>{property}{film}</sensor>"));
        let found = x_fov(&scene.sensor);
        assert!(
            (found - expected).abs() < 1e-4,
            "{width} x {height} {property}: {found}"
        );
    }
}

#[test]
fn of_several_sensors_the_first_or_the_one_that_is_named_is_taken() {
    let at = |id: &str, x: i32| {
        format!("<sensor type='perspective'{id}><transform name='to_world'><translate x='{x}'/></transform></sensor>\n")
    };
    let body = format!(
        "{}{}{}{LIGHT}{BALL}",
        at("", 1),
        at(" id='left'", 2),
        "<sensor type='distant' id='2'/>\n"
    );
    let eye = |sensor| {
        let scene = load(&body, sensor).unwrap();
        let ray = scene.sensor.ray(Vec2::ZERO, Vec2::ZERO);
        let eye = ray.origin - ray.direction * (scene.sensor.clip[0] / ray.direction.z);
        (eye.x.round(), warnings(&scene))
    };
    let (x, warnings) = eye(None);
    assert_eq!(x, 1.0);
    assert_eq!(
        warnings,
        [
            "main.xml:2: the first of the scene's 3 sensors is taken; --sensor chooses another, by number or id: 1, 2 or `left`, 3 or `2`"
        ]
    );
    assert_eq!(eye(Some("1")), (1.0, vec![]));
    assert_eq!(eye(Some("left")), (2.0, vec![]));
    // An id wins over a number, and only the chosen sensor need be one that exists here.
    assert!(
        load(&body, Some("2"))
            .unwrap_err()
            .to_string()
            .starts_with("main.xml:4: <sensor type=\"distant\">")
    );
    for bad in ["0", "4", "right", ""] {
        let error = load(&body, Some(bad)).unwrap_err().to_string();
        assert!(
            error.starts_with(&format!("main.xml: <scene>: unknown sensor `{bad}`; allowed: 1, 2 or")),
            "{error}"
        );
    }
    let error = load(&format!("{LIGHT}{BALL}"), Some("1")).unwrap_err().to_string();
    assert!(error.contains("none: the scene has no sensor"), "{error}");
}

/// A camera at the origin that looks along -z, with `up` in `up`; a ball before it, of `bsdf`.
fn room(up: &str, ball: &str, lamp: &str) -> String {
    format!(
        "<sensor type='perspective'><transform name='to_world'><lookat origin='0,0,9' target='0,0,0' up='{up}'/></transform></sensor>\n\
         <shape type='sphere'>{ball}</shape>\n{lamp}\n"
    )
}

fn only_warning(body: &str, start: &str) {
    let warnings = warnings(&load(body, None).unwrap());
    assert!(
        warnings.len() == 1 && warnings[0].starts_with(start),
        "{body}\n{warnings:?}"
    );
}

#[test]
fn what_is_probably_not_meant_is_warned_about() {
    let light = LIGHT.trim();
    for good in [
        room("0 1 0", "", light),
        room("0 0.1 0.5", "", light),
        room(
            "1 0 0",
            "",
            "<emitter type='directional'><rgb name='irradiance' value='1e5'/></emitter>",
        ),
        // Small and bright, and all in all a lamp of 400 W.
        room(
            "0 1 0",
            "",
            "<shape type='sphere'><float name='radius' value='1e-4'/><emitter type='area'><rgb name='radiance' value='1e9'/></emitter></shape>",
        ),
    ] {
        assert_eq!(warnings(&load(&good, None).unwrap()), Vec::<String>::new(), "{good}");
    }
    only_warning(&room("0 -1 0", "", light), "main.xml:2: the camera stands on its head");
    for (lamp, line) in [
        (
            "<emitter type='directional'><rgb name='irradiance' value='1e8'/></emitter>",
            4,
        ),
        ("<emitter type='point'><rgb name='intensity' value='1e8'/></emitter>", 4),
        (
            "<emitter type='constant'><rgb name='radiance' value='1e8'/></emitter>",
            4,
        ),
        (
            "<shape type='sphere'>\n<emitter type='area'><rgb name='radiance' value='1e8'/></emitter></shape>",
            5,
        ),
    ] {
        let start = format!("main.xml:{line}: this light alone gives");
        only_warning(&room("0 1 0", "", lamp), &start);
    }
    let red = "<bsdf type='diffuse'>\n<spectrum name='reflectance' value='400:0.2 700:1.4'/></bsdf>";
    only_warning(
        &room("0 1 0", red, light),
        "main.xml:4: no surface reflects more than arrives",
    );
}

#[test]
fn an_image_of_colours_that_is_read_raw_is_warned_about() {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(2, 2, image::Rgb([128; 3]))
        .write_to(&mut png, image::ImageFormat::Png)
        .unwrap();
    let ball = "<bsdf type='diffuse'><texture type='bitmap' name='reflectance'><string name='filename' value='a.png'/>\n\
                <boolean name='raw' value='RAW'/></texture></bsdf>";
    let warnings_of_ball = |ball: &str, png: &[u8]| {
        let body = room("0 1 0", ball, LIGHT.trim());
        let text = format!("<scene version='3.0.0'>\n{body}</scene>");
        let files = BTreeMap::from([
            ("main.xml".to_owned(), text.into_bytes()),
            ("a.png".to_owned(), png.to_vec()),
        ]);
        warnings(&Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap())
    };
    let load = |raw: &str| warnings_of_ball(&ball.replace("RAW", raw), png.get_ref());
    assert_eq!(load("false"), Vec::<String>::new());
    assert!(load("true")[0].starts_with("main.xml:4: <texture type=\"bitmap\">: `raw`: it takes the sRGB values"));
    let gamma = ball.replace("<boolean name='raw' value='RAW'/>", "<float name='gamma' value='1'/>");
    let gamma = warnings_of_ball(&gamma, png.get_ref());
    assert!(gamma[0].starts_with("main.xml:4: <texture type=\"bitmap\">: `gamma`: it takes the sRGB values"));
}

#[test]
fn path_tracing_of_glass_and_a_small_lamp_comes_with_a_hint() {
    let path = IntegratorSettings::Path(PathSettings::default());
    let glass = "<bsdf type='dielectric'/>";
    let point = "<emitter type='point'><point name='position' x='0' y='5' z='0'/></emitter>";
    let hints = |ball: &str, lamp: &str, settings: &IntegratorSettings| {
        load(&room("0 1 0", ball, lamp), None).unwrap().hints(settings).len()
    };
    let scene = load(&room("0 1 0", glass, point), None).unwrap();
    assert!(
        scene.hints(&path)[0]
            .to_string()
            .starts_with("main.xml:4: `path` finds"),
        "{:?}",
        scene.hints(&path)
    );
    assert_eq!(
        hints(glass, point, &IntegratorSettings::Pppm(PppmSettings::default())),
        0
    );
    assert_eq!(hints("", point, &path), 0);
    assert_eq!(hints(glass, LIGHT.trim(), &path), 0);
    for (size, expected) in [("0.005", 1), ("0.5", 0)] {
        let lamp = format!(
            "<shape type='rectangle'><transform name='to_world'><scale value='{size}'/></transform><emitter type='area'/></shape>"
        );
        assert_eq!(hints(glass, &lamp, &path), expected, "{size}");
    }
}

#[test]
fn plastic_is_read_with_its_defaults_and_may_be_a_side() {
    let shape = |bsdf: &str| format!("<shape type='sphere'>{bsdf}</shape>{LIGHT}");
    let scene = load(&shape("<bsdf type='plastic'/>"), None).unwrap();
    let mean = |name: &str| {
        let bsdf = format!(
            "<bsdf type='twosided'><bsdf type='plastic'><float name='{name}' value='0.3'/><boolean name='nonlinear' \
             value='true'/><string name='int_ior' value='water'/></bsdf></bsdf>"
        );
        let scene = load(&shape(&bsdf), None).unwrap();
        let sides = scene.materials.iter().find_map(|material| match material {
            Material::TwoSided { front, back } => Some([front.clone(), back.clone()]),
            _ => None,
        });
        sides.unwrap().map(|side| match *side {
            Material::Plastic {
                diffuse_reflectance,
                specular_reflectance,
                ..
            } => [diffuse_reflectance, specular_reflectance].map(|texture| texture.mean()[0]),
            other => panic!("{other:?}"),
        })
    };
    assert!(scene.materials.iter().any(|m| matches!(m, Material::Plastic { .. })));
    assert_eq!(mean("diffuse_reflectance"), [[0.3, 1.0]; 2]);
    assert_eq!(mean("specular_reflectance"), [[0.5, 0.3]; 2]);
    let error = load(
        &shape("<bsdf type='plastic'><float name='specular_transmittance' value='1'/></bsdf>"),
        None,
    );
    assert!(error.is_err() || !warnings(&error.unwrap()).is_empty());
}

#[test]
fn a_black_picture_has_a_reason() {
    let path = |max_depth| {
        IntegratorSettings::Path(PathSettings {
            max_depth,
            ..Default::default()
        })
    };
    let why = |body: &str, max_depth| load(body, None).unwrap().why_black(&path(max_depth));
    let point = "<emitter type='point'><point name='position' x='0' y='0' z='20'/></emitter>";
    let away = room("0 1 0", "", point).replace("target='0,0,0'", "target='0,0,20'");
    assert!(
        why(&away, None).starts_with("the camera meets no shape: it looks from [0, 0, 9"),
        "{}",
        why(&away, None)
    );
    assert!(why(&room("0 1 0", "", point), Some(1)).starts_with("`max_depth` is 1"));
    let inside_out = room("0 1 0", "<boolean name='flip_normals' value='true'/>", point);
    assert!(why(&inside_out, None).starts_with("the camera sees only the backs"));
    let behind = room("0 1 0", "", &point.replace("'20'", "'-20'"));
    assert!(
        why(&behind, None).starts_with("no light shines directly"),
        "{}",
        why(&behind, None)
    );
    let lens_alone = IntegratorSettings::Bdpt(BdptSettings {
        light_vertices: Some(1),
        camera_vertices: Some(1),
        ..Default::default()
    });
    let reason = load(&room("0 1 0", "", point), None).unwrap().why_black(&lens_alone);
    assert!(reason.starts_with("`light_vertices` and `camera_vertices`"), "{reason}");
    let black = "<bsdf type='diffuse'><rgb name='reflectance' value='0'/></bsdf>";
    assert!(why(&room("0 1 0", black, point), None).starts_with("what the camera sees is lit"));
}

#[test]
fn all_faults_are_told_together_and_each_once() {
    let body = "\
        <sensor type='perspective'><float name='fov' value='190'/><film type='hdrfilm'><integer name='widht' value='9'/></film></sensor>\n\
        <bsdf type='difuse' id='wall'/><bsdf type='dielectric' id='glass'><string name='int_ior' value='watter'/></bsdf>\n\
        <shape type='sphere'><float name='radius' value='big'/><float name='centre' value='1'/><ref id='wal'/></shape>\n\
        <shape type='obj'><string name='filename' value='a.obj'/><boolean name='face_normal' value='true'/><ref id='wall'/></shape>\n\
        <shape type='obj'><string name='filename' value='a.obj'/><ref id='wall'/></shape>\n\
        <shape type='cube'><transform name='to_wrold'/><string name='flip_normals' value='yes'/><ref id='glass'/></shape>\n\
        <include filename='part.xml'/>\n\
        <emitter type='point'><rgb name='intensity' value='-1'/><rgb name='intensty' value='1'/></emitter>\n";
    let text = format!("<scene version='3.0.0'>\n{body}</scene>");
    let part = b"<scene version='3.0.0'>\n<shap/>\n<shape type='sphere'><bsdf type='conductor'><string name='material' value='au'/></bsdf></shape></scene>";
    let files = BTreeMap::from([
        ("main.xml".to_owned(), text.into_bytes()),
        ("part.xml".to_owned(), part.to_vec()),
        ("a.obj".to_owned(), b"v 1 2 x\n".to_vec()),
    ]);
    let faults = Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap_err();
    let expected = [
        ("main.xml:4: <float name=\"radius\"> value: `big`", ""),
        ("part.xml:2: scene: unknown element `shap`", "did you mean `shape`?"),
        ("main.xml:4: id `wal`", "did you mean `wall`?"),
        ("main.xml:2: <sensor type=\"perspective\"> `fov`: 190", ""),
        ("main.xml:3: <bsdf>: unknown type `difuse`", "did you mean `diffuse`?"),
        (
            "main.xml:3: <bsdf type=\"dielectric\"> `int_ior`",
            "did you mean `water`?",
        ),
        ("a.obj:1: `v`: `x` is not a finite number", ""),
        ("main.xml:7: <shape type=\"cube\"> `flip_normals`: expected", ""),
        ("part.xml:3: <bsdf type=\"conductor\"> `material`", "did you mean `Au`?"),
        ("main.xml:9: <emitter type=\"point\"> `intensity`", "negative"),
    ];
    let told: Vec<String> = faults.all().iter().map(ToString::to_string).collect();
    for (fault, (start, part)) in told.iter().zip(expected) {
        assert!(
            fault.starts_with(start) && fault.contains(part),
            "expected `{start}` ... `{part}` in\n{faults}"
        );
    }
    assert_eq!(told.len(), expected.len(), "{faults}");
    let warned: Vec<String> = faults.warnings().iter().map(ToString::to_string).collect();
    let misspelt = [
        ("main.xml:2: <film type=\"hdrfilm\">: property `widht`", "width"),
        ("main.xml:4: <shape type=\"sphere\">: property `centre`", "center"),
        (
            "main.xml:5: <shape type=\"obj\">: property `face_normal`",
            "face_normals",
        ),
        ("main.xml:7: <shape type=\"cube\">: property `to_wrold`", "to_world"),
        ("main.xml:9: <emitter type=\"point\">: property `intensty`", "intensity"),
    ];
    assert_eq!(warned.len(), misspelt.len(), "{warned:?}");
    for (warning, (start, nearest)) in warned.iter().zip(misspelt) {
        assert!(warning.starts_with(start), "{warning}");
        assert!(warning.contains(&format!("did you mean `{nearest}`?")), "{warning}");
    }
    let all = faults.to_string();
    assert!(all.starts_with("10 faults:\n  main.xml:4: "), "{all}");
    assert!(all.contains("\n  warning: main.xml:2: <film"), "{all}");
}

#[test]
fn what_follows_from_a_lost_part_is_not_told() {
    let body = "<include filename='lost.xml'/>\n<shape type='sphere'><float name='radius' value='$size'/><ref id='glass'/></shape>\n";
    let faults = load(body, None).unwrap_err();
    assert!(
        faults.all().len() == 1
            && faults
                .to_string()
                .starts_with("main.xml:2: file `lost.xml` was not found"),
        "{faults}"
    );
    let many: String = (0..30).map(|i| format!("<shape{i}/>\n")).collect();
    let faults = load(&many, None).unwrap_err();
    assert_eq!(faults.all().len(), 21);
    assert!(
        faults.all()[20]
            .to_string()
            .contains("number of faults: 21 is over the limit of 20"),
        "{faults}"
    );
}

#[test]
fn settings_of_integrators_are_read_by_their_descriptions() {
    let read = |integrator: &str| {
        let body = room("0 1 0", "", LIGHT.trim()) + integrator;
        load(&body, None).map(|scene| scene.wishes.integrator)
    };
    let path = "<integrator type='path'><integer name='samples' value='3'/><integer name='rr_depth' value='5'/>\
                <integer name='max_depth' value='-1'/></integrator>";
    let expected = IntegratorSettings::Path(PathSettings {
        samples: 3,
        ..Default::default()
    });
    assert_eq!(read(path).unwrap(), Some(expected));
    let pcf = "<integrator type='pcf'><string name='sigma1' value='auto'/><string name='lookup_vertex' value='2'/>\
               <string name='samplers' value='camera importon'/><string name='sigma_by_length' value='0.5, 1'/>\
               <integer name='p' value='2'/><boolean name='nested' value='true'/><integer name='max_depth' value='6'/></integrator>";
    let expected = IntegratorSettings::Pcf(PcfSettings {
        lookup_vertex: LookupVertex::Fixed(2),
        samplers: vec![DirectionSampler::Camera, DirectionSampler::Importon],
        sigma_by_length: vec![0.5, 1.0],
        p: 2.0,
        nested: true,
        max_depth: Some(6),
        ..Default::default()
    });
    assert_eq!(read(pcf).unwrap(), Some(expected));
    let foreign =
        "<integrator type='sppm'><float name='alpha' value='0.5'/><integer name='granularity' value='9'/></integrator>";
    assert!(matches!(read(foreign).unwrap(), Some(IntegratorSettings::Sppm(settings)) if settings.0.alpha == 0.5));
    for (property, said) in [
        (
            "<float name='alpha' value='1.5'/>",
            "setting `alpha` is 1.5: expected a number between 0 and 1, both excluded",
        ),
        (
            "<rgb name='alpha' value='1'/>",
            "setting `alpha` is a rgb: expected a number",
        ),
        (
            "<float name='photons' value='10'/>",
            "setting `photons` is 10.0: expected a whole number",
        ),
    ] {
        let integrator = format!("<integrator type='pppm'>{property}</integrator>");
        let faults = read(&integrator).unwrap_err().to_string();
        assert!(faults.contains(said), "{faults}");
    }
}

/// A scene whose shutter is open from 0 to 4, with `body` from line 3 on.
fn with_shutter(body: &str) -> Result<Scene, SceneFaults> {
    let sensor = "<sensor type='perspective'><float name='shutterClose' value='4'/></sensor>\n";
    load(&format!("{sensor}{body}"), None)
}

/// An `<animation>` with a line for each transform.
fn animation(keyframes: &[(f64, &str)]) -> String {
    let transform = |(time, map): &(f64, &str)| format!("<transform time='{time}'>{map}</transform>\n");
    let transforms: String = keyframes.iter().map(transform).collect();
    format!("<animation name='toWorld'>\n{transforms}</animation>\n")
}

#[test]
fn shapes_lights_and_the_sensor_are_where_their_animations_put_them() {
    // The order of transforms does not matter.
    let along = |axis: &str| {
        let [late, early] = [5, 1].map(|to| format!("<translate {axis}='{to}'/>"));
        animation(&[(3.0, &late), (1.0, &early)])
    };
    let sensor = format!(
        "<sensor type='perspective'><float name='shutter_close' value='4'/>{}</sensor>\n",
        along("y")
    );
    let light = format!("<emitter type='point'>{}</emitter>\n", along("z"));
    let ball = format!("<shape type='sphere'>{}</shape>\n", along("x"));
    let scene = load(&format!("{sensor}{light}{ball}"), None).unwrap();
    let check = |scene: &Scene, expected: f32| {
        let (lower, upper) = scene.geometry.bounds();
        let center = 0.5 * (lower + upper);
        assert!((center - expected * Vec3::X).length() < 1e-5, "{center} for {expected}");
        let eye = scene.sensor.to_world.point(Vec3::ZERO);
        assert!((eye - expected * Vec3::Y).length() < 1e-5, "{eye} for {expected}");
        let lamp = scene
            .lights
            .sample_direct(&scene.geometry, Vec3::ZERO, 0.5, DVec2::ZERO)
            .unwrap();
        assert!(
            (lamp.wi * lamp.distance - expected * Vec3::Z).length() < 1e-5,
            "{lamp:?}"
        );
    };
    for (time, expected) in [(0.0, 1.0), (1.0, 1.0), (1.5, 2.0), (2.75, 4.5), (3.0, 5.0), (4.0, 5.0)] {
        check(&scene.at(time).unwrap(), expected);
    }
    check(&scene, 3.0);
}

#[test]
fn what_does_not_move_while_the_shutter_is_open_stands_still() {
    let ball = |keyframes| format!("{LIGHT}<shape type='sphere'>{}</shape>\n", animation(keyframes));
    let moves = [(1.0, "<translate x='1'/>"), (2.0, "<translate x='3'/>")];
    assert!(with_shutter(&ball(&moves)).unwrap().frame(1, 1).is_some());
    for still in [
        &[(1.0, "<translate x='1'/>"), (2.0, "<translate x='1'/>")][..],
        &[(1.0, "<translate x='1'/>")],
        &[(-2.0, "<translate x='3'/>"), (0.0, "<translate x='1'/>")],
        &[(4.0, "<translate x='1'/>"), (6.0, "<translate x='3'/>")],
    ] {
        let scene = with_shutter(&ball(still)).unwrap();
        assert!(scene.frame(1, 1).is_none() && scene.at(1.0).is_none());
        assert_eq!(scene.geometry.bounds().1.x, 2.0_f32.next_up());
    }
    let closed = "<sensor type='perspective'><float name='shutter_open' value='1.5'/></sensor>\n";
    let scene = load(&format!("{closed}{}", ball(&moves)), None).unwrap();
    assert!(scene.frame(1, 1).is_none());
    assert_eq!(
        scene.geometry.bounds().1.x,
        3.0_f32.next_up(),
        "the scene is that of the time at which the shutter opens"
    );
}

/// A moving shape has the surface of the shape whose transform is that of the time: sides, normals and texture coordinates, also where it
/// is mirrored.
#[test]
fn a_moving_shape_is_at_each_keyframe_that_with_its_transform() {
    let obj = "v 0 0 0\nv 2 0 0\nv 0 2 0\nv 0 0 2\nvn -1 -1 0.1\nvt 0.3 0.1\nvt 0.9 0.8\nvt 0.1 0.7\n";
    let flat = format!("{obj}f 1 2 3\nf 1 4 2\n");
    let shaded = format!("{obj}f 1/1/1 2/2/1 3/3/1\nf 1/1/1 4/2/1 2/3/1\n");
    let place = "<rotate x='1' y='2' z='-1' angle='70'/><translate x='0.5' y='-0.3' z='2'/>";
    for shape in [
        "type='rectangle'><boolean name='flip_normals' value='true'/>",
        "type='cube'>",
        "type='disk'>",
        "type='sphere'><point name='center' value='0.2, 0.1, -0.3'/><float name='radius' value='1.3'/>",
        "type='obj'><string name='filename' value='flat.obj'/>",
        "type='obj'><string name='filename' value='flat.obj'/><boolean name='face_normals' value='true'/>",
        "type='obj'><string name='filename' value='shaded.obj'/><boolean name='flip_normals' value='true'/>",
        "type='obj'><string name='filename' value='shaded.obj'/><boolean name='face_normals' value='true'/>",
    ] {
        for mirror in ["", "<scale y='-1'/>"] {
            let scene = |to_world: &str| {
                let text = format!(
                    "<scene version='3.0.0'><sensor type='perspective'><float name='shutter_close' value='4'/></sensor>\n\
                     {LIGHT}<shape {shape}{to_world}</shape></scene>"
                );
                let files = BTreeMap::from([
                    ("main.xml".to_owned(), text.into_bytes()),
                    ("flat.obj".to_owned(), flat.clone().into_bytes()),
                    ("shaded.obj".to_owned(), shaded.clone().into_bytes()),
                ]);
                Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap()
            };
            let map = format!("{mirror}<scale value='0.7'/>{place}");
            let still = scene(&format!("<transform name='to_world'>{map}</transform>"));
            let moving = scene(&animation(&[(0.0, mirror), (3.0, &map)])).at(3.0).unwrap();
            let (lower, upper) = still.geometry.bounds();
            let mut random = PathRandom::new(4, 1, Stream::Probe, 0);
            let mut hits = 0;
            for _ in 0..200 {
                let target = lower + (upper - lower) * Vec3::new(random.next_1d(), random.next_1d(), random.next_1d());
                let origin = 0.5 * (lower + upper) + 5.0 * square_to_sphere(random.next_2d());
                let ray = Ray {
                    origin,
                    direction: (target - origin).normalize(),
                    max_distance: f32::INFINITY,
                };
                let (Some(a), Some(b)) = (still.geometry.intersect(&ray), moving.geometry.intersect(&ray)) else {
                    continue;
                };
                hits += 1;
                let near = |a: Vec3, b: Vec3| (a - b).length() < 1e-3;
                let same = near(a.position, b.position)
                    && near(a.geometric_normal, b.geometric_normal)
                    && near(a.frame.n, b.frame.n)
                    && near(a.frame.s, b.frame.s)
                    && (a.uv - b.uv).length() < 1e-3;
                assert!(same, "{shape} {mirror}: {a:?} and {b:?}");
            }
            assert!(hits > 20, "{shape} {mirror}: {hits}");
        }
    }
}

#[test]
fn motions_that_a_shape_or_light_cannot_make_are_refused_in_their_line() {
    let (uneven, far) = ("<scale x='2'/>", "<translate x='9e8'/><scale value='2'/>");
    for (element, keyframe, message) in [
        (
            "shape type='cube'",
            far,
            "the shape may come 1.8e9 from the origin as it moves",
        ),
        (
            "shape type='disk'",
            far,
            "the shape may come 1.8e9 from the origin as it moves",
        ),
        (
            "shape type='disk'",
            "<scale value='1e-30'/>",
            "no area at one of the keyframes",
        ),
        (
            "emitter type='spot'",
            uneven,
            "a spot light can be moved, rotated and mirrored only",
        ),
        ("emitter type='point'", far, "lies beyond 1e9"),
    ] {
        let name = element.split(' ').next().unwrap();
        let keyframes = animation(&[(0.0, ""), (1.0, keyframe)]);
        let faults = with_shutter(&format!("{LIGHT}{BALL}<{element}>\n{keyframes}</{name}>\n")).unwrap_err();
        let told = faults.to_string();
        assert!(told.contains(message), "{told}");
        assert!(
            faults.all().len() == 1 && [Some(5), Some(6)].contains(&faults.first().line()),
            "{told}"
        );
    }
}

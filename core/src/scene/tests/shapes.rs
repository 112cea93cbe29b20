//! Cylinders, instances, curves and height fields as scenes describe them.

use super::{LIGHT, load, warnings};
use crate::geometry::{Ray, ShapeId, SurfacePoint};
use crate::integrator::{Unobserved, render_iteration};
use crate::material::{Material, TransportMode};
use crate::math::{PI, Vec2, Vec3};
use crate::random::Sampling;
use crate::scene::{Limits, Scene, SceneError, SceneFaults};
use crate::settings::{IntegratorSettings, PathSettings};
use std::collections::BTreeMap;

fn hit(scene: &Scene, origin: [f32; 3], direction: [f32; 3]) -> Option<SurfacePoint> {
    scene.geometry.intersect(&Ray {
        origin: origin.into(),
        direction: Vec3::from(direction).normalize(),
        max_distance: f32::INFINITY,
    })
}

fn load_files(body: &str, files: &[(&str, &[u8])], limits: &Limits) -> Result<Scene, SceneFaults> {
    let text = format!("<scene version='3.0.0'>\n{body}</scene>");
    let mut all = BTreeMap::from([("main.xml".to_owned(), text.into_bytes())]);
    all.extend(files.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())));
    Scene::load_sensor(&all, "main.xml", &BTreeMap::new(), None, limits)
}

/// A sphere that is stretched while the shutter is open is an ellipsoid at each moment.
#[test]
fn uneven_motion_of_a_sphere_makes_ellipsoids() {
    let body = format!(
        "<sensor type='perspective'><float name='shutter_open' value='0'/><float name='shutter_close' value='1'/></sensor>\
         {LIGHT}<shape type='sphere'><animation name='to_world'><transform time='0'><scale value='1'/></transform>\
         <transform time='1'><scale x='3'/></transform></animation></shape>"
    );
    let scene = load(&body, None).unwrap();
    for (time, x) in [(0.0, 1.0), (0.5, 2.0), (1.0, 3.0)] {
        let point = hit(&scene.at(time).unwrap(), [9.0, 0.0, 0.0], [-1.0, 0.0, 0.0]).unwrap();
        assert!((point.position.x - x).abs() < 1e-5, "{point:?}");
    }
}

/// What Mitsuba 3.9.1 (`scalar_rgb`) reports of a hit: `si.t`, `si.p`, `si.uv`, `si.n`, and `s` of `si.sh_frame`.
struct Expected {
    t: f32,
    p: [f32; 3],
    uv: [f32; 2],
    n: [f32; 3],
    s: [f32; 3],
}

fn check(point: &SurfacePoint, expected: &Expected) {
    let close = |a: Vec3, b: [f32; 3], error: f32| (a - Vec3::from(b)).length() < error;
    assert!((point.distance - expected.t).abs() < 1e-5 * expected.t, "{point:?}");
    assert!(close(point.position, expected.p, 1e-5 * expected.t), "{point:?}");
    assert!((point.uv - Vec2::from(expected.uv)).length() < 2e-5, "{point:?}");
    assert!(close(point.geometric_normal, expected.n, 2e-5), "{point:?}");
    assert!(close(point.frame.n, expected.n, 2e-5), "{point:?}");
    assert!(close(point.frame.s, expected.s, 1e-4), "{point:?}");
}

/// By `mi.load_dict({'type': 'cylinder', 'p0': [1, 2, 3], 'p1': [2, 4, 2.5], 'radius': 0.7})` with the maps below.
#[test]
fn a_cylinder_is_that_of_mitsuba() {
    let scene = |inside: &str| {
        let body = format!(
            "{LIGHT}<shape type='cylinder'><point name='p0' value='1 2 3'/><point name='p1' value='2 4 2.5'/>\
             <float name='radius' value='0.7'/>{inside}</shape>"
        );
        load(&body, None).unwrap()
    };
    let plain = Expected {
        t: 4.435_465_3,
        p: [1.936, 2.44, 3.108],
        uv: [0.007_646_08, 0.335_619],
        n: [0.857_688, -0.330_34, 0.394_014],
        s: [0.271_838, -0.359_125, -0.892_824],
    };
    let (origin, direction) = ([4.0, -1.0, 5.0], [-2.4, 4.0, -2.2]);
    check(&hit(&scene(""), origin, direction).unwrap(), &plain);
    let inwards = scene("<boolean name='flip_normals' value='true'/>");
    let flipped = Expected {
        n: plain.n.map(|n| -n),
        ..plain
    };
    check(&hit(&inwards, origin, direction).unwrap(), &flipped);
    let mirrored = scene("<transform name='to_world'><scale x='-1'/></transform>");
    let expected = Expected {
        p: [-1.936, 2.44, 3.108],
        uv: [0.007_646_18, 0.335_619],
        n: [-0.857_688, -0.330_341, 0.394_013],
        s: [-0.271_837, -0.359_124, -0.892_824],
        ..plain
    };
    check(&hit(&mirrored, [-4.0, -1.0, 5.0], [2.4, 4.0, -2.2]).unwrap(), &expected);
    // `T().scale([2, 2, 2]).rotate([1, 0, 0], 30)`: the rotation comes first.
    let scaled = scene("<transform name='to_world'><rotate x='1' angle='30'/><scale value='2'/></transform>");
    let expected = Expected {
        t: 10.846_519,
        p: [2.922_25, 2.574_8, 9.222_48],
        uv: [0.772_228, 0.595_682],
        n: [-0.192_226, -0.179_032, 0.964_882],
        s: [0.878_961, -0.468_676, 0.088_147],
    };
    check(&hit(&scaled, [4.0, 2.0, 20.0], [-1.5, 0.8, -15.0]).unwrap(), &expected);
    assert!(
        hit(&scene(""), [1.0, 2.0, 3.0], [1.0, 2.0, -0.5]).is_none(),
        "its ends are open"
    );
}

/// A group of a rectangle and a sphere, placed by a map that mirrors and stretches.
#[test]
fn an_instance_is_that_of_mitsuba() {
    let body = format!(
        "{LIGHT}<shape type='shapegroup' id='g'>\
         <shape type='rectangle'><transform name='to_world'><rotate y='1' angle='40'/>\
         <translate x='0.1' y='0.2' z='0.3'/></transform></shape>\
         <shape type='sphere'><point name='center' value='3 0 0'/><float name='radius' value='0.5'/>\
         <bsdf type='dielectric'/></shape></shape>\
         <shape type='instance'><ref id='g'/><transform name='to_world'><rotate z='1' angle='25'/>\
         <scale x='-2' y='1' z='3'/><translate x='1'/></transform></shape>"
    );
    let scene = load(&body, None).unwrap();
    let point = hit(&scene, [0.5, 0.3, 10.0], [0.1, 0.05, -10.0]).unwrap();
    let rectangle = Expected {
        t: 9.679_468,
        p: [0.596_788, 0.348_394, 0.321_135],
        uv: [0.650_092, 0.515_275],
        n: [-0.615_66, 0.574_174, 0.539_71],
        s: [-0.578_99, 0.134_994, -0.804_082],
    };
    check(&point, &rectangle);
    assert_eq!(point.shape, ShapeId(1));
    assert!(matches!(scene.material(&point), Material::Diffuse { .. }));
    let point = hit(&scene, [-4.6, 1.2, 10.0], [0.1, 0.05, -10.0]).unwrap();
    let sphere = Expected {
        t: 8.506_926,
        p: [-4.514_94, 1.242_53, 1.493_61],
        uv: [0.838_044, 0.029_401_8],
        n: [-0.114_05, -0.149_857, 0.982_108],
        s: [-0.795_755, 0.605_618, 2.561_74e-7],
    };
    check(&point, &sphere);
    assert_eq!(point.shape, ShapeId(2));
    assert!(matches!(scene.material(&point), Material::Dielectric { .. }));
    assert!(warnings(&scene).iter().all(|warning| warning.contains("<sensor>")));
}

const BALLS: &str = "<shape type='sphere'><float name='radius' value='0.5'/><bsdf type='dielectric'/></shape>\
                     <shape type='cube'><transform name='to_world'><scale value='0.25'/>\
                     <translate x='0.75' y='0.5'/></transform></shape>";

/// Rooms whose objects are instances, or copies, at places that need no rounding.
fn room(objects: &str) -> Scene {
    let body = format!(
        "<sensor type='perspective'><transform name='to_world'><lookat origin='0 1 8' target='0 0 0' up='0 1 0'/></transform>\
         <film type='hdrfilm'><integer name='width' value='16'/><integer name='height' value='16'/>\
         <rfilter type='box'/></film></sensor>\
         <shape type='rectangle'><transform name='to_world'><scale value='4'/><rotate x='1' angle='-90'/>\
         <translate y='-1'/></transform></shape>\
         <shape type='rectangle'><transform name='to_world'><rotate x='1' angle='90'/><translate y='4'/></transform>\
         <emitter type='area'><rgb name='radiance' value='8 8 8'/></emitter></shape>{objects}"
    );
    load(&body, None).unwrap()
}

/// Light through instanced glass: the same paths as through copies of it.
#[test]
fn instances_look_as_copies_do() {
    let places = [
        "<scale value='2'/><translate x='-1.5'/>",
        "<scale value='0.5'/><translate x='1.5' y='-0.5' z='1'/>",
    ];
    let place = |shapes: &str, place: &str| {
        let transform = format!("<transform name='to_world'>{place}</transform>");
        format!("<shape type='instance'>{shapes}{transform}</shape>")
    };
    let mut instanced = format!("<shape type='shapegroup' id='balls'>{BALLS}</shape>");
    let mut copied = String::new();
    for at in places {
        instanced += &place("<ref id='balls'/>", at);
        copied += &BALLS
            .replace("<bsdf", &format!("<transform name='to_world'>{at}</transform><bsdf"))
            .replace(
                "<translate x='0.75' y='0.5'/>",
                &format!("<translate x='0.75' y='0.5'/>{at}"),
            );
    }
    let settings = IntegratorSettings::Path(PathSettings {
        samples: 64,
        sampling: Sampling::Independent,
        max_depth: Some(12),
    });
    let render = |objects: &str| {
        render_iteration(&room(objects), &settings, 3, 1, &Unobserved)
            .unwrap()
            .pixels
    };
    let (a, b) = (render(&instanced), render(&copied));
    let sum = |pixels: &[crate::spectrum::Spectrum]| pixels.iter().map(|p| f64::from(p.luminance())).sum::<f64>();
    let same = a
        .iter()
        .zip(&b)
        .filter(|(a, b)| (a.luminance() - b.luminance()).abs() <= 1e-4 * b.luminance());
    assert!(same.count() > 240, "paths part only where a rounding decides");
    assert!((sum(&a) - sum(&b)).abs() < 1e-3 * sum(&b), "{} {}", sum(&a), sum(&b));
    assert!(sum(&b) > 1.0);
}

/// A shape that shines is a light of its own in each instance.
#[test]
fn lights_of_groups_shine_in_each_instance() {
    let body = "<shape type='shapegroup' id='g'><shape type='cube'/><shape type='rectangle'><emitter type='area'/>\
                <transform name='to_world'><translate z='2'/></transform></shape></shape>\
                <shape type='instance'><ref id='g'/></shape>\
                <shape type='instance'><ref id='g'/><transform name='to_world'><translate x='5'/></transform></shape>";
    let scene = load(body, None).unwrap();
    for (x, id) in [(0.5, 1), (5.5, 3)] {
        let lamp = hit(&scene, [x, 0.0, 5.0], [0.0, 0.0, -1.0]).unwrap();
        assert_eq!((lamp.position.z, lamp.shape), (2.0, ShapeId(id)));
        assert!(scene.light_at(&lamp).is_some());
        let cube = hit(&scene, [x, 0.0, 1.5], [0.0, 0.0, -1.0]).unwrap();
        assert_eq!((cube.position.z, cube.shape), (1.0, ShapeId(4)));
        assert!(scene.light_at(&cube).is_none());
    }
}

#[test]
fn what_cannot_be_an_instance_is_told() {
    let fault = |body: &str| {
        load(&format!("{LIGHT}{body}<shape type='cube'/>"), None)
            .unwrap_err()
            .first()
            .clone()
    };
    let alone = fault("<shape type='instance'/>\n");
    assert!(
        matches!(alone, SceneError::Missing { .. }) && alone.line() == Some(3),
        "{alone}"
    );
    let of_cube = fault("<shape type='cube' id='c'/><shape type='instance'><ref id='c'/></shape>");
    assert!(
        of_cube
            .to_string()
            .contains("a shape of type `cube`; allowed: shapegroup"),
        "{of_cube}"
    );
    let far = "<shape type='shapegroup' id='g'><shape type='cube'/></shape><shape type='instance'><ref id='g'/>\
               <transform name='to_world'><scale value='1e10'/></transform></shape>";
    assert!(
        fault(far).to_string().contains("coordinates reach to"),
        "{}",
        fault(far)
    );
    let warned = |body: &str| warnings(&load(&format!("{LIGHT}{body}<shape type='cube'/>"), None).unwrap()).join("\n");
    let nested = "<shape type='shapegroup' id='g'><shape type='cube'/></shape><shape type='shapegroup' id='h'>\
                  <shape type='cube'/><shape type='instance'><ref id='g'/></shape></shape>\
                  <shape type='instance'><ref id='h'/></shape>";
    let told = warned(nested);
    assert!(
        told.contains("a group holds no groups and no instances: it is left out"),
        "{told}"
    );
    assert!(told.contains("no instance places this group"), "{told}");
    let empty = warned("<shape type='shapegroup' id='g'/><shape type='instance'><ref id='g'/></shape>");
    assert!(empty.contains("the group holds no shapes"), "{empty}");
    let odd = warned("<shape type='sdfgrid'/>");
    assert!(odd.contains("the shape is left out of the picture"), "{odd}");
}

/// A group counts once, and its instances for themselves.
#[test]
fn limits_count_groups_once() {
    let instances = "<shape type='instance'><ref id='g'/></shape>\n".repeat(5);
    let body = format!("{LIGHT}<shape type='shapegroup' id='g'><shape type='cube'/></shape>{instances}");
    let limits = |shapes: u64| Limits {
        shapes,
        triangles: 12,
        ..Limits::default()
    };
    load_files(&body, &[], &limits(5)).unwrap();
    let over = load_files(&body, &[], &limits(4)).unwrap_err().to_string();
    assert!(over.contains("number of instances: 5 is over the limit of 4"), "{over}");
}

/// A sphere under an uneven map is the ellipsoid that the map makes of it: the unit sphere's hit, mapped.
#[test]
fn uneven_spheres_are_ellipsoids() {
    let uneven = "<transform name='to_world'><scale x='1' y='2' z='4'/></transform>";
    let scene = load(&format!("{LIGHT}<shape type='sphere'>{uneven}</shape>"), None).unwrap();
    let point = hit(&scene, [0.0, 1.0, 9.0], [0.0, 0.0, -1.0]).unwrap();
    // On x^2 + (y / 2)^2 + (z / 4)^2 = 1; the normal is the gradient.
    let z = 4.0 * 0.75_f32.sqrt();
    assert!((point.position - Vec3::new(0.0, 1.0, z)).length() < 1e-5, "{point:?}");
    let normal = Vec3::new(0.0, 1.0 / 4.0, z / 16.0).normalize();
    assert!((point.geometric_normal - normal).length() < 1e-6, "{point:?}");
    assert!(
        warnings(&scene)
            .iter()
            .any(|warning| warning.contains("the ellipsoid that this makes of it"))
    );
    let body = format!("{LIGHT}<shape type='ellipsoid'>{uneven}</shape>");
    assert!(
        warnings(&load(&body, None).unwrap())
            .iter()
            .all(|warning| !warning.contains("unevenly"))
    );
    let lamp = load(
        &format!("<shape type='ellipsoid'>{uneven}<emitter type='area'/></shape>"),
        None,
    )
    .unwrap();
    assert!(
        warnings(&lamp)
            .iter()
            .any(|warning| warning.contains("it is a mesh of 16384 triangles"))
    );
    let point = hit(&lamp, [0.0, 1.0, 9.0], [0.0, 0.0, -1.0]).unwrap();
    assert!((point.position - Vec3::new(0.0, 1.0, z)).length() < 1e-2 && scene.light_at(&point).is_none());
    assert!(lamp.light_at(&point).is_some() && point.frame.n.dot(normal) > 0.999);
}

/// Points on a light are chosen by its area, which an even cylinder only has in closed form, at each moment.
#[test]
fn cylinders_that_shine_are_even_or_meshes() {
    let told = |inside: &str| {
        let body = format!(
            "<sensor type='perspective'><float name='shutter_open' value='0'/><float name='shutter_close' value='1'/></sensor>\
             <shape type='cylinder'>{inside}<emitter type='area'/></shape>"
        );
        warnings(&load(&body, None).unwrap())
            .join("\n")
            .contains("it is a mesh of 256 triangles")
    };
    let still = |map: &str| told(&format!("<transform name='to_world'>{map}</transform>"));
    let moving = |map: &str| {
        told(&format!(
            "<animation name='to_world'><transform time='0'><scale value='1'/></transform>\
             <transform time='1'>{map}</transform></animation>"
        ))
    };
    for (map, mesh) in [
        ("<scale value='3'/><rotate x='1' y='1' angle='30'/>", false),
        ("<scale z='3'/>", false),
        ("<scale x='3'/>", true),
        ("<rotate x='1' angle='30'/><scale z='3'/>", true),
    ] {
        assert_eq!((still(map), moving(map)), (mesh, mesh), "{map}");
    }
}

const STRANDS: &str = "0 0 0 0.5\n0 0 3 0.5\n\n# another\n 4 0 0 0.25 \r\n4 0 2 0.25\n4 2 2 0.25\n";

#[test]
fn curves_are_tubes_of_their_radius() {
    let body = format!("{LIGHT}<shape type='linearcurve'><string name='filename' value='c.txt'/></shape>");
    let scene = load_files(&body, &[("c.txt", STRANDS.as_bytes())], &Limits::default()).unwrap();
    assert!(
        warnings(&scene)
            .iter()
            .any(|warning| warning.contains("tubes of 32 sides"))
    );
    for (x, z, radius) in [(0.0, 1.5, 0.5), (4.0, 1.0, 0.25)] {
        let point = hit(&scene, [x - 3.0, 0.0, z], [1.0, 0.0, 0.0]).unwrap();
        let expected = Vec3::new(x - radius, 0.0, z);
        assert!((point.position - expected).length() < 0.01 * radius, "{point:?}");
        assert!((point.frame.n + Vec3::X).length() < 0.01, "{point:?}");
    }
    // The mitred elbow is closed: what comes along its diagonal meets it.
    assert!(hit(&scene, [4.0, -2.0, 4.0], [0.0, 1.0, -1.0]).is_some());
    assert!(hit(&scene, [4.0, 4.0, 0.0], [0.0, -1.0, 1.0]).is_some());

    let hair = STRANDS.replace(" 0.5", "").replace(" 0.25", "");
    let body = format!(
        "{LIGHT}<shape type='hair'><string name='filename' value='c.txt'/><float name='radius' value='0.5'/></shape>"
    );
    let point_of = |bytes: &[u8]| {
        let scene = load_files(&body, &[("c.txt", bytes)], &Limits::default()).unwrap();
        hit(&scene, [1.0, 0.0, 1.0], [1.0, 0.0, 0.0]).unwrap()
    };
    let point = point_of(hair.as_bytes());
    assert!((point.position.x - 3.5).abs() < 0.01, "{point:?}");
    let mut binary = b"BINARY_HAIR\x05\0\0\0".to_vec();
    let inf = f32::INFINITY;
    let numbers = [
        0.0, 0.0, 0.0, 0.0, 0.0, 3.0, inf, 4.0, 0.0, 0.0, 4.0, 0.0, 2.0, 4.0, 2.0, 2.0,
    ];
    binary.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    assert_eq!(format!("{point:?}"), format!("{:?}", point_of(&binary)));
    let cut = load_files(&body, &[("c.txt", &binary[..60])], &Limits::default()).unwrap_err();
    assert!(cut.to_string().contains("ends too early"), "{cut}");
}

/// A uniform cubic B-spline of equally spaced points on a line runs along it at even speed, from the second point to the last but one.
#[test]
fn b_splines_begin_at_their_second_point() {
    let points = "0 0 0 1\n0 0 1 1\n0 0 2 1\n0 0 3 1\n0 0 4 1\n";
    let body = format!("{LIGHT}<shape type='bsplinecurve'><string name='filename' value='c.txt'/></shape>");
    let scene = load_files(&body, &[("c.txt", points.as_bytes())], &Limits::default()).unwrap();
    assert!(hit(&scene, [-3.0, 0.0, 0.99], [1.0, 0.0, 0.0]).is_none());
    assert!(hit(&scene, [-3.0, 0.0, 3.01], [1.0, 0.0, 0.0]).is_none());
    for z in [1.01_f32, 1.7, 2.5, 2.99] {
        let point = hit(&scene, [-3.0, 0.0, z], [1.0, 0.0, 0.0]).unwrap();
        assert!(
            (point.uv.x - (z - 1.0) / 2.0).abs() < 1e-5,
            "u runs along the curve: {point:?}"
        );
        assert!(point.frame.s.z > 0.99, "{point:?}");
        assert!(point.geometric_normal.x < -0.99);
    }
    for (text, line, reason) in [
        ("0 0 0 1\n1 1 1 1\n", 3, "a B-spline has 2 points; it needs at least 4"),
        ("0 0 0 1\n1 1 x 1\n", 2, "z: `x` is not a finite number"),
        ("0 0 0 1\n1 1 1 -1\n", 2, "the radius is -1"),
        ("\n\n", 0, "the file holds no curve"),
        ("0 0 0\n", 1, "the radius is missing"),
    ] {
        let faults = load_files(&body, &[("c.txt", text.as_bytes())], &Limits::default()).unwrap_err();
        let first = faults.first();
        assert_eq!((first.file(), first.line().unwrap_or(0)), ("c.txt", line), "{first}");
        assert!(first.to_string().contains(reason), "{first}");
    }
    let limits = Limits {
        triangles: 100,
        ..Limits::default()
    };
    let faults = load_files(&body, &[("c.txt", points.as_bytes())], &limits).unwrap_err();
    assert!(matches!(faults.first(), SceneError::Limit { .. }), "{faults}");
}

/// The grey levels 0 and 255 of a PGM stand at heights 0 and `scale`.
#[test]
fn a_height_field_is_raised_by_its_image() {
    let mut image = b"PF\n2 2\n-1\n".to_vec();
    // PFM runs from bottom to top: the lower row is 1, the upper 0.
    for value in [1.0_f32, 1.0, 0.0, 0.0] {
        image.extend([value; 3].iter().flat_map(|v| v.to_le_bytes()));
    }
    let body = format!(
        "{LIGHT}<shape type='heightfield'><string name='filename' value='h.pfm'/><float name='scale' value='2'/></shape>"
    );
    let scene = load_files(&body, &[("h.pfm", &image)], &Limits::default()).unwrap();
    let point = hit(&scene, [0.3, 0.5, 9.0], [0.0, 0.0, -1.0]).unwrap();
    assert!((point.position.z - 1.5).abs() < 1e-5, "{point:?}");
    assert!(point.geometric_normal.z > 0.0 && (point.uv - Vec2::new(0.65, 0.75)).length() < 1e-6);
    let limits = Limits {
        triangles: 1,
        ..Limits::default()
    };
    let over = load_files(&body, &[("h.pfm", &image)], &limits)
        .unwrap_err()
        .to_string();
    assert!(
        over.contains("number of triangles of the scene: 2 is over the limit of 1"),
        "{over}"
    );
    let one = b"PF\n1 1\n-1\n\0\0\0\0\0\0\0\0\0\0\0\0";
    let fault = load_files(&body, &[("h.pfm", one)], &Limits::default()).unwrap_err();
    assert!(fault.to_string().contains("at least 2 x 2"), "{fault}");
}

#[test]
fn merged_shapes_are_rendered_each() {
    let body = format!(
        "{LIGHT}<shape type='merge'><shape type='cube'/><shape type='sphere'><point name='center' value='5 0 0'/></shape></shape>"
    );
    let scene = load(&body, None).unwrap();
    assert_eq!(
        hit(&scene, [5.0, 0.0, 9.0], [0.0, 0.0, -1.0]).unwrap().shape,
        ShapeId(1)
    );
    assert_eq!(
        hit(&scene, [0.0, 0.0, 9.0], [0.0, 0.0, -1.0]).unwrap().shape,
        ShapeId(0)
    );
}

const ATTRIBUTES: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float heat_x\nproperty float tint_r\n\
    property float tint_g\nproperty float tint_b\nproperty uchar wood_0\nproperty uchar wood_1\nproperty uchar wood_2\n\
    element face 3\nproperty list uchar int vertex_indices\nproperty float r\nproperty float g\nproperty float b\nend_header\n\
    0 0 0 255 128 0 0.25 0.1 0.2 0.3 10 20 30\n1 0 0 0 64 255 0.5 0.4 0.5 0.6 40 50 60\n\
    1 1 0 32 32 32 0.75 0.7 0.8 0.9 70 80 90\n0 1 0 200 100 50 1.0 0.15 0.25 0.35 100 110 120\n\
    3 0 0 1 1 1 1\n3 0 1 2 0.2 0.4 0.6\n3 0 2 3 0.9 0.5 0.1\n";

/// The reflectance at two points of a mesh from file `name`, whose texture shows what `texture` says.
fn shown(name: &str, content: &str, texture: &str, place: &str) -> ([[f32; 3]; 2], String) {
    let plugin = name.rsplit('.').next().unwrap();
    let body = format!(
        "{LIGHT}<shape type='{plugin}'><string name='filename' value='{name}'/>{place}<bsdf type='twosided'>\
         <bsdf type='diffuse'>{texture}</bsdf></bsdf></shape>"
    );
    let scene = load_files(&body, &[(name, content.as_bytes())], &Limits::default()).unwrap();
    let colour = |x: f32, y: f32| {
        let point = hit(&scene, [x, y, 1.0], [0.0, 0.0, -1.0]).unwrap();
        let bsdf = scene.material(&point).resolve(&(&point).into(), Vec3::Z);
        // A diffuse surface: the reflectance over pi.
        (bsdf.f(Vec3::Z, Vec3::Z, TransportMode::Radiance) * PI).to_rgb()
    };
    ([colour(0.7, 0.2), colour(0.3, 0.6)], warnings(&scene).join("\n"))
}

fn attribute(name: &str, scale: f32) -> String {
    format!(
        "<texture type='mesh_attribute' name='reflectance'><string name='name' value='{name}'/>\
         <float name='scale' value='{scale}'/></texture>"
    )
}

/// By `mi.load_dict({'type': 'mesh_attribute', 'name': ..., 'scale': 0.5}).eval(si)` at the same points of the same mesh, without its
/// triangle of no area. Mitsuba takes integers as they are; here they are parts of 255, and sRGB values as colours.
#[test]
fn attributes_of_meshes_are_those_of_mitsuba() {
    let decoded = |mitsubas: [f64; 3]| mitsubas.map(|value| value as f32 / 255.0);
    for (name, expected) in [
        ("face_color", [[0.1, 0.2, 0.3], [0.45, 0.25, 0.05]]),
        ("vertex_heat", [[0.2375; 3], [0.3125; 3]]),
        ("vertex_tint_color", [[0.185, 0.235, 0.285], [0.1475, 0.1975, 0.2475]]),
        (
            "vertex_wood",
            [decoded([18.5, 23.5, 28.5]), decoded([27.5, 32.5, 37.5])],
        ),
    ] {
        let (found, told) = shown("m.ply", ATTRIBUTES, &attribute(name, 0.5), "");
        for (found, expected) in found.into_iter().zip(expected) {
            assert!(
                (0..3).all(|c| (found[c] - expected[c]).abs() < 1e-6),
                "{name}: {found:?}"
            );
        }
        assert!(!told.contains("attribute"), "{told}");
    }
    // The blend of three sRGB colours that are decoded first: at (0.7, 0.2) of vertices 0, 1 and 2 by 0.3, 0.5 and 0.2.
    let (found, _) = shown(
        "m.ply",
        ATTRIBUTES,
        "<texture type='vertexcolors' name='reflectance'/>",
        "",
    );
    let [white, half, dark, blue] = [1.0, 0.215_860_5, 0.014_443_8, 0.051_269_5];
    let expected = [
        0.3 * white + 0.2 * dark,
        0.3 * half + 0.5 * blue + 0.2 * dark,
        0.5 * white + 0.2 * dark,
    ];
    assert!(
        (0..3).all(|c| (found[0][c] - expected[c]).abs() < 1e-5),
        "{found:?} {expected:?}"
    );

    let (found, told) = shown("m.ply", ATTRIBUTES, &attribute("face_nope", 1.0), "");
    assert_eq!(found, [[0.5; 3]; 2]);
    assert!(told.contains("the shape has no attribute `face_nope`"), "{told}");
    let (found, told) = shown("m.ply", ATTRIBUTES, &attribute("vertex_heat", 4.0), "");
    assert_eq!(found[1], [1.0; 3]);
    assert!(
        told.contains("values of the attribute `vertex_heat` below 0 and above 1 count as these"),
        "{told}"
    );
    let broken = ATTRIBUTES.replace("0.9 0.5 0.1", "nan 0.5 0.1");
    let body = format!(
        "{LIGHT}<shape type='ply'><string name='filename' value='m.ply'/><bsdf type='diffuse'>{}</bsdf></shape>",
        attribute("face_color", 1.0)
    );
    let fault = load_files(&body, &[("m.ply", broken.as_bytes())], &Limits::default()).unwrap_err();
    assert_eq!(
        (fault.first().file(), fault.first().line()),
        ("m.ply", Some(29)),
        "{fault}"
    );
    assert!(
        fault.to_string().contains("face 2: `r` is NaN, not a finite number"),
        "{fault}"
    );
}

/// Colours behind the positions of an OBJ file are sRGB values; a vertex without is white. In an instance they are the same.
#[test]
fn colours_of_obj_vertices_are_shown() {
    let content = "v 0 0 0 0.5 0 1\nv 1 0 0\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0 0 0 0\nf 1 2 3\nf 1 3 4\n";
    let (found, told) = shown(
        "m.obj",
        content,
        "<texture type='vertexcolors' name='reflectance'/>",
        "",
    );
    let half = 0.214_041_1;
    let expected = [0.3 * half + 0.5 + 0.2 * half, 0.5 + 0.2 * half, 0.3 + 0.5 + 0.2 * half];
    assert!(
        (0..3).all(|c| (found[0][c] - expected[c]).abs() < 1e-5),
        "{found:?} {expected:?}"
    );
    assert!(!told.contains("attribute"), "{told}");
    let body = format!(
        "{LIGHT}<shape type='shapegroup' id='g'><shape type='cube'><transform name='to_world'><translate z='-9'/></transform></shape>\
         <shape type='obj'><string name='filename' value='m.obj'/><bsdf type='diffuse'>\
         <texture type='vertexcolors' name='reflectance'/></bsdf></shape></shape>\
         <shape type='instance'><ref id='g'/><transform name='to_world'><translate x='5'/></transform></shape>"
    );
    let scene = load_files(&body, &[("m.obj", content.as_bytes())], &Limits::default()).unwrap();
    let point = hit(&scene, [5.7, 0.2, 1.0], [0.0, 0.0, -1.0]).unwrap();
    let bsdf = scene.material(&point).resolve(&(&point).into(), Vec3::Z);
    let colour = (bsdf.f(Vec3::Z, Vec3::Z, TransportMode::Radiance) * PI).to_rgb();
    assert!(
        (0..3).all(|c| (colour[c] - expected[c]).abs() < 1e-5),
        "{colour:?} {expected:?}"
    );
}

//! Sensors of scenes: crops, windows, meters and the camera that looks everywhere.

use super::{BALL, LIGHT, load, warnings};
use crate::integrator::bandwidth;
use crate::math::{Vec2, Vec3};
use crate::random::{PathRandom, Stream};
use crate::scene::Scene;
use crate::sensor::{Projection, Sensor};
use crate::settings::{IntegratorSettings, PppmSettings};

fn scene(sensor: &str) -> Scene {
    load(&format!("{LIGHT}{sensor}{BALL}"), None).unwrap_or_else(|faults| panic!("{sensor}\n{faults}"))
}

fn assert_same_rays(label: &str, [a, b]: [&Sensor; 2], [offset_a, offset_b]: [Vec2; 2]) {
    let mut random = PathRandom::new(1, 1, Stream::Camera, 0);
    for _ in 0..200 {
        let (pixel, u) = (random.next_2d() * Vec2::new(5.0, 4.0), random.next_2d());
        let [a, b] = [a.ray(pixel + offset_a, u), b.ray(pixel + offset_b, u)];
        assert!(
            (a.direction - b.direction).length() < 2e-6,
            "{label} at {pixel}: {a:?} {b:?}"
        );
        assert!((a.origin - b.origin).length() < 1e-5, "{label} at {pixel}: {a:?} {b:?}");
        assert!((a.max_distance / b.max_distance - 1.0).abs() < 1e-5);
    }
}

/// What a window of a film shows is what the whole film shows there.
#[test]
fn a_crop_is_cut_out_of_the_picture() {
    let placed = "<transform name='to_world'><scale x='2' y='3'/><lookat origin='1 2 3' target='4 -1 7' up='0 1 0'/></transform>";
    let moved = "<transform name='to_world'><lookat origin='1 2 3' target='4 -1 7' up='0 1 0'/></transform>";
    let lens = "<float name='aperture_radius' value='0.3'/><float name='focus_distance' value='4'/>";
    let shifted =
        "<float name='principal_point_offset_x' value='0.2'/><float name='principal_point_offset_y' value='-0.1'/>";
    for (plugin, properties) in [
        ("perspective", format!("{moved}{shifted}")),
        ("thinlens", format!("{moved}{lens}{shifted}")),
        ("orthographic", placed.to_owned()),
    ] {
        let film = |crop: &str| {
            scene(&format!(
                "<sensor type='{plugin}'>{properties}<film type='hdrfilm'><integer name='width' value='40'/>\
                 <integer name='height' value='30'/>{crop}</film></sensor>"
            ))
        };
        let crop = "<integer name='crop_offset_x' value='7'/><integer name='crop_offset_y' value='21'/>\
                    <integer name='crop_width' value='5'/><integer name='crop_height' value='4'/>";
        let [whole, part] = [film(""), film(crop)];
        assert_eq!(warnings(&part), Vec::<String>::new());
        assert_eq!((part.film.resolution, part.sensor.resolution), ([5, 4], [5, 4]));
        assert_same_rays(
            plugin,
            [&whole.sensor, &part.sensor],
            [Vec2::new(7.0, 21.0), Vec2::ZERO],
        );
        let footprints = [&whole, &part].map(|scene| scene.sensor.pixel_footprint(3.0));
        assert!((footprints[0] / footprints[1] - 1.0).abs() < 1e-5);
        let widths =
            [&whole, &part].map(|scene| bandwidth(scene, &IntegratorSettings::Pppm(PppmSettings::default()), 1));
        assert_eq!(
            widths[0], widths[1],
            "kernels are as wide as those of the whole picture"
        );
    }
}

/// A screen window is what it says: half of what the angle sees, or a window that is another camera's crop.
#[test]
fn a_screen_window_narrows_the_view() {
    let film = "<film type='hdrfilm'><integer name='width' value='10'/><integer name='height' value='8'/></film>";
    let part = "<film type='hdrfilm'><integer name='width' value='40'/><integer name='height' value='32'/>\
                <integer name='crop_offset_x' value='20'/><integer name='crop_offset_y' value='8'/>\
                <integer name='crop_width' value='10'/><integer name='crop_height' value='8'/></film>";
    for plugin in ["perspective", "orthographic"] {
        let fov = match plugin {
            "perspective" => "<float name='fov' value='60'/>",
            _ => "",
        };
        let window = "<string name='screen_window' value='0, 0.5, 0 0.4'/>";
        let [window, crop] = [format!("{fov}{window}{film}"), format!("{fov}{part}")]
            .map(|inner| scene(&format!("<sensor type='{plugin}'>{inner}</sensor>")));
        assert_eq!(warnings(&window), Vec::<String>::new());
        assert_same_rays(plugin, [&window.sensor, &crop.sensor], [Vec2::ZERO; 2]);
    }
    let oblong = scene(&format!(
        "<sensor type='perspective'><string name='screen_window' value='-1 1 -1 1'/>{film}</sensor>"
    ));
    assert!(warnings(&oblong)[0].contains("pixels are square"));
    for wrong in ["1 2 3", "1 0 0 1", "a b c d", "0 1 0 1e30", "0 1 0 NaN"] {
        let sensor = format!("<sensor type='perspective'><string name='screen_window' value='{wrong}'/></sensor>");
        let faults = load(&format!("{LIGHT}{sensor}{BALL}"), None).unwrap_err();
        assert!(faults.to_string().contains("is not four numbers"), "{faults}");
    }
}

#[test]
fn meters_and_the_spherical_camera_are_built() {
    let meter = scene(
        "<sensor type='radiancemeter'><point name='origin' value='1 2 -5'/><vector name='direction' value='0 0 2'/></sensor>",
    );
    assert_eq!((warnings(&meter), meter.film.resolution), (Vec::new(), [1, 1]));
    for corner in [Vec2::ZERO, Vec2::ONE] {
        let ray = meter.sensor.ray(corner, Vec2::ZERO);
        assert!((ray.origin - Vec3::new(1.0, 2.0, -5.0)).length() < 1e-5);
        assert!((ray.direction - Vec3::Z).length() < 1e-5, "{ray:?}");
    }
    let downwards = scene("<sensor type='radiancemeter'><vector name='direction' value='0.1 -0.2 -1'/></sensor>");
    assert_eq!(warnings(&downwards), Vec::<String>::new());
    let rectangle =
        "<shape type='rectangle'><transform name='to_world'><scale value='2'/><translate z='-4'/></transform>";
    let on_shape = format!("{LIGHT}{BALL}{rectangle}<sensor type='irradiancemeter' id='lux'/></shape>");
    let scene_with_meter = load(&on_shape, Some("lux")).unwrap();
    assert_eq!(warnings(&scene_with_meter), Vec::<String>::new());
    assert!(matches!(
        scene_with_meter.sensor.projection,
        Projection::Irradiance { flipped: false }
    ));
    let everywhere = scene("<sensor type='spherical'/>");
    assert!(matches!(everywhere.sensor.projection, Projection::Spherical));
    for (wrong, expected) in [
        (
            format!("<sensor type='irradiancemeter'/>{BALL}"),
            "put it inside a <shape",
        ),
        (
            "<shape type='sphere'><sensor type='irradiancemeter'><film type='hdrfilm'/></sensor></shape>".to_owned(),
            "its film has 1 x 1 pixels",
        ),
        (
            "<shape type='merge'><sensor type='irradiancemeter'/></shape>".to_owned(),
            "on a shape of type `merge`",
        ),
        (
            "<shape type='rectangle'><sensor type='perspective'/></shape>".to_owned(),
            "alone lies on a shape",
        ),
        (format!("<sensor type='distant'/>{BALL}"), "type `distant`"),
        (
            format!(
                "<sensor type='spherical'><film type='hdrfilm'><integer name='crop_width' value='5'/></film></sensor>{BALL}"
            ),
            "a crop of the film",
        ),
    ] {
        let faults = load(&format!("{LIGHT}{wrong}"), None).unwrap_err();
        assert!(faults.to_string().contains(expected), "{wrong}: {faults}");
    }
    let batch = scene("<sensor type='batch'><sensor type='spherical'/></sensor>");
    assert!(matches!(batch.sensor.projection, Projection::Spherical) && warnings(&batch).is_empty());
    for (plugin, parallel) in [("codedOrthographic", true), ("tofcamera", false)] {
        let other = scene(&format!("<sensor type='{plugin}'/>"));
        assert!(warnings(&other)[0].contains("is not known here: it is rendered as"));
        assert_eq!(matches!(other.sensor.projection, Projection::Orthographic), parallel);
    }
    let distorted = scene("<sensor type='perspective_rdist'><string name='kc' value='0.1, 0'/></sensor>");
    assert!(warnings(&distorted)[0].contains("does not distort"));
}

//! Cameras against Mitsuba's, and against themselves.

use super::*;
use crate::random::{PathRandom, Stream};
use glam::{DMat4, DVec4};

/// `look_at` from (1, 2, 3) to (4, -1, 7), up (0.1, 1, 0.2).
fn sensor() -> Sensor {
    let matrix = DMat4::from_cols(
        DVec4::new(0.812_031_7, 0.035_305_73, -0.582_544_5, 0.0),
        DVec4::new(0.275_497_17, 0.856_765_87, 0.435_951_53, 0.0),
        DVec4::new(0.514_495_8, -0.514_495_8, 0.685_994_4, 0.0),
        DVec4::new(1.0, 2.0, 3.0, 1.0),
    );
    Sensor {
        to_world: Transform::from_matrix(matrix).unwrap(),
        projection: perspective(Vec2::new(0.1, -0.07), None),
        resolution: [64, 36],
        clip: [0.5, 80.0],
    }
}

fn perspective(principal_point: Vec2, lens: Option<Lens>) -> Projection {
    Projection::Perspective {
        fov_x: 50.0_f32.to_radians(),
        principal_point,
        lens,
    }
}

const LENS: Lens = Lens {
    radius: 0.2,
    focus_distance: 5.0,
};

/// `sensor` with its principal point in the centre and `lens`.
fn centred(lens: Option<Lens>) -> Sensor {
    Sensor {
        projection: perspective(Vec2::ZERO, lens),
        ..sensor()
    }
}

/// An orthographic camera like `sensor`, scaled.
fn orthographic(scale: [f64; 3], resolution: [u32; 2]) -> Sensor {
    let scale = Transform::from_matrix(DMat4::from_scale(scale.into())).unwrap();
    Sensor {
        to_world: sensor().to_world.after(&scale),
        projection: Projection::Orthographic,
        resolution,
        ..sensor()
    }
}

fn assert_ray(ray: &Ray, origin: [f32; 3], direction: [f32; 3], max_distance: f32) {
    assert!((ray.origin - Vec3::from(origin)).length() < 2e-6, "{ray:?}");
    assert!((ray.direction - Vec3::from(direction)).length() < 2e-6, "{ray:?}");
    assert!((ray.max_distance - max_distance).abs() < 2e-4, "{ray:?}");
}

/// As below, of the camera that looks everywhere, but for the rows at the poles.
#[test]
fn what_a_ray_of_all_directions_shows_is_seen_at_its_pixel() {
    let camera = Sensor {
        projection: Projection::Spherical,
        ..sensor()
    };
    let mut random = PathRandom::new(9, 1, Stream::Camera, 0);
    for _ in 0..1_000 {
        let pixel = Vec2::ONE + random.next_2d() * Vec2::new(62.0, 34.0);
        let (ray, distance) = (camera.ray(pixel, Vec2::ZERO), 0.5 + 20.0 * random.next_1d());
        let point = ray.origin + distance * ray.direction;
        let seen = camera.sample_we(point, Vec2::ZERO).expect("the camera sees it");
        assert!((seen.pixel - pixel).length() < 2e-3, "{} at {pixel}", seen.pixel);
        assert!((seen.direction + ray.direction).length() < 1e-4);
        assert!((seen.visible_distance() - distance).abs() < 1e-3);
        let moved = |offset: Vec2| camera.ray(pixel + offset, Vec2::ZERO).direction;
        let [x, y] = [Vec2::X, Vec2::Y].map(|axis| moved(0.1 * axis) - moved(-0.1 * axis));
        let solid_angle = x.cross(y).length() / sqr(0.2);
        assert!(
            (solid_angle * seen.pdf.pdf - 1.0).abs() < 0.01,
            "{pixel}: {solid_angle}, {seen:?}"
        );
    }
    let up = camera.to_world.vector(Vec3::Y);
    assert!((camera.ray(Vec2::new(20.0, 0.0), Vec2::ZERO).direction - up).length() < 1e-5);
    let middle = camera.ray(Vec2::new(32.0, 18.0), Vec2::ZERO).direction;
    assert!((middle - camera.to_world.vector(Vec3::Z)).length() < 1e-5);
}

/// Points that a camera ray passes are seen at the pixel of the ray, by the same way, with the density that moving the pixel gives.
#[test]
fn what_a_ray_shows_is_seen_at_its_pixel() {
    let unlike = Lens {
        radius: 0.7,
        focus_distance: 3.0,
    };
    for camera in [
        sensor(),
        centred(Some(LENS)),
        Sensor {
            projection: perspective(Vec2::new(0.1, -0.07), Some(unlike)),
            ..sensor()
        },
        orthographic([2.5, 1.5, 3.0], [64, 36]),
    ] {
        let mut random = PathRandom::new(8, 1, Stream::Camera, 0);
        for _ in 0..1_000 {
            let (pixel, u) = (random.next_2d() * Vec2::new(64.0, 36.0), random.next_2d());
            let ray = camera.ray(pixel, u);
            let distance = 0.5 + 20.0 * random.next_1d();
            let point = ray.origin + distance * ray.direction;
            let seen = camera.sample_we(point, u).expect("the camera sees it");
            assert!(
                (seen.pixel - pixel).length() < 2e-3,
                "{camera:?}: {} at {pixel}",
                seen.pixel
            );
            assert!((seen.direction + ray.direction).length() < 1e-4);
            assert!((seen.visible_distance() - distance).abs() < 1e-4 * (1.0 + distance));
            let moved = |offset: Vec2| {
                let beside = camera.ray(pixel + offset, u);
                let along = (point - beside.origin).dot(ray.direction) / beside.direction.dot(ray.direction);
                beside.origin + along * beside.direction
            };
            let [x, y] = [Vec2::X, Vec2::Y].map(|axis| moved(0.05 * axis) - moved(-0.05 * axis));
            let area = x.cross(y).length() / sqr(0.1);
            assert!(
                (area * seen.pdf_area() - 1.0).abs() < 0.01,
                "{camera:?}: {area}, {seen:?}"
            );
            let back = Ray {
                origin: point,
                direction: -ray.direction,
                max_distance: f32::INFINITY,
            };
            match camera.hit_lens(&back, distance * 1.001, false) {
                Some(hit) => {
                    assert!(
                        (hit.pixel - pixel).length() < 5e-3,
                        "{camera:?}: {} at {pixel}",
                        hit.pixel
                    );
                    assert!((hit.distance - seen.distance).abs() < 1e-3);
                    assert!(
                        camera.hit_lens(&back, 0.9 * distance, false).is_none(),
                        "something is in the way"
                    );
                }
                None => {
                    let has_lens = matches!(camera.projection, Projection::Perspective { lens: Some(_), .. });
                    assert!(!has_lens || u.max_element() > 0.999 || u.min_element() < 0.001);
                }
            }
        }
    }
    let behind = sensor().to_world.point(Vec3::new(0.0, 0.0, -3.0));
    assert!(sensor().sample_we(behind, Vec2::ZERO).is_none());
    let beyond = sensor().to_world.point(Vec3::new(0.0, 0.0, 81.0));
    assert!(sensor().sample_we(beyond, Vec2::ZERO).is_none());
}

/// Expected values: Mitsuba 3.9.1, `scalar_rgb`, `Sensor.sample_ray` of the same camera.
#[test]
fn pinhole_rays_are_those_of_mitsuba() {
    let ray = |x: f32, y: f32| sensor().ray(Vec2::new(x * 64.0, y * 36.0), Vec2::ZERO);
    let expected = [0.446_643_3, -0.483_901_86, 0.752_561_45];
    assert_ray(
        &ray(0.5, 0.5),
        [1.224_440_6, 1.756_836_8, 3.378_166_2],
        expected,
        79.898_35,
    );
    let expected = [0.744_940_9, -0.365_704_27, 0.557_963_67];
    assert_ray(
        &ray(0.1, 0.3),
        [1.390_355_7, 1.808_367_7, 3.292_378],
        expected,
        83.317_43,
    );
    let expected = [0.092_434_92, -0.571_495_06, 0.815_382_96];
    assert_ray(
        &ray(0.9, 0.8),
        [1.051_299_3, 1.682_833, 3.452_519_4],
        expected,
        88.241_45,
    );
}

/// The lens point of Mitsuba's ray is taken from its origin; the rest is expected from Mitsuba as above.
#[test]
fn lens_rays_meet_in_the_plane_of_focus_and_cover_the_lens() {
    let (sensor, pinhole) = (centred(Some(LENS)), centred(None));
    let centre = sensor.to_world.point(Vec3::ZERO);
    let axis = sensor.to_world.vector(Vec3::Z);
    let mut random = PathRandom::new(5, 1, Stream::Camera, 0);
    let (mut moments, samples) = (Vec2::ZERO, 10_000);
    for _ in 0..samples {
        let pixel = random.next_2d() * Vec2::new(64.0, 36.0);
        let ray = sensor.ray(pixel, random.next_2d());
        let through = pinhole.ray(pixel, Vec2::ZERO);
        let in_focus = |r: &Ray| {
            let depth = (r.origin - centre).dot(axis);
            r.origin + r.direction * ((5.0 - depth) / r.direction.dot(axis))
        };
        assert!((in_focus(&ray) - in_focus(&through)).length() < 1e-5);
        assert!(((ray.origin - centre).dot(axis) - 0.5).abs() < 1e-5);
        let end = ray.origin + ray.direction * ray.max_distance - centre;
        assert!((end.dot(axis) - 80.0).abs() < 1e-3);
        let start = ray.origin - ray.direction * (0.5 / ray.direction.dot(axis)) - centre;
        let on_lens = Vec2::new(
            start.dot(sensor.to_world.vector(Vec3::X)),
            start.dot(sensor.to_world.vector(Vec3::Y)),
        );
        assert!(on_lens.length() < 0.2 + 1e-5 && start.dot(axis).abs() < 1e-5);
        moments += on_lens * on_lens;
    }
    // The mean square of a coordinate on a uniform disc is r^2 / 4, with variance r^4 / 16.
    let deviations = (moments / samples as f32 - Vec2::splat(0.01)) / (0.01 / 100.0);
    assert!(deviations.abs().max_element() < 4.0, "{deviations}: false alarm 1.3e-4");
}

#[test]
fn a_lens_ray_is_that_of_mitsuba() {
    let ray = centred(Some(LENS)).ray(Vec2::new(0.9 * 64.0, 0.8 * 36.0), Vec2::new(0.3, 0.7));
    let direction = [0.161_866_4, -0.623_934_15, 0.764_529_65];
    assert_ray(&ray, [1.056_790_7, 1.710_570_2, 3.469_203_7], direction, 85.598_56);
}

/// Chi-square of pixel position (within a cell of the image) and lens point against the uniform density.
#[test]
fn lens_points_are_uniform_by_area() {
    use crate::chi_square::{Domain, chi_square};
    let sensor = Sensor {
        to_world: Transform::default(),
        clip: [0.0, 10.0],
        ..centred(Some(Lens { radius: 2.0, ..LENS }))
    };
    let domain = Domain {
        lower: [0.0, -std::f64::consts::PI],
        upper: [4.0, std::f64::consts::PI],
        cells: [16, 16],
    };
    let outcome = chi_square(
        &domain,
        200_000,
        11,
        |random| {
            let origin = sensor.ray(random.next_2d() * 30.0, random.next_2d()).origin.as_dvec3();
            Some([origin.length_squared(), libm::atan2(origin.y, origin.x)])
        },
        |_| 1.0 / (8.0 * std::f64::consts::PI),
    );
    assert!(outcome.passes(1), "{outcome:?}");
}

/// Expected values as above. The second camera scales its axes unevenly: its rays start 3 * 0.5 before the plane of the
/// camera and are no longer for it.
#[test]
fn orthographic_rays_are_those_of_mitsuba() {
    let axis = [0.514_495_8, -0.514_495_8, 0.685_994_4];
    let camera = orthographic([2.5, 2.5, 1.0], [64, 36]);
    let ray = |x: f32, y: f32| camera.ray(Vec2::new(x * 64.0, y * 36.0), Vec2::ZERO);
    assert_ray(&ray(0.5, 0.5), [1.257_248_2, 1.742_752_3, 3.342_997], axis, 79.5);
    assert_ray(&ray(0.1, 0.3), [3.036_278_2, 2.295_294_3, 2.423_131], axis, 79.5);
    assert_ray(&ray(0.9, 0.8), [-0.599_265_46, 0.949_244_6, 4.140_252], axis, 79.5);
    let camera = orthographic([2.5, 1.5, 3.0], [36, 64]);
    let ray = |x: f32, y: f32| camera.ray(Vec2::new(x * 36.0, y * 64.0), Vec2::ZERO);
    assert_ray(&ray(0.5, 0.5), [1.771_744, 1.228_256_6, 4.028_991_7], axis, 79.5);
    assert_ray(&ray(0.1, 0.3), [3.689_670_6, 2.212_751_4, 3.328_917_5], axis, 79.5);
    assert_ray(&ray(0.9, 0.8), [-0.293_114_3, -0.213_180_07, 4.496_558], axis, 79.5);
}

/// Every ray, followed back from a point on it, leaves along `direction_from` within the lens angle, and some come close to it.
#[test]
fn the_direction_to_the_camera_is_against_its_rays() {
    for (camera, nearest) in [
        (sensor(), 0.0),
        (centred(Some(Lens { radius: 1.5, ..LENS })), 0.8),
        (orthographic([2.5, 1.5, 3.0], [64, 36]), 0.0),
    ] {
        let mut random = PathRandom::new(6, 1, Stream::Camera, 0);
        let mut largest = 0.0_f32;
        for _ in 0..10_000 {
            let ray = camera.ray(random.next_2d() * Vec2::new(64.0, 36.0), random.next_2d());
            let point = ray.origin + ray.direction * (1.0 + 9.0 * random.next_1d());
            let towards = camera.direction_from(point).unwrap();
            assert!((towards.direction.length() - 1.0).abs() < 1e-6);
            let angle = (towards.direction + ray.direction).length();
            assert!(
                angle < towards.lens_angle + 1e-5,
                "{camera:?} {point}: {angle} {towards:?}"
            );
            if towards.lens_angle > 0.0 {
                largest = largest.max(angle / towards.lens_angle);
            }
        }
        assert!(largest >= nearest, "{camera:?}: {largest}");
    }
    let inside = centred(Some(LENS)).to_world.point(Vec3::new(0.0, 0.1, 0.1));
    assert_eq!(centred(Some(LENS)).direction_from(inside).unwrap().lens_angle, PI);
    assert!(sensor().direction_from(Vec3::new(1.0, 2.0, 3.0)).is_none());
}

/// The footprint is the distance between the points where the rays through neighbouring pixels meet a plane facing the camera.
#[test]
fn a_footprint_is_the_distance_of_neighbouring_rays() {
    for camera in [centred(None), orthographic([2.5, 2.5, 3.0], [64, 36])] {
        let axis = camera.to_world.vector(Vec3::Z).normalize();
        let at = |x: f32, y: f32| {
            let ray = camera.ray(Vec2::new(x, y), Vec2::ZERO);
            let depth = (ray.origin - Vec3::new(1.0, 2.0, 3.0)).dot(axis);
            ray.origin + ray.direction * ((7.0 - depth) / ray.direction.dot(axis))
        };
        let footprint = camera.pixel_footprint(7.0);
        for neighbour in [at(33.0, 18.0), at(32.0, 19.0)] {
            let side = (neighbour - at(32.0, 18.0)).length();
            assert!(
                (side / footprint - 1.0).abs() < 1e-4,
                "{camera:?}: {side} and {footprint}"
            );
        }
    }
}

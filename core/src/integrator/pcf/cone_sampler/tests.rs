use super::super::importons::Mixture;
use super::*;
use crate::chi_square::{assert_directions, assert_narrow};
use crate::integrator::test_scenes;
use crate::material::TransportMode;
use crate::math::Vec2;
use crate::math::warp::square_to_sphere;
use crate::path::Tracer;

fn mixture() -> Mixture {
    let lobe = |x: f32, y: f32, z: f32| Vec3::new(x, y, z).normalize();
    Mixture::of(
        &[
            (lobe(0.1, 0.9, 0.2), 1.0),
            (lobe(0.3, 0.8, 0.1), 0.2),
            (lobe(-0.7, -0.1, 0.6), 2.5),
        ],
        0.35,
    )
}

#[test]
fn importon_mixtures_are_sampled_with_their_density() {
    for (label, mixture) in [("three lobes", mixture()), ("no importons", Mixture::of(&[], 0.35))] {
        assert_directions(
            label,
            2,
            |random| {
                let choice = random.next_choice();
                Some(mixture.sample(choice, random.next_2d()))
            },
            |direction| mixture.pdf(direction),
        );
    }
}

/// Half angles at which `1 - cos` has few digits at single precision or none.
const NARROW: [f32; 3] = [1e-2, 1e-3, 1e-4];

#[test]
fn narrow_lobes_are_sampled_with_their_density() {
    let scene = test_scenes::load("mirror-glass", 24);
    let position = Vec3::new(0.2, -0.3, 0.1);
    let axis = scene.sensor.direction_from(position).unwrap().direction;
    for theta in NARROW {
        let mixture = Mixture::of(
            &[
                (axis, 1.0),
                ((axis + 0.5 * theta * axis.any_orthonormal_vector()).normalize(), 1e-7),
            ],
            theta,
        );
        let label = format!("mixture of {theta}");
        assert_narrow(
            &label,
            9,
            (axis, theta),
            |random| {
                let choice = random.next_choice();
                Some(mixture.sample(choice, random.next_2d()))
            },
            |direction| mixture.pdf(direction),
        );
        for defensive in [0.0, DEFENSIVE] {
            let lobe = CameraLobe::new(&scene.sensor, theta, 0.0, defensive);
            let lobe = lobe.at(position, Some(Vec3::Y)).unwrap();
            assert_narrow(
                &format!("camera lobe of {theta}"),
                9,
                (axis, 2.0 * theta),
                |random| {
                    let choice = random.next_choice();
                    Some(lobe.sample(choice, random.next_2d()))
                },
                |direction| lobe.pdf(direction),
            );
        }
    }
}

/// Alone, camera connections have a density wherever a query may look.
#[test]
fn a_camera_lobe_with_a_defensive_share_covers_all_directions() {
    let scene = test_scenes::load("mirror-glass", 24);
    let position = Vec3::new(0.2, -0.3, 0.1);
    let lobe = CameraLobe::new(&scene.sensor, 0.3, 0.0, DEFENSIVE);
    let lobe = lobe.at(position, Some(Vec3::Y)).unwrap();
    assert_directions(
        "defensive camera lobe",
        1,
        |random| {
            let choice = random.next_choice();
            Some(lobe.sample(choice, random.next_2d()))
        },
        |direction| lobe.pdf(direction),
    );
    for path in 0..1000 {
        let direction = square_to_sphere(PathRandom::new(1, 1, Stream::Probe, path).next_2d());
        assert!(lobe.pdf(direction) >= 0.99 * DEFENSIVE / (4.0 * crate::math::PI));
    }
}

/// Wherever some technique has a density, the shares of all techniques that have one sum to one.
#[test]
fn weights_of_the_techniques_sum_to_one() {
    let scene = test_scenes::load("mirror-glass", 24);
    let mut tracer = Tracer::new(&scene);
    let mut covered = 0;
    for path in 0..200 {
        let mut random = PathRandom::new(1, 1, Stream::Probe, path);
        let pixel = Vec2::new(24.0 * random.next_1d(), 24.0 * random.next_1d());
        let ray = scene.sensor.ray(pixel, Vec2::splat(0.5));
        let Some(point) = tracer.intersect(&ray) else { continue };
        let vertex = Vertex::new(&scene, point, square_to_sphere(random.next_2d()), TransportMode::Flux);
        if vertex.is_delta() {
            continue;
        }
        let lobe = CameraLobe::new(&scene.sensor, 0.3, 0.0, 0.0);
        for (bsdf, camera, importon, beta) in [
            (true, true, true, 2.0),
            (true, false, true, 1.3),
            (false, true, true, 4.0),
            (false, true, false, 2.0),
        ] {
            let techniques = Techniques {
                vertex: &vertex,
                beta,
                bsdf,
                camera: camera.then(|| lobe.at(point.position, Some(point.geometric_normal)).unwrap()),
                importons: importon.then(mixture),
            };
            for _ in 0..20 {
                let direction = square_to_sphere(random.next_2d());
                let densities = techniques.densities(direction);
                if densities.iter().all(|density| *density <= 0.0) {
                    continue;
                }
                covered += 1;
                let sum: f32 = (0..3)
                    .map(|technique| techniques.share_over_density(technique, densities) * densities[technique])
                    .sum();
                assert!((sum - 1.0).abs() < 1e-5, "{sum}: {densities:?}");
            }
        }
    }
    assert!(covered > 5_000, "the test looks at something: {covered}");
}

use super::*;
use crate::chi_square::{assert_directions, assert_narrow, integrate_sphere};

fn draw(lights: &Lights, geometry: &Geometry, from: Vec3, random: &mut PathRandom) -> Option<LightSample> {
    lights.sample_direct(geometry, from, random.next_choice(), random.next_choice_2d())
}

/// The density that path tracing would compute for the direction it happens to follow.
fn density(lights: &Lights, geometry: &Geometry, from: Vec3, direction: Vec3) -> f32 {
    let ray = Ray {
        origin: from,
        direction,
        max_distance: f32::INFINITY,
    };
    match geometry.intersect(&ray) {
        Some(hit) => lights.pdf_area(geometry, LightId(hit.shape.0), from, &hit),
        None => lights.pdf_background(direction),
    }
}

fn check_directions(label: &str, shapes: Vec<Shape>, lights: Vec<Light>, from: Vec3) {
    let geometry = Geometry::build(shapes);
    let lights = Lights::build(lights, &geometry);
    assert_directions(
        label,
        FAMILY,
        |random| draw(&lights, &geometry, from, random).map(|sample| sample.wi),
        |direction| density(&lights, &geometry, from, direction),
    );
}

#[test]
fn directions_to_area_lights_match_their_density() {
    let at = Vec3::new(0.3, -0.2, 1.0);
    let from = Vec3::new(0.1, 0.2, -0.4);
    let toward = from - at;
    check_directions(
        "mesh",
        vec![patch(at, toward + Vec3::X)],
        vec![area_light(0, 1.0)],
        from,
    );
    check_directions(
        "mesh from behind",
        vec![patch(at, -toward - Vec3::X)],
        vec![two_sided_light(0, 1.0)],
        from,
    );
    let oval = disk(at, toward + Vec3::Y, Vec3::new(0.5, 1.2, 3.0));
    check_directions("disk", vec![oval], vec![area_light(0, 1.0)], from);
    check_directions("sphere", vec![sphere(at, 0.9, false)], vec![area_light(0, 1.0)], from);
    check_directions(
        "near sphere",
        vec![sphere(at, 1.4, false)],
        vec![area_light(0, 1.0)],
        from,
    );
    check_directions(
        "sphere from inside",
        vec![sphere(at, 3.0, true)],
        vec![area_light(0, 1.0)],
        from,
    );
    let two = vec![sphere(at, 0.6, false), disk(-at, from + at, Vec3::ONE)];
    check_directions("two lights", two, vec![area_light(0, 1.0), area_light(1, 3.0)], from);
}

/// A light of two sides is one, seen from either, and its paths start on the side that is seen.
#[test]
fn two_sided_lights_shine_to_both_sides() {
    let geometry = Geometry::build(vec![patch(Vec3::ZERO, Vec3::Z)]);
    let [one, both] = [area_light(0, 2.0), two_sided_light(0, 2.0)].map(|light| Lights::build(vec![light], &geometry));
    for z in [3.0, -3.0] {
        let from = Vec3::new(0.1, 0.2, z);
        let sample = |lights: &Lights| lights.sample_direct(&geometry, from, 0.5, DVec2::new(0.4, 0.6));
        let found = sample(&both).expect("it is seen from both sides");
        let ray = Ray {
            origin: from,
            direction: found.wi,
            max_distance: f32::INFINITY,
        };
        let hit = geometry.intersect(&ray).expect("the connection meets the light");
        assert_eq!(both.emitted(LightId(0), &hit, -found.wi), gray(2.0));
        assert!((both.pdf_area(&geometry, LightId(0), from, &hit) / found.pdf - 1.0).abs() < 1e-4);
        assert_eq!(
            one.emitted(LightId(0), &hit, -found.wi),
            gray(if z > 0.0 { 2.0 } else { 0.0 })
        );
        // Half of the paths start on each side, and so arrive half as densely.
        match sample(&one) {
            Some(lit) => assert!(z > 0.0 && (found.arrival / lit.arrival - 0.5).abs() < 1e-6),
            None => assert!(z < 0.0),
        }
    }
    let half = both.pdf_emission_position(LightId(0)) / one.pdf_emission_position(LightId(0));
    assert!((half - 0.5).abs() < 1e-6);
}

#[test]
fn directions_to_backgrounds_match_their_density() {
    let from = Vec3::new(0.1, 0.2, -0.4);
    let constant = || Light::Constant { radiance: gray(0.5) };
    check_directions("constant", vec![], vec![constant()], from);
    check_directions("environment", vec![], vec![environment(16, 9)], from);
    check_directions("environment of one row", vec![], vec![environment(7, 1)], from);
    check_directions(
        "environment and constant",
        vec![],
        vec![environment(8, 6), constant(), constant()],
        from,
    );
    let Light::Environment { image, scale, .. } = environment(8, 6) else {
        unreachable!()
    };
    let to_world = facing(Vec3::ZERO, Vec3::X, Vec3::new(1.0, -2.0, 1.5));
    let stretched = Light::Environment {
        image,
        mapping: Mapping::LatitudeLongitude,
        scale,
        to_world,
    };
    check_directions("stretched environment", vec![], vec![stretched], from);
    check_directions("equal-area environment", vec![], vec![equal_area(11)], from);
    check_directions(
        "environments of both kinds, a wide sun and a constant",
        vec![],
        vec![equal_area(6), environment(8, 6), sun(0.6), constant()],
        from,
    );
}

/// What a connection says of a point on an area light, a ray that hits that point says too.
#[test]
fn connections_and_hits_agree() {
    let from = Vec3::new(0.1, 0.2, -0.4);
    let at = Vec3::new(0.3, -0.2, 3.0);
    let shapes = vec![
        patch(at, -Vec3::Z),
        sphere(at + Vec3::X * 3.0, 0.7, false),
        disk(-at, at + from, Vec3::ONE),
    ];
    let geometry = Geometry::build(shapes);
    let lights = Lights::build((0..3).map(|i| area_light(i, 1.0 + i as f32)).collect(), &geometry);
    let mut random = random(2);
    let (mut seen, mut at_edges) = ([0; 3], 0);
    for _ in 0..20_000 {
        let Some(sample) = draw(&lights, &geometry, from, &mut random) else {
            continue;
        };
        let ray = Ray {
            origin: from,
            direction: sample.wi,
            max_distance: f32::INFINITY,
        };
        let Some(hit) = geometry.intersect(&ray) else { continue };
        let light = LightId(hit.shape.0);
        let pdf = lights.pdf_area(&geometry, light, from, &hit);
        if (hit.distance - sample.distance).abs() > 1e-3 * sample.distance {
            at_edges += 1;
            continue;
        }
        seen[hit.shape.0 as usize] += 1;
        assert!((pdf - sample.pdf).abs() <= 2e-3 * sample.pdf, "{pdf} and {sample:?}");
        assert_eq!(lights.emitted(light, &hit, -sample.wi), sample.radiance);
    }
    assert!(
        seen.iter().all(|count| *count > 1_000) && at_edges < 20,
        "{seen:?}, {at_edges}"
    );
}

/// Irradiance on a receiver at the origin that faces +z.
fn irradiance(shape: Shape, radiance: f32) -> (f64, f64) {
    let geometry = Geometry::build(vec![shape]);
    let lights = Lights::build(vec![area_light(0, radiance)], &geometry);
    let mut random = random(3);
    mean(200_000, || {
        draw(&lights, &geometry, Vec3::ZERO, &mut random)
            .map_or(0.0, |s| f64::from(s.radiance.mean() * s.wi.z.max(0.0) / s.pdf))
    })
}

#[test]
fn irradiance_has_its_closed_form() {
    let (height, radius) = (1.5_f32, 0.8_f32);
    let above = Vec3::Z * height;
    // E = pi L r^2 / (r^2 + h^2) under a disc, pi L (r / d)^2 under a sphere.
    let under_disc = std::f64::consts::PI * 2.0 * 0.64 / (0.64 + 2.25);
    let disc = disk(above, -Vec3::Z, Vec3::new(radius, radius, 1.0));
    assert_mean("disc", irradiance(disc, 2.0), under_disc);
    let under_sphere = std::f64::consts::PI * 2.0 * 0.64 / 2.25;
    assert_mean("sphere", irradiance(sphere(above, radius, false), 2.0), under_sphere);
    // A sphere around the receiver fills its hemisphere: E = pi L.
    assert_mean(
        "enclosure",
        irradiance(sphere(Vec3::Y, 3.0, true), 2.0),
        std::f64::consts::TAU,
    );
    // Lambert's formula for a polygon: E = L / 2 sum_i angle_i cos(normal of edge plane i, z).
    let Shape::Mesh(mesh) = patch(Vec3::new(0.2, 0.3, height), -Vec3::Z) else {
        unreachable!()
    };
    let corners: Vec<DVec3> = mesh.positions[1..].iter().map(|p| p.as_dvec3().normalize()).collect();
    let polygon: f64 = (0..4)
        .map(|i| {
            let (a, b) = (corners[i], corners[(i + 1) % 4]);
            libm::acos(a.dot(b)) * a.cross(b).normalize().z
        })
        .sum();
    assert_mean("mesh", irradiance(Shape::Mesh(mesh), 2.0), polygon.abs());
}

#[test]
fn area_lights_emit_on_their_outer_side_only() {
    let geometry = Geometry::build(vec![disk(Vec3::ZERO, Vec3::Z, Vec3::ONE)]);
    let lights = Lights::build(vec![area_light(0, 2.0)], &geometry);
    let mut random = random(4);
    for _ in 0..100 {
        assert!(draw(&lights, &geometry, Vec3::new(0.3, 0.2, -1.0), &mut random).is_none());
        assert!(draw(&lights, &geometry, Vec3::new(0.3, 0.2, 1.0), &mut random).is_some());
    }
    let down = Ray {
        origin: Vec3::new(0.1, 0.1, 1.0),
        direction: -Vec3::Z,
        max_distance: f32::INFINITY,
    };
    let hit = geometry.intersect(&down).unwrap();
    assert_eq!(lights.emitted(LightId(0), &hit, Vec3::Z), gray(2.0));
    assert_eq!(lights.emitted(LightId(0), &hit, -Vec3::Z), Spectrum::ZERO);
    assert_eq!(lights.pdf_area(&geometry, LightId(0), -Vec3::Z, &hit), 0.0);
}

/// Expected values: Mitsuba 3.9.1, `scalar_rgb`, `Emitter.sample_direction` of the same light.
#[test]
fn a_spot_is_that_of_mitsuba() {
    let matrix = DMat4::from_cols(
        DVec4::new(0.812_031_7, 0.035_305_73, -0.582_544_5, 0.0),
        DVec4::new(0.275_497_17, 0.856_765_87, 0.435_951_53, 0.0),
        DVec4::new(0.514_495_8, -0.514_495_8, 0.685_994_4, 0.0),
        DVec4::new(1.0, 2.0, 3.0, 1.0),
    );
    let spot = Light::Spot {
        to_world: Transform::from_matrix(matrix).unwrap(),
        intensity: gray(3.0),
        cutoff_angle: 40.0_f32.to_radians(),
        beam_width: 25.0_f32.to_radians(),
        falloff: Falloff::Linear,
        texture: None,
    };
    let geometry = Geometry::build(Vec::new());
    let lights = Lights::build(vec![spot], &geometry);
    for (at, expected) in [
        (Vec3::new(4.0, -1.0, 7.0), 0.088_235_304),
        (Vec3::new(4.0, 0.0, 7.0), 0.103_448_27),
        (Vec3::new(3.0, 2.0, 7.0), 0.075_288_154),
        (Vec3::new(5.0, 1.0, 4.0), 0.001_969_599_6),
    ] {
        let sample = lights.sample_direct(&geometry, at, 0.5, DVec2::splat(0.5)).unwrap();
        assert!(
            (sample.radiance[0] - expected).abs() < 2e-5 * expected.max(0.1),
            "{sample:?}, {expected}"
        );
        assert!(sample.delta && sample.pdf == 1.0);
        assert!((at + sample.wi * sample.distance - Vec3::new(1.0, 2.0, 3.0)).length() < 1e-5);
    }
    assert!(
        lights
            .sample_direct(&geometry, Vec3::ZERO, 0.5, DVec2::splat(0.5))
            .is_none(),
        "behind the spot"
    );
}

/// Expected values: Mitsuba 3.9.1, `scalar_rgb`, `Emitter.sample_direction` of the same light. Columns of the slide are 1 to 4 in the first
/// channel, its rows 10 and 11 in the second.
#[test]
fn a_spot_with_a_slide_is_that_of_mitsuba() {
    let matrix = DMat4::from_cols(
        DVec4::new(0.812_031_7, 0.035_305_73, -0.582_544_5, 0.0),
        DVec4::new(0.275_497_17, 0.856_765_87, 0.435_951_53, 0.0),
        DVec4::new(0.514_495_8, -0.514_495_8, 0.685_994_4, 0.0),
        DVec4::new(1.0, 2.0, 3.0, 1.0),
    );
    let Light::Projector { image, .. } = projector() else {
        unreachable!()
    };
    let spot = Light::Spot {
        to_world: Transform::from_matrix(matrix).unwrap(),
        intensity: gray(3.0),
        cutoff_angle: 40.0_f32.to_radians(),
        beam_width: 25.0_f32.to_radians(),
        falloff: Falloff::Linear,
        texture: Some(image),
    };
    let geometry = Geometry::build(Vec::new());
    let lights = Lights::build(vec![spot], &geometry);
    for (at, expected) in [
        (Vec3::new(4.0, 0.0, 7.0), [0.310_344_8, 1.137_931, 0.051_724_14]),
        (Vec3::new(3.0, 2.0, 7.0), [0.150_576_1, 0.828_168_6, 0.037_644_03]),
        (Vec3::new(5.0, 1.0, 4.0), [0.007_878_549, 0.021_666_01, 0.000_984_818_7]),
        (Vec3::new(4.0, -2.5, 6.5), [0.216_867_5, 0.722_891_6, 0.036_144_58]),
    ] {
        let sample = lights.sample_direct(&geometry, at, 0.5, DVec2::splat(0.5)).unwrap();
        for (found, expected) in sample.radiance.to_rgb().into_iter().zip(expected) {
            assert!(
                (found - expected).abs() < 2e-5 * expected.max(0.1),
                "{sample:?}, {expected}"
            );
        }
    }
}

/// The share of the cosine's way from the edge of the cone to its beam, by hand: pbrt-v4's cubic and pbrt-v3's fourth power of it.
#[test]
fn spots_of_pbrt_fall_off_by_the_cosine() {
    let geometry = Geometry::build(Vec::new());
    let [edge, beam] = [40.0_f64, 25.0].map(|angle| libm::cos(angle.to_radians()));
    for (share, smooth, fourth) in [
        (0.0, 0.0, 0.0),
        (0.25, 0.156_25, 0.003_906_25),
        (0.5, 0.5, 0.062_5),
        (1.5, 1.0, 1.0),
        (-0.1, 0.0, 0.0),
    ] {
        for (falloff, expected) in [(Falloff::SmoothStep, smooth), (Falloff::FourthPower, fourth)] {
            let spot = Light::Spot {
                to_world: Transform::default(),
                intensity: gray(2.0),
                cutoff_angle: 40.0_f32.to_radians(),
                beam_width: 25.0_f32.to_radians(),
                falloff,
                texture: None,
            };
            let lights = Lights::build(vec![spot], &geometry);
            let cos = edge + share * (beam - edge);
            let at = Vec3::new((1.0 - cos * cos).sqrt() as f32, 0.0, cos as f32);
            let sample = lights.sample_direct(&geometry, at, 0.5, DVec2::splat(0.5));
            let found = sample.map_or(0.0, |sample| sample.radiance[0]);
            assert!(
                (found - 2.0 * expected).abs() < 1e-5,
                "{falloff:?} {share}: {found}, expected {expected}"
            );
        }
    }
}

/// A projector that is even by directions has in each the intensity of its image.
#[test]
fn a_projector_of_pbrt_is_even_by_directions() {
    let Light::Projector {
        to_world,
        fov_x,
        aspect,
        image,
        scale,
        ..
    } = projector()
    else {
        unreachable!()
    };
    let geometry = Geometry::build(Vec::new());
    let lights = [Even::Plane, Even::Directions].map(|even| {
        let (image, scale) = (image.clone(), scale);
        let light = Light::Projector {
            to_world,
            fov_x,
            aspect,
            image,
            scale,
            even,
        };
        Lights::build(vec![light], &geometry)
    });
    for at in [Vec3::new(0.3, 0.1, -0.2), Vec3::new(-0.5, -0.3, 0.1)] {
        let offset = (at - Vec3::new(1.0, 2.0, 3.0)).normalize();
        let cos = offset.dot(Vec3::new(-1.0, -2.0, -3.0).normalize());
        let [plane, directions] = [&lights[0], &lights[1]].map(|lights| {
            lights
                .sample_direct(&geometry, at, 0.5, DVec2::splat(0.5))
                .unwrap()
                .radiance[0]
        });
        let expected = plane * cos * cos * cos / PI;
        assert!(
            (directions / expected - 1.0).abs() < 1e-5,
            "{at}: {directions}, expected {expected}"
        );
    }
}

/// Expected values: Mitsuba 3.9.1, `scalar_rgb`, `Emitter.sample_direction` of the same light.
#[test]
fn a_projector_is_that_of_mitsuba() {
    let geometry = Geometry::build(Vec::new());
    let lights = Lights::build(vec![projector()], &geometry);
    let towards = |at: Vec3| lights.sample_direct(&geometry, at, 0.5, DVec2::splat(0.5));
    for (at, expected) in [
        (Vec3::new(0.3, 0.1, -0.2), [1.333_86, 4.446_2, 0.222_31]),
        (Vec3::new(-0.5, -0.3, 0.1), [0.810_956, 4.460_26, 0.202_739]),
        (Vec3::new(0.4, 0.2, 0.9), [2.414_02, 8.851_42, 0.402_337]),
    ] {
        let sample = towards(at).unwrap();
        for (found, expected) in sample.radiance.to_rgb().into_iter().zip(expected) {
            assert!(
                (found - expected).abs() < 2e-5 * expected,
                "{at}: {sample:?}, {expected}"
            );
        }
        assert!(sample.delta && sample.pdf == 1.0);
        assert!((at + sample.wi * sample.distance - Vec3::new(1.0, 2.0, 3.0)).length() < 1e-5);
    }
    assert!(towards(Vec3::splat(3.0)).is_none(), "beside the image");
    assert!(towards(Vec3::new(2.0, 4.0, 6.0)).is_none(), "behind the projector");
}

#[test]
fn points_and_directional_lights_have_their_closed_form() {
    let geometry = Geometry::build(vec![sphere(Vec3::ZERO, 1.0, false)]);
    let point = Light::Point {
        position: Vec3::new(0.0, 0.0, 4.0),
        intensity: gray(8.0),
    };
    let sun = Light::Directional {
        direction: -Vec3::Y,
        irradiance: gray(1.5),
    };
    let lights = Lights::build(vec![point, sun], &geometry);
    let power = 8.0 * 4.0 / (8.0 * 4.0 + 1.5 * 3.0);
    let share = 0.9 * power + 0.05;
    let sample = lights
        .sample_direct(&geometry, Vec3::Z * 2.0, 0.0, DVec2::ZERO)
        .unwrap();
    assert_eq!((sample.wi, sample.distance, sample.radiance), (Vec3::Z, 2.0, gray(2.0)));
    assert!((sample.pdf - share).abs() < 1e-3 && sample.delta);
    let sample = lights
        .sample_direct(&geometry, Vec3::Z * 2.0, 0.999, DVec2::ZERO)
        .unwrap();
    assert_eq!(
        (sample.wi, sample.distance, sample.radiance),
        (Vec3::Y, f32::INFINITY, gray(1.5))
    );
    assert!((sample.pdf - (1.0 - share)).abs() < 1e-3 && sample.delta);
    assert_eq!(lights.background(Vec3::Y), Spectrum::ZERO);
}

/// A small sphere far away fills a cone whose cosine is one at single precision.
#[test]
fn narrow_lights_are_sampled_with_their_density() {
    let axis = Vec3::new(0.48, -0.6, 0.64);
    for theta in [1e-2_f32, 1e-3, 1e-4] {
        let geometry = Geometry::build(vec![sphere(axis, theta, false)]);
        let lights = Lights::build(vec![area_light(0, 1.0)], &geometry);
        let pdf = draw(&lights, &geometry, Vec3::ZERO, &mut random(1)).unwrap().pdf;
        assert_narrow(
            &format!("sphere of {theta}"),
            6,
            (axis, theta),
            |random| draw(&lights, &geometry, Vec3::ZERO, random).map(|sample| sample.wi),
            |_| pdf,
        );
        // With its linear falloff from the axis on, a spot's flux is not uniform over the cone, but its directions are.
        let spot = Light::Spot {
            to_world: facing(Vec3::ONE, axis, Vec3::ONE),
            intensity: gray(2.0),
            cutoff_angle: theta,
            beam_width: 0.0,
            falloff: Falloff::Linear,
            texture: None,
        };
        let lights = Lights::build(vec![spot], &geometry);
        let emit = |random: &mut PathRandom| {
            lights.sample_emission(
                &geometry,
                random.next_choice(),
                random.next_choice_2d(),
                random.next_choice_2d(),
            )
        };
        let one_minus_cos = crate::math::warp::one_minus_cos(theta);
        assert_narrow(
            &format!("spot of {theta}"),
            6,
            (axis, theta),
            |random| emit(random).map(|sample| sample.ray.direction),
            |_| 1.0 / (2.0 * PI * one_minus_cos),
        );
        let mut numbers = random(5);
        let flux = mean(100_000, || {
            emit(&mut numbers).map_or(0.0, |sample| f64::from(sample.flux[0]))
        });
        // For a small angle the integral of 2 (1 - t / theta) 2 pi t is 2 pi theta^2 / 3.
        let power = 2.0 * std::f64::consts::PI * f64::from(theta).powi(2) / 3.0;
        assert_mean("narrow spot", flux, power);
    }
}

/// However weak a light is beside the others, it is chosen with its part of the defensive share, by connections and by light paths,
/// first and last in the list alike, and its flux is divided by just that probability.
#[test]
fn a_lamp_beside_a_sun_is_chosen_often_enough() {
    let geometry = Geometry::build(vec![sphere(Vec3::ZERO, 1.0, false)]);
    let lamp = Light::Point {
        position: Vec3::new(0.0, 0.0, 4.0),
        intensity: gray(1e-3),
    };
    let sun = Light::Directional {
        direction: -Vec3::Y,
        irradiance: gray(1e9),
    };
    let dark = Light::Constant { radiance: gray(0.0) };
    for order in [vec![lamp.clone(), dark.clone(), sun.clone()], vec![sun, dark, lamp]] {
        let lights = Lights::build(order, &geometry);
        let mut random = random(21);
        const DRAWS: usize = 100_000;
        let (mut connections, mut flux) = (0, 0.0);
        for _ in 0..DRAWS {
            let sample = draw(&lights, &geometry, Vec3::Z * 2.0, &mut random).unwrap();
            if sample.distance.is_finite() {
                connections += 1;
                assert!((sample.pdf - 0.05).abs() < 1e-6, "{sample:?}");
            }
            let emission = lights
                .sample_emission(
                    &geometry,
                    random.next_choice(),
                    random.next_choice_2d(),
                    random.next_choice_2d(),
                )
                .unwrap();
            if emission.ray.origin == Vec3::new(0.0, 0.0, 4.0) {
                flux += f64::from(emission.flux.luminance());
            }
        }
        let deviation = (0.05 * 0.95 / DRAWS as f64).sqrt() / 0.05;
        let power = 4.0 * std::f64::consts::PI * 1e-3;
        for met in [
            f64::from(connections) / (0.05 * DRAWS as f64),
            flux / DRAWS as f64 / power,
        ] {
            assert!((met - 1.0).abs() < DEVIATIONS * deviation, "{met}");
        }
    }
}

/// Expected values: Mitsuba 3.9.1, `scalar_rgb`, `Emitter.eval` of the same map.
#[test]
fn an_environment_is_looked_up_as_in_mitsuba() {
    let matrix = DMat4::from_cols(
        DVec4::new(0.766_044_44, 0.0, -0.642_787_6, 0.0),
        DVec4::new(0.271_653_77, 0.906_307_76, 0.323_744_4, 0.0),
        DVec4::new(0.582_563_34, -0.422_618_27, 0.694_272_04, 0.0),
        DVec4::W,
    );
    let texels = (0..12)
        .map(|i| gray((i % 4 + 10 * (i / 4) + 1) as f32))
        .collect::<Vec<_>>();
    let image = Bitmap {
        width: 4,
        height: 3,
        texels: texels.into(),
        wrap: WrapMode::Repeat,
        filter: TextureFilter::Bilinear,
    };
    let to_world = Transform::from_matrix(matrix).unwrap();
    let light = Light::Environment {
        image: Arc::new(image),
        mapping: Mapping::LatitudeLongitude,
        scale: 2.0,
        to_world,
    };
    let lights = Lights::build(vec![light], &Geometry::build(Vec::new()));
    for (direction, expected) in [
        (Vec3::new(0.48, 0.6, 0.64), 11.382_643),
        (Vec3::new(-0.36, -0.48, 0.8), 29.758_82),
        (Vec3::new(0.0, 0.96, -0.28), 12.507_84),
        (Vec3::new(-0.6, -0.64, -0.48), 40.553_223),
    ] {
        let value = lights.background(direction)[1];
        assert!(
            (value - expected).abs() < 1e-5 * expected,
            "{direction}: {value}, {expected}"
        );
    }
}

#[test]
fn sampled_environments_have_the_integral_of_their_image() {
    let geometry = Geometry::build(Vec::new());
    let lights = Lights::build(
        vec![
            environment(16, 9),
            equal_area(9),
            sun(0.4),
            Light::Constant { radiance: gray(0.5) },
        ],
        &geometry,
    );
    let mut random = random(5);
    let sampled = mean(100_000, || {
        let sample = draw(&lights, &geometry, Vec3::ONE, &mut random).expect("no direction is black");
        f64::from(sample.radiance[0] / sample.pdf)
    });
    assert_mean("integral", sampled, integral_of_radiance(&lights, 0));
    assert!(sampled.1 < 0.01 * sampled.0, "samples follow the image: {sampled:?}");

    let black = Bitmap {
        texels: vec![Spectrum::ZERO; 12].into(),
        width: 4,
        height: 3,
        ..(*image(4, 3)).clone()
    };
    let light = Light::Environment {
        image: Arc::new(black),
        mapping: Mapping::LatitudeLongitude,
        scale: 1.0,
        to_world: Transform::default(),
    };
    let lights = Lights::build(vec![light], &geometry);
    assert!(draw(&lights, &geometry, Vec3::ONE, &mut random).is_none());
    assert_eq!(lights.pdf_background(Vec3::X), 0.0);
}

/// A sun has the irradiance that it is given, is seen as a disc, and is found by connections.
#[test]
fn a_sun_has_its_irradiance_and_its_size() {
    let geometry = Geometry::build(Vec::new());
    let half_angle = 0.004_675;
    let lights = Lights::build(vec![sun(half_angle)], &geometry);
    let Light::Sun {
        towards, irradiance, ..
    } = sun(half_angle)
    else {
        unreachable!()
    };
    let aside = Frame::from_normal(towards).s;
    let seen = |angle: f32| lights.background((towards + angle * aside).normalize());
    assert_eq!(seen(0.0), seen(0.99 * half_angle));
    assert_eq!(seen(1.01 * half_angle), Spectrum::ZERO);
    assert_eq!(lights.background(-towards), Spectrum::ZERO);
    let mut random = random(6);
    let found = mean(2_000, || {
        let sample = draw(&lights, &geometry, Vec3::ONE, &mut random).expect("the sun shines");
        assert!(sample.wi.dot(towards) > 0.9999 && !sample.delta);
        f64::from(sample.radiance[1] / sample.pdf)
    });
    assert_mean("irradiance", found, irradiance[1].into());
}

/// What the lamp sends to a point is its image in that direction, whatever the mapping, over the squared distance.
#[test]
fn a_goniometric_light_is_its_image() {
    let geometry = Geometry::build(Vec::new());
    for (lamp, image) in [
        (goniometric(environment(16, 9)), environment(16, 9)),
        (goniometric(equal_area(9)), equal_area(9)),
    ] {
        let around = Lights::build(vec![image], &geometry);
        let lights = Lights::build(vec![lamp], &geometry);
        let mut random = random(7);
        for _ in 0..100 {
            let offset = 2.0 * square_to_sphere(random.next_2d());
            let sample = lights
                .sample_direct(&geometry, LAMP + offset, 0.5, DVec2::splat(0.5))
                .unwrap();
            let expected = around.background(offset / 2.0)[0] / 4.0;
            assert!(
                (sample.radiance[0] - expected).abs() < 1e-3 * expected,
                "{sample:?}, {expected}"
            );
            assert!(sample.delta && sample.pdf == 1.0);
        }
    }
}

/// Integral over the sphere of the radiance from outside.
pub(super) fn integral_of_radiance(lights: &Lights, channel: usize) -> f64 {
    integrate_sphere(|direction| f64::from(lights.background(direction)[channel]))
}

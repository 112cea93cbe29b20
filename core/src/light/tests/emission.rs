use super::direct::integral_of_radiance;
use super::*;
use crate::chi_square::{Domain, assert_directions, chi_square};
use crate::math::{FRAC_1_PI, cos};

fn draw(lights: &Lights, geometry: &Geometry, random: &mut PathRandom) -> Option<EmissionSample> {
    lights.sample_emission(
        geometry,
        random.next_choice(),
        random.next_choice_2d(),
        random.next_choice_2d(),
    )
}

fn check_directions(label: &str, shapes: Vec<Shape>, light: Light, density: impl Fn(&Lights, Vec3) -> f32) {
    let geometry = Geometry::build(shapes);
    let lights = Lights::build(vec![light], &geometry);
    assert_directions(
        label,
        FAMILY,
        |random| draw(&lights, &geometry, random).map(|sample| sample.ray.direction),
        |direction| density(&lights, direction),
    );
}

#[test]
fn directions_of_emission_match_their_density() {
    let normal = Vec3::new(0.48, -0.6, 0.64);
    let cosine = |_: &Lights, d: Vec3| d.dot(normal).max(0.0) * FRAC_1_PI;
    check_directions(
        "disk",
        vec![disk(Vec3::ONE, normal, Vec3::splat(2.0))],
        area_light(0, 1.0),
        cosine,
    );
    check_directions("mesh", vec![patch(Vec3::ONE, normal)], area_light(0, 1.0), cosine);
    let either_side = |_: &Lights, d: Vec3| 0.5 * d.dot(normal).abs() * FRAC_1_PI;
    check_directions(
        "two-sided mesh",
        vec![patch(Vec3::ONE, normal)],
        two_sided_light(0, 1.0),
        either_side,
    );
    let spot = Light::Spot {
        to_world: facing(Vec3::ONE, normal, Vec3::ONE),
        intensity: gray(2.0),
        cutoff_angle: 0.9,
        beam_width: 0.5,
        falloff: Falloff::Linear,
        texture: None,
    };
    let (inside, cap) = (cos(0.9), 2.0 * PI * (1.0 - cos(0.9)));
    check_directions("spot", vec![], spot, |_, d| {
        if d.dot(normal) >= inside { 1.0 / cap } else { 0.0 }
    });
    // A connection's density by area at the distance 1 is that by solid angle.
    let projector_pdf = |lights: &Lights, d: Vec3| {
        let at = Vec3::new(1.0, 2.0, 3.0) + d;
        let connection = lights.sample_direct(&Geometry::build(vec![]), at, 0.5, DVec2::splat(0.5));
        connection.map_or(0.0, |connection| connection.arrival)
    };
    check_directions("projector", vec![], projector(), projector_pdf);
    let environment_pdf = |lights: &Lights, d: Vec3| lights.pdf_background(-d);
    check_directions("environment", vec![], environment(16, 9), environment_pdf);
    check_directions("equal-area environment", vec![], equal_area(9), environment_pdf);
    let lamp_pdf = |lights: &Lights, d: Vec3| {
        let connection = lights.sample_direct(&Geometry::build(vec![]), LAMP + d, 0.5, DVec2::splat(0.5));
        connection.map_or(0.0, |connection| connection.arrival)
    };
    check_directions("goniometric", vec![], goniometric(environment(16, 9)), lamp_pdf);
}

/// Origins, as positions on the emitting shape or on the disc before the scene.
#[test]
fn origins_of_emission_are_uniform_by_area() {
    let pi = std::f64::consts::PI;
    let check = |label: &str, shapes, light, domain: Domain, locate: &dyn Fn(&Ray) -> [f64; 2]| {
        let geometry = Geometry::build(shapes);
        let lights = Lights::build(vec![light], &geometry);
        let size = (domain.upper[0] - domain.lower[0]) * (domain.upper[1] - domain.lower[1]);
        let sampler = |random: &mut PathRandom| draw(&lights, &geometry, random).map(|s| locate(&s.ray));
        let outcome = chi_square(&domain, 1 << 18, 7, sampler, |_| 1.0 / size);
        assert!(outcome.passes(FAMILY), "{label}: {outcome:?}");
    };
    let polar = |p: Vec3| {
        let p = p.as_dvec3();
        [p.x * p.x + p.y * p.y, libm::atan2(p.y, p.x)]
    };
    let unit_disc = |r_squared: f64| Domain {
        lower: [0.0, -pi],
        upper: [r_squared, pi],
        cells: [16, 16],
    };

    let place = facing(Vec3::ONE, Vec3::new(1.0, 2.0, 3.0), Vec3::new(0.5, 1.5, 1.0));
    let oval = Shape::Disk {
        to_world: place,
        flip_normals: true,
    };
    let on_disk = |ray: &Ray| polar(place.inverted().point(ray.origin));
    check("disk", vec![oval], area_light(0, 1.0), unit_disc(1.0 + 1e-6), &on_disk);

    let on_sphere = |ray: &Ray| {
        let p = (ray.origin - Vec3::ONE).as_dvec3() / 2.0;
        [p.z, libm::atan2(p.y, p.x)]
    };
    let cylinder = Domain {
        lower: [-1.0 - 1e-6, -pi],
        upper: [1.0 + 1e-6, pi],
        cells: [16, 16],
    };
    let ball = sphere(Vec3::ONE, 2.0, false);
    check("sphere", vec![ball], area_light(0, 1.0), cylinder, &on_sphere);

    let direction = Vec3::new(0.6, 0.0, -0.8);
    let (across, center) = (Frame::from_normal(direction), Vec3::new(1.0, 0.0, 0.0));
    let before = |ray: &Ray| {
        assert!((ray.direction - direction).length() < 1e-6);
        let local = across.to_local(ray.origin - center);
        assert!(local.z < -1.999 * 3.0_f32.sqrt());
        polar(local)
    };
    let radius = 2.0 * 3.0_f64.sqrt() * (1.0 + 1e-4);
    let parallel = Light::Directional {
        direction,
        irradiance: gray(1.0),
    };
    check(
        "directional",
        vec![sphere(center, 2.0, false)],
        parallel,
        unit_disc(radius * radius * (1.0 + 1e-6)),
        &before,
    );
}

/// Triangles of a mesh are chosen by area.
#[test]
fn emission_covers_the_triangles_of_a_mesh_by_area() {
    let geometry = Geometry::build(vec![patch(Vec3::ZERO, Vec3::Z)]);
    let lights = Lights::build(vec![area_light(0, 1.0)], &geometry);
    let shares = [0.55, 0.85, 0.47, 0.33].map(|area: f64| area / PATCH_AREA);
    let mut random = random(8);
    let mut counts = [0.0; 4];
    let samples = 100_000;
    for _ in 0..samples {
        let sample = draw(&lights, &geometry, &mut random).unwrap();
        let back = Ray {
            origin: sample.ray.origin + Vec3::Z,
            direction: -Vec3::Z,
            max_distance: f32::INFINITY,
        };
        counts[geometry.intersect(&back).unwrap().primitive as usize] += 1.0;
    }
    for (count, share) in counts.into_iter().zip(shares) {
        let deviation = (share * (1.0 - share) * f64::from(samples)).sqrt();
        let difference: f64 = count - share * f64::from(samples);
        assert!(difference.abs() < DEVIATIONS * deviation, "{counts:?}");
    }
}

fn check_power(label: &str, shapes: Vec<Shape>, lights: Vec<Light>, expected: f64) {
    let geometry = Geometry::build(shapes);
    let lights = Lights::build(lights, &geometry);
    let mut random = random(9);
    let flux = mean(200_000, || {
        draw(&lights, &geometry, &mut random).map_or(0.0, |s| f64::from(s.flux[0]))
    });
    assert_mean(label, flux, expected);
}

#[test]
fn mean_flux_is_the_power() {
    let pi = std::f64::consts::PI;
    let ball = || sphere(Vec3::ONE, 2.0, false);
    let cross_section = pi * 12.0 * 1.0001 * 1.0001;
    check_power("sphere", vec![ball()], vec![area_light(0, 3.0)], pi * 3.0 * 16.0 * pi);
    let mesh = patch(Vec3::ONE, Vec3::X);
    check_power("mesh", vec![mesh], vec![area_light(0, 3.0)], pi * 3.0 * PATCH_AREA);
    let mesh = patch(Vec3::ONE, Vec3::X);
    check_power(
        "two-sided mesh",
        vec![mesh],
        vec![two_sided_light(0, 3.0)],
        2.0 * pi * 3.0 * PATCH_AREA,
    );
    let point = Light::Point {
        position: Vec3::ZERO,
        intensity: gray(3.0),
    };
    check_power("point", vec![], vec![point.clone()], 12.0 * pi);
    let spot = Light::Spot {
        to_world: Transform::default(),
        intensity: gray(3.0),
        cutoff_angle: 0.9,
        beam_width: 0.5,
        falloff: Falloff::Linear,
        texture: None,
    };
    let spot_power = 6.0 * pi * (1.0 - (libm::sin(0.9) - libm::sin(0.5)) / 0.4);
    check_power("spot", vec![], vec![spot], spot_power);
    for (falloff, share) in [(Falloff::SmoothStep, 0.5), (Falloff::FourthPower, 0.2)] {
        let spot = Light::Spot {
            to_world: Transform::default(),
            intensity: gray(3.0),
            cutoff_angle: 0.9,
            beam_width: 0.5,
            falloff,
            texture: None,
        };
        let [beam, cutoff] = [0.5, 0.9].map(libm::cos);
        let power = 6.0 * pi * (1.0 - beam + share * (beam - cutoff));
        check_power(&format!("{falloff:?}"), vec![], vec![spot], power);
    }
    let pyramid = Light::Projector {
        to_world: Transform::default(),
        fov_x: 0.5 * PI,
        aspect: 1.0,
        image: Texture::Constant(gray(3.0)),
        scale: 2.0,
        even: Even::Directions,
    };
    check_power("even projector", vec![], vec![pyramid], 6.0 * 4.0 * pi / 6.0);
    // Columns of the image show 1 to 4 in the first channel.
    let half_width = libm::tan(20.0_f64.to_radians());
    let projector_power = 2.0 * pi * 2.5 * 4.0 * half_width * (0.5 * half_width);
    check_power("projector", vec![], vec![projector()], projector_power);
    let parallel = Light::Directional {
        direction: Vec3::Y,
        irradiance: gray(3.0),
    };
    check_power("directional", vec![ball()], vec![parallel], 3.0 * cross_section);
    let sky = Light::Constant { radiance: gray(3.0) };
    check_power("constant", vec![ball()], vec![sky], 12.0 * pi * cross_section);
    let lights = Lights::build(vec![environment(16, 9)], &Geometry::build(vec![ball()]));
    let integral = integral_of_radiance(&lights, 0);
    check_power(
        "environment",
        vec![ball()],
        vec![environment(16, 9)],
        integral * cross_section,
    );
    let lamp = Lights::build(vec![equal_area(9)], &Geometry::build(vec![]));
    let power = integral_of_radiance(&lamp, 0);
    check_power("goniometric", vec![], vec![goniometric(equal_area(9))], power);
    check_power("sun", vec![ball()], vec![sun(0.4)], 3.0 * cross_section);
    let together = vec![area_light(0, 3.0), point, environment(16, 9)];
    let sum = pi * 3.0 * 16.0 * pi + 12.0 * pi + integral * cross_section;
    check_power("together", vec![ball()], together, sum);
}

#[test]
fn emission_leaves_the_surface_on_the_outer_side() {
    let geometry = Geometry::build(vec![sphere(Vec3::ONE, 2.0, false), sphere(Vec3::ONE, 9.0, true)]);
    let lights = Lights::build(vec![area_light(0, 1.0), area_light(1, 1.0)], &geometry);
    let mut random = random(10);
    for _ in 0..10_000 {
        let ray = draw(&lights, &geometry, &mut random).unwrap().ray;
        let hit = geometry.intersect(&ray).expect("the outer sphere encloses all");
        assert!(hit.shape == ShapeId(1) || (ray.origin - Vec3::ONE).length() > 8.9);
    }
}

#[test]
fn without_light_nothing_is_sampled() {
    let geometry = Geometry::build(vec![sphere(Vec3::ONE, 2.0, false)]);
    for lights in [vec![], vec![area_light(0, 0.0)]] {
        let empty = lights.is_empty();
        let lights = Lights::build(lights, &geometry);
        assert_eq!(lights.is_empty(), empty);
        assert!(draw(&lights, &geometry, &mut random(11)).is_none());
        assert!(
            lights
                .sample_direct(&geometry, Vec3::ZERO, 0.5, DVec2::splat(0.5))
                .is_none()
        );
    }
}

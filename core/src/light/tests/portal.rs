use super::*;
use crate::chi_square::{Domain, assert_directions, chi_square, integrate_sphere};
use crate::math::warp::square_to_sphere;

/// A turned rectangle of 1.5 x 0.8 about (0.2, 0.4, 1) that lets light in against [`OUTWARDS`].
fn corners() -> [Vec3; 4] {
    let frame = Frame::from_normal(OUTWARDS);
    let middle = Vec3::new(0.2, 0.4, 1.0);
    [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]
        .map(|(x, y)| middle + frame.to_world(Vec3::new(0.75 * x, 0.4 * y, 0.0)))
}

const OUTWARDS: Vec3 = Vec3::new(0.48, -0.6, 0.64);
const AREA: f32 = 1.2;

fn through_portal(beyond: Light) -> Light {
    Light::Portal {
        portal: Portal::new(corners()).expect("it is a rectangle"),
        beyond: Box::new(beyond),
    }
}

fn even() -> Light {
    Light::Constant { radiance: gray(2.0) }
}

fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray {
        origin,
        direction,
        max_distance: f32::INFINITY,
    }
}

fn emission(lights: &Lights, random: &mut PathRandom) -> Option<EmissionSample> {
    let (choice, u, v) = (random.next_choice(), random.next_choice_2d(), random.next_choice_2d());
    lights.sample_emission(&Geometry::build(vec![]), choice, u, v)
}

fn connection(lights: &Lights, from: Vec3, random: &mut PathRandom) -> Option<LightSample> {
    lights.sample_direct(
        &Geometry::build(vec![]),
        from,
        random.next_choice(),
        random.next_choice_2d(),
    )
}

#[test]
fn portals_are_rectangles() {
    let [a, b, c, d] = corners();
    assert!((Portal::new([a, b, c, d]).unwrap().area() - AREA).abs() < 1e-6);
    // Its corners may begin anywhere and go either way round, which turns it over.
    assert!(Portal::new([b, c, d, a]).is_some() && Portal::new([d, c, b, a]).is_some());
    let off = 0.1 * OUTWARDS;
    for wrong in [
        [a, c, b, d],
        [a, b, c + off, d],
        [a, b, c + 0.1 * (b - a), d + 0.1 * (b - a)],
        [a, b, c, c],
        [a; 4],
        [a, b, c, Vec3::NAN],
        [a, b, c, Vec3::INFINITY],
    ] {
        assert!(Portal::new(wrong).is_none(), "{wrong:?}");
    }
}

#[test]
fn directions_through_portals_match_their_density() {
    let middle = Vec3::new(0.2, 0.4, 1.0);
    let lights = vec![through_portal(equal_area(6)), through_portal(even()), even()];
    let lights = Lights::build(lights, &Geometry::build(vec![]));
    let from = middle - 0.3 * OUTWARDS + 0.5 * Frame::from_normal(OUTWARDS).s;
    assert_directions(
        "two portals and an open sky",
        FAMILY,
        |random| connection(&lights, from, random).map(|sample| sample.wi),
        |direction| {
            let found = lights.beyond(&ray(from, direction));
            found.map(|beyond| beyond.pdf_direct(from, direction)).sum()
        },
    );
}

#[test]
fn light_paths_through_portals_match_their_density() {
    let lights = Lights::build(vec![through_portal(even())], &Geometry::build(vec![]));
    assert_directions(
        "even sky behind a portal",
        FAMILY,
        |random| emission(&lights, random).map(|start| start.ray.direction),
        |direction| {
            // Back along the way in, through the middle.
            let from = Vec3::new(0.2, 0.4, 1.0) + direction;
            let found = lights.beyond(&ray(from, -direction)).nth(1);
            let across = AREA * -direction.dot(OUTWARDS);
            found.map_or(0.0, |beyond| beyond.densities(from, -direction).1 * across)
        },
    );
    let [a, b, _, d] = corners();
    let place = |start: EmissionSample| {
        let offset = start.ray.origin - a;
        [b - a, d - a].map(|edge| f64::from(offset.dot(edge) / edge.length_squared()))
    };
    let square = Domain {
        lower: [-1e-6; 2],
        upper: [1.0 + 1e-6; 2],
        cells: [16, 16],
    };
    let outcome = chi_square(
        &square,
        1 << 16,
        7,
        |random| emission(&lights, random).map(place),
        |_| 1.0,
    );
    assert!(outcome.passes(FAMILY), "places on a portal: {outcome:?}");
}

/// What connections, hits and light paths say of the same line agrees, and light goes one way.
#[test]
fn densities_at_portals_agree() {
    let geometry = Geometry::build(vec![]);
    let close = |a: f32, b: f32, label: &str| assert!((a / b - 1.0).abs() < 2e-4, "{label}: {a}, {b}");
    for light in [even(), environment(16, 9)] {
        let lights = vec![through_portal(light), sun(0.3)];
        let lights = Lights::build(lights, &geometry);
        let mut random = random(3);
        let (mut starts, mut connections) = (0, 0);
        for _ in 0..2_000 {
            let Some(start) = emission(&lights, &mut random).filter(|start| matches!(start.origin, Origin::Portal(_)))
            else {
                continue;
            };
            starts += 1;
            let towards = -start.ray.direction;
            let from = start.ray.origin - 0.7 * towards;
            let before = lights.way_before(&start).expect("the way before the portal is told");
            assert_eq!(before.direction, towards);
            let gap = (before.origin - start.ray.origin).dot(OUTWARDS);
            assert!(gap < 0.0 && gap > -1e-5, "the ways overlap a little: {gap}");
            let beyond = lights.beyond(&ray(from, towards)).nth(1);
            let beyond = beyond.expect("the way back passes the portal");
            let (connected, emitted) = beyond.densities(from, towards);
            close(start.pdf_position * start.pdf_direction, emitted, "emission");
            let over = lights.connection_over_emission(&geometry, &start, from);
            close(over * start.pdf_direction, connected, "connection over emission");
            let carried = beyond.radiance(towards)[1] / emitted;
            close(start.flux[1], carried, "flux");
            let outside = start.ray.origin + 0.1 * towards;
            assert_eq!(lights.beyond(&ray(outside, towards)).count(), 1, "light goes one way");
            assert_eq!(lights.beyond(&ray(from, -towards)).count(), 1, "it is ahead");
            if let Some(sample) = connection(&lights, from, &mut random)
                && let Some(beyond) = lights.beyond(&ray(from, sample.wi)).nth(1)
                && sample.radiance == beyond.radiance(sample.wi)
            {
                connections += 1;
                let (connected, emitted) = beyond.densities(from, sample.wi);
                close(sample.pdf, connected, "connection");
                close(sample.arrival, emitted / connected, "arrival");
            }
            assert!(
                connection(&lights, outside, &mut random).is_none_or(|sample| sample.radiance[1] != 2.0),
                "nothing comes back out"
            );
        }
        assert!(starts > 400 && connections > 100, "{starts}, {connections}");
    }
}

/// An even sky through a portal lights points as a lamp in its place does, near and far, and of any shape.
#[test]
fn a_portal_before_an_even_sky_is_a_lamp_of_its_size() {
    let [a, b, c, d] = corners();
    let middle = 0.5 * (a + c);
    let lamp = Shape::Mesh(Arc::new(TriangleMesh {
        positions: vec![a, b, c, d],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..TriangleMesh::default()
    }));
    let lamp_geometry = Geometry::build(vec![lamp]);
    let lamps = Lights::build(vec![two_sided_light(0, 2.0)], &lamp_geometry);
    let portals = Lights::build(vec![through_portal(even())], &Geometry::build(vec![]));
    let mut random = random(5);
    for distance in [0.05, 0.3, 2.0, 4_000.0] {
        for _ in 0..4 {
            let aside = square_to_sphere(random.next_2d());
            let from = middle - distance * (OUTWARDS + 0.6 * aside).normalize();
            // Of a surface that faces a fixed direction, counting both of its sides.
            let mut irradiance = |sample: &dyn Fn(&mut PathRandom) -> Option<LightSample>| {
                mean(10_000, || {
                    sample(&mut random).map_or(0.0, |sample| {
                        f64::from(sample.radiance[0] * sample.wi.z.abs() / sample.pdf)
                    })
                })
            };
            let (expected, noise) = irradiance(&|random| {
                lamps.sample_direct(&lamp_geometry, from, random.next_choice(), random.next_choice_2d())
            });
            let (found, error) = irradiance(&|random| connection(&portals, from, random));
            let allowed = 5.0 * noise.hypot(error) + 1e-3 * expected;
            assert!((found - expected).abs() < allowed, "{from}: {found}, {expected}");
            assert!(error < 0.05 * expected, "samples follow the solid angle");
        }
    }
}

#[test]
fn mean_flux_through_a_portal_is_its_power() {
    for (label, light) in [("even", even()), ("image", environment(16, 9))] {
        let lights = Lights::build(vec![light.clone()], &Geometry::build(vec![]));
        let through = Lights::build(vec![through_portal(light)], &Geometry::build(vec![]));
        let mut random = random(9);
        let flux = mean(100_000, || {
            emission(&through, &mut random).map_or(0.0, |start| f64::from(start.flux[0]))
        });
        let arriving =
            integrate_sphere(|direction| f64::from(lights.background(direction)[0] * direction.dot(OUTWARDS).max(0.0)));
        assert_mean(label, flux, arriving * f64::from(AREA));
    }
}

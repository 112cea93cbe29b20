//! The true mean radiance of an image, by the method of images and quadrature: no integrator takes part.

use super::layout::{
    ALBEDO, Aim, Chain, Emitter, Eye, FIRST_PATCH, LENS_RADIUS, LIGHT_RADIUS, Layout, cap_radiance, mirror_height,
};
use anyhow::Result;
use photonfarm_core::geometry::{Ray, SurfacePoint};
use photonfarm_core::math::{Frame, Vec2, Vec3};
use photonfarm_core::scene::Scene;
use std::f64::consts::{PI, TAU};

/// Mean radiance of the image; `None` where it has no finite value: parallel light along parallel rays.
pub(super) fn mean_radiance(layout: &Layout) -> Result<Option<f64>> {
    let unfolded = layout.unfolded()?;
    Ok(match layout.chain {
        Chain::S | Chain::Ss if layout.emitter.is_delta() => image_of_delta_light(layout),
        Chain::S | Chain::Ss => {
            let scene = layout.scene()?;
            // The light's edge is resolved to a percent of its radius or better.
            let grid = if layout.eye == Eye::ThinLens { 384 } else { 768 };
            Some(over_image(layout.eye, &scene, grid, |ray| {
                seen_light(layout, &scene, *ray)
            }))
        }
        Chain::D | Chain::Sds => {
            let light = layout.light();
            Some(over_image(layout.eye, &unfolded, 32, |ray| {
                ALBEDO / PI * irradiance(layout.emitter, &light, on_floor(ray), None)
            }))
        }
        Chain::Dsd => Some(second_patch(layout, &unfolded, &layout.scene()?)),
    })
}

/// Mean over the image and the lens, on a grid of `grid` by `grid` places of the image; a lens is seen through at sixteen points
/// from each of them.
fn over_image(eye: Eye, scene: &Scene, grid: u32, value: impl Fn(&Ray) -> f64) -> f64 {
    let side = if eye == Eye::ThinLens { 4 } else { 1 };
    let middle = |index: u32, side: u32| {
        let [x, y] = [index % side, index / side].map(|n| n as f32 + 0.5);
        Vec2::new(x, y) / side as f32
    };
    let [width, height] = scene.sensor.resolution.map(|n| n as f32);
    let mut sum = 0.0;
    for place in 0..grid * grid {
        let at = middle(place, grid) * Vec2::new(width, height);
        for lens in 0..side * side {
            sum += value(&scene.sensor.ray(at, middle(lens, side)));
        }
    }
    sum / f64::from(grid * grid * side * side)
}

fn on_floor(ray: &Ray) -> Vec3 {
    ray.origin - ray.direction * (ray.origin.y / ray.direction.y)
}

/// A small part of the light as it arrives at a point.
struct Arrival {
    /// Towards the light.
    direction: Vec3,
    distance: f32,
    /// Irradiance on a surface that faces it.
    irradiance: f64,
}

/// Points of a disc of radius 1 that stand for equal areas.
fn disc_points() -> impl Iterator<Item = (f64, f64)> {
    const RINGS: u32 = 24;
    const SPOKES: u32 = 12;
    (0..RINGS * SPOKES).map(|i| {
        let radius = ((f64::from(i / SPOKES) + 0.5) / f64::from(RINGS)).sqrt();
        (radius, TAU * f64::from(i % SPOKES) / f64::from(SPOKES))
    })
}

fn arrivals(emitter: Emitter, light: &Aim, at: Vec3) -> Vec<Arrival> {
    let towards = |origin: Vec3| {
        let way = origin - at;
        (way.normalize(), way.length())
    };
    let axis = -light.direction();
    let frame = Frame::from_normal(axis);
    match emitter {
        Emitter::Point | Emitter::Spot => {
            let (direction, distance) = towards(light.origin);
            let full = emitter == Emitter::Point || direction.dot(axis) > 30.0_f32.to_radians().cos();
            assert!(full, "every point of interest lies in the spot's full beam");
            let irradiance = 1.0 / f64::from(distance).powi(2);
            vec![Arrival {
                direction,
                distance,
                irradiance,
            }]
        }
        Emitter::Directional => vec![Arrival {
            direction: axis,
            distance: f32::INFINITY,
            irradiance: 1.0,
        }],
        Emitter::Area => {
            let points: Vec<_> = disc_points().collect();
            let area = PI * f64::from(LIGHT_RADIUS).powi(2) / points.len() as f64;
            let part = |(radius, phi): &(f64, f64)| {
                let local = Vec3::new((radius * phi.cos()) as f32, (radius * phi.sin()) as f32, 0.0);
                let (direction, distance) = towards(light.origin + LIGHT_RADIUS * frame.to_world(local));
                let cos = f64::from(direction.dot(axis)).max(0.0);
                Arrival {
                    direction,
                    distance,
                    irradiance: cos * area / f64::from(distance).powi(2),
                }
            };
            points.iter().map(part).collect()
        }
        Emitter::Environment => {
            // The cap ends 4 degrees from its axis.
            let rim = 1.0 - 4.0_f64.to_radians().cos();
            let points: Vec<_> = disc_points().collect();
            let solid_angle = TAU * rim / points.len() as f64;
            let part = |(radius, phi): &(f64, f64)| {
                let cos = 1.0 - radius * radius * rim;
                let sin = (1.0 - cos * cos).sqrt();
                let local = Vec3::new((sin * phi.cos()) as f32, (sin * phi.sin()) as f32, cos as f32);
                Arrival {
                    direction: frame.to_world(local),
                    distance: f32::INFINITY,
                    irradiance: cap_radiance(cos.acos()) * solid_angle,
                }
            };
            points.iter().map(part).collect()
        }
    }
}

/// Irradiance of a point of the floor; shaded by the surfaces of `shades`, if given.
fn irradiance(emitter: Emitter, light: &Aim, at: Vec3, shades: Option<&Scene>) -> f64 {
    let lit = |arrival: &Arrival| {
        shades.is_none_or(|scene| {
            let ray = Ray {
                origin: at + 1e-4 * arrival.direction,
                direction: arrival.direction,
                max_distance: arrival.distance - 2e-4,
            };
            !scene.geometry.occluded(&ray)
        })
    };
    let part = |arrival: Arrival| {
        let cos = f64::from(arrival.direction.y).max(0.0);
        if cos > 0.0 && lit(&arrival) {
            arrival.irradiance * cos
        } else {
            0.0
        }
    };
    arrivals(emitter, light, at).into_iter().map(part).sum()
}

/// Radiance of an extended light along a ray of the camera, followed by its mirrors: their backs are black, and block some rays.
fn seen_light(layout: &Layout, scene: &Scene, mut ray: Ray) -> f64 {
    // The area light's disc is the first shape.
    let is_light = |hit: &SurfacePoint| layout.emitter == Emitter::Area && hit.shape.0 == 0;
    for _ in 1..layout.chain.edges() {
        let Some(hit) = scene.geometry.intersect(&ray) else {
            return 0.0;
        };
        let towards_normal = ray.direction.dot(hit.geometric_normal);
        if is_light(&hit) || towards_normal >= 0.0 {
            return 0.0;
        }
        ray = hit.ray_towards(ray.direction - 2.0 * towards_normal * hit.geometric_normal);
    }
    match (layout.emitter, scene.geometry.intersect(&ray)) {
        (Emitter::Environment, None) => {
            let axis = -layout.placed_light().direction();
            cap_radiance(f64::from(ray.direction.dot(axis).min(1.0)).acos())
        }
        (_, Some(hit)) => f64::from(is_light(&hit) && ray.direction.dot(hit.geometric_normal) < 0.0),
        _ => 0.0,
    }
}

/// Light that goes from the first patch by the mirror to the second one, which the camera sees.
fn second_patch(layout: &Layout, unfolded: &Scene, scene: &Scene) -> f64 {
    const GRID: u32 = 28;
    let light = layout.light();
    let (centre, half) = FIRST_PATCH;
    let cell = 2.0 * half / GRID as f32;
    let patch: Vec<(Vec3, f64)> = (0..GRID * GRID)
        .map(|i| {
            let [x, z] = [i % GRID, i / GRID].map(|n| (n as f32 + 0.5) * cell - half);
            let at = centre + Vec3::new(x, 0.0, z);
            let flux = irradiance(layout.emitter, &light, at, Some(scene)) * f64::from(cell * cell);
            // As the mirror shows it.
            (at + Vec3::new(0.0, 2.0 * mirror_height(layout.chain), 0.0), flux)
        })
        .collect();
    over_image(layout.eye, unfolded, 24, |ray| {
        let at = on_floor(ray);
        assert!(
            irradiance(layout.emitter, &light, at, Some(scene)) == 0.0,
            "{layout:?}: the second patch is in the shade at {at}"
        );
        let received = |(from, flux): &(Vec3, f64)| {
            let way = *from - at;
            let distance2 = f64::from(way.length_squared());
            let cos = f64::from(way.y) / distance2.sqrt();
            flux * cos * cos / distance2
        };
        (ALBEDO / PI).powi(2) * patch.iter().map(received).sum::<f64>()
    })
}

/// Mean over the image of a light that is a delta function of direction, seen by mirrors.
///
/// For a point of the lens at `c`, camera rays have the density `p(w) = D^3 / (f A)` of solid angle, where `A` is the area that
/// the image covers on the plane at distance `f` of the lens, and `D` the distance of that plane along `w`. A
/// point light at distance `r` gives the radiance `I / r^2 delta(w - w_0)`, so the mean is `I p(w_0) / r^2`; parallel light of
/// irradiance `E` gives `E p(w_0)`. Parallel rays see the point light once on the area `A` of the image: `I / A`.
fn image_of_delta_light(layout: &Layout) -> Option<f64> {
    let (light, camera) = (layout.light(), layout.camera());
    let area = f64::from(2.0 * layout.half_width()).powi(2);
    let lens = match layout.eye {
        Eye::Orthographic if layout.emitter == Emitter::Directional => return None,
        Eye::Orthographic => return Some(1.0 / area),
        Eye::Pinhole => 0.0,
        Eye::ThinLens => LENS_RADIUS,
    };
    let axis = camera.direction();
    let frame = Frame::from_normal(axis);
    let focus = camera.distance();
    let points: Vec<_> = disc_points().collect();
    let density = |(radius, phi): &(f64, f64)| {
        let local = Vec3::new((radius * phi.cos()) as f32, (radius * phi.sin()) as f32, 0.0);
        let at = camera.origin + lens * frame.to_world(local);
        let (towards, falloff) = match layout.emitter {
            Emitter::Directional => (-light.direction(), 1.0),
            _ => (
                (light.origin - at).normalize(),
                f64::from((light.origin - at).length()).powi(-2),
            ),
        };
        let distance = f64::from(focus / towards.dot(axis));
        falloff * distance.powi(3) / (f64::from(focus) * area)
    };
    Some(points.iter().map(density).sum::<f64>() / points.len() as f64)
}

/// Share of the cap's radiance that a kernel of half angle `theta` \[radians\] leaves of a ray along its axis: the mean over the cone.
pub(super) fn blurred_cap(theta: f64) -> f64 {
    const STEPS: u32 = 10_000;
    let rim = 1.0 - theta.cos();
    let part = |step: u32| cap_radiance((1.0 - rim * (f64::from(step) + 0.5) / f64::from(STEPS)).acos());
    (0..STEPS).map(part).sum::<f64>() / f64::from(STEPS)
}

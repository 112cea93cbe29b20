//! Paths from the camera, shared by the integrators: emission, next-event estimation and Russian roulette.

use super::vertex::{Tracer, Vertex};
use crate::geometry::{Ray, SurfacePoint};
use crate::light::LightId;
use crate::material::TransportMode;
use crate::math::{Vec3, sqr};
use crate::random::PathRandom;
use crate::spectrum::Spectrum;

/// Edges after which paths face Russian roulette, as Mitsuba's `rr_depth`.
pub(super) const ROULETTE_EDGES: u32 = 5;

/// Highest probability of surviving Russian roulette, as Mitsuba's.
pub(super) const ROULETTE_SURVIVAL: f32 = 0.95;

/// What an integrator does at a camera vertex.
pub(super) enum Visit {
    /// Estimate direct light there and walk on.
    Walk,
    /// Walk on: direct light there has been accounted for.
    WalkOnly,
    /// Add this radiance and estimate direct light there, which accounts for all lobes but delta functions: end, or walk on along
    /// one of these.
    AddAndEndAfterDirect(Spectrum),
    /// All lobes but delta functions have been accounted for: end, or walk on along one of these.
    WalkAlongDelta,
    /// End: all light there has been accounted for.
    End,
}

/// A bounce whose direction might have been chosen by next-event estimation too.
struct Bounce {
    from: Vec3,
    /// Solid-angle density of the BSDF's sample [1/sr].
    pdf: f32,
}

/// Estimates the radiance along `ray` over paths of at most `max_edges` edges, with lights sampled both by the material
/// and by next-event estimation and combined by the power heuristic (Veach 1997, section 9.2).
///
/// `visit(vertex, edges, throughput)` is asked at every surface vertex, `edges` from the camera, where the path carries the
/// share `throughput` of radiance to the camera; an integrator that ends the walk there answers for all longer paths.
pub(super) fn radiance(
    tracer: &mut Tracer,
    mut ray: Ray,
    random: &mut PathRandom,
    max_edges: u32,
    mut visit: impl FnMut(&Vertex, u32, Spectrum) -> Visit,
) -> Spectrum {
    let mut total = Spectrum::ZERO;
    let mut throughput = Spectrum::ONE;
    let mut eta = 1.0;
    let mut bounce: Option<Bounce> = None;
    // Whether the path ends with its next edge; whether light that it meets by scattering, or by a connection, counts.
    let (mut ending, mut direct) = (false, true);
    for edges in 1..=max_edges {
        let hit = tracer.intersect(&ray);
        if direct {
            total += throughput * emission(tracer, &ray, hit.as_ref(), bounce.as_ref());
        }
        let Some(point) = hit else { break };
        if ending {
            break;
        }
        let vertex = Vertex::new(tracer.scene, point, -ray.direction, TransportMode::Radiance);
        direct = true;
        let mut only_delta = false;
        match visit(&vertex, edges, throughput) {
            Visit::Walk => {}
            Visit::WalkOnly => direct = false,
            Visit::AddAndEndAfterDirect(radiance) => {
                total += throughput * radiance;
                ending = true;
            }
            Visit::WalkAlongDelta if vertex.has_delta() => only_delta = true,
            Visit::WalkAlongDelta | Visit::End => break,
        }
        if edges == max_edges {
            break;
        }
        if direct && !only_delta && !vertex.is_delta() {
            total += throughput * next_event(tracer, &vertex, random);
        }
        let Some(scattered) = vertex.sample(random) else {
            break;
        };
        if scattered.bsdf.delta {
            ending = false;
        } else if only_delta {
            break;
        }
        throughput *= scattered.weight();
        eta *= scattered.bsdf.eta;
        bounce = (!scattered.bsdf.delta).then_some(Bounce {
            from: point.position,
            pdf: scattered.bsdf.pdf,
        });
        match roulette(throughput, eta, edges, random) {
            Some(survived) => throughput = survived,
            None => break,
        }
        ray = point.ray_towards(scattered.wi);
    }
    total
}

/// The throughput of a camera path of `edges` edges that goes on; `None` where Russian roulette ends it. `eta` is the index of refraction
/// at its end over that at the camera.
#[inline]
pub(super) fn roulette(throughput: Spectrum, eta: f32, edges: u32, random: &mut PathRandom) -> Option<Spectrum> {
    if edges < ROULETTE_EDGES {
        return Some(throughput);
    }
    let survival = (throughput.max_component() * sqr(eta)).min(ROULETTE_SURVIVAL);
    (random.next_choice() < f64::from(survival)).then(|| throughput * (1.0 / survival))
}

/// Light emitted towards the ray's origin by what the ray found.
fn emission(tracer: &Tracer, ray: &Ray, hit: Option<&SurfacePoint>, bounce: Option<&Bounce>) -> Spectrum {
    let lights = &tracer.scene.lights;
    let weight = |light_pdf: &dyn Fn(Vec3) -> f32| bounce.map_or(1.0, |b| power_heuristic(b.pdf, light_pdf(b.from)));
    match hit {
        None => {
            let radiance = lights.background(ray.direction);
            if radiance.is_black() {
                radiance
            } else {
                radiance * weight(&|_| lights.pdf_background(ray.direction))
            }
        }
        Some(point) => {
            let Some(light) = tracer.scene.light_at(point) else {
                return Spectrum::ZERO;
            };
            let radiance = lights.emitted(light, point, -ray.direction);
            if radiance.is_black() {
                radiance
            } else {
                radiance * weight(&|from| area_pdf(tracer, light, from, point))
            }
        }
    }
}

fn area_pdf(tracer: &Tracer, light: LightId, from: Vec3, hit: &SurfacePoint) -> f32 {
    tracer.scene.lights.pdf_area(&tracer.scene.geometry, light, from, hit)
}

/// Direct light at a vertex by one connection with a light.
fn next_event(tracer: &mut Tracer, vertex: &Vertex, random: &mut PathRandom) -> Spectrum {
    let (choice, u) = (random.next_choice(), random.next_choice_2d());
    let Some((light, f)) = tracer.connect_with_light(vertex, choice, u) else {
        return Spectrum::ZERO;
    };
    let weight = if light.delta {
        1.0
    } else {
        power_heuristic(light.pdf, vertex.pdf(light.wi))
    };
    f * light.radiance * (vertex.cos_shading(light.wi) * weight / light.pdf)
}

/// Power heuristic with beta = 2 for one sample of each of two techniques (Veach 1997, equation 9.13), written so that large
/// densities do not overflow.
fn power_heuristic(pdf: f32, other: f32) -> f32 {
    if pdf == 0.0 {
        return 0.0;
    }
    1.0 / (1.0 + sqr(other / pdf))
}

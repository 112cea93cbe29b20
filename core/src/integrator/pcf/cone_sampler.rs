//! Where a cone points: the direction samplers of PCF (thesis, section 4.2), combined by the power heuristic (4.3).

use super::camera_lobe::{CameraLobe, LobeAt};
use super::importons::{DEFENSIVE, Importons, Mixture};
use super::query::is_automatic_lookup;
use crate::density::{Cone, Extent, Occupancy};
use crate::integrator::light_paths::Arrival;
use crate::integrator::{Bandwidth, Job};
use crate::math::{Vec3, pow, sqr};
use crate::path::{States, Vertex};
use crate::random::{PathRandom, Stream};
use crate::settings::{DirectionSampler, LookupVertex, PcfSettings};
use crate::spectrum::Spectrum;

/// Stores the cones of light paths at places of one sort.
pub(super) struct ConeSampler<'a> {
    job: &'a Job<'a>,
    /// Exponent of the power heuristic.
    beta: f32,
    lookup: LookupVertex,
    bsdf: bool,
    camera: Option<CameraLobe<'a>>,
    importons: Option<Importons>,
}

/// Techniques at a vertex, in the order of [`Techniques::densities`].
const BSDF: usize = 0;
const CAMERA: usize = 1;
const IMPORTON: usize = 2;

/// The samplers in use at a vertex that is not delta.
struct Techniques<'v> {
    vertex: &'v Vertex<'v>,
    beta: f32,
    bsdf: bool,
    camera: Option<LobeAt>,
    importons: Option<Mixture>,
}

impl Techniques<'_> {
    /// Solid-angle density \[1/sr\] of each technique; zero for one that is not in use, and for one too small to divide by.
    fn densities(&self, direction: Vec3) -> [f32; 3] {
        let densities = [
            if self.bsdf { self.vertex.pdf(direction) } else { 0.0 },
            self.camera.as_ref().map_or(0.0, |lobe| lobe.pdf(direction)),
            self.importons.as_ref().map_or(0.0, |mixture| mixture.pdf(direction)),
        ];
        densities.map(|density| if density.is_normal() { density } else { 0.0 })
    }

    /// Weight of a sample of `technique` by the power heuristic (thesis, equation 4.4), over its density.
    fn share_over_density(&self, technique: usize, densities: [f32; 3]) -> f32 {
        let own = densities[technique];
        if own <= 0.0 {
            return 0.0;
        }
        let sum: f32 = densities.iter().map(|other| power(other / own, self.beta)).sum();
        1.0 / (sum * own)
    }
}

fn power(ratio: f32, beta: f32) -> f32 {
    if beta == 2.0 { sqr(ratio) } else { pow(ratio, beta) }
}

impl<'a> ConeSampler<'a> {
    pub(super) fn new(
        job: &'a Job<'a>,
        settings: &PcfSettings,
        (extent, bandwidth): (Extent, Bandwidth),
        importons: Option<Importons>,
    ) -> Self {
        let uses = |sampler| settings.samplers.contains(&sampler);
        let alone = !uses(DirectionSampler::Bsdf) && !uses(DirectionSampler::Importon);
        // The other techniques have a density in every direction that carries light. Alone, camera connections need one too: a
        // lookup vertex beyond the first wants radiance away from the camera.
        let defensive = if alone { DEFENSIVE } else { 0.0 };
        // On surfaces, discs are small against the distance from the camera.
        let radius = match extent {
            Extent::Disc => 0.0,
            Extent::Ball => bandwidth.sigma,
        };
        Self {
            job,
            beta: settings.mis_beta,
            lookup: settings.lookup_vertex,
            bsdf: uses(DirectionSampler::Bsdf),
            camera: uses(DirectionSampler::Camera)
                .then(|| CameraLobe::new(&job.scene.sensor, bandwidth.theta, radius, defensive)),
            importons,
        }
    }

    /// Stores the cones of a light path's arrival: one from each sampler, weighted so that together they count once. Those that
    /// `occupancy` rules out are left out.
    pub(super) fn store(&self, arrival: &Arrival, occupancy: Option<&Occupancy>, records: &mut Vec<Cone>) {
        let vertex = arrival.vertex;
        let position = vertex.position();
        if occupancy.is_some_and(|o| !o.may_count_at(position)) {
            return;
        }
        let wanted = |direction: Vec3| occupancy.is_none_or(|o| o.may_count(position, direction));
        let mut push = |direction: Vec3, weight: Spectrum, states: States| {
            if !weight.is_black() {
                records.push(vertex.cone(direction, weight, states));
            }
        };
        let walked = |vertex| self.lookup == LookupVertex::Auto && is_automatic_lookup(vertex);
        if let Some(scattered) = arrival
            .scattered
            .filter(|s| s.bsdf.delta && wanted(s.wi) && !walked(vertex))
        {
            push(
                scattered.wi,
                vertex.beta * scattered.bsdf.f * (1.0 / scattered.bsdf.pdf),
                vertex.states.delta,
            );
        }
        if vertex.is_delta() {
            return;
        }
        let techniques = self.techniques(vertex);
        if let Some(scattered) = arrival.scattered.filter(|s| self.bsdf && !s.bsdf.delta && wanted(s.wi)) {
            let mut densities = techniques.densities(scattered.wi);
            densities[BSDF] = scattered.bsdf.pdf;
            let share = techniques.share_over_density(BSDF, densities);
            push(
                scattered.wi,
                vertex.beta * scattered.bsdf.f * share,
                vertex.states.smooth,
            );
        }
        let mut random = self.random(arrival);
        let (u, choice, v) = (random.next_2d(), random.next_choice(), random.next_2d());
        let sampled = [
            (CAMERA, techniques.camera.as_ref().map(|lobe| lobe.sample(choice, u))),
            (
                IMPORTON,
                techniques.importons.as_ref().map(|mixture| mixture.sample(choice, v)),
            ),
        ];
        for (technique, direction) in sampled {
            if let Some(direction) = direction.filter(|direction| wanted(*direction)) {
                let share = techniques.share_over_density(technique, techniques.densities(direction));
                push(
                    direction,
                    vertex.beta * vertex.eval(direction) * share,
                    vertex.states.smooth,
                );
            }
        }
    }

    fn techniques<'v>(&self, vertex: &'v Vertex<'v>) -> Techniques<'v> {
        let position = vertex.position();
        let normal = vertex.surface().map(|point| point.geometric_normal);
        Techniques {
            vertex,
            beta: self.beta,
            bsdf: self.bsdf,
            camera: self.camera.as_ref().and_then(|lobe| lobe.at(position, normal)),
            importons: self.importons.as_ref().map(|importons| importons.around(position)),
        }
    }

    /// The random numbers of an arrival's cones: its own, so that a cone that is not sampled changes nothing for the others.
    fn random(&self, arrival: &Arrival) -> PathRandom {
        let cone = u64::from(arrival.path) << 32 | u64::from(arrival.vertex.edges);
        PathRandom::new(self.job.seed, self.job.iteration, Stream::Cone, cone)
    }
}

#[cfg(test)]
mod tests;

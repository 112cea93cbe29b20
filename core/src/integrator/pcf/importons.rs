//! Conical importons: where camera paths need radiance, and in which directions (thesis, section 4.2.3).
//!
//! The queries of the iteration are the importons. Their density guides cones without changing what is estimated: given the
//! camera paths, cones are sampled with a known density, and each query's sum keeps its mean.

use super::queries::Queries;
use super::query::{Query, Surface};
use crate::density::{Point, PointMap};
use crate::integrator::Bandwidth;
use crate::math::warp::{Cone, square_to_sphere};
use crate::math::{PI, Vec2, Vec3};
use crate::settings::{DirectionSampler, PcfSettings};

/// Importons that a mixture holds on average, at most about.
const NEIGHBOURS: f32 = 16.0;

/// Importons among which their density is measured first, at most.
const PILOT: usize = 1 << 16;

/// Places at which it is measured.
const PROBES: usize = 256;

/// Share of the samples that are spread over all directions, so that no direction is without density where importons were
/// left out (a defensive mixture: Hesterberg 1995).
pub(super) const DEFENSIVE: f32 = 0.1;

/// Widening of the lobes against the rounding of stored directions \[radians\].
const ROUNDING: f32 = 1.5e-4;

/// An importon, as the map keeps it.
#[derive(Clone, Copy, Default)]
struct Importon {
    /// Unit direction of the radiance that is wanted.
    direction: Vec3,
    /// Luminance of the share that the camera path carries to its pixel.
    importance: f32,
}

/// The importon map of an iteration.
pub(super) struct Importons {
    map: PointMap<Importon>,
    radius: f32,
    /// The directions of a lobe.
    cone: Cone,
}

impl Importons {
    /// Makes importons of the queries; `None` where the settings do not use them. First camera vertices are left to camera
    /// connections where these are on, and delta surfaces to the material's own sampling (thesis, section 4.3.2).
    pub(super) fn build(queries: &Queries, settings: &PcfSettings, bandwidth: Bandwidth) -> Option<Self> {
        let uses = |sampler| settings.samplers.contains(&sampler);
        if !uses(DirectionSampler::Importon) {
            return None;
        }
        let first_edges = if uses(DirectionSampler::Camera) { 2 } else { 1 };
        let is_importon = |query: &&Query| {
            query.camera_edges >= first_edges && query.surface != Surface::Delta && query.throughput.luminance() > 0.0
        };
        let count = queries.iter().filter(is_importon).count();
        let every = |stride: usize| -> Vec<_> {
            queries
                .iter()
                .filter(is_importon)
                .step_by(stride)
                .map(importon)
                .collect()
        };
        let map_of = |importons| PointMap::build(vec![importons], bandwidth.sigma);
        let pilot_stride = count.div_ceil(PILOT).max(1);
        let pilot = map_of(every(pilot_stride));
        let crowd = mean_neighbours(
            &pilot,
            queries
                .iter()
                .filter(is_importon)
                .step_by(count.div_ceil(PROBES).max(1)),
            bandwidth.sigma,
        );
        let stride = ((pilot_stride as f32 * crowd / NEIGHBOURS).ceil() as usize).max(1);
        Some(Self {
            map: if stride == pilot_stride {
                pilot
            } else {
                map_of(every(stride))
            },
            radius: bandwidth.sigma,
            cone: Cone::of_angle((bandwidth.theta + ROUNDING).min(PI)),
        })
    }

    /// The mixture of the importons within a bandwidth of `position`.
    pub(super) fn around(&self, position: Vec3) -> Mixture {
        let mut mixture = Mixture {
            lobes: Vec::new(),
            cone: self.cone,
        };
        self.map.query(position, self.radius, |importon| {
            mixture.add(importon.direction, importon.importance);
        });
        mixture
    }
}

fn importon(query: &Query) -> Point<Importon> {
    Point {
        position: query.position,
        payload: Importon {
            direction: query.direction,
            importance: query.throughput.luminance(),
        },
    }
}

/// Mean number of importons in reach of a probe.
fn mean_neighbours<'q>(importons: &PointMap<Importon>, probes: impl Iterator<Item = &'q Query>, radius: f32) -> f32 {
    let (mut places, mut found) = (0, 0);
    for probe in probes {
        places += 1;
        importons.query(probe.position, radius, |_| found += 1);
    }
    found as f32 / (places as f32).max(1.0)
}

/// A density of directions: uniform cones about those of importons, in proportion to their importance, and a share of
/// [`DEFENSIVE`] over the sphere, which has all where there are no importons.
pub(super) struct Mixture {
    /// Axis of each lobe, and the importance up to and with it.
    lobes: Vec<(Vec3, f64)>,
    cone: Cone,
}

impl Mixture {
    fn add(&mut self, axis: Vec3, importance: f32) {
        let before = self.lobes.last().map_or(0.0, |(_, sum)| *sum);
        self.lobes.push((axis, before + f64::from(importance)));
    }

    pub(super) fn sample(&self, choice: f64, u: Vec2) -> Vec3 {
        let Some((_, total)) = self.lobes.last() else {
            return square_to_sphere(u);
        };
        let defensive = f64::from(DEFENSIVE);
        if choice < defensive {
            return square_to_sphere(u);
        }
        let target = (choice - defensive) / (1.0 - defensive) * total;
        let chosen = self
            .lobes
            .partition_point(|(_, sum)| *sum <= target)
            .min(self.lobes.len() - 1);
        self.cone.sample_about(self.lobes[chosen].0, u)
    }

    /// Solid-angle density [1/sr].
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        const UNIFORM: f32 = 1.0 / (4.0 * PI);
        let Some((_, total)) = self.lobes.last() else {
            return UNIFORM;
        };
        let (mut covered, mut before) = (0.0, 0.0);
        for (axis, sum) in &self.lobes {
            if self.cone.holds(*axis, direction) {
                covered += sum - before;
            }
            before = *sum;
        }
        DEFENSIVE * UNIFORM + (1.0 - DEFENSIVE) * (covered / total) as f32 * self.cone.pdf()
    }
}

#[cfg(test)]
impl Mixture {
    /// Lobes of half angle `theta` [radians], each with its axis and importance.
    pub(super) fn of(lobes: &[(Vec3, f32)], theta: f32) -> Self {
        let mut mixture = Self {
            lobes: Vec::new(),
            cone: Cone::of_angle(theta),
        };
        for (axis, importance) in lobes {
            mixture.add(*axis, *importance);
        }
        mixture
    }
}

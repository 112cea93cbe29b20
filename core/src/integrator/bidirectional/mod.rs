//! Paths from both sides: light tracing, bidirectional path tracing (Veach 1997, chapter 10) and vertex connection and
//! merging (Georgiev, Krivanek, Davidovic and Slusallek 2012), which are one estimator with techniques on and off.
//!
//! A path `x_0 ... x_k` from a light to the lens is made by technique `(s, t)` of `s` vertices of a light subpath and `t` of a
//! camera subpath, which a connection joins (`s + t = k + 1`), or by merging the two where their ends lie close to each other.
//! Every technique that can make the path counts with its share of the balance heuristic, so that the shares add up to one
//! ([`Partial`]).
//!
//! An iteration traces `M` light paths, and `S` camera paths for each pixel. Camera path `i` is connected with light path
//! `i mod M`; all light paths are merged with all camera paths, and all are connected with the lens (`t = 1`), or hit it
//! (`t = 0`).

mod camera;
mod light;
mod merge;
#[cfg(test)]
mod tests;

use super::{Counts, Iteration, Job, Observer, Phase, RenderError, trace_pixels};
use crate::density::PointMap;
use crate::math::{PI, sqr};
use crate::path::{Edges, Partial, Scattered, Vertex};
use crate::settings::shared::PHOTONS;
use crate::settings::{Kind, Setting};
use crate::spectrum::Spectrum;

/// Light paths of an iteration. Their vertices are kept until the iteration ends, some 280 bytes each: more than a gigabyte for a
/// million paths of five, and five times as much among white walls.
pub(super) const LIGHT_PATHS: Setting = Setting {
    kind: Kind::Integer {
        least: 1,
        most: 1_000_000,
    },
    ..PHOTONS
};

/// Which techniques are used. Lights that the camera sees itself are always found by the camera's rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Techniques {
    /// A camera path finds a light (`s = 0`).
    pub(super) hit: bool,
    /// A camera path is connected with a point of a light (`s = 1`).
    pub(super) next_event: bool,
    /// A camera path is connected with a light path (`s` and `t` of 2 and more).
    pub(super) connect: bool,
    /// A light path is connected with the lens, or hits it (`t = 1` and `t = 0`).
    pub(super) splat: bool,
    /// A camera path is merged with light paths that end near its vertices.
    pub(super) merge: bool,
}

impl Techniques {
    pub(super) const NONE: Self = Self {
        hit: false,
        next_event: false,
        connect: false,
        splat: false,
        merge: false,
    };
    pub(super) const ALL: Self = Self {
        hit: true,
        next_event: true,
        connect: true,
        splat: true,
        merge: true,
    };
}

/// Some techniques that connect, as they are beside all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Only {
    /// Vertices of the light subpath; `None`: any number.
    pub(super) s: Option<u32>,
    /// Vertices of the camera subpath; `None`: any number.
    pub(super) t: Option<u32>,
    /// Whether each counts with its share; otherwise each counts in full.
    pub(super) weighted: bool,
}

/// What an iteration is rendered with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    /// Light paths of an iteration (M).
    pub(super) light_paths: u32,
    /// Camera paths of each pixel (S).
    pub(super) samples: u32,
    /// Most edges of a path from the light to the camera.
    pub(super) max_edges: u32,
    pub(super) techniques: Techniques,
    /// Radius within which paths are merged, where they are \[scene units\].
    pub(super) radius: Option<f32>,
    /// The techniques that count, where not all do.
    pub(super) only: Option<Only>,
}

/// The plan with what the shares of techniques are made of.
struct Estimator<'a> {
    job: &'a Job<'a>,
    plan: Plan,
    /// Radius within which paths are merged; `None` where they are not \[scene units\].
    merge_radius: Option<f32>,
    /// Expected number of light paths merged with a vertex per unit of their density, `M pi r^2`; 0 without merging. The factor of a merge's
    /// density over that of a connection (Georgiev et al. 2012, equation 10, times the number of light paths).
    merges: f32,
    light_edges: Edges,
    camera_edges: Edges,
}

/// A vertex of a subpath that the other side's subpaths can be connected and merged with.
#[derive(Clone)]
struct End<'s> {
    vertex: Vertex<'s>,
    partial: Partial,
}

/// A path that counts for a pixel other than that of its camera path.
#[derive(Clone, Copy, Debug)]
struct Splat {
    /// Index of the pixel, row by row from the top left.
    pixel: u32,
    value: Spectrum,
}

/// Renders an iteration.
pub(super) fn render(job: &Job, plan: Plan, observer: &dyn Observer) -> Result<Iteration, RenderError> {
    let estimator = Estimator::new(job, plan);
    let mut counts = Counts::default();

    observer.phase(Phase::TraceLight);
    let mut light = estimator.trace_light(observer, &mut counts)?;

    observer.phase(Phase::BuildMap);
    let map = estimator
        .merge_radius
        .map(|radius| (PointMap::build(light.take_merge_points(), radius), radius));

    let held = if map.is_some() {
        job.batches.vertices
    } else {
        usize::MAX
    };
    let mut pixels = Vec::with_capacity(job.pixel_count());
    for pass in job.passes(held, plan.samples) {
        observer.phase(Phase::TraceCamera);
        let (sums, merges) = trace_pixels(
            job,
            plan.samples,
            pass.clone(),
            observer,
            &mut counts,
            |sample, merges| estimator.radiance(sample, &light, merges),
        )?;
        pixels.extend(sums);
        if let Some((map, radius)) = &map {
            observer.phase(Phase::ReadMap);
            for found in estimator.merge(&merges, map, *radius, observer)?.iter().flatten() {
                found.add_to(&mut pixels, &mut counts);
            }
        }
    }
    for pixel in &mut pixels {
        *pixel *= 1.0 / plan.samples as f32;
    }
    // In the order of paths, whatever the number of threads.
    for splat in light.splats() {
        pixels[splat.pixel as usize] += splat.value * (1.0 / plan.light_paths as f32);
    }
    Ok(Iteration {
        pixels,
        counts,
        statistics: Vec::new(),
    })
}

impl<'a> Estimator<'a> {
    fn new(job: &'a Job<'a>, plan: Plan) -> Self {
        let Techniques {
            next_event,
            connect,
            splat,
            merge,
            ..
        } = plan.techniques;
        let used = |technique: bool| f32::from(u8::from(technique));
        let merge_radius = plan.radius.filter(|_| merge);
        Self {
            job,
            plan,
            merge_radius,
            merges: merge_radius.map_or(0.0, |radius| plan.light_paths as f32 * PI * sqr(radius)),
            light_edges: Edges {
                first: used(next_event),
                others: used(connect),
            },
            camera_edges: Edges {
                first: used(splat) * plan.light_paths as f32 / plan.samples as f32,
                others: used(connect),
            },
        }
    }

    /// Whether technique `(s, t)` is used.
    fn uses(&self, s: u32, t: u32) -> bool {
        let techniques = &self.plan.techniques;
        let used = match (s, t) {
            (0, 2) | (2, 0) if self.job.scene.hide_emitters => false,
            (0, 2) => true,
            (_, 0 | 1) => techniques.splat,
            (0, _) => techniques.hit,
            (1, _) => techniques.next_event,
            _ => techniques.connect,
        };
        let shown = |only: Only| only.s.is_none_or(|shown| shown == s) && only.t.is_none_or(|shown| shown == t);
        used && self.plan.only.is_none_or(shown)
    }

    /// Share of a technique with which a path counts, beside others whose densities, and numbers of paths, make `others` times as much.
    fn share(&self, others: f32) -> f32 {
        match self.plan.only {
            Some(Only { weighted: false, .. }) => 1.0,
            // Where densities are 0 or infinite there is no such path.
            _ if others.is_nan() => 0.0,
            _ => 1.0 / (1.0 + others),
        }
    }

    /// The factor of merging at a vertex: there is none in a medium.
    fn merges_at(&self, vertex: &Vertex) -> f32 {
        match vertex.surface() {
            Some(_) => self.merges,
            None => 0.0,
        }
    }

    /// Goes on from a vertex in a direction sampled there.
    fn partial_after(&self, vertex: &Vertex, partial: Partial, edge: f32, scattered: &Scattered) -> Partial {
        let cos = vertex.cos_geometric(scattered.wi);
        let (pdf, pdf_rev) = (scattered.bsdf.pdf, vertex.pdf_rev_of(scattered));
        if scattered.bsdf.delta {
            return partial.after_delta(cos, pdf_rev / pdf);
        }
        partial.after(cos, pdf, pdf_rev, edge, self.merges_at(vertex))
    }
}

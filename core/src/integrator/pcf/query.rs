//! Queries: what camera paths want to know from the map.

use super::clip::share_on_surface;
use super::kernel::Kernel;
use crate::integrator::camera_path::{self, Visit};
use crate::integrator::vertex::{Tracer, Vertex};
use crate::integrator::{Counts, GLOSSY_ROUGHNESS, Job, Observer, RenderError, edge_limit, trace_pixels};
use crate::map::{Occupancy, Reach, RecordMap, count_edges};
use crate::math::Vec3;
use crate::random::{PathRandom, Stream};
use crate::settings::{LookupVertex, PcfSettings};
use crate::spectrum::Spectrum;
use rayon::prelude::*;
use std::ops::Range;

/// How a surface scatters to the query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Surface {
    Rough,
    Glossy,
    Delta,
}

impl Surface {
    fn of(vertex: &Vertex) -> Self {
        if vertex.is_delta() {
            Self::Delta
        } else if vertex.is_glossier_than(GLOSSY_ROUGHNESS) {
            Self::Glossy
        } else {
            Self::Rough
        }
    }
}

/// Radiance wanted at a camera vertex.
#[derive(Clone, Copy, Debug)]
pub(super) struct Query {
    pub(super) position: Vec3,
    /// Unit direction in which the radiance leaves: back along the camera path.
    pub(super) direction: Vec3,
    /// Geometric normal.
    pub(super) normal: Vec3,
    /// Share of the radiance that the camera path carries to its pixel.
    pub(super) throughput: Spectrum,
    /// Edges of the camera path.
    pub(super) camera_edges: u32,
    /// Most edges of a light path that counts.
    pub(super) limit: u8,
    pub(super) surface: Surface,
    /// Pixel, counted from the first of the pass.
    pixel: u32,
    /// Sum over the cones found so far.
    radiance: Spectrum,
}

/// The camera paths of a range of pixels: what they have gathered themselves, and their queries.
pub(super) struct Queries {
    /// Sum over the samples of each pixel.
    pixels: Vec<Spectrum>,
    /// In the order of pixels.
    tasks: Vec<Vec<Query>>,
}

impl Queries {
    pub(super) fn trace(
        job: &Job,
        settings: &PcfSettings,
        pixels: Range<usize>,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<Self, RenderError> {
        let max_edges = edge_limit(settings.max_depth);
        let first = pixels.start;
        let (pixels, tasks) = trace_pixels(job, settings.samples, pixels, observer, counts, |sample, queries| {
            camera_path::radiance(
                sample.tracer,
                sample.ray,
                sample.random,
                max_edges,
                |vertex, edges, throughput| {
                    let at_lookup = is_lookup(settings.lookup_vertex, vertex, edges);
                    if !at_lookup && !settings.nested {
                        return Visit::Walk;
                    }
                    let longest = if at_lookup { u32::MAX } else { 1 };
                    queries.push(Query {
                        position: vertex.point.position,
                        direction: vertex.wo,
                        normal: vertex.point.geometric_normal,
                        throughput,
                        camera_edges: edges,
                        limit: count_edges((max_edges - edges).min(longest)),
                        surface: Surface::of(vertex),
                        pixel: (sample.pixel - first) as u32,
                        radiance: Spectrum::ZERO,
                    });
                    if at_lookup { Visit::End } else { Visit::WalkOnly }
                },
            )
        })?;
        Ok(Self { pixels, tasks })
    }

    /// Makes up for the part of each query's kernel that does not lie on its surface. Returns the number of rays.
    pub(super) fn clip(&mut self, job: &Job, kernel: &Kernel) -> u64 {
        let clip_task = |(task, queries): (usize, &mut Vec<Query>)| {
            let mut tracer = Tracer::new(job.scene);
            for (index, query) in queries.iter_mut().enumerate() {
                let disc = (task as u64) << 32 | index as u64;
                let mut random = PathRandom::new(job.seed, job.iteration, Stream::Disc, disc);
                let bandwidth = kernel.bandwidth(query);
                query.throughput *= 1.0 / share_on_surface(&mut tracer, query, bandwidth, kernel.shape(), &mut random);
            }
            tracer.rays
        };
        self.tasks.par_iter_mut().enumerate().map(clip_task).sum()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Query> {
        self.tasks.iter().flatten()
    }

    /// Where the queries look.
    pub(super) fn occupancy(&self, reach: &Reach) -> Occupancy {
        let occupancy = Occupancy::new(reach, self.tasks.iter().map(Vec::len).sum());
        self.tasks.par_iter().for_each(|queries| {
            let mut last = Default::default();
            for query in queries {
                occupancy.mark(query.position, query.direction, &mut last);
            }
        });
        occupancy
    }

    /// Adds the cones of `map` to every query's sum.
    pub(super) fn read(
        &mut self,
        map: &RecordMap,
        kernel: &Kernel,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<(), RenderError> {
        let read: Vec<[u64; 2]> = self
            .tasks
            .par_iter_mut()
            .map(|queries| {
                if observer.cancelled() {
                    return Err(RenderError::Cancelled);
                }
                let mut totals = [0; 2];
                for query in queries {
                    let (sum, read, counted) = kernel.sum(map, query);
                    query.radiance += sum;
                    totals = [totals[0] + read, totals[1] + counted];
                }
                Ok(totals)
            })
            .collect::<Result<_, _>>()?;
        counts.records_read += read.iter().map(|totals| totals[0]).sum::<u64>();
        counts.records_counted += read.iter().map(|totals| totals[1]).sum::<u64>();
        Ok(())
    }

    /// The mean of each pixel over its `samples`; the queries' sums are over `light_paths` light paths.
    pub(super) fn into_pixels(self, light_paths: u32, samples: u32) -> Vec<Spectrum> {
        let mut pixels = self.pixels;
        for query in self.tasks.iter().flatten() {
            pixels[query.pixel as usize] += query.throughput * query.radiance * (1.0 / light_paths as f32);
        }
        for pixel in &mut pixels {
            *pixel *= 1.0 / samples as f32;
        }
        pixels
    }
}

fn is_lookup(lookup: LookupVertex, vertex: &Vertex, edges: u32) -> bool {
    match lookup {
        LookupVertex::Fixed(k) => edges == k,
        LookupVertex::Auto => !vertex.is_glossier_than(GLOSSY_ROUGHNESS),
    }
}

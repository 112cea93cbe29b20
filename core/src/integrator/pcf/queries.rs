//! The queries of camera paths: they are traced, put into groups and answered together.

use super::clip::share_on_surface;
use super::kernel::Kernel;
use super::places::{ByPlace, Place};
use super::query::{Query, Surface, is_lookup};
use crate::density::{Candidates, ConeMap, Groups, Occupancy, QueryCell, Reach, count_edges};
use crate::integrator::camera_path::CameraPath;
use crate::integrator::{Counts, Job, Observer, RenderError, Sample, edge_limit, trace_pixels_into};
use crate::path::Tracer;
use crate::random::{PathRandom, Stream};
use crate::settings::{ConesInMedia, LookupVertex, PcfSettings};
use crate::spectrum::Spectrum;
use rayon::prelude::*;
use std::ops::Range;

/// The queries at places of one sort of the camera paths of a range of pixels.
pub(super) struct Queries {
    /// In the order of pixels.
    queries: Vec<Query>,
    /// For each query and each length of light paths the share of the kernel that lies on the query's surface; empty where nobody
    /// asks.
    on_surface: Vec<f32>,
    /// Of indices in `queries`.
    groups: Groups<u32>,
}

/// Queries clipped, or marked, by one task.
const PER_TASK: usize = 256;

/// The camera paths of a range of pixels: what they have gathered themselves, and their queries.
pub(super) struct CameraPaths {
    /// Sum over the samples of each pixel.
    pub(super) pixels: Vec<Spectrum>,
    /// For each place ([`Place::index`]).
    pub(super) queries: Vec<Queries>,
}

impl CameraPaths {
    pub(super) fn trace(
        job: &Job,
        settings: &PcfSettings,
        pixels: Range<usize>,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<Self, RenderError> {
        let max_edges = edge_limit(settings.max_depth);
        let first = pixels.start;
        let media = match settings.media {
            ConesInMedia::Paths => 0,
            ConesInMedia::Cones => job.scene.media.as_ref().map_or(0, |media| media.media.len()),
        };
        let trace = |sample: Sample, queries: &mut ByPlace<Query>| {
            let mut path = CameraPath::new(sample.tracer, sample.camera.ray, sample.random, max_edges);
            if media > 0 {
                path.cross_media();
            }
            loop {
                let met = path.trace_edge();
                for crossed in path.take_crossed() {
                    let place = Place::Medium(crossed.medium);
                    let query = Query::in_medium(job.scene, crossed, sample.pixel - first, max_edges);
                    queries.list(place).extend(query);
                }
                let Some(vertex) = path.arrive(&met) else { break };
                let at_lookup = is_lookup(settings.lookup_vertex, &vertex);
                let asked = vertex.surface().filter(|_| at_lookup || settings.nested);
                let asks = asked.is_some();
                if let Some(point) = asked {
                    let longest = if at_lookup { u32::MAX } else { 1 };
                    queries.list(Place::Surface).push(Query {
                        position: point.position,
                        direction: vertex.wo,
                        normal: point.geometric_normal,
                        throughput: vertex.beta,
                        camera_edges: vertex.edges,
                        limit: count_edges((max_edges - vertex.counted_edges).min(longest)),
                        states: vertex.states.arrived,
                        surface: Surface::of(&vertex),
                        pixel: (sample.pixel - first) as u32,
                        radiance: Spectrum::ZERO,
                    });
                } else {
                    path.add_next_event(&vertex);
                }
                // An automatic lookup has counted all lobes but delta functions.
                let walks = match settings.lookup_vertex {
                    _ if !at_lookup => true,
                    LookupVertex::Fixed(_) => false,
                    LookupVertex::Auto => vertex.has_delta(),
                };
                let Some(scattered) = walks.then(|| path.go_on(&vertex)).flatten() else {
                    break;
                };
                if at_lookup && !scattered.bsdf.delta {
                    break;
                }
                if asks && !at_lookup {
                    path.count_no_light_on_next_edge();
                }
            }
            path.radiance
        };
        let (pixels, lists) = trace_pixels_into(job, settings.samples, pixels, observer, counts, trace)?;
        let queries = ByPlace::sort(lists, 1 + media).into_iter();
        Ok(Self {
            pixels,
            queries: queries.map(|lists| Queries::new(lists.concat())).collect(),
        })
    }
}

impl Queries {
    fn new(queries: Vec<Query>) -> Self {
        Self {
            queries,
            on_surface: Vec::new(),
            groups: Groups::default(),
        }
    }

    /// Finds the part of each query's kernel that lies on its surface, which the sums are divided by. Returns the number of rays.
    pub(super) fn clip(&mut self, job: &Job, kernel: &Kernel) -> u64 {
        let lengths = kernel.lengths();
        let mut on_surface = vec![1.0; self.queries.len() * lengths];
        let clip_task = |(task, (queries, shares)): (usize, (&[Query], &mut [f32]))| {
            let mut tracer = Tracer::new(job.scene);
            for (offset, (query, shares)) in queries.iter().zip(shares.chunks_mut(lengths)).enumerate() {
                let disc = (task * PER_TASK + offset) as u64;
                let mut random = PathRandom::new(job.seed, job.iteration, Stream::Disc, disc);
                for (share, bandwidth) in shares.iter_mut().zip(kernel.bandwidths(query)) {
                    *share = share_on_surface(&mut tracer, query, bandwidth, kernel.shape(), &mut random);
                }
            }
            tracer.rays
        };
        let tasks = self.queries.par_chunks(PER_TASK);
        let rays = tasks
            .zip(on_surface.par_chunks_mut(PER_TASK * lengths))
            .enumerate()
            .map(clip_task)
            .sum();
        self.on_surface = on_surface;
        rays
    }

    /// The shares of [`Self::clip`] of a query.
    fn shares_on_surface(&self, index: u32) -> &[f32] {
        let lengths = self.on_surface.len() / self.queries.len();
        &self.on_surface[index as usize * lengths..][..lengths]
    }

    /// Puts queries of the same place into groups.
    pub(super) fn group(&mut self, reach: &Reach) {
        let cell = |query: &Query| QueryCell::new(query.position, query.direction, reach);
        let cells = self.queries.par_iter().map(cell);
        self.groups = Groups::new(cells.zip(0..self.queries.len() as u32).collect());
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Query> {
        self.queries.iter()
    }

    /// Where the queries look.
    pub(super) fn occupancy(&self, reach: &Reach) -> Occupancy {
        let occupancy = Occupancy::new(reach, self.queries.len());
        self.queries.par_chunks(PER_TASK).for_each(|queries| {
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
        map: &ConeMap,
        kernel: &Kernel,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<(), RenderError> {
        let tasks: Vec<(Vec<Spectrum>, [u64; 2])> = self
            .groups
            .tasks()
            .map(|task| {
                if observer.cancelled() {
                    return Err(RenderError::Cancelled);
                }
                let mut candidates = Candidates::new(map);
                let (mut sums, mut totals) = (Vec::new(), [0; 2]);
                for indices in task {
                    let group = indices.iter().map(|index| &self.queries[*index as usize]);
                    totals[0] += candidates.gather(group.clone().map(|q| (q.position, q.direction)), kernel.reach());
                    for (query, index) in group.zip(indices) {
                        let (sum, tested, counted) = kernel.sum(&candidates, query, self.shares_on_surface(*index));
                        sums.push(sum);
                        totals = [totals[0] + tested, totals[1] + counted];
                    }
                }
                Ok((sums, totals))
            })
            .collect::<Result<_, _>>()?;
        let sums = tasks.iter().flat_map(|(sums, _)| sums);
        for (index, sum) in self.groups.order().iter().zip(sums) {
            self.queries[*index as usize].radiance += *sum;
        }
        counts.records_read += tasks.iter().map(|(_, totals)| totals[0]).sum::<u64>();
        counts.records_counted += tasks.iter().map(|(_, totals)| totals[1]).sum::<u64>();
        Ok(())
    }

    /// Adds what the queries have found to their pixels; their sums are over `light_paths` light paths.
    pub(super) fn add_to(&self, pixels: &mut [Spectrum], light_paths: u32) {
        for query in &self.queries {
            pixels[query.pixel as usize] += query.throughput * query.radiance * (1.0 / light_paths as f32);
        }
    }
}

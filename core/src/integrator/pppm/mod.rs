//! Probabilistic progressive photon mapping (Knaus and Zwicker 2011).
//!
//! Camera paths go on through specular and glossy surfaces and end at the first vertex that is rough enough, where the
//! map is read. Direct light there comes from next-event estimation, so photons that come straight from a light
//! are not stored: a path with `k` camera edges and `j` light edges is counted by the map where `j >= 2`, and by the
//! camera path where `j <= 1`. Lights that no connection and no ray finds are the exception: all of their photons are stored.
//!
//! A surface with a coat is both: its rough lobe ends the path as above, and with the probability of choosing the coat's delta lobe
//! the path goes on along that, as it does from a mirror. Neither lobe knows of the other's light, so that nothing is counted twice.
//!
//! Media scatter camera paths as glossy surfaces do, unless the setting `media` says that light in them is estimated by photons or beams ([`super::media`]).

pub(super) mod settings;

use super::camera_path::CameraPath;
use super::light_paths::LightPaths;
use super::media::{Records, Segment, VolumeEstimator, VolumeMap};
use super::{
    Counts, Found, GLOSSY_ROUGHNESS, Iteration, Job, Observer, Phase, RenderError, edge_limit, trace_pixels_into,
};
use crate::density::{Point, PointMap, count_edges, disc_height, radius_at};
use crate::math::Vec3;
use crate::path::{States, Vertex};
use crate::settings::PppmSettings;
use crate::spectrum::Spectrum;
use std::ops::Range;

/// Renders an iteration with photons gathered within `radius` \[scene units\].
pub(super) fn render(
    job: &Job,
    settings: &PppmSettings,
    radius: f32,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let discs = Discs {
        radius_of: |_| radius,
        widest: radius,
    };
    let gathered = gather_image(job, settings, &discs, observer)?;
    Ok(Iteration {
        pixels: gathered.pixels,
        counts: gathered.counts,
        statistics: Vec::new(),
    })
}

/// The discs in which photons count, pixel by pixel.
pub(super) struct Discs<F> {
    /// Radius of a pixel's disc \[scene units\], by index from the top left.
    pub(super) radius_of: F,
    /// The largest of them \[scene units\].
    pub(super) widest: f32,
}

/// An image by photons.
pub(super) struct Gathered {
    pub(super) pixels: Vec<Spectrum>,
    /// Photons within the discs of each pixel, the mean over its camera paths.
    pub(super) photons: Vec<f32>,
    pub(super) counts: Counts,
}

/// Light that arrived at a surface, as the map keeps it.
#[derive(Clone, Copy, Default)]
struct Photon {
    /// Unit direction that it came from.
    wi: Vec3,
    /// Corrected for the shading normal \[W\].
    flux: Spectrum,
    /// Edges of its light path.
    edges: u8,
    /// Where its path is among the words of the scene's path expression.
    states: States,
}

/// Radiance wanted from photons at a camera vertex.
struct Query<'s> {
    vertex: Vertex<'s>,
    /// Index of the pixel, from the top left.
    pixel: u32,
    /// Most edges of a light path that counts.
    limit: u8,
}

/// What the camera paths of a task want to know.
#[derive(Default)]
struct Wanted<'s> {
    queries: Vec<Query<'s>>,
    segments: Vec<Segment>,
}

/// What the light paths of a chunk leave.
#[derive(Default)]
struct Left {
    photons: Vec<Point<Photon>>,
    in_media: Records,
}

/// What light paths have left, on surfaces and in media.
struct Maps {
    photons: PointMap<Photon>,
    media: Option<VolumeMap>,
}

/// Renders an image with photons gathered in a disc of each pixel's own.
///
/// Camera paths are worked through pass by pass: they leave queries, which then read the map in an order in which those that look at the
/// same place follow each other. More light paths than a batch holds are mapped batch by batch, and every query of a pass reads all
/// these maps; such passes are longer, since each traces the light paths anew.
pub(super) fn gather_image(
    job: &Job,
    settings: &PppmSettings,
    discs: &Discs<impl Fn(usize) -> f32 + Sync>,
    observer: &dyn Observer,
) -> Result<Gathered, RenderError> {
    let media = VolumeEstimator::new(job, settings);
    let media = media.as_ref();
    let held = match media.is_some_and(VolumeEstimator::has_beams) {
        true => job.batches.of_beams(),
        false => job.batches,
    };
    let batches: Vec<Range<u32>> = held.of_light_paths(settings.photons).collect();
    let held = if batches.len() == 1 {
        job.batches.vertices
    } else {
        job.batches.vertices_of_batches
    };
    let mut counts = Counts::default();
    let maps_of = |batch: &Range<u32>, counts: &mut _| {
        trace_light(job, settings, media, batch.clone(), discs.widest, observer, counts)
    };
    let only = match &batches[..] {
        [all] => Some(maps_of(all, &mut counts)?),
        _ => None,
    };
    let mut sums = Vec::with_capacity(job.pixel_count());
    let mut photons = vec![0_u32; job.pixel_count()];
    for pass in job.passes(held, settings.samples) {
        observer.phase(Phase::TraceCamera);
        let (direct, wanted) = trace_queries(job, settings, media.is_some(), pass, observer, &mut counts)?;
        let (queries, segments): (Vec<_>, Vec<_>) = wanted
            .into_iter()
            .map(|wanted| (wanted.queries, wanted.segments))
            .unzip();
        sums.extend(direct);
        for batch in &batches {
            let of_batch;
            let maps = match &only {
                Some(maps) => maps,
                None => {
                    of_batch = maps_of(batch, &mut counts)?;
                    &of_batch
                }
            };
            observer.phase(Phase::ReadMap);
            for found in read(&maps.photons, &queries, settings.photons, discs, observer)?
                .iter()
                .flatten()
            {
                found.add_to(&mut sums, &mut counts);
                photons[found.pixel as usize] += found.counted;
            }
            if let (Some(media), Some(map)) = (media, &maps.media) {
                for found in media.read(map, &segments, settings.photons, observer)?.iter().flatten() {
                    found.add_to(&mut sums, &mut counts);
                }
            }
        }
    }
    let samples = settings.samples as f32;
    Ok(Gathered {
        pixels: sums.into_iter().map(|sum| sum * (1.0 / samples)).collect(),
        photons: photons.into_iter().map(|count| count as f32 / samples).collect(),
        counts,
    })
}

/// Traces the camera paths of a range of pixels: the sum of what each pixel's paths find without records of light paths, and what they
/// want of these. `crosses`: whether media do not scatter the paths.
fn trace_queries<'a>(
    job: &Job<'a>,
    settings: &PppmSettings,
    crosses: bool,
    pixels: Range<usize>,
    observer: &dyn Observer,
    counts: &mut Counts,
) -> Result<(Vec<Spectrum>, Vec<Wanted<'a>>), RenderError> {
    let max_edges = edge_limit(settings.max_depth);
    trace_pixels_into(
        job,
        settings.samples,
        pixels,
        observer,
        counts,
        |sample, wanted: &mut Wanted| {
            let mut path = CameraPath::new(sample.tracer, sample.camera.ray, sample.random, max_edges);
            if crosses {
                path.cross_media();
            }
            loop {
                let met = path.trace_edge();
                let crossed = path.take_crossed();
                wanted
                    .segments
                    .extend(crossed.filter_map(|crossed| Segment::new(crossed, sample.pixel, max_edges)));
                let Some(vertex) = path.arrive(&met) else {
                    break path.radiance;
                };
                let rough = !vertex.is_glossier_than(GLOSSY_ROUGHNESS);
                path.add_next_event(&vertex);
                let scattered = path.go_on(&vertex);
                if rough {
                    wanted.queries.push(Query {
                        limit: count_edges(max_edges - vertex.counted_edges),
                        vertex,
                        pixel: sample.pixel as u32,
                    });
                }
                match scattered {
                    None => break path.radiance,
                    // What the rough lobe's directions find is direct light at this vertex; the photons are all other light.
                    Some(scattered) if rough && !scattered.bsdf.delta => break path.end_with_edge(),
                    Some(_) => {}
                }
            }
        },
    )
}

/// Traces the light paths `batch` and maps what they leave, on surfaces for discs of the radius `widest` at most.
fn trace_light(
    job: &Job,
    settings: &PppmSettings,
    media: Option<&VolumeEstimator>,
    batch: Range<u32>,
    widest: f32,
    observer: &dyn Observer,
    counts: &mut Counts,
) -> Result<Maps, RenderError> {
    observer.phase(Phase::TraceLight);
    let paths = LightPaths {
        sequence: job.light_sequence(settings.photons),
        range: batch,
        max_edges: edge_limit(settings.max_depth).saturating_sub(1),
    };
    let left = paths.trace_edges(
        job.scene,
        observer,
        counts,
        |walk, tracer, random, left: &mut Left| {
            if let Some(media) = media {
                media.depart(walk, tracer, random, &mut left.in_media);
            }
        },
        |arrival, left| {
            let vertex = arrival.vertex;
            if let Some(media) = media {
                media.arrive(arrival, &mut left.in_media);
            }
            if (vertex.edges >= 2 || arrival.is_found_alone) && !vertex.is_glossier_than(GLOSSY_ROUGHNESS) {
                left.photons.push(Point {
                    position: vertex.position(),
                    payload: Photon {
                        wi: vertex.wo,
                        flux: vertex.beta,
                        edges: count_edges(vertex.counted_edges),
                        states: vertex.states.arrived,
                    },
                });
            }
        },
    )?;
    let (photons, in_media): (Vec<_>, Vec<_>) = left.into_iter().map(|left| (left.photons, left.in_media)).unzip();
    let stored = photons.iter().map(Vec::len).chain(in_media.iter().map(Records::len));
    counts.records_stored += stored.sum::<usize>() as u64;
    observer.phase(Phase::BuildMap);
    Ok(Maps {
        photons: PointMap::build(photons, widest),
        media: media.map(|_| VolumeMap::build(in_media)),
    })
}

/// What each query finds in a map of some of the `light_paths` light paths.
fn read(
    map: &PointMap<Photon>,
    queries: &[Vec<Query>],
    light_paths: u32,
    discs: &Discs<impl Fn(usize) -> f32 + Sync>,
    observer: &dyn Observer,
) -> Result<Vec<Vec<Found>>, RenderError> {
    let disc = |query: &Query| {
        let position = query.vertex.position();
        (position, radius_at((discs.radius_of)(query.pixel as usize), position))
    };
    let found = map.answer(
        queries,
        disc,
        || observer.cancelled(),
        |query, near| {
            let (position, radius) = disc(query);
            let (mut sum, mut counted) = (Spectrum::ZERO, 0);
            let read = near.query(position, radius, |photon| {
                if let Some(radiance) = reflected(photon, query) {
                    counted += 1;
                    sum += radiance;
                }
            });
            Found {
                pixel: query.pixel,
                value: query.vertex.beta * sum * (disc_height(radius) / light_paths as f32),
                read,
                counted,
            }
        },
    );
    found.ok_or(RenderError::Cancelled)
}

/// `f(wo, w_j) Phi_j` of a photon in a query's disc; `None` where it does not count.
///
/// A photon counts on the side that it came from: one that hit the back of the surface, or the far side of a thin wall, is none of
/// this side's unless the material lets it through. Photons of a surface that meets this one are taken: in a right-angled corner
/// under even light the disc loses 2 / (3 pi) = 21 % of its area on average over the places within a radius of the edge, and the
/// half of the other wall's photons that come from above this surface adds 17 %. Without them five times as much would be missing.
fn reflected(photon: &Photon, query: &Query) -> Option<Spectrum> {
    if photon.edges > query.limit || photon.states & query.vertex.states.smooth == 0 {
        return None;
    }
    let f = query.vertex.eval(photon.wi);
    let counts = query.vertex.on_side_of_wo(photon.wi) || !f.is_black();
    counts.then(|| f * photon.flux)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::{Batches, Unobserved, test_scenes};
    use crate::random::Sampling;

    /// Batches of light paths, whose images are averaged, change the image by no more than rounding.
    #[test]
    fn one_batch_or_three_make_one_image() {
        let scene = test_scenes::load("mirror-glass", 16);
        let settings = PppmSettings {
            photons: 8_000,
            samples: 2,
            ..Default::default()
        };
        let gather = |light_paths| {
            let job = Job {
                scene: &scene,
                at_rest: &scene,
                seed: 5,
                iteration: 3,
                sampling: Sampling::Sobol,
                batches: Batches {
                    light_paths,
                    ..Default::default()
                },
            };
            let discs = Discs {
                radius_of: |pixel| if pixel % 2 == 0 { 0.1 } else { 0.2 },
                widest: 0.2,
            };
            gather_image(&job, &settings, &discs, &Unobserved).unwrap()
        };
        let (one, three) = (gather(1 << 20), gather(3_001));
        assert_eq!(one.photons, three.photons, "the photons of each pixel");
        assert!(one.photons.iter().sum::<f32>() > 1_000.0);
        assert_eq!(three.counts.light_paths, 8_000);
        for (a, b) in one.pixels.iter().zip(&three.pixels) {
            let (a, b) = (a.luminance(), b.luminance());
            assert!((a - b).abs() <= 1e-5 * a, "{a} in one batch, {b} in three");
        }
    }
}

//! Probabilistic progressive photon mapping (Knaus and Zwicker 2011).
//!
//! Camera paths go on through specular and glossy surfaces and end at the first vertex that is rough enough, where the
//! map is read. Direct light there comes from next-event estimation, so photons that come straight from a light
//! are not stored: a path with `k` camera edges and `j` light edges is counted by the map where `j >= 2`, and by the
//! camera path where `j <= 1`.
//!
//! A surface with a coat is both: its rough lobe ends the path as above, and with the probability of choosing the coat's delta lobe
//! the path goes on along that, as it does from a mirror. Neither lobe knows of the other's light, so that nothing is counted twice.

pub(super) mod settings;

use super::camera_path::CameraPath;
use super::light_paths::LightPaths;
use super::{Counts, GLOSSY_ROUGHNESS, Iteration, Job, Observer, Phase, RenderError, edge_limit, trace_pixels};
use crate::map::{Reach, RecordMap, count_edges};
use crate::math::{PI, sqr};
use crate::path::Vertex;
use crate::settings::PppmSettings;
use crate::spectrum::Spectrum;
use std::ops::Range;

/// Renders an iteration with photons gathered within `radius` [scene units].
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
    /// Radius of a pixel's disc [scene units], by index from the top left.
    pub(super) radius_of: F,
    /// The largest of them [scene units].
    pub(super) widest: f32,
}

/// An image by photons.
pub(super) struct Gathered {
    pub(super) pixels: Vec<Spectrum>,
    /// Photons within the discs of each pixel, the mean over its camera paths.
    pub(super) photons: Vec<f32>,
    pub(super) counts: Counts,
}

/// Renders an image with photons gathered in a disc of each pixel's own.
///
/// More light paths than a batch holds are worked through batch by batch, with the same camera paths: the image is the mean of
/// the batches' images, weighted by their number of light paths.
pub(super) fn gather_image(
    job: &Job,
    settings: &PppmSettings,
    discs: &Discs<impl Fn(usize) -> f32 + Sync>,
    observer: &dyn Observer,
) -> Result<Gathered, RenderError> {
    let mut gathered = Gathered {
        pixels: vec![Spectrum::ZERO; job.pixel_count()],
        photons: vec![0.0; job.pixel_count()],
        counts: Counts::default(),
    };
    for batch in job.batches.of_light_paths(settings.photons) {
        let share = batch.len() as f32 / settings.photons as f32;
        let (sums, counted) = gather_batch(job, settings, batch, discs, observer, &mut gathered.counts)?;
        let samples = settings.samples as usize;
        let pixels = gathered.pixels.iter_mut().zip(&mut gathered.photons);
        for (((pixel, photons), sum), counted) in pixels.zip(sums).zip(counted.chunks(samples)) {
            *pixel += sum * (1.0 / samples as f32) * share;
            *photons += counted.iter().sum::<u32>() as f32 / samples as f32;
        }
    }
    Ok(gathered)
}

/// The sums of each pixel's camera paths, and the photons that each camera path counted.
fn gather_batch(
    job: &Job,
    settings: &PppmSettings,
    batch: Range<u32>,
    discs: &Discs<impl Fn(usize) -> f32 + Sync>,
    observer: &dyn Observer,
    counts: &mut Counts,
) -> Result<(Vec<Spectrum>, Vec<u32>), RenderError> {
    let max_edges = edge_limit(settings.max_depth);
    let light_paths = batch.len() as f32;

    observer.phase(Phase::TraceLight);
    let paths = LightPaths {
        sequence: job.light_sequence(settings.photons),
        range: batch,
        max_edges: max_edges.saturating_sub(1),
    };
    let photons = paths.trace(job.scene, observer, counts, |arrival, photons| {
        let vertex = arrival.vertex;
        if vertex.edges >= 2 && !vertex.is_glossier_than(GLOSSY_ROUGHNESS) {
            photons.push(vertex.record(vertex.wo, vertex.beta));
        }
    })?;

    observer.phase(Phase::BuildMap);
    let map = RecordMap::build(photons, &Reach::new(discs.widest, PI), false);

    observer.phase(Phase::TraceCamera);
    let pixels = 0..job.pixel_count();
    let (sums, counted) = trace_pixels(job, settings.samples, pixels, observer, counts, |sample, counted| {
        let counts = sample.counts;
        let radius = (discs.radius_of)(sample.pixel);
        let reach = Reach::new(radius, PI);
        let mut found = 0;
        let mut path = CameraPath::new(sample.tracer, sample.ray, sample.random, max_edges);
        let radiance = loop {
            let Some(vertex) = path.next_vertex() else {
                break path.radiance;
            };
            let rough = !vertex.is_glossier_than(GLOSSY_ROUGHNESS);
            if rough {
                let limit = count_edges(max_edges - vertex.edges);
                let reach = reach.at(vertex.point.position);
                let (sum, photons) = gather(&map, &reach, &vertex, limit, counts);
                found += photons;
                path.radiance += vertex.beta * (sum * (1.0 / (light_paths * PI * sqr(reach.radius()))));
            }
            path.add_next_event(&vertex);
            match path.go_on(&vertex) {
                None => break path.radiance,
                // What the rough lobe's directions find is direct light at this vertex; the photons are all other light.
                Some(scattered) if rough && !scattered.bsdf.delta => break path.end_with_edge(),
                Some(_) => {}
            }
        };
        counted.push(found);
        radiance
    })?;
    Ok((sums, counted.concat()))
}

/// `sum_j f(wo, w_j) Phi_j` over the photons in reach that came by at most `limit` edges, and their number.
///
/// A photon counts on the side that it came from: one that hit the back of the surface, or the far side of a thin wall, is none of
/// this side's unless the material lets it through. Photons of a surface that meets this one are taken: in a right-angled corner
/// under even light the disc loses 2 / (3 pi) = 21 % of its area on average over the places within a radius of the edge, and the
/// half of the other wall's photons that come from above this surface adds 17 %. Without them five times as much would be missing.
fn gather(map: &RecordMap, reach: &Reach, vertex: &Vertex, limit: u8, counts: &mut Counts) -> (Spectrum, u32) {
    let mut sum = Spectrum::ZERO;
    let mut counted = 0;
    counts.records_read += map.query(vertex.point.position, reach, |photon| {
        if photon.edges() > limit {
            return;
        }
        let f = vertex.eval(photon.direction());
        if vertex.on_side_of_wo(photon.direction()) || !f.is_black() {
            counted += 1;
            sum += f * photon.weight();
        }
    });
    counts.records_counted += u64::from(counted);
    (sum, counted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::{Batches, Unobserved};
    use crate::random::Sampling;
    use crate::scene::{Limits, Scene, SceneFolder};
    use std::collections::BTreeMap;
    use std::path::Path;

    /// Batches of light paths, whose images are averaged, change the image by no more than rounding.
    #[test]
    fn one_batch_or_three_make_one_image() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/scenes");
        let defines = BTreeMap::from([("res".to_owned(), "16".to_owned())]);
        let files = SceneFolder::new(&folder).unwrap();
        let scene = Scene::load(&files, "mirror-glass.xml", &defines, &Limits::default()).unwrap();
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

//! Density estimation in media: light that a medium scatters towards the camera, by photons or beams along the rays of camera paths.
//!
//! Which technique counts a path: camera paths are not scattered by media. They carry on the share of light that comes through, by the closed form or by
//! ratio tracking, through boundaries, mirrors, glass and glossy surfaces up to the first vertex that is rough enough for a density estimate on surfaces.
//!
//! * Light whose last vertex before these edges lies in a medium on one of them is counted by the estimator here, for light paths of
//!   one edge and more: direct light, too. No vertex in a medium is connected with a light.
//! * Light whose last such vertex is the rough surface is counted as without media: what comes from there straight from a light by
//!   connections, and by the edge that follows, which crosses media as well; all else by photons on the surface, of light paths that media may have scattered.
//! * What media emit is added along the edges that are crossed.
//!
//! The estimators of a segment of the camera path, each the mean over light paths (Krivanek et al. 2014, table 1):
//!
//! | kind | light paths leave | counted | blur |
//! | --- | --- | --- | --- |
//! | `points` | photons where they collide | about one point of the segment: `3 f / (4 pi r^3 p)`, with the point's density `p` | 3-D |
//! | `radiance` | photons where they collide | along the segment: `T_c f / (pi r^2)` (Jarosz, Zwicker and Jensen 2008) | 2-D |
//! | `beams` | edges up to the next surface | along the segment: `T_c T_l sigma_s f / (2 r sin)` (Jarosz et al. 2011, equation 38) | 1-D |
//! | `short_beams` | edges up to the next collision | the same without `T_l` | 1-D |
//!
//! where `f` is phase function times flux, and `T_c` and `T_l` are the shares of light that come through along the segment and the beam. Records count
//! in the medium that they were made in.
//!
//! Kernels shrink with the iteration: `r^d` as the area of `pppm`'s discs does, whatever their dimension `d` (Knaus and Zwicker 2011, section 4).

mod beams;
mod photons;
pub(super) mod settings;
#[cfg(test)]
pub(super) mod tests;

use super::bandwidth::media_radius;
use super::light_paths::Arrival;
use super::{Found, Job, Observer, RenderError};
use crate::density::{RayMap, ball_height, count_edges, radius_at};
use crate::geometry::Ray;
use crate::math::{PI, sqr};
use crate::medium::{Medium, MediumId, Steps};
use crate::path::{Crossed, States, Tracer, Walk};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::settings::{MediaEstimator, PppmSettings};
use crate::spectrum::Spectrum;
use beams::{Beam, Cut};
use photons::MediumPhoton;
use rayon::prelude::*;

/// How an iteration estimates light that media scatter.
pub(super) struct VolumeEstimator<'a> {
    scene: &'a Scene,
    kind: MediaEstimator,
    /// Distance within which records count \[scene units\].
    radius: f32,
    cut: Cut,
}

/// What light paths leave in media.
#[derive(Default)]
pub(super) struct Records {
    photons: Vec<MediumPhoton>,
    beams: Vec<Beam>,
}

/// What light paths have left in media, to be found by camera rays.
pub(super) struct VolumeMap {
    photons: RayMap<MediumPhoton>,
    beams: RayMap<Beam>,
}

/// A piece of a camera path's edge in a medium, along which light is wanted.
pub(super) struct Segment {
    crossed: Crossed,
    /// Index of the pixel, from the top left.
    pixel: u32,
    /// Most edges of a light path that counts.
    limit: u8,
}

impl Segment {
    /// The wish of a path of `max_edges` at most; `None` where nothing can be found.
    pub(super) fn new(crossed: Crossed, pixel: usize, max_edges: u32) -> Option<Self> {
        let limit = count_edges(max_edges.saturating_sub(crossed.counted_edges));
        (limit > 0 && crossed.states != 0 && !crossed.beta.is_black()).then_some(Self {
            crossed,
            pixel: pixel as u32,
            limit,
        })
    }

    /// Whether the light of a record counts.
    fn counts(&self, medium: MediumId, edges: u8, states: States) -> bool {
        medium == self.crossed.medium && edges <= self.limit && states & self.crossed.states != 0
    }
}

impl Records {
    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.photons.len() + self.beams.len()
    }
}

impl VolumeMap {
    /// Maps records, chunks of them in the order of paths.
    pub(super) fn build(chunks: Vec<Records>) -> Self {
        let (photons, beams) = chunks
            .into_iter()
            .map(|records| (records.photons, records.beams))
            .unzip();
        Self {
            photons: RayMap::build(photons),
            beams: RayMap::build(beams),
        }
    }
}

impl<'a> VolumeEstimator<'a> {
    /// The estimator of an iteration; `None` where camera paths are scattered by media, or there are none.
    pub(super) fn new(job: &Job<'a>, settings: &PppmSettings) -> Option<Self> {
        let dimensions = settings.media.dimensions().filter(|_| job.scene.media.is_some())?;
        let radius = media_radius(job.at_rest, settings, job.iteration, dimensions);
        Some(Self {
            scene: job.scene,
            kind: settings.media,
            radius,
            cut: Cut::new(job.scene.geometry.bounds(), radius),
        })
    }

    /// Whether light paths leave beams.
    pub(super) fn has_beams(&self) -> bool {
        self.kind.has_beams()
    }

    /// What the edge leaves that a light path is about to take.
    pub(super) fn depart(&self, walk: &Walk, tracer: &mut Tracer, random: &mut PathRandom, records: &mut Records) {
        if self.has_beams() {
            self.add_beams(walk, tracer, random, &mut records.beams);
        }
    }

    /// What a light path leaves where it arrives.
    pub(super) fn arrive(&self, arrival: &Arrival, records: &mut Records) {
        let vertex = arrival.vertex;
        if self.has_beams() || vertex.surface().is_some() {
            return;
        }
        let Some((medium, _)) = self.scene.medium(vertex.space_towards(vertex.wo)) else {
            return;
        };
        let position = vertex.position();
        records.photons.push(MediumPhoton {
            position,
            wi: vertex.wo,
            flux: vertex.beta,
            radius: radius_at(self.radius, position),
            medium,
            edges: count_edges(vertex.counted_edges),
            states: vertex.states.arrived,
        });
    }

    /// What each segment finds in a map of some of the `light_paths` light paths, in the order of segments.
    pub(super) fn read(
        &self,
        map: &VolumeMap,
        segments: &[Vec<Segment>],
        light_paths: u32,
        observer: &dyn Observer,
    ) -> Result<Vec<Vec<Found>>, RenderError> {
        let answer = |list: &Vec<Segment>| {
            if observer.cancelled() {
                return Err(RenderError::Cancelled);
            }
            let mut steps = Steps::new();
            let found = list.iter().filter_map(|segment| {
                let (_, medium) = self.scene.medium(segment.crossed.space)?;
                let mut found = match self.kind {
                    MediaEstimator::Points => points(map, segment, medium)?,
                    MediaEstimator::Radiance => radiance(map, segment, medium, &mut steps),
                    _ => self.beams(map, segment, medium, &mut steps),
                };
                found.value *= segment.crossed.beta * (1.0 / light_paths as f32);
                Some(found)
            });
            Ok(found.collect())
        };
        segments.par_iter().map(answer).collect()
    }

    /// By beams along the segment.
    fn beams(&self, map: &VolumeMap, segment: &Segment, medium: &Medium, steps: &mut Steps) -> Found {
        let ray = &segment.crossed.ray;
        let passage = medium.passage(ray, segment.crossed.random.clone(), steps);
        let mut found = segment.nothing();
        found.read = map.beams.along(ray, |beam, meeting| {
            if segment.counts(beam.medium, beam.edges, beam.states) {
                let phase = medium.phase.pdf(-beam.direction, -ray.direction);
                let height = phase / (2.0 * beam.radius * meeting.sine);
                let flux = beam.flux * self.left_of_beam(medium, meeting.along_beam);
                found.counted += 1;
                found.value += passage.share(meeting.along_ray) * flux * medium.scattering(meeting.place) * height;
            }
        });
        found
    }
}

/// By photons in a ball about a point of the segment.
fn points(map: &VolumeMap, segment: &Segment, medium: &Medium) -> Option<Found> {
    let ray = &segment.crossed.ray;
    let (distance, share) = medium.choose_distance(ray, segment.crossed.random.clone())?;
    let point = Ray {
        origin: ray.origin + ray.direction * distance,
        direction: ray.direction,
        max_distance: 0.0,
    };
    let mut found = segment.nothing();
    found.read = map.photons.along(&point, |photon, _| {
        if segment.counts(photon.medium, photon.edges, photon.states) {
            let height = ball_height(photon.radius);
            found.counted += 1;
            found.value += share * photon.flux * (medium.phase.pdf(photon.wi, -ray.direction) * height);
        }
    });
    Some(found)
}

/// By photons along the segment.
fn radiance(map: &VolumeMap, segment: &Segment, medium: &Medium, steps: &mut Steps) -> Found {
    let ray = &segment.crossed.ray;
    let passage = medium.passage(ray, segment.crossed.random.clone(), steps);
    let mut found = segment.nothing();
    found.read = map.photons.along(ray, |photon, along| {
        if segment.counts(photon.medium, photon.edges, photon.states) {
            let height = 1.0 / (PI * sqr(photon.radius));
            found.counted += 1;
            found.value += passage.share(along) * photon.flux * (medium.phase.pdf(photon.wi, -ray.direction) * height);
        }
    });
    found
}

impl Segment {
    fn nothing(&self) -> Found {
        Found {
            pixel: self.pixel,
            value: Spectrum::ZERO,
            read: 0,
            counted: 0,
        }
    }
}

//! Photon beams: the edges of light paths through media, cut into pieces.

use super::VolumeEstimator;
use crate::density::{Passable, count_edges, radius_at};
use crate::geometry::Ray;
use crate::math::Vec3;
use crate::medium::{Medium, MediumId, Passage, Steps};
use crate::path::{States, Tracer, Walk};
use crate::random::PathRandom;
use crate::settings::MediaEstimator;
use crate::spectrum::Spectrum;

/// A piece of a beam.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    pub(super) origin: Vec3,
    /// Unit vector of the light's way.
    pub(super) direction: Vec3,
    /// Of the piece \[scene units\].
    length: f32,
    /// Length of the beam before the piece, through the same medium \[scene units\].
    before: f32,
    /// Distance within which it counts \[scene units\].
    pub(super) radius: f32,
    /// Flux at the beam's start in a medium that is the same everywhere, and else that of the piece \[W\].
    pub(super) flux: Spectrum,
    pub(super) medium: MediumId,
    /// Edges of its light path, this one among them.
    pub(super) edges: u8,
    /// Where its path is among the words of the scene's path expression, before it is scattered.
    pub(super) states: States,
}

/// Where a ray and a beam come closest to each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meeting {
    /// Distance along the ray.
    pub(super) along_ray: f32,
    /// Distance along the beam, from its start.
    pub(super) along_beam: f32,
    /// The place on the beam.
    pub(super) place: Vec3,
    /// Sine of the angle between both.
    pub(super) sine: f32,
}

/// Squared sine of the angle below which a ray and a beam are parallel: they come as close to each other as they are.
const LEAST_SINE2: f64 = 1e-12;

impl Passable for Beam {
    type Found = Meeting;

    fn bounds(&self) -> (Vec3, Vec3) {
        let end = self.origin + self.direction * self.length;
        (self.origin.min(end) - self.radius, self.origin.max(end) + self.radius)
    }

    #[inline]
    fn pass(&self, ray: &Ray) -> Option<Meeting> {
        let (on, along) = (ray.direction.as_dvec3(), self.direction.as_dvec3());
        let between = self.origin.as_dvec3() - ray.origin.as_dvec3();
        let across = on.cross(along);
        let sine2 = across.length_squared();
        let apart = between.dot(across);
        let radius = f64::from(self.radius);
        if sine2 < LEAST_SINE2 || apart * apart >= radius * radius * sine2 {
            return None;
        }
        let along_ray = between.cross(along).dot(across) / sine2;
        let along_beam = between.cross(on).dot(across) / sine2;
        let meets = (0.0..f64::from(ray.max_distance)).contains(&along_ray)
            && (0.0..f64::from(self.length)).contains(&along_beam);
        meets.then(|| Meeting {
            along_ray: along_ray as f32,
            along_beam: self.before + along_beam as f32,
            place: self.origin + self.direction * along_beam as f32,
            sine: sine2.sqrt() as f32,
        })
    }
}

/// Share of its first flux below which a beam goes on by Russian roulette.
const LEAST_SHARE: f32 = 0.05;

/// Pieces of a beam through the whole scene: their boxes are tighter than one of the whole would be.
const PIECES: f32 = 24.0;

/// How long pieces are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// The middle of the scene, and half its size \[scene units\].
    middle: Vec3,
    half_size: f32,
    /// Within that distance of the middle \[scene units\].
    length: f32,
}

impl Cut {
    /// Of beams of this radius in a scene of these bounds.
    pub(super) fn new((lower, upper): (Vec3, Vec3), radius: f32) -> Self {
        let size = (upper - lower).length();
        let length = (size / PIECES).max(2.0 * radius);
        Self {
            middle: 0.5 * (lower + upper),
            half_size: (0.5 * size).max(length),
            length,
        }
    }

    /// Length of a piece that begins at a place. Far from the scene they grow longer, so that a beam to infinity has few.
    fn length_at(&self, place: Vec3) -> f32 {
        self.length * (place.distance(self.middle) / self.half_size).max(1.0)
    }
}

impl VolumeEstimator<'_> {
    /// Makes beams of the next edge of a light path.
    pub(super) fn add_beams(&self, walk: &Walk, tracer: &mut Tracer, random: &mut PathRandom, beams: &mut Vec<Beam>) {
        let mut flux = walk.carried.beta();
        let of_path = (count_edges(walk.counted_with_next()), walk.states);
        tracer.for_each_piece(walk.way(), |inside, piece| {
            flux = self.add_pieces((inside.id, inside.medium), of_path, piece, flux, random, beams);
            !flux.is_black()
        });
    }

    /// Cuts the part of a beam along `ray` that lies in one medium into pieces. Returns the flux that comes out of it.
    fn add_pieces(
        &self,
        (id, medium): (MediumId, &Medium),
        (edges, states): (u8, States),
        ray: &Ray,
        mut flux: Spectrum,
        random: &mut PathRandom,
        beams: &mut Vec<Beam>,
    ) -> Spectrum {
        let (mut steps, numbers) = (Steps::new(), random.apart());
        let (end, passage) = match self.kind {
            MediaEstimator::ShortBeams => medium.short_passage(ray, numbers, &mut steps),
            _ => (ray.max_distance, medium.passage(ray, numbers, &mut steps)),
        };
        let ends_within = end < ray.max_distance;
        // What matters of the flux is what is scattered.
        let importance = medium.scattered_colour();
        let first = (flux * importance).max_component();
        let Some((start, last)) = medium.reach(ray, end).filter(|_| first > 0.0) else {
            return if ends_within {
                Spectrum::ZERO
            } else {
                flux * passage.share(end)
            };
        };
        let mut roulette = random.apart();
        let mut at = start;
        while at < last {
            let place = ray.origin + ray.direction * at;
            let share = passage.share(at);
            let survival = (flux * share * importance).max_component() / (first * LEAST_SHARE);
            if survival < 1.0 {
                if roulette.next_1d() >= survival {
                    return Spectrum::ZERO;
                }
                flux *= 1.0 / survival;
            }
            let next = passage.next_step(at).min(at + self.cut.length_at(place)).min(last);
            let finite = at.is_finite() && next.is_finite();
            if !finite || next <= at {
                return Spectrum::ZERO;
            }
            let far = ray.origin + ray.direction * next;
            beams.push(Beam {
                origin: place,
                direction: ray.direction,
                length: next - at,
                before: at,
                radius: radius_at(self.radius, place.abs().max(far.abs())),
                flux: match passage {
                    Passage::Steps(_) => flux * share,
                    Passage::Even(_) | Passage::Flown(_) => flux,
                },
                medium: id,
                edges,
                states,
            });
            at = next;
        }
        match ends_within {
            true => Spectrum::ZERO,
            false => flux * passage.share(end),
        }
    }

    /// Share of a beam's flux that is left at a distance from its start, where the piece does not hold it already.
    pub(super) fn left_of_beam(&self, medium: &Medium, distance: f32) -> Spectrum {
        medium
            .even_passage(self.kind == MediaEstimator::ShortBeams)
            .map_or(Spectrum::ONE, |passage| passage.share(distance))
    }
}

//! Participating media: what fills the space between surfaces, absorbs light, scatters it and glows.
//!
//! A [`Medium`] is extinction, albedo, emission and a [`Phase`]. A surface says what lies on its two sides ([`Boundary`]), or bounds a [`Body`], which may
//! overlap others; a path keeps in mind what it is in ([`Space`]). [`Medium::fly`] takes a path on to where it is scattered, or to the end of its way: in a
//! medium that is the same everywhere by the closed form, and in one that varies by delta tracking through bounds of its bricks
//! (Woodcock et al. 1965; Galtier et al. 2013). [`Medium::transmittance`] is the share of light that comes through, by the closed form or by ratio
//! tracking (Novak, Selle and Jarosz 2014).
//!
//! Extinction differs between the channels of a colour, but a path has one length: one channel, the *hero* of the path,
//! chooses it, and every path counts with the mean of the densities that all channels would have given it (Wilkie et al.
//! 2014; Miller, Georgiev and Jarosz 2019). [`Carried`] holds these densities.

mod bodies;
mod carried;
mod crossing;
mod field;
mod grid;
mod phase;
mod space;
mod volume;

pub use bodies::{Body, BodyId, Space};
pub(crate) use bodies::{MOST_BODIES, Sides};
pub(crate) use carried::Carried;
pub(crate) use crossing::{Passage, Steps};
pub use field::Field;
pub use grid::{Grid, Interpolation};
pub use phase::{Phase, PhaseTable};
pub use volume::{GridVolume, Volume};

use crate::geometry::Ray;
use crate::math::{Vec3, exp, exp_m1, ln_1p};
use crate::random::PathRandom;
use crate::spectrum::Spectrum;

/// Index of a medium in [`Media::media`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MediumId(pub u16);

/// What lies on the sides of a shape; `None` is empty space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Boundary {
    /// On the inner side.
    pub interior: Option<MediumId>,
    /// On the outer side, to which the normal points.
    pub exterior: Option<MediumId>,
}

/// The media of a scene.
#[derive(Clone, Debug)]
pub struct Media {
    /// All of them.
    pub media: Vec<Medium>,
    /// Whether all of them are the same in all channels that choose the lengths of paths.
    pub grey: bool,
    /// Bodies, those before others that hold where both lie.
    pub bodies: Vec<Body>,
    /// What the camera is in.
    pub camera: Space,
    /// What fills all space around the scene.
    pub around: Option<MediumId>,
    /// What each light is in, by [`crate::light::LightId`], where it does not lie on a boundary or at infinity.
    pub lights: Vec<Space>,
}

/// A medium, as validated data.
#[derive(Clone, Debug)]
pub struct Medium {
    /// Extinction coefficient.
    pub extinction: Extinction,
    /// Share of what is extinguished that is scattered, in \[0, 1\].
    pub albedo: Volume,
    /// Radiance that it emits per length \[W/(m^2 sr) / unit\]; where the extinction varies, none counts where the lattice holds none.
    pub emission: Volume,
    /// How it scatters.
    pub phase: Phase,
}

/// How much light is lost along a way, per length \[1/unit\].
#[derive(Clone, Debug)]
pub enum Extinction {
    /// The same everywhere.
    Uniform(Spectrum),
    /// That of a lattice; around it is nothing.
    Varying(Box<Field>),
}

/// How a flight through a medium ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Flight {
    /// Distance at which the path is scattered; `None` where it comes to the end of its way.
    pub(crate) scattered_at: Option<f32>,
    /// What the medium's glow on the way gives the path, all weights applied.
    pub(crate) glow: Spectrum,
}

impl Boundary {
    /// What lies on the side to which `direction` leads from the surface of this normal.
    pub(crate) fn towards(self, direction: Vec3, normal: Vec3) -> Option<MediumId> {
        match direction.dot(normal) > 0.0 {
            true => self.exterior,
            false => self.interior,
        }
    }
}

impl Media {
    pub(crate) fn get(&self, id: MediumId) -> &Medium {
        &self.media[id.0 as usize]
    }
}

impl Medium {
    /// Takes a path on along a ray of the length `distance`, perhaps infinite, until it is scattered or there. `hero` is the channel that chooses.
    pub(crate) fn fly(
        &self,
        ray: &Ray,
        distance: f32,
        hero: usize,
        carried: &mut Carried,
        random: &mut PathRandom,
    ) -> Flight {
        match &self.extinction {
            Extinction::Uniform(sigma_t) => self.fly_evenly(*sigma_t, ray, distance, hero, carried, random),
            Extinction::Varying(field) => self.track(field, ray, distance, hero, carried, &mut random.apart()),
        }
    }

    /// A flight where the extinction is `sigma_t`: its length has the density `sigma_t exp(-sigma_t t)`.
    fn fly_evenly(
        &self,
        sigma_t: Spectrum,
        ray: &Ray,
        distance: f32,
        hero: usize,
        carried: &mut Carried,
        random: &mut PathRandom,
    ) -> Flight {
        let emission = self.emission.constant();
        let glow = match emission.is_black() {
            true => Spectrum::ZERO,
            false => carried.beta() * emission * sigma_t.map(|sigma| seen_length(sigma, distance)),
        };
        let free = -ln_1p(-random.next_1d()) / sigma_t[hero];
        // Without extinction in the hero's channel the length is infinite, or no number.
        if free < distance {
            let passed = transmitted(sigma_t, free);
            let density = sigma_t * passed;
            carried.scattered(density * self.albedo.at(at(ray, free)), density, density[hero]);
            return Flight {
                scattered_at: Some(free),
                glow,
            };
        }
        let passed = transmitted(sigma_t, distance);
        carried.passed(passed, passed[hero]);
        Flight {
            scattered_at: None,
            glow,
        }
    }

    /// A flight from one tentative collision to the next: they have the density of the bound, the same in all channels, and are real
    /// with the probability of the extinction over the bound.
    fn track(
        &self,
        field: &Field,
        ray: &Ray,
        distance: f32,
        hero: usize,
        carried: &mut Carried,
        random: &mut PathRandom,
    ) -> Flight {
        let mut flight = Flight {
            scattered_at: None,
            glow: Spectrum::ZERO,
        };
        let mut decisions = random.apart();
        field.collisions(ray, distance, random, |collision| {
            let real = field.at(&collision) * (1.0 / collision.bound);
            let place = at(ray, collision.distance);
            let emission = self.emission.at(place);
            if !emission.is_black() {
                flight.glow += carried.beta() * emission * (1.0 / collision.bound);
            }
            if decisions.next_1d() < real[hero] {
                carried.scattered(real * self.albedo.at(place), real, real[hero]);
                flight.scattered_at = Some(collision.distance);
                return false;
            }
            let fictitious = real.map(|real| (1.0 - real).max(0.0));
            carried.passed(fictitious, fictitious[hero]);
            !carried.is_black()
        });
        flight
    }

    /// An estimate of the share of light that comes through along a ray of the length `distance`, perhaps infinite.
    pub(crate) fn transmittance(&self, ray: &Ray, distance: f32, random: &mut PathRandom) -> Spectrum {
        match &self.extinction {
            Extinction::Uniform(sigma_t) => transmitted(*sigma_t, distance),
            Extinction::Varying(field) => {
                let mut passed = Spectrum::ONE;
                field.collisions(ray, distance, &mut random.apart(), |collision| {
                    let real = field.at(&collision) * (1.0 / collision.bound);
                    passed *= real.map(|real| (1.0 - real).max(0.0));
                    !passed.is_black()
                });
                passed
            }
        }
    }

    /// What stands for the share of light that comes through where techniques are weighed, a function of the way alone: the mean over
    /// channels in a medium that is the same everywhere, and 1 in others.
    pub(crate) fn expected_transmittance(&self, distance: f32) -> f32 {
        match &self.extinction {
            Extinction::Uniform(sigma_t) => transmitted(*sigma_t, distance).mean(),
            Extinction::Varying(_) => 1.0,
        }
    }

    /// The distances along a ray of the length `distance` between which the medium can scatter.
    pub(crate) fn reach(&self, ray: &Ray, distance: f32) -> Option<(f32, f32)> {
        match &self.extinction {
            Extinction::Uniform(_) => Some((0.0, distance)),
            Extinction::Varying(field) => field.reach(ray, distance),
        }
    }

    /// An extinction in proportion to which lengths are drawn where any density will do: in a lattice half its bound in the bricks that hold
    /// something, on the mean.
    pub(crate) fn typical_extinction(&self) -> Spectrum {
        match &self.extinction {
            Extinction::Uniform(sigma_t) => *sigma_t,
            Extinction::Varying(field) => Spectrum::splat(0.5 * field.mean_bound()),
        }
    }

    /// Whether it emits light.
    pub(crate) fn glows(&self) -> bool {
        !matches!(&self.emission, Volume::Constant(emission) if emission.is_black())
    }

    /// The scattering coefficient at a place \[1/unit\].
    pub(crate) fn scattering(&self, place: Vec3) -> Spectrum {
        let sigma_t = match &self.extinction {
            Extinction::Uniform(sigma_t) => *sigma_t,
            Extinction::Varying(field) => field.at_place(place),
        };
        match sigma_t.is_black() {
            true => sigma_t,
            false => sigma_t * self.albedo.at(place),
        }
    }

    /// Whether it is the same in all channels that choose the lengths of paths.
    pub(crate) fn is_grey(&self) -> bool {
        match &self.extinction {
            Extinction::Uniform(sigma_t) => is_grey(*sigma_t),
            Extinction::Varying(field) => field.is_grey(),
        }
    }
}

fn is_grey(value: Spectrum) -> bool {
    value == Spectrum::splat(value[0])
}

fn at(ray: &Ray, distance: f32) -> Vec3 {
    ray.origin + ray.direction * distance
}

/// `sigma distance`, where one may be zero and the other infinite.
fn optical_depth(sigma: f32, distance: f32) -> f32 {
    if sigma == 0.0 { 0.0 } else { sigma * distance }
}

/// The integral of the transmittance over a way: the length of the medium that is seen. Of an infinite way without extinction it counts as zero.
fn seen_length(sigma: f32, distance: f32) -> f32 {
    match (sigma > 0.0, distance.is_finite()) {
        (true, _) => -exp_m1(-sigma * distance) / sigma,
        (false, true) => distance,
        (false, false) => 0.0,
    }
}

/// The law of Beer and Lambert.
fn transmitted(sigma_t: Spectrum, distance: f32) -> Spectrum {
    sigma_t.map(|sigma| exp(-optical_depth(sigma, distance)))
}

#[cfg(test)]
pub(crate) mod tests;

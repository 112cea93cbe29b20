//! What a ray meets that hits nothing.

use super::Lights;
use super::portal::Opening;
use crate::geometry::Ray;
use crate::math::Vec3;
use crate::spectrum::Spectrum;

/// Lights at infinity that fill directions and are sampled as one: all that have no portal, or one that has, with the probability of
/// choosing it. What several of them send along a ray adds up, and each part has a density of its own.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Beyond<'a> {
    lights: &'a Lights,
    portal: Option<(f32, &'a Opening)>,
}

impl Beyond<'_> {
    /// Radiance that arrives from the unit vector `direction`.
    #[inline]
    pub(crate) fn radiance(&self, direction: Vec3) -> Spectrum {
        match self.portal {
            None => self.lights.background(direction),
            Some((_, opening)) => opening.radiance(direction),
        }
    }

    /// Density [1/sr, choice of light included] with which [`Lights::sample_direct`] at `from` returns `direction`.
    #[inline]
    pub(crate) fn pdf_direct(&self, from: Vec3, direction: Vec3) -> f32 {
        match self.portal {
            None => self.lights.pdf_background(direction),
            Some((probability, opening)) => probability * opening.pdf(from, direction),
        }
    }

    /// The same, and the density with which [`Lights::sample_emission`] starts light paths that come from there, by solid angle and by area
    /// that faces them [1/(sr unit^2)].
    pub(crate) fn densities(&self, from: Vec3, direction: Vec3) -> (f32, f32) {
        let connected = self.pdf_direct(from, direction);
        let emitted = match self.portal {
            None => connected * self.lights.pdf_through_scene(),
            Some((probability, opening)) => probability * opening.pdf_emission(direction),
        };
        (connected, emitted)
    }
}

impl Lights {
    /// What arrives along a ray that hits nothing.
    #[inline]
    pub(crate) fn beyond<'a>(&'a self, ray: &Ray) -> impl Iterator<Item = Beyond<'a>> + use<'a> {
        let (from, direction) = (ray.origin, ray.direction);
        let passed = move |(_, opening): &(f32, &Opening)| opening.is_passed(from, direction);
        let portals = self.portals().filter(passed).map(Some);
        std::iter::once(None)
            .chain(portals)
            .map(|portal| Beyond { lights: self, portal })
    }
}

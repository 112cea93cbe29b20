//! What a path carries through media.

use crate::spectrum::Spectrum;

/// The weight of a path whose lengths one channel has chosen, and the densities of the path for each channel.
///
/// All densities are over that of the hero alone, with which the path was sampled: the path's contribution over this density is `weight`,
/// and its value is `weight` over the mean of the densities, which is the balance heuristic over channels (Miller, Georgiev and Jarosz
/// 2019, section 5).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Carried {
    weight: Spectrum,
    /// Density of the path had each channel been the hero.
    density: Spectrum,
    /// Density of the path had its last vertex been connected with what is found at the end of the path, without the density of what it is connected with
    /// and with the direction's own \[1/sr\] left out: since the vertex a connection goes straight on, whatever the medium.
    connected: Spectrum,
}

impl Carried {
    pub(crate) fn new(weight: Spectrum) -> Self {
        Self {
            weight,
            density: Spectrum::ONE,
            connected: Spectrum::ONE,
        }
    }

    /// What the path carries.
    #[inline]
    pub(crate) fn beta(&self) -> Spectrum {
        self.weight * (1.0 / self.density.mean())
    }

    pub(crate) fn is_black(&self) -> bool {
        self.weight.is_black()
    }

    /// The path is scattered: `value` is what scattering at this distance contributes, `density` that of each channel, and `sampled` the
    /// hero's.
    pub(super) fn scattered(&mut self, value: Spectrum, density: Spectrum, sampled: f32) {
        self.weight *= value * (1.0 / sampled);
        self.density *= density * (1.0 / sampled);
    }

    /// The path gets through: with the probability `passed` for each channel, which is also the share of light that gets through;
    /// `sampled` is the hero's.
    pub(super) fn passed(&mut self, passed: Spectrum, sampled: f32) {
        let ratio = passed * (1.0 / sampled);
        self.weight *= ratio;
        self.density *= ratio;
        self.connected *= 1.0 / sampled;
    }

    /// The path goes on from a vertex in a direction sampled there, with a factor on what it carries.
    #[inline]
    pub(crate) fn turned(&mut self, factor: Spectrum) {
        self.weight *= factor;
        self.connected = self.density;
    }

    /// The path crosses a medium without being scattered: `share` of the light comes through, and every channel would have gone on.
    pub(crate) fn crossed(&mut self, share: Spectrum) {
        self.weight *= share;
    }

    /// A factor on what the path carries.
    #[inline]
    pub(crate) fn scale(&mut self, factor: f32) {
        self.weight *= factor;
    }

    /// What the path carries to what it has found, with its share beside a connection of its last vertex, whose density is `ratio` times that of
    /// the direction.
    pub(crate) fn beta_beside_connection(&self, ratio: f32) -> Spectrum {
        self.weight * (1.0 / (self.density + self.connected * ratio).mean())
    }

    /// What the path carries to what its last vertex is connected with, where light comes through with the share `transmittance`. The direction has
    /// `ratio` times the density of the connection; 0 where no direction finds it.
    pub(crate) fn beta_of_connection(&self, transmittance: Spectrum, ratio: f32) -> Spectrum {
        let found = transmittance * ratio;
        self.weight * (1.0 / (self.density * (Spectrum::ONE + found)).mean())
    }
}

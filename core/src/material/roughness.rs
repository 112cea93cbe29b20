//! Roughness as scenes give it, and numbers from textures.

use super::{MicrofacetKind, Microfacets};
use crate::math::Vec2;
use crate::texture::{Texture, TexturePoint};

/// Largest roughness.
const ROUGHEST: f32 = 10.0;

/// Distribution of microfacet normals whose roughness may vary over the surface.
#[derive(Clone, Debug)]
pub struct Roughness {
    /// Which distribution.
    pub kind: MicrofacetKind,
    /// Roughness along the tangent and the bitangent, as numbers ([`crate::spectrum::Spectrum::number`]); values below 1e-4 count as 1e-4,
    /// and above 10 as 10.
    pub alpha: [Texture; 2],
}

impl Roughness {
    /// The distribution at a point.
    pub(super) fn at(&self, at: &TexturePoint) -> Microfacets {
        let [u, v] = &self.alpha;
        Microfacets {
            kind: self.kind,
            alpha: Vec2::new(number(u, at), number(v, at)).min(Vec2::splat(ROUGHEST)),
        }
    }

    /// The mean over the textures and both axes.
    #[must_use]
    pub fn mean(&self) -> f32 {
        let [u, v] = &self.alpha;
        (0.5 * (u.mean().number() + v.mean().number())).min(ROUGHEST)
    }
}

/// What a texture says as a number, as Mitsuba's `eval_1`.
fn number(texture: &Texture, at: &TexturePoint) -> f32 {
    texture.eval(at).number()
}

/// As [`number`], within [0, 1].
pub(super) fn share(texture: &Texture, at: &TexturePoint) -> f32 {
    number(texture, at).clamp(0.0, 1.0)
}

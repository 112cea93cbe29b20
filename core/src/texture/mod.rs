//! Textures: colour as a function of the place on a surface.
//!
//! Conventions are Mitsuba 3's: u runs to the right, v runs *down* the image, texel (i, j) covers
//! `[i, i + 1) / width` by `[j, j + 1) / height`, and its value holds at its centre.

mod attribute;
mod bitmap;
mod mapping;
mod noise;
mod pattern;
mod tiles;

pub use attribute::AttributeTexture;
pub use bitmap::{Bitmap, Texels, TextureFilter, WrapMode};
pub use mapping::{Mapping, UvTransform};
pub(crate) use noise::perlin;
pub use noise::{Noise, Octaves};
pub use pattern::{Curve, Pattern};
pub use tiles::{TileFile, Tiles};

use crate::geometry::SurfacePoint;
use crate::math::{Vec2, Vec3};
use crate::spectrum::Spectrum;
use std::sync::Arc;

/// A reflectance, radiance or optical constant that may vary over the surface. Whoever builds one checks the range of
/// its values (a reflectance lies in [0, 1], a radiance is finite and not negative): evaluation does not.
#[derive(Clone, Debug)]
pub enum Texture {
    /// The same everywhere.
    Constant(Spectrum),
    /// An image; the transform is applied to the surface coordinates first.
    Bitmap(Arc<Bitmap>, UvTransform),
    /// What is computed, or made of other textures.
    Pattern(Arc<Pattern>),
    /// What a mesh says of its vertices or triangles. It belongs to this mesh alone.
    Attribute(Arc<AttributeTexture>),
}

/// What a texture is a function of.
#[derive(Clone, Copy, Debug)]
pub struct TexturePoint {
    /// Surface coordinates.
    pub uv: Vec2,
    /// Position in the world [scene units].
    pub position: Vec3,
    /// Unit normal of the surface, or zero where there is none.
    pub normal: Vec3,
    /// The triangle of a mesh.
    pub primitive: u32,
    /// Barycentric coordinates of the triangle's second and third vertex.
    pub barycentric: Vec2,
}

impl TexturePoint {
    /// A point that is no point of a surface, in the origin.
    #[must_use]
    pub fn of_uv(uv: Vec2) -> Self {
        Self {
            uv,
            position: Vec3::ZERO,
            normal: Vec3::ZERO,
            primitive: 0,
            barycentric: Vec2::ZERO,
        }
    }
}

impl From<&SurfacePoint> for TexturePoint {
    fn from(point: &SurfacePoint) -> Self {
        Self {
            uv: point.uv,
            position: point.position,
            normal: point.geometric_normal,
            primitive: point.primitive,
            barycentric: point.barycentric,
        }
    }
}

impl From<Pattern> for Texture {
    fn from(pattern: Pattern) -> Self {
        Self::Pattern(Arc::new(pattern))
    }
}

impl Texture {
    /// The value at a point.
    #[inline]
    #[must_use]
    pub fn eval(&self, at: &TexturePoint) -> Spectrum {
        match self {
            Self::Constant(value) => *value,
            varying => varying.look_up(at),
        }
    }

    /// [`Self::eval`] of what is no constant.
    fn look_up(&self, at: &TexturePoint) -> Spectrum {
        match self {
            Self::Constant(value) => *value,
            Self::Bitmap(bitmap, to_uv) => bitmap.eval(to_uv.apply(at.uv)),
            Self::Pattern(pattern) => pattern.eval(at),
            Self::Attribute(attribute) => attribute.eval(at),
        }
    }

    /// The value at a point of a texture that is grey: all channels are the same.
    #[must_use]
    pub fn grey(&self, at: &TexturePoint) -> f32 {
        self.eval(at)[0]
    }

    /// Derivatives of the value as a number ([`Spectrum::number`]) by u and by v.
    #[must_use]
    pub fn gradient(&self, at: &TexturePoint) -> Vec2 {
        match self {
            Self::Constant(_) => Vec2::ZERO,
            Self::Bitmap(bitmap, to_uv) => to_uv.gradient(bitmap.gradient(to_uv.apply(at.uv))),
            Self::Pattern(pattern) => pattern.gradient(at),
            Self::Attribute(attribute) => attribute.gradient(at),
        }
    }

    /// The mean over the whole pattern: over one period, for a bitmap over its texels, and for noise over a part of space. Lights
    /// take it for their power; it visits every texel.
    #[must_use]
    pub fn mean(&self) -> Spectrum {
        match self {
            Self::Constant(value) => *value,
            Self::Bitmap(bitmap, _) => Spectrum::average(bitmap.texels.iter()),
            Self::Pattern(pattern) => pattern.mean(),
            Self::Attribute(attribute) => Spectrum::average(attribute.values.iter().copied()),
        }
    }

    /// A bound on its channels; it visits every texel.
    #[must_use]
    pub fn brightest(&self) -> f32 {
        match self {
            Self::Constant(value) => value.max_component(),
            Self::Bitmap(bitmap, _) => bitmap.texels.brightest(),
            Self::Pattern(pattern) => pattern.brightest(),
            Self::Attribute(attribute) => {
                let channels = attribute.values.iter().map(|value| value.max_component());
                channels.fold(0.0, f32::max)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SKEW: UvTransform = UvTransform {
        linear: [Vec2::new(1.5, 0.2), Vec2::new(-0.4, 2.0)],
        offset: Vec2::new(0.3, -0.1),
    };

    fn chequers(to_uv: UvTransform) -> Texture {
        Texture::from(Pattern::Checkerboard {
            even: Texture::Constant(Spectrum::ONE),
            odd: Texture::Constant(Spectrum::ZERO),
            to_uv,
        })
    }

    /// Values of Mitsuba 3.9.1.
    #[test]
    fn the_chequers_agree_with_mitsuba() {
        let uvs = [
            [0.1, 0.2],
            [0.6, 0.2],
            [0.6, 0.7],
            [0.1, 0.7],
            [-0.1, 0.3],
            [0.5, 0.1],
            [1.7, -2.2],
        ];
        let cases = [
            (UvTransform::IDENTITY, [true, false, true, false, false, true, true]),
            (SKEW, [true, true, true, false, false, false, false]),
        ];
        for (to_uv, evens) in cases {
            let texture = chequers(to_uv);
            for (uv, even) in uvs.into_iter().zip(evens) {
                assert_eq!(
                    texture.eval(&TexturePoint::of_uv(uv.into())) == Spectrum::ONE,
                    even,
                    "{to_uv:?} {uv:?}"
                );
            }
        }
    }

    #[test]
    fn means_are_means() {
        let texels = (0..12).map(|i| Spectrum::from_rgb([(i % 4) as f32, (i / 4) as f32, 0.5]));
        let bitmap = Bitmap {
            width: 4,
            height: 3,
            texels: texels.collect::<Vec<_>>().into(),
            wrap: WrapMode::Repeat,
            filter: TextureFilter::Bilinear,
        };
        let bitmap = Texture::Bitmap(Arc::new(bitmap), SKEW);
        assert_eq!((bitmap.mean().to_rgb(), bitmap.brightest()), ([1.5, 1.0, 0.5], 3.0));
        assert_eq!(chequers(SKEW).mean(), Spectrum::splat(0.5));
    }
}

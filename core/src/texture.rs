//! Textures: colour as a function of surface coordinates.

use crate::math::Vec2;
use crate::spectrum::Spectrum;
use std::sync::Arc;

/// A reflectance, radiance or optical constant that may vary over the surface.
#[derive(Clone, Debug)]
pub enum Texture {
    /// The same everywhere.
    Constant(Spectrum),
    /// Two colours in a chequer pattern; `to_uv` is applied to the surface coordinates first.
    Checkerboard {
        even: Spectrum,
        odd: Spectrum,
        to_uv: UvTransform,
    },
    /// An image.
    Bitmap(Arc<Bitmap>, UvTransform),
}

/// Affine map of surface coordinates: `scale`-rotation part by rows, then offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UvTransform {
    /// Rows of the linear part.
    pub linear: [Vec2; 2],
    /// Added after the linear part.
    pub offset: Vec2,
}

/// A decoded image in linear colour, rows from top to bottom.
#[derive(Clone, Debug)]
pub struct Bitmap {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// `width * height` texels.
    pub texels: Vec<Spectrum>,
    /// How coordinates outside [0, 1) are treated.
    pub wrap: WrapMode,
    /// How texels are interpolated.
    pub filter: TextureFilter,
}

/// Treatment of coordinates outside the image (Mitsuba's `wrap_mode`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WrapMode {
    Repeat,
    Mirror,
    Clamp,
}

/// Interpolation (Mitsuba's `filter_type`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextureFilter {
    Nearest,
    Bilinear,
}

impl Texture {
    /// The value at surface coordinates `uv`.
    #[must_use]
    pub fn eval(&self, uv: Vec2) -> Spectrum {
        match self {
            Self::Constant(value) => *value,
            _ => unimplemented!("{uv}"),
        }
    }
}

//! Images as textures.

use super::tiles::Tiles;
use crate::math::Vec2;
use crate::spectrum::Spectrum;

/// A decoded image, rows from top to bottom. It has at least one texel and fewer than 2^30 per axis.
#[derive(Clone, Debug)]
pub struct Bitmap {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// `width * height` texels.
    pub texels: Texels,
    /// How coordinates outside [0, 1) are treated.
    pub wrap: WrapMode,
    /// How texels are interpolated.
    pub filter: TextureFilter,
}

/// Texels in linear colour, row by row from the top left. Images of bytes stay bytes: they are decoded where they are looked up.
#[derive(Clone, Debug)]
pub enum Texels {
    /// A colour each.
    Colours(Vec<Spectrum>),
    /// The same number in every channel.
    Greys(Vec<f32>),
    /// Three bytes each, with the number that a byte stands for.
    ColourBytes(Vec<[u8; 3]>, Box<[f32; 256]>),
    /// A byte each, with the number that it stands for in every channel.
    GreyBytes(Vec<u8>, Box<[f32; 256]>),
    /// In a temporary file.
    Tiled(Tiles),
}

impl From<Vec<Spectrum>> for Texels {
    fn from(colours: Vec<Spectrum>) -> Self {
        Self::Colours(colours)
    }
}

impl Texels {
    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Colours(texels) => texels.len(),
            Self::Greys(texels) => texels.len(),
            Self::ColourBytes(texels, _) => texels.len(),
            Self::GreyBytes(texels, _) => texels.len(),
            Self::Tiled(tiles) => tiles.len(),
        }
    }

    /// Bytes of memory that they take.
    #[must_use]
    pub fn memory(&self) -> u64 {
        let each = match self {
            Self::Colours(_) => size_of::<Spectrum>(),
            Self::Greys(_) => size_of::<f32>(),
            Self::ColourBytes(..) => 3,
            Self::GreyBytes(..) => 1,
            Self::Tiled(_) => 0,
        };
        self.len() as u64 * each as u64
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The texel of an index below [`Self::len`].
    #[must_use]
    #[inline]
    pub fn get(&self, index: usize) -> Spectrum {
        match self {
            Self::Colours(texels) => texels[index],
            Self::Greys(texels) => Spectrum::splat(texels[index]),
            Self::ColourBytes(texels, values) => {
                Spectrum::from_rgb(texels[index].map(|byte| values[usize::from(byte)]))
            }
            Self::GreyBytes(texels, values) => Spectrum::splat(values[usize::from(texels[index])]),
            Self::Tiled(tiles) => tiles.get(index),
        }
    }

    /// All of them in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Spectrum> + '_ {
        (0..self.len()).map(|index| self.get(index))
    }

    /// The largest channel of any texel.
    #[must_use]
    pub fn brightest(&self) -> f32 {
        match self {
            // Reading the whole file again would take long.
            Self::Tiled(tiles) => tiles.brightest(),
            _ => self.iter().map(Spectrum::max_component).fold(0.0, f32::max),
        }
    }

    /// Applies `f` to every channel of every texel.
    #[must_use]
    pub fn map(self, mut f: impl FnMut(f32) -> f32) -> Self {
        match self {
            Self::Colours(texels) => Self::Colours(texels.into_iter().map(|texel| texel.map(&mut f)).collect()),
            Self::Greys(texels) => Self::Greys(texels.into_iter().map(f).collect()),
            Self::ColourBytes(texels, values) => Self::ColourBytes(texels, Box::new(values.map(f))),
            Self::GreyBytes(texels, values) => Self::GreyBytes(texels, Box::new(values.map(f))),
            Self::Tiled(_) => Self::Colours(self.iter().map(|texel| texel.map(&mut f)).collect()),
        }
    }
}

/// Treatment of coordinates outside the image (Mitsuba's `wrap_mode`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum WrapMode {
    /// Tiles the plane.
    Repeat,
    /// Tiles the plane, every second tile mirrored.
    Mirror,
    /// The nearest texel of the border.
    Clamp,
    /// Black outside the image (pbrt's `black`).
    Black,
}

/// Interpolation (Mitsuba's `filter_type`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TextureFilter {
    /// The texel that the point lies in.
    Nearest,
    /// Between the four nearest texel centres.
    Bilinear,
}

impl Bitmap {
    /// The value at texture coordinates `uv`.
    #[must_use]
    pub fn eval(&self, uv: Vec2) -> Spectrum {
        let (x, y) = (uv.x * self.width as f32, uv.y * self.height as f32);
        match self.filter {
            TextureFilter::Nearest => self.texel(cell_of(x).0, cell_of(y).0),
            TextureFilter::Bilinear => {
                let ((i, s), (j, t)) = (cell_of(x - 0.5), cell_of(y - 0.5));
                let row = |j| self.texel(i, j) * (1.0 - s) + self.texel(i + 1, j) * s;
                row(j) * (1.0 - t) + row(j + 1) * t
            }
        }
    }

    /// Derivatives of [`Self::eval`] as a number by the texture coordinates.
    pub(super) fn gradient(&self, uv: Vec2) -> Vec2 {
        let size = Vec2::new(self.width as f32, self.height as f32);
        let place = uv * size;
        match self.filter {
            TextureFilter::Nearest => Vec2::ZERO,
            TextureFilter::Bilinear => {
                let ((i, s), (j, t)) = (cell_of(place.x - 0.5), cell_of(place.y - 0.5));
                let texel = |i, j| self.texel(i, j).number();
                let (upper, lower) = ([texel(i, j), texel(i + 1, j)], [texel(i, j + 1), texel(i + 1, j + 1)]);
                let along = (upper[1] - upper[0]) * (1.0 - t) + (lower[1] - lower[0]) * t;
                let down = (lower[0] - upper[0]) * (1.0 - s) + (lower[1] - upper[1]) * s;
                Vec2::new(along, down) * size
            }
        }
    }

    /// The texel in column `i` and row `j`, either of which may lie outside the image.
    fn texel(&self, i: i32, j: i32) -> Spectrum {
        match (self.wrap.index(j, self.height), self.wrap.index(i, self.width)) {
            (Some(row), Some(column)) => self.texels.get(row * self.width + column),
            _ => Spectrum::ZERO,
        }
    }
}

/// Whole and fractional part of a texel coordinate; absurd and undefined coordinates are brought into range.
fn cell_of(x: f32) -> (i32, f32) {
    let x = if x.is_finite() { x.clamp(-1e9, 1e9) } else { 0.0 };
    let cell = x.floor();
    (cell as i32, x - cell)
}

impl WrapMode {
    /// The texel that stands for index `i` along an axis of `size` texels.
    fn index(self, i: i32, size: usize) -> Option<usize> {
        let size = size as i32;
        let index = match self {
            Self::Repeat => i.rem_euclid(size),
            Self::Mirror => {
                let place = i.rem_euclid(2 * size);
                place.min(2 * size - 1 - place)
            }
            Self::Clamp => i.clamp(0, size - 1),
            Self::Black if i < 0 || i >= size => return None,
            Self::Black => i,
        };
        Some(index as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::{Texture, TexturePoint, UvTransform};
    use std::sync::Arc;

    fn bitmap(wrap: WrapMode, filter: TextureFilter) -> Bitmap {
        let (width, height) = (4, 3);
        let texels = (0..height)
            .flat_map(|y| {
                (0..width).map(move |x| Spectrum::from_rgb([x as f32, y as f32, ((7 * x + 3 * y) % 5) as f32]))
            })
            .collect::<Vec<_>>();
        Bitmap {
            width,
            height,
            texels: texels.into(),
            wrap,
            filter,
        }
    }

    const POINTS: [[f32; 2]; 7] = [
        [0.1, 0.05],
        [0.3, 0.4],
        [0.95, 0.97],
        [1.3, -0.2],
        [-0.05, 2.6],
        [2.9, 1.1],
        [-1.4, -3.3],
    ];

    /// Values of Mitsuba 3.9.1 (scalar_rgb, `bitmap` with raw data) for the image above.
    #[test]
    fn lookups_agree_with_mitsuba() {
        use TextureFilter::{Bilinear, Nearest};
        use WrapMode::{Clamp, Mirror, Repeat};
        #[rustfmt::skip]
        let expected = [
            (Repeat, Nearest, [[0., 0., 0.], [1., 1., 0.], [3., 2., 2.], [1., 2., 3.], [3., 1., 4.], [3., 0., 1.],
                [2., 2., 0.]]),
            (Repeat, Bilinear, [[0.3, 0.7, 0.45], [0.7, 0.7, 1.05], [2.1, 1.18, 1.29], [0.7, 1.9, 2.25],
                [2.1, 1.3, 3.1], [2.7, 0.4, 1.1], [1.9, 1.6, 0.9]]),
            (Mirror, Nearest, [[0., 0., 0.], [1., 1., 0.], [3., 2., 2.], [2., 0., 4.], [0., 1., 3.], [3., 2., 2.],
                [2., 2., 0.]]),
            (Mirror, Bilinear, [[0., 0., 0.], [0.7, 0.7, 1.05], [3., 2., 2.], [2.3, 0.1, 3.05], [0., 1.3, 2.4],
                [3., 2., 2.], [1.9, 1.6, 0.9]]),
            (Clamp, Nearest, [[0., 0., 0.], [1., 1., 0.], [3., 2., 2.], [3., 0., 1.], [0., 2., 1.], [3., 2., 2.],
                [0., 0., 0.]]),
            (Clamp, Bilinear, [[0., 0., 0.], [0.7, 0.7, 1.05], [3., 2., 2.], [3., 0., 1.], [0., 2., 1.], [3., 2., 2.],
                [0., 0., 0.]]),
        ];
        for (wrap, filter, values) in expected {
            let bitmap = bitmap(wrap, filter);
            for (uv, value) in POINTS.into_iter().zip(values) {
                let found = bitmap.eval(uv.into()).to_rgb();
                let close = (0..3).all(|c| (found[c] - value[c]).abs() < 1e-5);
                assert!(close, "{wrap:?} {filter:?} {uv:?}: {found:?}, expected {value:?}");
            }
        }
    }

    const SKEW: UvTransform = UvTransform {
        linear: [Vec2::new(1.5, 0.2), Vec2::new(-0.4, 2.0)],
        offset: Vec2::new(0.3, -0.1),
    };

    /// Values of Mitsuba 3.9.1 with `to_uv` set to [`SKEW`].
    #[test]
    fn coordinates_are_transformed_as_in_mitsuba() {
        let texture = Texture::Bitmap(Arc::new(bitmap(WrapMode::Repeat, TextureFilter::Bilinear)), SKEW);
        for (uv, value) in [([0.3, 0.4], [2.82, 1.24, 3.16]), ([0.7, 0.9], [1.62, 0.76, 1.72])] {
            let found = texture.eval(&TexturePoint::of_uv(uv.into())).to_rgb();
            assert!((0..3).all(|c| (found[c] - value[c]).abs() < 1e-5), "{uv:?} {found:?}");
        }
    }

    /// Values of Mitsuba 3.9.1 for an image of three by two at (0.4, 0.3): of `eval_1_grad`, and with `to_uv` set to [`SKEW`] of differences of
    /// `eval_1`, since `eval_1_grad` is not the derivative of it there.
    #[test]
    fn slopes_agree_with_mitsuba() {
        let texels = [0.0, 0.2, 0.1, 0.3, 0.5, 0.05].map(Spectrum::splat).to_vec();
        let image = Arc::new(Bitmap {
            width: 3,
            height: 2,
            texels: texels.into(),
            wrap: WrapMode::Repeat,
            filter: TextureFilter::Bilinear,
        });
        for (to_uv, expected) in [
            (UvTransform::IDENTITY, Vec2::new(0.6, 0.6)),
            (SKEW, Vec2::new(-0.2329, 0.3098)),
        ] {
            let slope = Texture::Bitmap(image.clone(), to_uv).gradient(&TexturePoint::of_uv(Vec2::new(0.4, 0.3)));
            assert!((slope - expected).length() < 1e-5, "{slope}");
        }
    }

    #[test]
    fn absurd_coordinates_give_a_value() {
        for wrap in [WrapMode::Repeat, WrapMode::Mirror, WrapMode::Clamp] {
            for filter in [TextureFilter::Nearest, TextureFilter::Bilinear] {
                let bitmap = bitmap(wrap, filter);
                for x in [
                    f32::NAN,
                    f32::INFINITY,
                    f32::NEG_INFINITY,
                    f32::MAX,
                    -1e-45,
                    1.0 - 1e-8,
                    -1e9,
                ] {
                    assert!(bitmap.eval(Vec2::new(x, 0.5)).is_valid() && bitmap.eval(Vec2::new(0.5, x)).is_valid());
                }
            }
        }
    }
}

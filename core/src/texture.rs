//! Textures: colour as a function of the place on a surface.
//!
//! Conventions are Mitsuba 3's: u runs to the right, v runs *down* the image, texel (i, j) covers
//! `[i, i + 1) / width` by `[j, j + 1) / height`, and its value holds at its centre.

use crate::geometry::{SurfacePoint, TriangleMesh};
use crate::math::{Vec2, Vec3};
use crate::spectrum::Spectrum;
use std::sync::Arc;

/// A reflectance, radiance or optical constant that may vary over the surface. Whoever builds one checks the range of
/// its values (a reflectance lies in [0, 1], a radiance is finite and not negative): evaluation does not.
#[derive(Clone, Debug)]
pub enum Texture {
    /// The same everywhere.
    Constant(Spectrum),
    /// Two colours in a chequer pattern, squares of side 1/2; `to_uv` is applied to the surface coordinates first.
    Checkerboard {
        /// Where both coordinates lie in the lower, or both in the upper half of their unit (Mitsuba's `color0`).
        even: Spectrum,
        /// Elsewhere (Mitsuba's `color1`).
        odd: Spectrum,
        /// Applied to the surface coordinates.
        to_uv: UvTransform,
    },
    /// An image; the transform is applied to the surface coordinates first.
    Bitmap(Arc<Bitmap>, UvTransform),
    /// What a mesh says of its vertices or triangles. It belongs to this mesh alone.
    Attribute(Arc<AttributeTexture>),
}

/// Values of the vertices or triangles of a mesh.
#[derive(Clone, Debug)]
pub struct AttributeTexture {
    /// The mesh.
    pub mesh: Arc<TriangleMesh>,
    /// A value for each vertex, between which it is interpolated, or for each triangle.
    pub values: Vec<Spectrum>,
    /// Whether there is one for each triangle.
    pub of_faces: bool,
}

/// What a texture is a function of.
#[derive(Clone, Copy, Debug)]
pub struct TexturePoint {
    /// Surface coordinates.
    pub uv: Vec2,
    /// Position in the world [scene units].
    pub position: Vec3,
    /// The triangle of a mesh.
    pub primitive: u32,
    /// Barycentric coordinates of the triangle's second and third vertex.
    pub barycentric: Vec2,
}

impl From<&SurfacePoint> for TexturePoint {
    fn from(point: &SurfacePoint) -> Self {
        Self {
            uv: point.uv,
            position: point.position,
            primitive: point.primitive,
            barycentric: point.barycentric,
        }
    }
}

/// Affine map of surface coordinates: linear part by rows, then offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UvTransform {
    /// Rows of the linear part.
    pub linear: [Vec2; 2],
    /// Added after the linear part.
    pub offset: Vec2,
}

/// A decoded image in linear colour, rows from top to bottom. It has at least one texel and fewer than 2^30 per axis.
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
    /// Tiles the plane.
    Repeat,
    /// Tiles the plane, every second tile mirrored.
    Mirror,
    /// The nearest texel of the border.
    Clamp,
}

/// Interpolation (Mitsuba's `filter_type`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextureFilter {
    /// The texel that the point lies in.
    Nearest,
    /// Between the four nearest texel centres.
    Bilinear,
}

impl Texture {
    /// The value at a point.
    #[must_use]
    pub fn eval(&self, at: &TexturePoint) -> Spectrum {
        match self {
            Self::Constant(value) => *value,
            Self::Checkerboard { even, odd, to_uv } => {
                let cell = to_uv.apply(at.uv);
                let upper = (cell - cell.floor()).cmpgt(Vec2::splat(0.5));
                if upper.x == upper.y { *even } else { *odd }
            }
            Self::Bitmap(bitmap, to_uv) => bitmap.eval(to_uv.apply(at.uv)),
            Self::Attribute(attribute) => attribute.eval(at),
        }
    }

    /// The mean over the whole pattern: over one period, and for a bitmap over its texels. Lights take it for their
    /// power; it visits every texel.
    #[must_use]
    pub fn mean(&self) -> Spectrum {
        match self {
            Self::Constant(value) => *value,
            Self::Checkerboard { even, odd, .. } => (*even + *odd) * 0.5,
            Self::Bitmap(bitmap, _) => bitmap.mean(),
            Self::Attribute(attribute) => Spectrum::average(&attribute.values),
        }
    }
}

impl AttributeTexture {
    fn eval(&self, at: &TexturePoint) -> Spectrum {
        let triangle = at.primitive as usize;
        if self.of_faces {
            return self.values[triangle];
        }
        let [a, b, c] = self.mesh.triangles[triangle].map(|vertex| self.values[vertex as usize]);
        let [s, t] = at.barycentric.to_array();
        a * (1.0 - s - t) + b * s + c * t
    }
}

/// Distance over which textures are compared that do not tell their slope.
const SLOPE_STEP: f32 = 1.0 / 2048.0;

impl Texture {
    /// Derivatives of the value as a number ([`Spectrum::number`]) by u and by v.
    #[must_use]
    pub fn gradient(&self, at: &TexturePoint) -> Vec2 {
        match self {
            Self::Constant(_) => Vec2::ZERO,
            Self::Bitmap(bitmap, to_uv) => to_uv.gradient(bitmap.gradient(to_uv.apply(at.uv))),
            Self::Checkerboard { .. } => {
                let value = |offset: Vec2| {
                    let uv = at.uv + offset;
                    self.eval(&TexturePoint { uv, ..*at }).number()
                };
                let slope = |step: Vec2| (value(step) - value(-step)) / (2.0 * SLOPE_STEP);
                Vec2::new(slope(Vec2::X * SLOPE_STEP), slope(Vec2::Y * SLOPE_STEP))
            }
        }
    }
}

impl UvTransform {
    /// Leaves coordinates as they are.
    pub const IDENTITY: Self = Self {
        linear: [Vec2::X, Vec2::Y],
        offset: Vec2::ZERO,
    };

    /// Maps surface coordinates to texture coordinates.
    #[must_use]
    pub fn apply(&self, uv: Vec2) -> Vec2 {
        Vec2::new(self.linear[0].dot(uv), self.linear[1].dot(uv)) + self.offset
    }

    /// From derivatives by texture coordinates to derivatives by surface coordinates.
    fn gradient(&self, of_texture: Vec2) -> Vec2 {
        self.linear[0] * of_texture.x + self.linear[1] * of_texture.y
    }
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
    fn gradient(&self, uv: Vec2) -> Vec2 {
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
        self.texels[self.wrap.index(j, self.height) * self.width + self.wrap.index(i, self.width)]
    }

    fn mean(&self) -> Spectrum {
        Spectrum::average(&self.texels)
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
    fn index(self, i: i32, size: usize) -> usize {
        let size = size as i32;
        let index = match self {
            Self::Repeat => i.rem_euclid(size),
            Self::Mirror => {
                let place = i.rem_euclid(2 * size);
                place.min(2 * size - 1 - place)
            }
            Self::Clamp => i.clamp(0, size - 1),
        };
        index as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bitmap(wrap: WrapMode, filter: TextureFilter) -> Bitmap {
        let (width, height) = (4, 3);
        let texels = (0..height)
            .flat_map(|y| {
                (0..width).map(move |x| Spectrum::from_rgb([x as f32, y as f32, ((7 * x + 3 * y) % 5) as f32]))
            })
            .collect();
        Bitmap {
            width,
            height,
            texels,
            wrap,
            filter,
        }
    }

    fn at(uv: [f32; 2]) -> TexturePoint {
        TexturePoint {
            uv: uv.into(),
            position: Vec3::ZERO,
            primitive: 0,
            barycentric: Vec2::ZERO,
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
            let found = texture.eval(&at(uv)).to_rgb();
            assert!((0..3).all(|c| (found[c] - value[c]).abs() < 1e-5), "{uv:?} {found:?}");
        }
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
            let texture = Texture::Checkerboard {
                even: Spectrum::ONE,
                odd: Spectrum::ZERO,
                to_uv,
            };
            for (uv, even) in uvs.into_iter().zip(evens) {
                assert_eq!(texture.eval(&at(uv)) == Spectrum::ONE, even, "{to_uv:?} {uv:?}");
            }
        }
    }

    #[test]
    fn means_are_means() {
        let bitmap = bitmap(WrapMode::Repeat, TextureFilter::Bilinear);
        let third = [0, 2, 4, 1, 3, 0, 2, 4, 1, 3, 0, 2].iter().sum::<i32>() as f32 / 12.0;
        assert_eq!(
            Texture::Bitmap(Arc::new(bitmap), SKEW).mean().to_rgb(),
            [1.5, 1.0, third]
        );
        let chequers = Texture::Checkerboard {
            even: Spectrum::ONE,
            odd: Spectrum::ZERO,
            to_uv: SKEW,
        };
        assert_eq!(chequers.mean(), Spectrum::splat(0.5));
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

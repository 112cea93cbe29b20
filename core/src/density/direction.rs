//! Unit directions in 32 bits, by the face of a cube and the place on it, and the part of the cube that a cone covers.

use super::LANES;
use crate::math::Vec3;
use wide::{f32x4, i32x4};

/// Bits of the coordinate along a row of a face.
const COLUMN_BITS: u32 = 15;
/// Bits of the coordinate across the rows of a face.
pub(super) const ROW_BITS: u32 = 14;
const COLUMNS: f32 = (1u32 << COLUMN_BITS) as f32;
const ROWS: f32 = (1u32 << ROW_BITS) as f32;

/// Above this sine of its half angle a cone is not narrowed down: it covers most of the faces it touches.
const WIDE: f32 = 0.94;

/// Least component along a face's axis of the directions on it, that of the cube's corner, rounded down.
const LEAST_HEIGHT: f32 = 0.577;
/// Upper bound of the chord of an angle over its sine, up to that of [`WIDE`].
const CHORD_OVER_SIN: f32 = 1.25;

/// A unit direction in 32 bits: face of the cube (3 bits), row (14 bits) and column (15 bits) of the gnomonic projection.
#[must_use]
pub fn encode_direction(d: Vec3) -> u32 {
    let (x, y, z) = (d.x.abs(), d.y.abs(), d.z.abs());
    let axis = if x >= y && x >= z { 0 } else { 1 + u32::from(z > y) };
    let [along, across, height] = on_axis(d, axis);
    let face = 2 * axis + u32::from(height < 0.0);
    let inverse = 1.0 / height.abs();
    face << (ROW_BITS + COLUMN_BITS) | row(across * inverse) << COLUMN_BITS | column(along * inverse)
}

/// The unit direction of [`encode_direction`], to about 7e-5 radians.
#[must_use]
pub fn decode_direction(code: u32) -> Vec3 {
    let along = ((code & ((1 << COLUMN_BITS) - 1)) as f32 + 0.5) * (2.0 / COLUMNS) - 1.0;
    let across = ((code >> COLUMN_BITS & ((1 << ROW_BITS) - 1)) as f32 + 0.5) * (2.0 / ROWS) - 1.0;
    let scale = 1.0 / (1.0 + along * along + across * across).sqrt();
    let face = code >> (ROW_BITS + COLUMN_BITS);
    let (along, across, height) = (
        along * scale,
        across * scale,
        if face & 1 == 0 { scale } else { -scale },
    );
    match face >> 1 {
        0 => Vec3::new(height, along, across),
        1 => Vec3::new(across, height, along),
        _ => Vec3::new(along, across, height),
    }
}

/// Bits that a coarse direction drops from each coordinate.
const COARSE: u32 = 8;
const COARSE_COLUMN_BITS: u32 = COLUMN_BITS - COARSE;
const COARSE_ROW_BITS: u32 = ROW_BITS - COARSE;

/// A unit direction in 16 bits.
pub(super) fn encode_coarse(d: Vec3) -> u16 {
    let code = encode_direction(d);
    let row = code >> COLUMN_BITS & ((1 << ROW_BITS) - 1);
    let column = code & ((1 << COLUMN_BITS) - 1);
    let face = code >> (ROW_BITS + COLUMN_BITS);
    (face << (COARSE_ROW_BITS + COARSE_COLUMN_BITS) | row >> COARSE << COARSE_COLUMN_BITS | column >> COARSE) as u16
}

/// The unit direction of [`encode_coarse`], to about a degree.
pub(super) fn decode_coarse(code: u16) -> Vec3 {
    let code = u32::from(code);
    let middle = 1 << (COARSE - 1);
    let column = (code & ((1 << COARSE_COLUMN_BITS) - 1)) << COARSE | middle;
    let row = (code >> COARSE_COLUMN_BITS & ((1 << COARSE_ROW_BITS) - 1)) << COARSE | middle;
    let face = code >> (COARSE_ROW_BITS + COARSE_COLUMN_BITS);
    decode_direction(face << (ROW_BITS + COLUMN_BITS) | row << COLUMN_BITS | column)
}

/// [`decode_direction`] for [`LANES`] directions on the same face: their components along the rows, across them, and along the
/// face's axis.
#[inline(always)]
pub(super) fn decode_on_face(codes: [u32; LANES], face: u32) -> [f32x4; 3] {
    let codes = i32x4::new(codes.map(|code| code as i32));
    let coordinate = |part: i32x4, bits: u32| {
        let index = f32x4::from_i32x4(part & i32x4::splat((1 << bits) - 1));
        (index + f32x4::splat(0.5)) * f32x4::splat(2.0 / (1u32 << bits) as f32) - f32x4::ONE
    };
    let along = coordinate(codes, COLUMN_BITS);
    let across = coordinate(codes >> COLUMN_BITS as i32, ROW_BITS);
    let scale = f32x4::ONE / (f32x4::ONE + along * along + across * across).sqrt();
    [
        along * scale,
        across * scale,
        if face & 1 == 0 { scale } else { -scale },
    ]
}

/// Coordinates of `d` along the rows of the faces of `axis`, across them, and along the axis.
pub(super) fn on_axis(d: Vec3, axis: u32) -> [f32; 3] {
    match axis {
        0 => [d.y, d.z, d.x],
        1 => [d.z, d.x, d.y],
        _ => [d.x, d.y, d.z],
    }
}

fn column(along: f32) -> u32 {
    ((along + 1.0) * (0.5 * COLUMNS)).clamp(0.0, COLUMNS - 1.0) as u32
}

fn row(across: f32) -> u32 {
    ((across + 1.0) * (0.5 * ROWS)).clamp(0.0, ROWS - 1.0) as u32
}

/// Sort key of a direction: rows of `2^shift` quantised rows, face by face, and in each the column.
pub(super) fn sort_key(code: u32, shift: u32) -> u32 {
    let column = code & ((1 << COLUMN_BITS) - 1);
    (code >> COLUMN_BITS >> shift) << COLUMN_BITS | column
}

/// A rectangle on a face of the cube; both ends of its ranges belong to it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Window {
    face: u32,
    rows: [u32; 2],
    columns: [u32; 2],
}

impl Window {
    pub(super) fn face(&self) -> u32 {
        self.face
    }

    /// Whether it has the column of a direction.
    pub(super) fn holds_column(&self, code: u32) -> bool {
        let column = code & ((1 << COLUMN_BITS) - 1);
        self.columns[0] <= column && column <= self.columns[1]
    }

    /// The range of sort keys that holds all rows of `2^shift` quantised rows, both ends included.
    pub(super) fn rows(&self, shift: u32) -> [u32; 2] {
        let row = |row: u32| (self.face << ROW_BITS | row) >> shift << COLUMN_BITS;
        [row(self.rows[0]), row(self.rows[1]) | ((1 << COLUMN_BITS) - 1)]
    }

    /// Ranges of sort keys, one a row of `2^shift` quantised rows, both ends included.
    pub(super) fn keys(&self, shift: u32) -> impl Iterator<Item = [u32; 2]> + use<> {
        let face = self.face << ROW_BITS;
        let columns = self.columns;
        ((face | self.rows[0]) >> shift..=(face | self.rows[1]) >> shift)
            .map(move |row| columns.map(|column| row << COLUMN_BITS | column))
    }
}

/// Square cells of directions that cover a cone: for each face rows and columns, both ends of their ranges included.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct CellWindows {
    faces: [[[u32; 2]; 2]; 6],
    count: usize,
}

impl CellWindows {
    pub(super) fn for_each(&self, mut visit: impl FnMut(u32)) {
        for [rows, columns] in &self.faces[..self.count] {
            for row in rows[0]..=rows[1] {
                for column in columns[0]..=columns[1] {
                    visit(row << COLUMN_BITS | column);
                }
            }
        }
    }
}

/// The cell of [`CellWindows`] with sides of `2^shift` quantised rows that a direction lies in.
pub(super) fn direction_cell(code: u32, shift: u32) -> u32 {
    let column = code & ((1 << COLUMN_BITS) - 1);
    (code >> COLUMN_BITS >> shift) << COLUMN_BITS | column >> (shift + COLUMN_BITS - ROW_BITS)
}

/// The shift for which the height of `2^shift` quantised rows is at most the gnomonic radius of a cone of half angle `theta`
/// \[radians\] about a face's centre, and more than half of it.
pub(super) fn row_shift(sin_theta: f32) -> u32 {
    let sin = sin_theta.min(WIDE);
    let radius = sin / (1.0 - sin * sin).sqrt();
    let mut shift = 0;
    while shift < ROW_BITS && (2u32 << shift) as f32 * (2.0 / ROWS) <= radius {
        shift += 1;
    }
    shift
}

/// Rectangles on the faces of the cube that together cover a cone of directions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Windows {
    windows: [Window; 6],
    count: usize,
}

impl Windows {
    /// Covers the directions whose angle with the unit vector `direction` has a sine below `sin_theta`, on its side.
    pub(super) fn around(direction: Vec3, sin_theta: f32) -> Self {
        let mut covered = Self {
            windows: [Window::default(); 6],
            count: 0,
        };
        for face in 0..6 {
            let [along, across, height] = on_axis(direction, face >> 1);
            let height = if face & 1 == 0 { height } else { -height };
            if sin_theta < WIDE && height + CHORD_OVER_SIN * sin_theta < LEAST_HEIGHT {
                continue;
            }
            let ranges = if sin_theta >= WIDE {
                Some(([-1.0, 1.0], [-1.0, 1.0]))
            } else {
                slopes(across, height, sin_theta).zip(slopes(along, height, sin_theta))
            };
            if let Some((across, along)) = ranges {
                covered.windows[covered.count] = Window {
                    face,
                    rows: [
                        row(across[0]).saturating_sub(1),
                        (row(across[1]) + 1).min(ROWS as u32 - 1),
                    ],
                    columns: [
                        column(along[0]).saturating_sub(1),
                        (column(along[1]) + 1).min(COLUMNS as u32 - 1),
                    ],
                };
                covered.count += 1;
            }
        }
        covered
    }

    /// The square cells, with sides of `2^shift` quantised rows, that the rectangles touch.
    pub(super) fn cells(&self, shift: u32) -> CellWindows {
        let column_shift = shift + COLUMN_BITS - ROW_BITS;
        let mut cells = CellWindows {
            count: self.count,
            ..CellWindows::default()
        };
        for (cells, window) in cells.faces.iter_mut().zip(self.as_slice()) {
            let rows = window.rows.map(|row| (window.face << ROW_BITS | row) >> shift);
            *cells = [rows, window.columns.map(|column| column >> column_shift)];
        }
        cells
    }

    pub(super) fn as_slice(&self) -> &[Window] {
        &self.windows[..self.count]
    }
}

/// Range of `side / height` over the part of a cone with `height > 0`, cut to [-1, 1]; `None` where nothing is left. The
/// cone's axis has the components `side` and `height` in the plane of projection: there the cone is a wedge.
fn slopes(side: f32, height: f32, sin_theta: f32) -> Option<[f32; 2]> {
    /// Widening against rounding.
    const MARGIN: f32 = 1e-5;
    let length2 = side * side + height * height;
    if length2 <= sin_theta * sin_theta {
        return Some([-1.0, 1.0]);
    }
    let sin = sin_theta / length2.sqrt();
    let cos = (1.0 - sin * sin).sqrt();
    let (low_side, low_height) = (side * cos - height * sin, height * cos + side * sin);
    let (high_side, high_height) = (side * cos + height * sin, height * cos - side * sin);
    if low_height <= 0.0 && high_height <= 0.0 {
        return None;
    }
    let low = if low_height > 0.0 { low_side / low_height } else { -1.0 };
    let high = if high_height > 0.0 {
        high_side / high_height
    } else {
        1.0
    };
    let (low, high) = (low - MARGIN, high + MARGIN);
    (low <= 1.0 && high >= -1.0).then(|| [low.max(-1.0), high.min(1.0)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sin;
    use crate::math::warp::square_to_sphere;
    use crate::random::{PathRandom, Stream};

    fn direction(i: u64) -> Vec3 {
        square_to_sphere(PathRandom::new(9, 1, Stream::Light, i).next_2d())
    }

    fn axes() -> [Vec3; 6] {
        [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z]
    }

    #[test]
    fn directions_survive_coding() {
        for direction in axes().into_iter().chain((0..10_000).map(direction)) {
            let error = (decode_direction(encode_direction(direction)) - direction).length();
            assert!(error < 7e-5, "{direction}: off by {error}");
            let error = (decode_coarse(encode_coarse(direction)) - direction).length();
            assert!(error < 0.019, "{direction}: off by {error}");
        }
    }

    #[test]
    fn windows_hold_every_direction_of_the_cone() {
        let mut inside = 0;
        for theta in [0.004_f32, 0.05, 0.3, 0.8, 1.1, 1.3] {
            let sin_theta = sin(theta);
            for i in 0..200 {
                let axis = if i < 6 { axes()[i as usize] } else { direction(i) };
                let windows = Windows::around(axis, sin_theta);
                for j in 0..200 {
                    let offset = 1.5 * theta * PathRandom::new(3, 1, Stream::Camera, j).next_1d();
                    let other = (axis + offset * direction(1000 + 200 * i + j)).normalize();
                    let code = encode_direction(other);
                    let decoded = decode_direction(code);
                    if axis.cross(decoded).length() >= sin_theta || axis.dot(decoded) < 0.0 {
                        continue;
                    }
                    inside += 1;
                    for shift in [row_shift(sin_theta), row_shift(sin_theta) / 2 + 5] {
                        let key = sort_key(code, shift);
                        let cell = direction_cell(code, shift);
                        let found = |w: &Window| w.keys(shift).any(|[low, high]| low <= key && key <= high);
                        let mut marked = false;
                        windows.cells(shift).for_each(|c| marked |= c == cell);
                        assert!(
                            marked && windows.as_slice().iter().any(found),
                            "{other} within {theta} of {axis}"
                        );
                    }
                }
            }
        }
        assert!(inside > 50_000, "the test looks at something: {inside}");
    }
}

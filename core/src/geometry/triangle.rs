//! Ray-triangle intersection, watertight at shared edges and vertices (Woop, Benthin and Wald 2013).
//!
//! Vertices are moved to the ray's origin and sheared so that the ray runs along one axis; three edge functions then
//! say whether it passes inside. Four triangles are tested at once in single precision, with a margin that covers
//! every rounding error, and what passes is decided in double precision. There, a vertex shared by two triangles
//! has the same sheared coordinates in both, the sign of an edge function flips exactly between the two sides of an
//! edge, and zero counts as inside: no ray slips through between them.

use super::Line;
use crate::math::Vec3;
use wide::f32x4;

/// Triangles tested together.
pub(super) const LANES: usize = 4;

/// Four triangles, by vertex, axis and lane; unused lanes hold NaN, which no test passes.
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleBlock {
    vertices: [[f32x4; 3]; 3],
    primitives: [u32; LANES],
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TriangleHit {
    /// Distance along the ray.
    pub(super) t: f64,
    /// Barycentric coordinates of the second and third vertex.
    pub(super) barycentric: [f64; 2],
}

/// What the test needs of a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShearedRay {
    /// Axes; the last is the one along which the direction is longest.
    axes: [usize; 3],
    origin: [f32x4; 3],
    shear: [f32x4; 2],
    margin: [f32x4; 2],
    exact_origin: [f64; 3],
    exact_shear: [f64; 2],
    inverse_z: f64,
}

impl ShearedRay {
    /// `reach` bounds the absolute value of every vertex coordinate.
    pub(super) fn new(line: &Line, reach: f32) -> Self {
        let direction = line.direction.to_array();
        let magnitude = line.direction.abs();
        let z = if magnitude.x >= magnitude.y && magnitude.x >= magnitude.z {
            0
        } else if magnitude.y >= magnitude.z {
            1
        } else {
            2
        };
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let exact_origin = line.origin.to_array();
        let origin = line.origin.as_vec3();
        let inverse_z = 1.0 / direction[z];
        let exact_shear = [0, 1].map(|i| direction[axes[i]] * inverse_z);
        let unit = 0.5 * f32::EPSILON * (reach + origin.abs().max_element());
        Self {
            axes,
            origin: axes.map(|a| f32x4::splat(origin[a])),
            shear: exact_shear.map(|s| f32x4::splat(s as f32)),
            margin: [f32x4::splat(48.0 * unit), f32x4::splat(128.0 * unit * unit)],
            exact_origin: axes.map(|a| exact_origin[a]),
            exact_shear,
            inverse_z,
        }
    }
}

impl TriangleBlock {
    /// A block of the given triangles, at most [`LANES`], each with its primitive index.
    pub(super) fn new(triangles: &[(u32, [Vec3; 3])]) -> Self {
        let mut block = Self {
            vertices: [[f32x4::splat(f32::NAN); 3]; 3],
            primitives: [u32::MAX; LANES],
        };
        for (lane, (primitive, corners)) in triangles.iter().enumerate() {
            block.primitives[lane] = *primitive;
            block.set(lane, Some(*corners));
        }
        block
    }

    /// Sets the vertices in `lane`; without any the lane is never hit.
    pub(super) fn set(&mut self, lane: usize, corners: Option<[Vec3; 3]>) {
        for (vertex, corner) in corners.unwrap_or([Vec3::NAN; 3]).into_iter().enumerate() {
            for axis in 0..3 {
                self.vertices[vertex][axis].as_mut_array()[lane] = corner[axis];
            }
        }
    }

    /// Index of the primitive in `lane`; `u32::MAX` in an unused one.
    pub(super) fn primitive(&self, lane: usize) -> u32 {
        self.primitives[lane]
    }

    /// Bounds of the triangles; inside out where there are none.
    pub(super) fn bounds(&self) -> (Vec3, Vec3) {
        let mut bounds = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for corner in (0..LANES).flat_map(|lane| self.corners(lane)) {
            if !corner.is_nan() {
                bounds = (bounds.0.min(corner), bounds.1.max(corner));
            }
        }
        bounds
    }

    /// Vertices of the triangle in `lane`.
    pub(super) fn corners(&self, lane: usize) -> [Vec3; 3] {
        self.vertices
            .map(|vertex| Vec3::from(vertex.map(|axis| axis.to_array()[lane])))
    }

    /// A bit for every lane that the ray's line may hit.
    ///
    /// With `u` the unit roundoff, `m` the largest sheared coordinate of a lane and `M` a bound of all translated
    /// ones, coordinates are off by less than `8 u M`, so edge functions by less than `40 u M m + 128 (u M)^2`.
    #[inline]
    pub(super) fn candidates(&self, ray: &ShearedRay) -> u32 {
        let [kx, ky, kz] = ray.axes;
        let sheared = self.vertices.each_ref().map(|vertex| {
            let z = vertex[kz] - ray.origin[2];
            let x = (vertex[kx] - ray.origin[0]) - ray.shear[0] * z;
            let y = (vertex[ky] - ray.origin[1]) - ray.shear[1] * z;
            [x, y]
        });
        let [[ax, ay], [bx, by], [cx, cy]] = sheared;
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        let largest = |a: f32x4, b: f32x4| a.abs().fast_max(b.abs());
        let m = largest(ax, ay).fast_max(largest(bx, by)).fast_max(largest(cx, cy));
        let margin = m * ray.margin[0] + ray.margin[1];
        let smallest = u.fast_min(v).fast_min(w);
        let greatest = u.fast_max(v).fast_max(w);
        (smallest.simd_ge(-margin) | greatest.simd_le(margin)).to_bitmask()
    }

    /// The hit of one lane with the ray's line, at any signed distance.
    #[inline]
    pub(super) fn intersect(&self, lane: usize, ray: &ShearedRay) -> Option<TriangleHit> {
        let [kx, ky, kz] = ray.axes;
        let sheared = self.vertices.each_ref().map(|vertex| {
            let at = |axis: usize| f64::from(vertex[axis].as_array()[lane]);
            let z = at(kz) - ray.exact_origin[2];
            let x = (at(kx) - ray.exact_origin[0]) - ray.exact_shear[0] * z;
            let y = (at(ky) - ray.exact_origin[1]) - ray.exact_shear[1] * z;
            [x, y, z]
        });
        let [a, b, c] = sheared;
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
        let determinant = u + v + w;
        if !inside || determinant == 0.0 {
            return None;
        }
        let scale = 1.0 / determinant;
        let z = (u * a[2] + v * b[2] + w * c[2]) * scale;
        Some(TriangleHit {
            t: z * ray.inverse_z,
            barycentric: [v * scale, w * scale],
        })
    }
}

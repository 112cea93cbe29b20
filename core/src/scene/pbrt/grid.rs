//! Curved surfaces as meshes: parts of surfaces of revolution, and bilinear patches.

use crate::math::Vec2;
use crate::scene::mesh::RawMesh;
use glam::DVec3;
use std::f64::consts::PI;

/// Columns about a whole axis of revolution.
const AROUND: usize = 256;
/// Rows along a curved profile.
pub(super) const ALONG: usize = 128;

/// A surface that a profile sweeps about the z axis.
pub(super) struct Revolution<F: Fn(f64) -> Profile> {
    /// The profile for v from 0 to 1.
    pub(super) profile: F,
    /// Whether the profile is curved.
    pub(super) curved: bool,
    /// How far it goes about the axis, beginning at +x towards +y \[radians\].
    pub(super) phi_max: f64,
}

/// A point of a profile.
#[derive(Clone, Copy, Debug)]
pub(super) struct Profile {
    /// Distance from the axis.
    pub(super) r: f64,
    pub(super) z: f64,
    /// The normal in the plane of the axis: away from the axis, and along it.
    pub(super) normal: [f64; 2],
}

impl<F: Fn(f64) -> Profile> Revolution<F> {
    pub(super) fn mesh(&self) -> RawMesh {
        let rows = if self.curved { ALONG } else { 1 };
        patch(columns(self.phi_max), rows, |u, v| {
            let (sin, cos) = libm::sincos(u * self.phi_max);
            let Profile { r, z, normal } = (self.profile)(v);
            let around = |radial: f64, along: f64| DVec3::new(radial * cos, radial * sin, along);
            (around(r, z), around(normal[0], normal[1]))
        })
    }
}

/// Columns about an angle \[radians\] of revolution.
pub(super) fn columns(phi_max: f64) -> usize {
    ((AROUND as f64 * phi_max / (2.0 * PI)).ceil() as usize).max(1)
}

/// The mesh of a surface over the unit square, in cells of which each is two triangles. `at` is a point and its normal.
pub(super) fn patch(columns: usize, rows: usize, at: impl Fn(f64, f64) -> (DVec3, DVec3)) -> RawMesh {
    let mut mesh = RawMesh::default();
    add_patch(&mut mesh, columns, rows, at);
    mesh
}

/// Adds such a surface to a mesh.
pub(super) fn add_patch(mesh: &mut RawMesh, columns: usize, rows: usize, at: impl Fn(f64, f64) -> (DVec3, DVec3)) {
    let first = mesh.positions.len() as u32;
    for row in 0..=rows {
        for column in 0..=columns {
            let (u, v) = (column as f64 / columns as f64, row as f64 / rows as f64);
            let (point, normal) = at(u, v);
            mesh.positions.push(point.as_vec3());
            mesh.normals.push(normal.normalize_or_zero().as_vec3());
            mesh.uvs.push(Vec2::new(u as f32, v as f32));
        }
    }
    let width = columns as u32 + 1;
    for row in 0..rows as u32 {
        for column in 0..columns as u32 {
            let corner = first + row * width + column;
            mesh.triangles.push([corner, corner + 1, corner + width + 1]);
            mesh.triangles.push([corner, corner + width + 1, corner + width]);
        }
    }
}

/// Cells along a side of a curved bilinear patch.
const CELLS: usize = 16;

/// Adds a bilinear patch with the corners (0, 0), (1, 0), (0, 1) and (1, 1). `few` divides curved ones more coarsely.
pub(super) fn add_bilinear(mesh: &mut RawMesh, corners: [DVec3; 4], few: bool) {
    let [p00, p10, p01, p11] = corners;
    let twist = p00 - p10 - p01 + p11;
    let size = (p11 - p00).length().max((p10 - p01).length());
    let cells = match (twist.length() > 1e-6 * size, few) {
        (false, _) => 1,
        (true, true) => 4,
        (true, false) => CELLS,
    };
    add_patch(mesh, cells, cells, |u, v| {
        let point = p00 + (p10 - p00) * u + (p01 - p00) * v + twist * (u * v);
        let (along_u, along_v) = (p10 - p00 + twist * v, p01 - p00 + twist * u);
        (point, along_u.cross(along_v))
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(mesh: &RawMesh) -> f64 {
        let of = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize].as_dvec3());
            0.5 * (b - a).cross(c - a).length()
        };
        mesh.triangles.iter().map(of).sum()
    }

    #[test]
    fn surfaces_of_revolution_have_their_areas() {
        let sphere = Revolution {
            profile: |v| {
                let (sin, cos) = libm::sincos(PI * (1.0 - v));
                Profile {
                    r: 2.0 * sin,
                    z: 2.0 * cos,
                    normal: [sin, cos],
                }
            },
            curved: true,
            phi_max: PI,
        };
        let mesh = sphere.mesh();
        assert!((area(&mesh) / (8.0 * PI) - 1.0).abs() < 2e-4, "{}", area(&mesh));
        let outward = mesh.positions.iter().zip(&mesh.normals).all(|(p, n)| p.dot(*n) > 1.99);
        assert!(outward && mesh.positions.iter().all(|p| p.y > -1e-6));
        let ring = Revolution {
            profile: |v| Profile {
                r: 1.0 - 0.5 * v,
                z: 0.0,
                normal: [0.0, 1.0],
            },
            curved: false,
            phi_max: 2.0 * PI,
        };
        assert!((area(&ring.mesh()) / (0.75 * PI) - 1.0).abs() < 2e-4);
    }

    #[test]
    fn flat_bilinear_patches_are_two_triangles() {
        let mut mesh = RawMesh::default();
        add_bilinear(
            &mut mesh,
            [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 0.0)],
            false,
        );
        assert_eq!((mesh.triangles.len(), area(&mesh)), (2, 1.0));
        assert!(mesh.normals.iter().all(|normal| normal.z == 1.0));
        add_bilinear(&mut mesh, [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::ONE], false);
        assert_eq!(mesh.triangles.len(), 2 + 2 * CELLS * CELLS);
        // The middle of z = x y.
        let middle = mesh.positions[4 + CELLS / 2 * (CELLS + 1) + CELLS / 2];
        assert_eq!(middle.to_array(), [0.5, 0.5, 0.25]);
    }
}

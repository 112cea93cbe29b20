//! Rectangle, cube, sphere and cylinder as meshes, with the corners, texture coordinates and outer sides of Mitsuba's shapes.

use super::RawMesh;
use crate::math::{PI, TAU, Vec2, Vec3, sin_cos};

/// The square [-1, 1]^2 in the plane z = 0, facing +z; its texture coordinates run with x and y.
pub(crate) fn rectangle() -> RawMesh {
    let uvs = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(u, v)| Vec2::new(u, v));
    RawMesh {
        positions: uvs.iter().map(|uv| (*uv * 2.0 - Vec2::ONE).extend(0.0)).collect(),
        normals: vec![Vec3::Z; 4],
        uvs: uvs.to_vec(),
        triangles: vec![[0, 1, 2], [2, 3, 0]],
        ..RawMesh::default()
    }
}

/// The cube [-1, 1]^3, facing outwards; each face has its own corners.
pub(crate) fn cube() -> RawMesh {
    // Per face: the outward normal, and the directions in which u rises and v falls.
    let faces = [
        (Vec3::NEG_Y, Vec3::Z, Vec3::NEG_X),
        (Vec3::Y, Vec3::NEG_X, Vec3::Z),
        (Vec3::X, Vec3::Y, Vec3::Z),
        (Vec3::Z, Vec3::Y, Vec3::NEG_X),
        (Vec3::NEG_X, Vec3::Y, Vec3::NEG_Z),
        (Vec3::NEG_Z, Vec3::NEG_Y, Vec3::NEG_X),
    ];
    let mut mesh = RawMesh::default();
    for (normal, rising_u, falling_v) in faces {
        let first = mesh.positions.len() as u32;
        for (u, v) in [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)] {
            mesh.positions
                .push(normal + rising_u * (2.0 * u - 1.0) + falling_v * (1.0 - 2.0 * v));
            mesh.normals.push(normal);
            mesh.uvs.push(Vec2::new(u, v));
        }
        mesh.triangles
            .extend([[first, first + 1, first + 2], [first + 3, first, first + 2]]);
    }
    mesh
}

/// Columns of a sphere and of a cylinder, and rows of a sphere.
const ROUND: [u32; 2] = [128, 64];

/// The unit sphere about the origin with its poles on the z axis, facing outwards.
pub(crate) fn sphere() -> RawMesh {
    let [columns, rows] = ROUND;
    grid([columns, rows], |uv| {
        let ((sin_phi, cos_phi), (sin_theta, cos_theta)) = (sin_cos(TAU * uv.x), sin_cos(PI * uv.y));
        let outward = Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta);
        (outward, outward)
    })
}

/// The mantle of the cylinder of radius 1 about the z axis from z = 0 to 1, facing outwards.
pub(crate) fn cylinder() -> RawMesh {
    grid([ROUND[0], 1], |uv| {
        let (sin_phi, cos_phi) = sin_cos(TAU * uv.x);
        let outward = Vec3::new(cos_phi, sin_phi, 0.0);
        (outward.with_z(uv.y), outward)
    })
}

/// A grid of columns and rows over the texture coordinates, at each of which `point` gives position and normal.
fn grid([columns, rows]: [u32; 2], point: impl Fn(Vec2) -> (Vec3, Vec3)) -> RawMesh {
    let mut mesh = RawMesh::default();
    for row in 0..=rows {
        for column in 0..=columns {
            let uv = Vec2::new(column as f32 / columns as f32, row as f32 / rows as f32);
            let (position, normal) = point(uv);
            mesh.positions.push(position);
            mesh.normals.push(normal);
            mesh.uvs.push(uv);
            if row < rows && column < columns {
                let corner = row * (columns + 1) + column;
                let below = corner + columns + 1;
                mesh.triangles
                    .extend([[corner, corner + 1, below + 1], [corner, below + 1, below]]);
            }
        }
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faces_along_normals(mesh: &RawMesh) -> bool {
        mesh.triangles.iter().all(|triangle| {
            let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
            (b - a).cross(c - a).dot(mesh.normals[triangle[0] as usize]) > 0.0
        })
    }

    #[test]
    fn triangles_face_along_their_normals() {
        assert!(faces_along_normals(&rectangle()));
        assert!(faces_along_normals(&cube()));
    }

    /// Corners as Mitsuba 3.9.1 lists them (`traverse(cube)["vertex_positions"]`).
    #[test]
    fn the_cube_has_the_corners_of_mitsubas() {
        let mesh = cube();
        let expected = [
            (0, [1.0, -1.0, -1.0]),
            (1, [1.0, -1.0, 1.0]),
            (2, [-1.0, -1.0, 1.0]),
            (4, [1.0, 1.0, -1.0]),
            (6, [-1.0, 1.0, 1.0]),
            (8, [1.0, -1.0, -1.0]),
            (10, [1.0, 1.0, 1.0]),
            (12, [1.0, -1.0, 1.0]),
            (13, [1.0, 1.0, 1.0]),
            (14, [-1.0, 1.0, 1.0]),
            (16, [-1.0, -1.0, 1.0]),
            (17, [-1.0, 1.0, 1.0]),
            (18, [-1.0, 1.0, -1.0]),
            (20, [1.0, 1.0, -1.0]),
            (21, [1.0, -1.0, -1.0]),
            (23, [-1.0, 1.0, -1.0]),
        ];
        for (index, corner) in expected {
            assert_eq!(mesh.positions[index].to_array(), corner, "corner {index}");
        }
    }
}

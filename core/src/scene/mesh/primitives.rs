//! Rectangle and cube as meshes, with the corners, texture coordinates and outer sides of Mitsuba's shapes.

use super::RawMesh;
use crate::math::{Vec2, Vec3};

/// The square [-1, 1]^2 in the plane z = 0, facing +z; its texture coordinates run with x and y.
pub(crate) fn rectangle() -> RawMesh {
    let uvs = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(u, v)| Vec2::new(u, v));
    RawMesh {
        positions: uvs.iter().map(|uv| (*uv * 2.0 - Vec2::ONE).extend(0.0)).collect(),
        normals: vec![Vec3::Z; 4],
        uvs: uvs.to_vec(),
        triangles: vec![[0, 1, 2], [2, 3, 0]],
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

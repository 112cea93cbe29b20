//! From a mesh as its file gives it to triangles in the world.

use super::{RawAttribute, RawMesh};
use crate::geometry::TriangleMesh;
use crate::math::{DVec3, Transform, Vec3};

/// The largest coordinate in the world [scene units]: beyond it areas and their squares leave single precision.
pub(crate) const LARGEST_COORDINATE: f32 = 1e9;

/// Maps a mesh to the world, gives it normals, and turns its triangles' outer sides as Mitsuba has them.
///
/// Vertices without a normal get the mean of the adjacent triangles' normals, weighted by the angle at the vertex
/// (Thürmer and Wüthrich 1998), and +z where there is none. Vertex normals decide which side is the outer one; without them the winding does,
/// as it is in the world. Triangles without area are left out. The attributes come back beside the mesh. Errors say what is wrong with the mesh.
pub(crate) fn finish(
    raw: RawMesh,
    to_world: &Transform,
    face_normals: bool,
    flip_normals: bool,
) -> Result<(TriangleMesh, Vec<RawAttribute>), String> {
    let mut positions = raw.positions;
    positions.iter_mut().for_each(|p| *p = to_world.point(*p));
    let too_far = |p: &Vec3| !p.is_finite() || p.abs().max_element() > LARGEST_COORDINATE;
    if let Some(vertex) = positions.iter().position(too_far) {
        let p = positions[vertex];
        return Err(format!(
            "vertex {vertex} lies at {p} in the world; coordinates reach to {LARGEST_COORDINATE:e}"
        ));
    }
    let (mut triangles, mut attributes) = (raw.triangles, raw.attributes);
    let has_area = |triangle: &[u32; 3]| area_vector(&positions, triangle).length_squared() >= f32::MIN_POSITIVE;
    for attribute in attributes.iter_mut().filter(|attribute| attribute.of_faces) {
        let mut kept = triangles.iter().map(has_area);
        attribute.values.retain(|_| kept.next() == Some(true));
    }
    triangles.retain(has_area);
    if triangles.is_empty() {
        return Err("the mesh has no triangle with an area".into());
    }
    let mut normals = Vec::new();
    if !face_normals {
        normals = raw.normals;
        normals.iter_mut().for_each(|n| *n = to_world.normal(*n));
        normals.resize(positions.len(), Vec3::ZERO);
        if normals.contains(&Vec3::ZERO) {
            let sums = normal_sums(&positions, &triangles);
            let missing = normals
                .iter_mut()
                .zip(&sums)
                .filter(|(normal, _)| **normal == Vec3::ZERO);
            missing.for_each(|(normal, sum)| *normal = sum.normalize_or(DVec3::Z).as_vec3());
        }
    }
    if flip_normals {
        normals.iter_mut().for_each(|normal| *normal = -*normal);
    }
    let inward = |triangle: &[u32; 3]| match normals.is_empty() {
        true => flip_normals,
        false => {
            let mean: Vec3 = triangle.iter().map(|vertex| normals[*vertex as usize]).sum();
            mean.dot(area_vector(&positions, triangle)) < 0.0
        }
    };
    triangles
        .iter_mut()
        .filter(|triangle| inward(triangle))
        .for_each(|triangle| triangle.swap(1, 2));
    let mesh = TriangleMesh {
        positions,
        normals,
        uvs: raw.uvs,
        triangles,
    };
    Ok((mesh, attributes))
}

/// The normal of a triangle, twice its area long.
fn area_vector(positions: &[Vec3], triangle: &[u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
    (b - a).cross(c - a)
}

/// Sums of the normals of the triangles that meet at each vertex, which have an area; zero where none meet or they cancel.
fn normal_sums(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for triangle in triangles {
        let corners = triangle.map(|vertex| positions[vertex as usize].as_dvec3());
        let normal = (corners[1] - corners[0])
            .cross(corners[2] - corners[0])
            .normalize_or(DVec3::ZERO);
        for (i, vertex) in triangle.iter().enumerate() {
            let (a, b) = (corners[(i + 1) % 3] - corners[i], corners[(i + 2) % 3] - corners[i]);
            let angle = libm::atan2(a.cross(b).length(), a.dot(b));
            sums[*vertex as usize] += normal * angle;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Vec2;
    use glam::DMat4;

    fn triangle(normal: Option<Vec3>) -> RawMesh {
        RawMesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            normals: normal.map_or(Vec::new(), |normal| vec![normal; 3]),
            uvs: vec![Vec2::ZERO; 3],
            triangles: vec![[0, 1, 2]],
            ..RawMesh::default()
        }
    }

    fn outer(mesh: &TriangleMesh) -> Vec3 {
        area_vector(&mesh.positions, &mesh.triangles[0])
    }

    /// The sides are those that Mitsuba 3.9.1 reports for the same triangles (`sh_frame.n`).
    #[test]
    fn the_outer_side_is_that_of_mitsuba() {
        let mirror = Transform::from_matrix(DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0))).unwrap();
        let identity = Transform::default();
        for (normal, to_world, face_normals, flip, z) in [
            (None, identity, false, false, 1.0),
            (None, identity, true, false, 1.0),
            (None, identity, false, true, -1.0),
            (None, identity, true, true, -1.0),
            (None, mirror, false, false, -1.0),
            (None, mirror, true, false, -1.0),
            (Some(-Vec3::Z), identity, false, false, -1.0),
            (Some(-Vec3::Z), identity, true, false, 1.0),
            (Some(-Vec3::Z), identity, false, true, 1.0),
            (Some(-Vec3::Z), mirror, false, false, -1.0),
            (Some(-Vec3::Z), mirror, true, false, -1.0),
        ] {
            let (mesh, _) = finish(triangle(normal), &to_world, face_normals, flip).unwrap();
            assert_eq!(outer(&mesh).z, z, "{normal:?} {face_normals} {flip}");
            assert!(mesh.normals.is_empty() == face_normals);
            assert!(mesh.normals.iter().all(|n| n.z == z));
        }
    }

    #[test]
    fn smooth_normals_are_weighted_by_angle() {
        // A roof: the ridge's end belongs to one right angle on the left and two half ones on the right.
        let positions = vec![Vec3::ZERO, Vec3::Y, -Vec3::X, Vec3::Z, Vec3::new(0.0, 1.0, 1.0)];
        let triangles = vec![[0, 1, 2], [0, 3, 4], [0, 4, 1]];
        let raw = RawMesh {
            positions,
            triangles,
            ..RawMesh::default()
        };
        let (mesh, _) = finish(raw, &Transform::default(), false, false).unwrap();
        let expected = (Vec3::Z - Vec3::X).normalize();
        assert!((mesh.normals[0] - expected).length() < 1e-6, "{}", mesh.normals[0]);
    }

    #[test]
    fn triangles_without_area_go_and_meshes_without_triangles_are_refused() {
        let mut raw = triangle(None);
        raw.triangles.push([0, 0, 1]);
        raw.triangles.push([1, 1, 1]);
        assert_eq!(
            finish(raw.clone(), &Transform::default(), false, false)
                .unwrap()
                .0
                .triangles
                .len(),
            1
        );
        raw.triangles.remove(0);
        assert!(finish(raw, &Transform::default(), false, false).is_err());
        let mut far = triangle(None);
        far.positions[1].x = 1e10;
        assert!(
            finish(far, &Transform::default(), false, false)
                .unwrap_err()
                .contains("vertex 1")
        );
    }
}

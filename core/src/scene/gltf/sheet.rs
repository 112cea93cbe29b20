//! The back of open surfaces that shine: in glTF they shine to both sides, and an area light to the outer side only.

use crate::math::Vec3;
use crate::scene::mesh::RawMesh;
use std::collections::BTreeMap;

/// How far the back lies behind the front, as a share of the mesh's extent: far enough for rays to tell them apart, too little to be seen.
const GAP: f32 = 1e-4;

/// The same surface just behind a mesh and turned round, where the mesh has an edge; the back of a closed surface is within it.
pub(super) fn back(mesh: &RawMesh) -> Option<RawMesh> {
    if is_closed(mesh) {
        return None;
    }
    let mut outward = vec![Vec3::ZERO; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|corner| mesh.positions[corner as usize]);
        let area = (b - a).cross(c - a);
        // Where vertices have normals, these tell the outer side, whichever way the triangle winds.
        let mean: Vec3 = match mesh.normals.is_empty() {
            true => area,
            false => triangle.iter().map(|corner| mesh.normals[*corner as usize]).sum(),
        };
        let area = if mean.dot(area) < 0.0 { -area } else { area };
        for corner in triangle {
            outward[*corner as usize] += area;
        }
    }
    let infinite = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    let (lower, upper) = mesh
        .positions
        .iter()
        .fold(infinite, |(lower, upper), p| (lower.min(*p), upper.max(*p)));
    let gap = GAP * (upper - lower).max_element();
    let mut back = mesh.clone();
    for (position, outward) in back.positions.iter_mut().zip(outward) {
        *position -= outward.normalize_or_zero() * gap;
    }
    back.normals.iter_mut().for_each(|normal| *normal = -*normal);
    back.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    Some(back)
}

/// Whether each edge has as many triangles on the one side as on the other, vertices at one place being one.
fn is_closed(mesh: &RawMesh) -> bool {
    // Adding 0 makes one zero of the two.
    let place = |corner: u32| {
        (mesh.positions[corner as usize] + Vec3::ZERO)
            .to_array()
            .map(f32::to_bits)
    };
    let mut edges: BTreeMap<_, i64> = BTreeMap::new();
    for triangle in &mesh.triangles {
        for i in 0..3 {
            let (from, to) = (place(triangle[i]), place(triangle[(i + 1) % 3]));
            let (edge, side) = if from < to { ((from, to), 1) } else { ((to, from), -1) };
            *edges.entry(edge).or_default() += side;
        }
    }
    edges.values().all(|sum| *sum == 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::mesh::primitives;

    #[test]
    fn an_open_surface_has_a_back_and_a_closed_one_has_none() {
        assert!(back(&primitives::cube()).is_none());
        let sheet = primitives::rectangle();
        let back = back(&sheet).unwrap();
        for (front, back) in sheet.positions.iter().zip(&back.positions) {
            assert_eq!(*back, *front - Vec3::Z * 2.0 * GAP);
        }
        assert!(back.normals.iter().all(|normal| *normal == -Vec3::Z));
    }
}

//! Attributes of meshes as textures.

use super::TexturePoint;
use crate::geometry::TriangleMesh;
use crate::math::Vec2;
use crate::spectrum::Spectrum;
use std::sync::Arc;

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

impl AttributeTexture {
    pub(super) fn eval(&self, at: &TexturePoint) -> Spectrum {
        let triangle = at.primitive as usize;
        if self.of_faces {
            return self.values[triangle];
        }
        let [a, b, c] = self.mesh.triangles[triangle].map(|vertex| self.values[vertex as usize]);
        let [s, t] = at.barycentric.to_array();
        a * (1.0 - s - t) + b * s + c * t
    }

    /// Derivatives as a number by u and by v; 0 without texture coordinates, or where they are the same all over the triangle.
    pub(super) fn gradient(&self, at: &TexturePoint) -> Vec2 {
        let indices = self.mesh.triangles[at.primitive as usize].map(|vertex| vertex as usize);
        if self.of_faces || self.mesh.uvs.is_empty() {
            return Vec2::ZERO;
        }
        let [a, b, c] = indices.map(|vertex| self.values[vertex].number());
        let [uv_a, uv_b, uv_c] = indices.map(|vertex| self.mesh.uvs[vertex]);
        let (first, second) = (uv_b - uv_a, uv_c - uv_a);
        let area = first.perp_dot(second);
        if area == 0.0 {
            return Vec2::ZERO;
        }
        let by_u = (b - a) * second.y - (c - a) * first.y;
        let by_v = (c - a) * first.x - (b - a) * second.x;
        Vec2::new(by_u, by_v) / area
    }
}

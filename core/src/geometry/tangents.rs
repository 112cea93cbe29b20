//! Derivatives of points on surfaces by their texture coordinates, for those materials that ask for them.

use super::{Geometry, Shape, SurfacePoint};
use crate::math::{PI, TAU, Transform, Vec2, Vec3};

impl Geometry {
    /// Derivatives of the position by u and by v at a point of a surface [scene units], as Mitsuba has them: those of a disc by v are
    /// not multiplied by the circumference. Where the texture coordinates say nothing, they are axes of the shading frame.
    #[must_use]
    pub fn tangents(&self, point: &SurfacePoint) -> [Vec3; 2] {
        let shape = point.shape.0 as usize;
        let found = match &self.shapes[shape] {
            Shape::Mesh(mesh) if mesh.uvs.is_empty() => None,
            Shape::Mesh(mesh) => {
                let triangle = mesh.triangles[(point.primitive - self.first_primitive[shape]) as usize];
                let [p0, p1, p2] = triangle.map(|i| mesh.positions[i as usize]);
                let [uv0, uv1, uv2] = triangle.map(|i| mesh.uvs[i as usize]);
                of_triangle([p1 - p0, p2 - p0], [uv1 - uv0, uv2 - uv0])
            }
            Shape::Sphere { center, to_local, .. } => of_sphere(point.position - *center, to_local),
            Shape::Disk { to_world, .. } => of_disk(point.position, to_world),
        };
        found.unwrap_or([point.frame.s, point.frame.t])
    }
}

/// From two edges and the differences of (u, v) along them.
fn of_triangle(edges: [Vec3; 2], differences: [Vec2; 2]) -> Option<[Vec3; 2]> {
    let determinant = differences[0].perp_dot(differences[1]);
    let du = (edges[0] * differences[1].y - edges[1] * differences[0].y) / determinant;
    let dv = (edges[1] * differences[0].x - edges[0] * differences[1].x) / determinant;
    (du.is_finite() && dv.is_finite()).then_some([du, dv])
}

/// `offset` points from the centre to the point.
fn of_sphere(offset: Vec3, to_local: &Transform) -> Option<[Vec3; 2]> {
    let w = to_local.vector(offset).try_normalize()?;
    let radius = (w.x * w.x + w.y * w.y).sqrt();
    if radius == 0.0 {
        return None;
    }
    let du = Vec3::new(-w.y, w.x, 0.0) * TAU;
    let dv = Vec3::new(w.z * w.x / radius, w.z * w.y / radius, -radius) * PI;
    let to_world = to_local.inverted();
    Some([to_world.vector(du), to_world.vector(dv)])
}

fn of_disk(position: Vec3, to_world: &Transform) -> Option<[Vec3; 2]> {
    let local = to_world.inverted().point(position);
    let outward = Vec3::new(local.x, local.y, 0.0).try_normalize()?;
    let around = Vec3::new(-outward.y, outward.x, 0.0);
    Some([to_world.vector(outward), to_world.vector(around)])
}

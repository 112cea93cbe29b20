//! Derivatives of points on surfaces by their texture coordinates, for those materials that ask for them.

use super::{Geometry, Shape, SurfacePoint};
use crate::math::{PI, TAU, Transform, Vec2, Vec3};

impl Geometry {
    /// Derivatives of the position by u and by v at a point of a surface [scene units], as Mitsuba has them: those of a disc by v are
    /// not multiplied by the circumference. Where the texture coordinates say nothing, they are axes of the shading frame.
    #[must_use]
    pub fn tangents(&self, point: &SurfacePoint) -> [Vec3; 2] {
        let found = match self.shape(point.outer) {
            Shape::Instance { group, to_world } => {
                let position = to_world.inverted().point(point.position);
                let inner = group.shape(point.shape.0 - self.shapes.len() as u32);
                of_shape(inner, point.primitive, position).map(|tangents| tangents.map(|t| to_world.vector(t)))
            }
            shape => of_shape(shape, point.primitive, point.position),
        };
        found.unwrap_or([point.frame.s, point.frame.t])
    }
}

/// Of a shape that is no instance, at `position` on its triangle number `primitive`.
fn of_shape(shape: &Shape, primitive: u32, position: Vec3) -> Option<[Vec3; 2]> {
    match shape {
        Shape::Mesh(mesh) if mesh.uvs.is_empty() => None,
        Shape::Mesh(mesh) => {
            let triangle = mesh.triangles[primitive as usize];
            let [p0, p1, p2] = triangle.map(|i| mesh.positions[i as usize]);
            let [uv0, uv1, uv2] = triangle.map(|i| mesh.uvs[i as usize]);
            of_triangle([p1 - p0, p2 - p0], [uv1 - uv0, uv2 - uv0])
        }
        Shape::Sphere { center, to_local, .. } => {
            let local = to_local.vector(position - *center);
            of_sphere(local).map(|tangents| tangents.map(|t| to_local.inverted().vector(t)))
        }
        Shape::Ellipsoid { to_world, .. } => {
            let local = to_world.inverted().point(position);
            of_sphere(local).map(|tangents| tangents.map(|t| to_world.vector(t)))
        }
        Shape::Disk { to_world, .. } => of_disk(position, to_world),
        Shape::Cylinder { to_world, .. } => {
            let local = to_world.inverted().point(position);
            let around = Vec3::new(-local.y, local.x, 0.0) * TAU;
            Some([to_world.vector(around), to_world.vector(Vec3::Z)])
        }
        Shape::Instance { .. } => None,
    }
}

/// From two edges and the differences of (u, v) along them.
fn of_triangle(edges: [Vec3; 2], differences: [Vec2; 2]) -> Option<[Vec3; 2]> {
    let determinant = differences[0].perp_dot(differences[1]);
    let du = (edges[0] * differences[1].y - edges[1] * differences[0].y) / determinant;
    let dv = (edges[1] * differences[0].x - edges[0] * differences[1].x) / determinant;
    (du.is_finite() && dv.is_finite()).then_some([du, dv])
}

/// On the unit sphere about the origin, along the direction `local`.
fn of_sphere(local: Vec3) -> Option<[Vec3; 2]> {
    let w = local.try_normalize()?;
    let radius = (w.x * w.x + w.y * w.y).sqrt();
    if radius == 0.0 {
        return None;
    }
    let du = Vec3::new(-w.y, w.x, 0.0) * TAU;
    let dv = Vec3::new(w.z * w.x / radius, w.z * w.y / radius, -radius) * PI;
    Some([du, dv])
}

fn of_disk(position: Vec3, to_world: &Transform) -> Option<[Vec3; 2]> {
    let local = to_world.inverted().point(position);
    let outward = Vec3::new(local.x, local.y, 0.0).try_normalize()?;
    let around = Vec3::new(-outward.y, outward.x, 0.0);
    Some([to_world.vector(outward), to_world.vector(around)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Ray, TriangleMesh};
    use std::sync::Arc;

    /// A step along both tangents changes the texture coordinates by as much.
    #[test]
    fn tangents_are_derivatives_by_the_texture_coordinates() {
        let mesh = TriangleMesh {
            positions: vec![
                Vec3::new(-1.0, -1.0, 0.1),
                Vec3::new(2.0, -1.0, 0.3),
                Vec3::new(0.0, 2.0, -0.2),
            ],
            normals: Vec::new(),
            uvs: vec![Vec2::new(0.1, 0.9), Vec2::new(0.8, 0.7), Vec2::new(0.4, 0.2)],
            triangles: vec![[0, 1, 2]],
        };
        let turned = glam::DMat4::from_rotation_y(0.7) * glam::DMat4::from_scale(glam::DVec3::splat(0.5));
        let sphere = Shape::Sphere {
            center: Vec3::new(0.2, 0.1, 0.0),
            radius: 2.0,
            to_local: Transform::from_matrix(turned).unwrap(),
            flip_normals: false,
        };
        for shape in [Shape::Mesh(Arc::new(mesh)), sphere] {
            let geometry = Geometry::build(vec![shape]);
            let hit = |x: f32, y: f32| {
                geometry
                    .intersect(&Ray {
                        origin: Vec3::new(x, y, 5.0),
                        direction: -Vec3::Z,
                        max_distance: f32::INFINITY,
                    })
                    .unwrap()
            };
            let (at, step) = (hit(0.3, 0.2), 1e-3);
            let [du, dv] = geometry.tangents(&at);
            for (x, y) in [(step, 0.0), (0.0, step)] {
                let near = hit(0.3 + x, 0.2 + y);
                let change = near.uv - at.uv;
                let moved = near.position - at.position;
                let expected = du * change.x + dv * change.y;
                assert!(
                    (moved - expected).length() < 2e-2 * moved.length(),
                    "{moved} {expected}"
                );
            }
        }
    }
}

//! Points on surfaces, and the rays that leave them.

use super::traversal::Hit;
use super::{Geometry, Ray, Shape, ShapeId, SurfacePoint, TriangleMesh};
use crate::math::{DVec3, Frame, PI, TAU, Transform, Vec2, Vec3, acos, atan2};

/// Part of the coordinates of a triangle that bounds the rounding of positions interpolated in double precision.
const INTERPOLATION_ERROR: f32 = 1.0 / (1u64 << 44) as f32;
/// Shadow rays end this part of the distance, and this many rounding errors of the position, before their end point.
pub(crate) const SHADOW_GAP: f32 = 1e-4;
const SHADOW_GAP_ROUNDINGS: f32 = 64.0;

/// Position, normals and texture coordinates of a point, before its frame is set up.
pub(super) struct Interpolated {
    pub(super) position: DVec3,
    /// The largest coordinates that went into the position, per axis.
    pub(super) extent: Vec3,
    pub(super) geometric_normal: Vec3,
    pub(super) shading_normal: Vec3,
    pub(super) uv: Vec2,
    /// Derivative of the position by the first texture coordinate; zero where there is none.
    pub(super) tangent: Vec3,
}

impl Geometry {
    pub(super) fn surface_point(&self, ray: &Ray, hit: &Hit) -> SurfacePoint {
        let along = || ray.origin.as_dvec3() + hit.t * ray.direction.as_dvec3();
        let shape = self.shape_of(hit.primitive);
        if let Shape::Instance { group, to_world } = &self.shapes[shape as usize] {
            let point = self.instanced_point(group, to_world, hit, along());
            return SurfacePoint {
                outer: ShapeId(shape),
                ..point
            };
        }
        let interpolated = self.interpolate(shape, hit, along);
        let primitive = hit.primitive - self.first_primitive[shape as usize];
        interpolated.finish(ShapeId(shape), primitive, hit.barycentric, hit.t as f32)
    }

    /// The point of a hit on `shape`, which is no instance; `position` tells about where.
    #[inline]
    pub(super) fn interpolate(&self, shape: u32, hit: &Hit, position: impl FnOnce() -> DVec3) -> Interpolated {
        match &self.shapes[shape as usize] {
            Shape::Mesh(mesh) => {
                let triangle = hit.primitive - self.first_primitive[shape as usize];
                on_triangle(mesh, triangle, self.hierarchy.corners(hit), hit.barycentric)
            }
            Shape::Sphere {
                center,
                radius,
                to_local,
                flip_normals,
            } => on_sphere(
                position() - center.as_dvec3(),
                *center,
                *radius,
                to_local,
                *flip_normals,
            ),
            Shape::Ellipsoid { to_world, flip_normals } => on_ellipsoid(
                to_world.inverted().matrix().transform_point3(position()),
                to_world,
                *flip_normals,
            ),
            Shape::Disk { to_world, flip_normals } => on_disk(
                to_world.inverted().matrix().transform_point3(position()),
                to_world,
                *flip_normals,
            ),
            Shape::Cylinder { to_world, flip_normals } => on_cylinder(
                to_world.inverted().matrix().transform_point3(position()),
                to_world,
                *flip_normals,
            ),
            Shape::Instance { .. } => unreachable!("groups hold no instances"),
        }
    }

    /// The point with the given barycentric coordinates (of the second and third vertex) on triangle `triangle` of a mesh.
    pub(super) fn point_on_triangle(&self, shape: ShapeId, triangle: u32, barycentric: Vec2) -> Option<SurfacePoint> {
        let Shape::Mesh(mesh) = self.shape(shape) else {
            return None;
        };
        let barycentric = [barycentric.x, barycentric.y].map(f64::from);
        let corners = mesh.triangles[triangle as usize].map(|i| mesh.positions[i as usize]);
        Some(on_triangle(mesh, triangle, corners, barycentric).finish(shape, triangle, barycentric, 0.0))
    }

    /// The point of a sphere in the unit direction `local` from its centre, or of a disc or a cylinder at `local` in its own space.
    pub(super) fn point_on_curved(&self, shape: ShapeId, local: Vec3) -> Option<SurfacePoint> {
        let interpolated = match self.shape(shape) {
            Shape::Mesh(_) | Shape::Instance { .. } => return None,
            Shape::Sphere {
                center,
                radius,
                to_local,
                flip_normals,
            } => on_sphere(local.as_dvec3(), *center, *radius, to_local, *flip_normals),
            Shape::Ellipsoid { to_world, flip_normals } => on_ellipsoid(local.as_dvec3(), to_world, *flip_normals),
            Shape::Disk { to_world, flip_normals } => on_disk(local.as_dvec3(), to_world, *flip_normals),
            Shape::Cylinder { to_world, flip_normals } => on_cylinder(local.as_dvec3(), to_world, *flip_normals),
        };
        Some(interpolated.finish(shape, 0, [0.0; 2], 0.0))
    }
}

#[inline]
fn on_triangle(mesh: &TriangleMesh, triangle: u32, corners: [Vec3; 3], barycentric: [f64; 2]) -> Interpolated {
    let [p0, p1, p2] = corners.map(|p| p.as_dvec3());
    let [b1, b2] = barycentric;
    let (e1, e2) = (p1 - p0, p2 - p0);
    let face_normal = e1.cross(e2).normalize_or_zero().as_vec3();
    let weights = [1.0 - b1 - b2, b1, b2];
    let blend = weights.map(|w| w as f32);
    let indices = || mesh.triangles[triangle as usize].map(|i| i as usize);
    let shading_normal = if mesh.normals.is_empty() {
        face_normal
    } else {
        let [n0, n1, n2] = indices().map(|i| mesh.normals[i]);
        let sum = n0 * blend[0] + n1 * blend[1] + n2 * blend[2];
        sum.try_normalize().unwrap_or(face_normal)
    };
    let (uv, tangent) = if mesh.uvs.is_empty() {
        (Vec2::new(blend[1], blend[2]), Vec3::ZERO)
    } else {
        let [uv0, uv1, uv2] = indices().map(|i| mesh.uvs[i]);
        let uv = uv0 * blend[0] + uv1 * blend[1] + uv2 * blend[2];
        (uv, along_u([e1.as_vec3(), e2.as_vec3()], [uv1 - uv0, uv2 - uv0]))
    };
    let disagree = face_normal.dot(shading_normal) < 0.0;
    Interpolated {
        position: p0 * weights[0] + p1 * weights[1] + p2 * weights[2],
        extent: corners[0].abs().max(corners[1].abs()).max(corners[2].abs()),
        geometric_normal: if disagree { -face_normal } else { face_normal },
        shading_normal,
        uv,
        tangent,
    }
}

/// The direction along which u grows on a triangle, from two edges and the differences of (u, v) along them.
fn along_u(edges: [Vec3; 2], differences: [Vec2; 2]) -> Vec3 {
    let determinant = differences[0].perp_dot(differences[1]);
    if determinant == 0.0 {
        return Vec3::ZERO;
    }
    (edges[0] * differences[1].y - edges[1] * differences[0].y) * determinant.signum()
}

/// `offset` points from the centre to the point; its length is corrected.
fn on_sphere(offset: DVec3, center: Vec3, radius: f32, to_local: &Transform, flip_normals: bool) -> Interpolated {
    let outward = offset.normalize_or(DVec3::Z);
    let local = to_local
        .matrix()
        .transform_vector3(outward)
        .normalize_or(DVec3::Z)
        .as_vec3();
    let normal = if flip_normals {
        -outward.as_vec3()
    } else {
        outward.as_vec3()
    };
    Interpolated {
        position: center.as_dvec3() + outward * f64::from(radius),
        extent: center.abs() + Vec3::splat(radius),
        geometric_normal: normal,
        shading_normal: normal,
        uv: Vec2::new(turn(local.x, local.y), acos(local.z) / PI),
        tangent: to_local.inverted().vector(Vec3::new(-local.y, local.x, 0.0)),
    }
}

/// `local` is the point in the ellipsoid's own space, where it is the unit sphere; its length is corrected.
fn on_ellipsoid(local: DVec3, to_world: &Transform, flip_normals: bool) -> Interpolated {
    let outward = local.normalize_or(DVec3::Z);
    let local = outward.as_vec3();
    let normal = to_world.normal(if flip_normals { -local } else { local });
    Interpolated {
        position: to_world.matrix().transform_point3(outward),
        extent: extent_of(to_world),
        geometric_normal: normal,
        shading_normal: normal,
        uv: Vec2::new(turn(local.x, local.y), acos(local.z) / PI),
        tangent: to_world.vector(Vec3::new(-local.y, local.x, 0.0)),
    }
}

/// The angle of (x, y) from the x axis towards y, in turns from 0 to 1.
fn turn(x: f32, y: f32) -> f32 {
    let phi = atan2(y, x);
    (if phi < 0.0 { phi + TAU } else { phi }) / TAU
}

/// A bound, per axis, of the coordinates that go into the image of a point of the unit cube.
fn extent_of(to_world: &Transform) -> Vec3 {
    let matrix = to_world.matrix();
    let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis, matrix.w_axis];
    axes.into_iter().map(|axis| axis.truncate().as_vec3().abs()).sum()
}

/// `local` is the point in the frame of the unit disc.
fn on_disk(local: DVec3, to_world: &Transform, flip_normals: bool) -> Interpolated {
    let (x, y) = (local.x as f32, local.y as f32);
    let radius = (x * x + y * y).sqrt();
    let matrix = to_world.matrix();
    let normal = to_world.normal(if flip_normals { -Vec3::Z } else { Vec3::Z });
    let origin = matrix.w_axis.truncate().as_vec3();
    Interpolated {
        position: matrix.transform_point3(DVec3::new(local.x, local.y, 0.0)),
        extent: origin.abs() + to_world.vector(Vec3::X).abs() + to_world.vector(Vec3::Y).abs(),
        geometric_normal: normal,
        shading_normal: normal,
        uv: Vec2::new(radius, turn(x, y)),
        tangent: to_world.vector(if radius > 0.0 { Vec3::new(x, y, 0.0) } else { Vec3::X }),
    }
}

/// `local` is the point in the cylinder's own space; its distance from the axis is corrected.
fn on_cylinder(local: DVec3, to_world: &Transform, flip_normals: bool) -> Interpolated {
    let around = local.with_z(0.0).normalize_or(DVec3::X);
    let (x, y) = (around.x as f32, around.y as f32);
    let outward = Vec3::new(x, y, 0.0);
    let normal = to_world.normal(if flip_normals { -outward } else { outward });
    Interpolated {
        position: to_world.matrix().transform_point3(around.with_z(local.z)),
        extent: extent_of(to_world),
        geometric_normal: normal,
        shading_normal: normal,
        uv: Vec2::new(turn(x, y), local.z as f32),
        tangent: to_world.vector(Vec3::new(-y, x, 0.0)),
    }
}

impl Interpolated {
    #[inline]
    pub(super) fn finish(self, shape: ShapeId, primitive: u32, barycentric: [f64; 2], distance: f32) -> SurfacePoint {
        let position = self.position.as_vec3();
        SurfacePoint {
            position,
            geometric_normal: self.geometric_normal,
            frame: frame_along(self.shading_normal, self.tangent),
            uv: self.uv,
            position_error: (position.abs() * f32::EPSILON + self.extent * INTERPOLATION_ERROR).max_element(),
            shape,
            outer: shape,
            primitive,
            barycentric: Vec2::from_array(barycentric.map(|b| b as f32)),
            distance,
        }
    }
}

/// The basis about `normal` whose first axis is nearest to `tangent`; any where that says nothing.
#[inline]
fn frame_along(normal: Vec3, tangent: Vec3) -> Frame {
    if tangent == Vec3::ZERO {
        return Frame::from_normal(normal);
    }
    match (tangent - normal * normal.dot(tangent)).try_normalize() {
        Some(s) => Frame {
            s,
            t: normal.cross(s),
            n: normal,
        },
        None => Frame::from_normal(normal),
    }
}

impl SurfacePoint {
    /// A ray that leaves this point along the unit vector `direction`. Its origin is moved along the geometric normal
    /// until the cube of `position_error` lies behind it, then rounded away from the surface (Pharr, Jakob and
    /// Humphreys 2023, section 6.8.6).
    #[must_use]
    pub fn ray_towards(&self, direction: Vec3) -> Ray {
        let normal = self.geometric_normal;
        let side = normal.dot(direction);
        let height = normal.abs().element_sum() * self.position_error;
        let offset = normal * if side < 0.0 { -height } else { height };
        let away = |p: f32, offset: f32| {
            if offset > 0.0 {
                (p + offset).next_up()
            } else if offset < 0.0 {
                (p + offset).next_down()
            } else {
                p
            }
        };
        let origin = Vec3::new(
            away(self.position.x, offset.x),
            away(self.position.y, offset.y),
            away(self.position.z, offset.z),
        );
        Ray {
            origin,
            direction,
            max_distance: f32::INFINITY,
        }
    }

    /// A ray for a visibility test along the unit vector `direction` that ends just before `distance`: by one part in
    /// ten thousand, and by what the rounding of the coordinates can make of the distance.
    #[must_use]
    pub fn shadow_ray(&self, direction: Vec3, distance: f32) -> Ray {
        let rounding = SHADOW_GAP_ROUNDINGS * self.position_error;
        let max_distance = (distance * (1.0 - SHADOW_GAP) - rounding).max(0.0);
        Ray {
            max_distance,
            ..self.ray_towards(direction)
        }
    }
}

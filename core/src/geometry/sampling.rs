//! Points sampled on shapes, for lights.

use super::{Geometry, Shape, ShapeId, SurfacePoint};
use crate::math::warp::{self, square_to_disk, square_to_sphere, square_to_triangle};
use crate::math::{DVec2, Discrete, Frame, PI, TAU, Vec2, Vec3, safe_sqrt, sin_cos, sqr, to_unit_f32, to_unit_vec2};

/// Samples the points of one shape.
#[derive(Clone, Debug)]
pub struct ShapeSampler {
    shape: ShapeId,
    area: f32,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    /// Triangles in proportion to their area.
    Mesh(Discrete),
    Sphere {
        center: Vec3,
        radius: f32,
    },
    Disk,
    Cylinder,
}

/// A point on a shape as seen from elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct TowardsSample {
    /// The point.
    pub point: SurfacePoint,
    /// Unit direction to it.
    pub direction: Vec3,
    /// Distance to it [scene units].
    pub distance: f32,
    /// Solid-angle density of the direction [1/sr].
    pub pdf: f32,
}

impl ShapeSampler {
    /// The sampler of shape `id`.
    #[must_use]
    pub fn new(geometry: &Geometry, id: ShapeId) -> Self {
        Self::of(geometry.shape(id), id)
    }

    /// The sampler of `shape`, which has the index `id`.
    pub(crate) fn of(shape: &Shape, id: ShapeId) -> Self {
        let (area, kind) = match shape {
            Shape::Mesh(mesh) => {
                let triangles = Discrete::new(mesh.triangles.iter().map(|triangle| {
                    let [a, b, c] = triangle.map(|i| mesh.positions[i as usize].as_dvec3());
                    0.5 * (b - a).cross(c - a).length()
                }));
                (triangles.total(), Kind::Mesh(triangles))
            }
            Shape::Sphere { center, radius, .. } => {
                let area = 4.0 * f64::from(PI) * f64::from(*radius) * f64::from(*radius);
                (
                    area,
                    Kind::Sphere {
                        center: *center,
                        radius: *radius,
                    },
                )
            }
            Shape::Disk { to_world, .. } => {
                let (x, y) = (to_world.matrix().x_axis.truncate(), to_world.matrix().y_axis.truncate());
                (f64::from(PI) * x.cross(y).length(), Kind::Disk)
            }
            Shape::Cylinder { to_world, .. } => {
                let (x, z) = (to_world.matrix().x_axis.truncate(), to_world.matrix().z_axis.truncate());
                (f64::from(TAU) * x.cross(z).length(), Kind::Cylinder)
            }
            // These are no lights.
            Shape::Ellipsoid { .. } | Shape::Instance { .. } => (0.0, Kind::Mesh(Discrete::default())),
        };
        Self {
            shape: id,
            area: area as f32,
            kind,
        }
    }

    /// The shape.
    pub(crate) fn shape(&self) -> ShapeId {
        self.shape
    }

    /// Area [scene units squared].
    #[must_use]
    pub fn area(&self) -> f32 {
        self.area
    }

    /// A point uniform by area, density `1 / area`; `None` for a shape without area.
    #[must_use]
    pub fn sample(&self, geometry: &Geometry, u: DVec2) -> Option<SurfacePoint> {
        match &self.kind {
            Kind::Mesh(triangles) => {
                let (triangle, rest) = triangles.sample(u.x)?;
                geometry.point_on_triangle(
                    self.shape,
                    triangle as u32,
                    square_to_triangle(Vec2::new(rest, to_unit_f32(u.y))),
                )
            }
            Kind::Sphere { .. } => geometry.point_on_curved(self.shape, square_to_sphere(to_unit_vec2(u))),
            Kind::Disk => geometry.point_on_curved(self.shape, square_to_disk(to_unit_vec2(u)).extend(0.0)),
            Kind::Cylinder => {
                let u = to_unit_vec2(u);
                let (sin_phi, cos_phi) = sin_cos(TAU * u.x);
                geometry.point_on_curved(self.shape, Vec3::new(cos_phi, sin_phi, u.y))
            }
        }
    }

    /// A point for a connection from `from`: on a sphere seen from outside uniform within the cone that it fills,
    /// otherwise uniform by area. `None` where the point is seen edge-on or lies at `from`.
    #[must_use]
    pub fn sample_towards(&self, geometry: &Geometry, from: Vec3, u: DVec2) -> Option<TowardsSample> {
        if let Kind::Sphere { center, radius } = self.kind
            && let Some(seen) = SeenSphere::new(center, radius, from)
        {
            return seen.sample(geometry, self.shape, from, to_unit_vec2(u));
        }
        let point = self.sample(geometry, u)?;
        let offset = point.position - from;
        let distance = offset.length();
        let direction = offset / distance;
        let pdf = self.pdf_by_area(&point, direction, distance);
        (pdf.is_finite() && distance > 0.0).then_some(TowardsSample {
            point,
            direction,
            distance,
            pdf,
        })
    }

    /// Density [1/sr] with which [`Self::sample_towards`] returns the direction from `from` to `point` on the shape.
    /// Zero on the far side of a sphere seen from outside.
    #[must_use]
    pub fn pdf_towards(&self, from: Vec3, point: &SurfacePoint) -> f32 {
        let offset = point.position - from;
        if let Kind::Sphere { center, radius } = self.kind
            && let Some(seen) = SeenSphere::new(center, radius, from)
        {
            return if offset.dot(point.position - center) < 0.0 {
                seen.cone.pdf()
            } else {
                0.0
            };
        }
        let distance = offset.length();
        let pdf = self.pdf_by_area(point, offset / distance, distance);
        if pdf.is_finite() { pdf } else { 0.0 }
    }

    fn pdf_by_area(&self, point: &SurfacePoint, direction: Vec3, distance: f32) -> f32 {
        distance * distance / (self.area * direction.dot(point.geometric_normal).abs())
    }
}

/// The cone of directions under which a sphere is seen from outside.
struct SeenSphere {
    axis: Vec3,
    distance: f32,
    radius: f32,
    cone: warp::Cone,
}

impl SeenSphere {
    /// `None` for a viewpoint inside the sphere, or so close to it that the cone would be a hemisphere.
    fn new(center: Vec3, radius: f32, from: Vec3) -> Option<Self> {
        let offset = center - from;
        let distance = offset.length();
        let sine = radius / distance;
        (sine < 1.0 - 1e-4).then(|| Self {
            axis: offset / distance,
            distance,
            radius,
            cone: warp::Cone::of_sine(sine),
        })
    }

    fn sample(&self, geometry: &Geometry, shape: ShapeId, from: Vec3, u: Vec2) -> Option<TowardsSample> {
        let local = self.cone.sample(u);
        let sine_squared = local.truncate().length_squared();
        let direction = Frame::from_normal(self.axis).to_world(local).normalize();
        let half_chord = safe_sqrt(sqr(self.radius) - sqr(self.distance) * sine_squared);
        let distance = self.distance * local.z - half_chord;
        let outward = direction * distance - self.axis * self.distance;
        let point = geometry.point_on_curved(shape, outward)?;
        let distance = (point.position - from).length();
        Some(TowardsSample {
            point,
            direction,
            distance,
            pdf: self.cone.pdf(),
        })
    }
}

//! Area lights as photon surfaces sweep over them (Deng et al. 2019, section 5.2).

use crate::geometry::{Geometry, Ray, Shape, ShapeId, SurfacePoint};
use crate::light::{LightId, Lights};
use crate::math::{TAU, Vec3, sin_cos};
use crate::random::PathRandom;
use crate::scene::Scene;
use std::sync::Arc;

/// How far the sides of a quadrilateral may be from those of a rectangle, and normals from each other, in parts of their lengths.
const EVENNESS: f32 = 1e-5;

/// An area light.
#[derive(Debug)]
pub(super) struct Lamp {
    /// The shape alone.
    geometry: Geometry,
    shape: ShapeId,
    /// \[unit^2\].
    pub(super) area: f32,
    pub(super) two_sided: bool,
    /// Whether its normal is the same everywhere.
    pub(super) is_plane: bool,
    pub(super) rectangle: Option<Rectangle>,
}

/// A light's rectangle: the places `corner + u e_u + v e_v`, with `u` and `v` up to the lengths of its edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rectangle {
    pub(super) corner: Vec3,
    /// Unit vectors, perpendicular to each other.
    pub(super) edges: [Vec3; 2],
    /// \[scene units\].
    pub(super) lengths: [f32; 2],
}

/// A straight line on a rectangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub(super) origin: Vec3,
    /// Unit vector.
    pub(super) along: Vec3,
    /// \[scene units\].
    pub(super) length: f32,
}

impl Lamp {
    /// Those of the scene's lights that are area lights, each at its number.
    pub(super) fn all(scene: &Scene) -> Vec<Option<Arc<Self>>> {
        let lights: &Lights = &scene.lights;
        let lamp = |id| {
            let (shape, area, two_sided) = lights.area(LightId(id))?;
            let form = scene.geometry.shape(shape);
            let rectangle = Rectangle::of(form);
            Some(Arc::new(Self {
                is_plane: rectangle.is_some() || is_plane(form),
                geometry: Geometry::build(vec![form.clone()]),
                shape,
                area,
                two_sided,
                rectangle,
            }))
        };
        (0..lights.count() as u32).map(lamp).collect()
    }

    /// A box that holds it: lower and upper corner.
    pub(super) fn bounds(&self) -> (Vec3, Vec3) {
        self.geometry.bounds()
    }

    /// Calls `visit` with all places at which a ray meets the light's shape, and their distances.
    pub(super) fn each_meeting(&self, ray: &Ray, mut visit: impl FnMut(f32, SurfacePoint)) {
        let (mut ray, mut before) = (*ray, 0.0);
        while let Some(point) = self.geometry.intersect(&ray) {
            let behind = Ray {
                max_distance: ray.max_distance - point.distance,
                ..point.ray_towards(ray.direction)
            };
            before += point.distance;
            visit(before, self.of_scene(point));
            ray = behind;
        }
    }

    /// The point of the light at `place`, which lies on it; `normal` is its unit normal there.
    pub(super) fn point_at(&self, place: Vec3, normal: Vec3) -> Option<SurfacePoint> {
        let (lower, upper) = self.bounds();
        let height = 1e-3 * (upper - lower).length();
        let point = self.geometry.intersect(&Ray {
            origin: place + normal * height,
            direction: -normal,
            max_distance: 2.0 * height,
        })?;
        Some(self.of_scene(point))
    }

    /// Area of the sides that emit \[unit^2\].
    pub(super) fn emitting(&self) -> f32 {
        self.area * if self.two_sided { 2.0 } else { 1.0 }
    }

    /// A point of the light as paths along `direction` start there, with the normal of its side; `None` where that emits nothing.
    pub(super) fn facing(&self, mut point: SurfacePoint, direction: Vec3) -> Option<SurfacePoint> {
        if point.geometric_normal.dot(direction) < 0.0 {
            if !self.two_sided {
                return None;
            }
            point.geometric_normal = -point.geometric_normal;
        }
        Some(point)
    }

    /// A point of the lamp's own geometry as one of the scene.
    fn of_scene(&self, point: SurfacePoint) -> SurfacePoint {
        SurfacePoint {
            shape: self.shape,
            outer: self.shape,
            ..point
        }
    }
}

impl Rectangle {
    /// The rectangle that a mesh of two triangles makes.
    fn of(shape: &Shape) -> Option<Self> {
        let Shape::Mesh(mesh) = shape else { return None };
        let [first, second] = mesh.triangles[..] else {
            return None;
        };
        let [first, second] = [first, second].map(|triangle| triangle.map(|corner| mesh.positions[corner as usize]));
        let corner = *first.iter().find(|corner| !second.contains(corner))?;
        let opposite = *second.iter().find(|corner| !first.contains(corner))?;
        let mut shared = first.iter().filter(|place| **place != corner);
        let sides = [*shared.next()? - corner, *shared.next()? - corner];
        let lengths = sides.map(Vec3::length);
        let edges = [sides[0] / lengths[0], sides[1] / lengths[1]];
        let closes = (corner + sides[0] + sides[1] - opposite).length() <= EVENNESS * (lengths[0] + lengths[1]);
        let is_right = edges[0].dot(edges[1]).abs() <= EVENNESS;
        (closes && is_right).then_some(Self { corner, edges, lengths })
    }

    fn middle(&self) -> Vec3 {
        self.corner + (self.edges[0] * self.lengths[0] + self.edges[1] * self.lengths[1]) * 0.5
    }

    /// The distance of a corner from the middle.
    pub(super) fn radius(&self) -> f32 {
        0.5 * self.lengths[0].hypot(self.lengths[1])
    }

    /// The line along the edge of the number `edge` on which a place lies.
    pub(super) fn line_through(&self, place: Vec3, edge: usize) -> Line {
        let across = self.edges[1 - edge];
        Line {
            origin: self.corner + across * (place - self.corner).dot(across),
            along: self.edges[edge],
            length: self.lengths[edge],
        }
    }

    /// A line in a random direction, at a distance from the middle that is uniform up to [`Self::radius`]; `None` where it misses the
    /// rectangle.
    pub(super) fn random_line(&self, random: &mut PathRandom) -> Option<Line> {
        let (sine, cosine) = sin_cos(TAU * random.next_1d());
        let offset = self.radius() * (2.0 * random.next_1d() - 1.0);
        let (along, across) = ([cosine, sine], [-sine, cosine]);
        // From the middle; the line enters and leaves the strips between opposite sides.
        let (mut start, mut end) = (f32::NEG_INFINITY, f32::INFINITY);
        for axis in 0..2 {
            let (at, half) = (offset * across[axis], 0.5 * self.lengths[axis]);
            let (low, high) = ((-half - at) / along[axis], (half - at) / along[axis]);
            start = start.max(low.min(high));
            end = end.min(low.max(high));
        }
        let on_rectangle = |[u, v]: [f32; 2]| self.edges[0] * u + self.edges[1] * v;
        let along = on_rectangle(along);
        (start < end).then(|| Line {
            origin: self.middle() + on_rectangle(across) * offset + along * start,
            along,
            length: end - start,
        })
    }
}

/// Whether a shape has the same normal everywhere.
fn is_plane(shape: &Shape) -> bool {
    match shape {
        Shape::Mesh(mesh) => {
            let mut normals = mesh.triangles.iter().map(|triangle| {
                let [a, b, c] = triangle.map(|corner| mesh.positions[corner as usize]);
                (b - a).cross(c - a)
            });
            let Some(first) = normals.next().and_then(Vec3::try_normalize) else {
                return false;
            };
            normals.all(|normal| (normal - first * normal.length()).length() <= EVENNESS * normal.length())
        }
        Shape::Disk { .. } => true,
        Shape::Sphere { .. } | Shape::Ellipsoid { .. } | Shape::Cylinder { .. } | Shape::Instance { .. } => false,
    }
}

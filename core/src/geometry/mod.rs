//! Shapes and the ray queries over them.
//!
//! Primitives (triangles, spheres, discs) are numbered through all shapes in order. One hierarchy covers them all; it
//! stores what the intersection tests need, while shading attributes are read from the shape once the nearest hit is
//! known.
//!
//! An instance is a further kind of primitive: it holds a transform and a shared [`ShapeGroup`], which has a hierarchy of
//! its own, carries the ray into the group's space, and answers with the hit that it finds there.

mod boxes;
mod curved;
mod hierarchy;
mod instance;
mod sampling;
mod surface;
mod tangents;
mod traversal;
mod triangle;

use crate::math::{DVec3, Frame, Transform, Vec2, Vec3};
pub(crate) use boxes::BoxTree;
use hierarchy::{EXACT_ORIGINS, Hierarchy};
pub use instance::ShapeGroup;
pub use sampling::{ShapeSampler, TowardsSample};
use std::sync::Arc;
pub(crate) use surface::SHADOW_GAP;

/// A ray; `direction` is unit length. Hits with distance in `(0, max_distance)` count: the origin has already been
/// moved off its surface (see [`SurfacePoint::ray_towards`]).
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start \[scene units\].
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
    /// Hits at this distance or beyond do not count \[scene units\].
    pub max_distance: f32,
}

/// The line of a ray in double precision, as the hierarchy is searched with it.
#[derive(Clone, Copy, Debug)]
struct Line {
    origin: DVec3,
    /// Unit direction.
    direction: DVec3,
}

impl Line {
    fn of(ray: &Ray) -> Self {
        Self {
            origin: ray.origin.as_dvec3(),
            direction: ray.direction.as_dvec3(),
        }
    }
}

/// Index of a shape in the scene (one per `<shape>` element). Shapes of groups are numbered behind all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ShapeId(pub u32);

/// Where a ray met a surface: everything that shading needs, in world space.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Position \[scene units\].
    pub position: Vec3,
    /// Unit normal of the true surface, on the shape's outer side (Mitsuba's convention for each shape). Where the
    /// vertex normals of a mesh contradict the order of its vertices, they decide which side is the outer one, since
    /// in Mitsuba the shading frame tells materials and lights the front from the back.
    pub geometric_normal: Vec3,
    /// Shading frame; `frame.n` is the interpolated normal, within 90 degrees of `geometric_normal`, and `frame.s` runs
    /// along the first texture coordinate where the surface has texture coordinates.
    pub frame: Frame,
    /// Texture coordinates.
    pub uv: Vec2,
    /// Bound of the rounding error of `position` per axis, for ray offsets.
    pub position_error: f32,
    /// The shape that was hit, within its group where an instance was; the scene maps it to its material and light.
    pub shape: ShapeId,
    /// The shape itself, or the instance by which it was hit.
    pub outer: ShapeId,
    /// The triangle of a mesh that was hit; 0 on other shapes.
    pub primitive: u32,
    /// Barycentric coordinates of the second and third vertex of that triangle; zero on other shapes.
    pub barycentric: Vec2,
    /// Distance along the ray.
    pub distance: f32,
}

/// A shape in world space, as validated data.
#[derive(Clone, Debug)]
pub enum Shape {
    /// Triangles.
    Mesh(Arc<TriangleMesh>),
    /// A sphere; the outer side is outside unless `flip_normals`.
    Sphere {
        /// Centre \[scene units\].
        center: Vec3,
        /// Radius \[scene units\], positive.
        radius: f32,
        /// Maps the sphere to the unit sphere about the origin, whose poles on the z axis place the texture coordinates.
        to_local: Transform,
        /// Whether the outer side is inside.
        flip_normals: bool,
    },
    /// The unit sphere about the origin, mapped by `to_world`; the outer side is outside unless `flip_normals`.
    Ellipsoid {
        /// Local to world; any affine map.
        to_world: Transform,
        /// Whether the outer side is inside.
        flip_normals: bool,
    },
    /// The unit disc about the local z axis, mapped by `to_world`; the outer side is local +z unless `flip_normals`.
    Disk {
        /// Local to world; any affine map.
        to_world: Transform,
        /// Whether the outer side is local -z.
        flip_normals: bool,
    },
    /// The mantle of the cylinder of radius 1 about the local z axis from z = 0 to 1, mapped by `to_world`; the outer side
    /// is outside unless `flip_normals`.
    Cylinder {
        /// Local to world; any affine map, but a light's scales x and y evenly and keeps z perpendicular to them.
        to_world: Transform,
        /// Whether the outer side is inside.
        flip_normals: bool,
    },
    /// A group of shapes, mapped by `to_world`. Outer sides stay those of the group's shapes, whether or not the map mirrors.
    Instance {
        /// The shapes.
        group: Arc<ShapeGroup>,
        /// The group's space to world; any affine map.
        to_world: Transform,
    },
}

/// Triangles in world space. The outer side is the one from which vertices appear counter-clockwise, unless `normals`
/// point to the other (see [`SurfacePoint::geometric_normal`]).
#[derive(Clone, Debug, Default)]
pub struct TriangleMesh {
    /// Vertices \[scene units\].
    pub positions: Vec<Vec3>,
    /// Unit vertex normals, or empty for flat shading.
    pub normals: Vec<Vec3>,
    /// Vertex texture coordinates, or empty (then the barycentric coordinates are used).
    pub uvs: Vec<Vec2>,
    /// Vertex indices, each below `positions.len()`.
    pub triangles: Vec<[u32; 3]>,
}

/// All shapes with their hierarchy.
#[derive(Clone, Debug)]
pub struct Geometry {
    shapes: Vec<Shape>,
    /// Index of each shape's first primitive.
    first_primitive: Vec<u32>,
    hierarchy: Hierarchy,
}

impl Shape {
    /// Bounds of the shape in the world.
    pub(crate) fn bounds(&self) -> (Vec3, Vec3) {
        match self {
            Self::Mesh(mesh) => {
                let nothing = (Vec3::INFINITY, Vec3::NEG_INFINITY);
                let positions = mesh.positions.iter();
                positions.fold(nothing, |(lower, upper), place| (lower.min(*place), upper.max(*place)))
            }
            curved => curved::bounds(curved).unwrap_or_default(),
        }
    }

    /// Number of primitives.
    fn primitives(&self) -> usize {
        match self {
            Self::Mesh(mesh) => mesh.triangles.len(),
            _ => 1,
        }
    }

    /// The shape carried along by the map `by`, which does not mirror, and scales spheres evenly. Its primitives keep their numbers.
    #[must_use]
    pub fn moved(&self, by: &Transform) -> Self {
        match self {
            Self::Mesh(mesh) => Self::Mesh(Arc::new(TriangleMesh {
                positions: mesh.positions.iter().map(|p| by.point(*p)).collect(),
                normals: mesh.normals.iter().map(|n| by.normal(*n)).collect(),
                uvs: mesh.uvs.clone(),
                triangles: mesh.triangles.clone(),
            })),
            Self::Sphere {
                center,
                radius,
                to_local,
                flip_normals,
            } => Self::Sphere {
                center: by.point(*center),
                radius: (f64::from(*radius) * libm::cbrt(by.matrix().determinant())) as f32,
                to_local: to_local.after(&by.inverted()),
                flip_normals: *flip_normals,
            },
            Self::Ellipsoid { to_world, flip_normals } => Self::Ellipsoid {
                to_world: by.after(to_world),
                flip_normals: *flip_normals,
            },
            Self::Disk { to_world, flip_normals } => Self::Disk {
                to_world: by.after(to_world),
                flip_normals: *flip_normals,
            },
            Self::Cylinder { to_world, flip_normals } => Self::Cylinder {
                to_world: by.after(to_world),
                flip_normals: *flip_normals,
            },
            Self::Instance { group, to_world } => Self::Instance {
                group: Arc::clone(group),
                to_world: by.after(to_world),
            },
        }
    }
}

impl Geometry {
    /// Builds the hierarchy. The same shapes give the same structure on any machine and with any number of threads.
    ///
    /// Triangles without area keep their number but are never hit.
    ///
    /// # Panics
    /// If there are 2^29 primitives or more, or a mesh refers to a vertex that it does not have.
    #[must_use]
    pub fn build(shapes: Vec<Shape>) -> Self {
        Self::build_for(shapes, EXACT_ORIGINS)
    }

    /// Builds a hierarchy with the given margin of its boxes.
    fn build_for(shapes: Vec<Shape>, margin: f32) -> Self {
        let count: usize = shapes.iter().map(Shape::primitives).sum();
        assert!(count < 1 << 29, "{count} primitives: the limit is 2^29");
        let mut next = 0;
        let first_primitive = shapes
            .iter()
            .map(|shape| {
                let first = next;
                next += shape.primitives() as u32;
                first
            })
            .collect();
        let hierarchy = Hierarchy::build(&shapes, margin);
        Self {
            shapes,
            first_primitive,
            hierarchy,
        }
    }

    /// The geometry with new shapes in place of some of its own, each with as many primitives as the one before.
    ///
    /// The hierarchy keeps its structure and is fitted to the new shapes. A ray hits the same as if it were built for them, to the
    /// last bit, but for triangles that had no area when it was built: these are not hit even where they have one now.
    #[must_use]
    pub fn moved(&self, shapes: impl IntoIterator<Item = (ShapeId, Shape)>) -> Self {
        let mut moved = self.clone();
        let mut ids = Vec::new();
        for (id, shape) in shapes {
            moved.shapes[id.0 as usize] = shape;
            ids.push(id.0 as usize);
        }
        ids.sort_unstable();
        let renewed: Vec<_> = ids
            .into_iter()
            .map(|id| {
                let (first, shape) = (self.first_primitive[id], &moved.shapes[id]);
                (first..first + shape.primitives() as u32, shape)
            })
            .collect();
        moved.hierarchy.refit(&renewed);
        moved
    }

    /// The nearest hit. Of hits at equal distance the one with the lowest primitive index wins.
    #[must_use]
    pub fn intersect(&self, ray: &Ray) -> Option<SurfacePoint> {
        let hit = self.hierarchy.nearest(&Line::of(ray), f64::from(ray.max_distance));
        hit.map(|hit| self.surface_point(ray, &hit))
    }

    /// Whether anything lies on the ray before `max_distance`.
    #[must_use]
    pub fn occluded(&self, ray: &Ray) -> bool {
        self.hierarchy.any(&Line::of(ray), f64::from(ray.max_distance))
    }

    /// Bounds of all shapes \[scene units\]: lower and upper corner. Both are zero where there is nothing.
    #[must_use]
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.hierarchy.bounds
    }

    /// The shape to which a primitive belongs.
    #[inline]
    fn shape_of(&self, primitive: u32) -> u32 {
        self.first_primitive.partition_point(|first| *first <= primitive) as u32 - 1
    }

    /// A shape of the scene that belongs to no group.
    #[must_use]
    pub fn shape(&self, id: ShapeId) -> &Shape {
        &self.shapes[id.0 as usize]
    }
}

#[cfg(test)]
mod tests;

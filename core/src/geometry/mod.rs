//! Shapes and the ray queries over them.
use crate::math::{Frame, Vec2, Vec3};

/// A ray; `direction` is unit length. Hits with distance in `(0, max_distance)` count: the origin has already been
/// moved off its surface (see [`SurfacePoint::ray_towards`]).
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: Vec3,
    pub direction: Vec3,
    pub max_distance: f32,
}

/// Index of a shape in the scene (one per `<shape>` element).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ShapeId(pub u32);

/// Where a ray met a surface: everything that shading needs, in world space.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Position [scene units].
    pub position: Vec3,
    /// Unit normal of the true surface, on the shape's outer side (Mitsuba's convention for each shape).
    pub geometric_normal: Vec3,
    /// Shading frame; `frame.n` is the interpolated normal, within 90 degrees of `geometric_normal`.
    pub frame: Frame,
    /// Texture coordinates.
    pub uv: Vec2,
    /// Bound of the rounding error of `position` per axis, for ray offsets.
    pub position_error: Vec3,
    /// The shape that was hit; the scene maps it to its material and light.
    pub shape: ShapeId,
    /// Primitive within the geometry (triangle, sphere or disk), for light densities.
    pub primitive: u32,
    /// Distance along the ray.
    pub distance: f32,
}

/// A shape in world space, as validated data.
#[derive(Clone, Debug)]
pub enum Shape {
    /// Triangles.
    Mesh(TriangleMesh),
    /// A sphere; the outer side is outside unless `flip_normals`.
    Sphere {
        center: Vec3,
        radius: f32,
        to_local: crate::math::Transform,
        flip_normals: bool,
    },
    /// The unit disc about the local z axis, mapped by `to_world`; the outer side is local +z unless `flip_normals`.
    Disk {
        to_world: crate::math::Transform,
        flip_normals: bool,
    },
}

/// Triangles in world space. The outer side is the one from which vertices appear counter-clockwise.
#[derive(Clone, Debug, Default)]
pub struct TriangleMesh {
    /// Vertices [scene units].
    pub positions: Vec<Vec3>,
    /// Unit vertex normals, or empty for flat shading.
    pub normals: Vec<Vec3>,
    /// Vertex texture coordinates, or empty (then the barycentric coordinates are used).
    pub uvs: Vec<Vec2>,
    /// Vertex indices, each below `positions.len()`.
    pub triangles: Vec<[u32; 3]>,
}

/// All shapes with their hierarchy.
#[derive(Debug)]
pub struct Geometry {}

impl Geometry {
    /// Builds the hierarchy. The same shapes give the same structure on any machine and with any number of threads.
    #[must_use]
    pub fn build(_shapes: Vec<Shape>) -> Self {
        unimplemented!()
    }
    /// The nearest hit. Of hits at equal distance the one with the lowest primitive index wins.
    #[must_use]
    pub fn intersect(&self, _ray: &Ray) -> Option<SurfacePoint> {
        unimplemented!()
    }
    /// Whether anything lies on the ray before `max_distance`.
    #[must_use]
    pub fn occluded(&self, _ray: &Ray) -> bool {
        unimplemented!()
    }
    /// Bounds of all shapes [scene units]: lower and upper corner.
    #[must_use]
    pub fn bounds(&self) -> (Vec3, Vec3) {
        unimplemented!()
    }
}

impl SurfacePoint {
    /// A ray that leaves this point along the unit vector `direction`, its origin moved off the surface (Waechter and Binder 2019, or error bounds).
    #[must_use]
    pub fn ray_towards(&self, _direction: Vec3) -> Ray {
        unimplemented!()
    }
    /// A ray for a visibility test along the unit vector `direction` that ends just before `distance`.
    #[must_use]
    pub fn shadow_ray(&self, _direction: Vec3, _distance: f32) -> Ray {
        unimplemented!()
    }
}

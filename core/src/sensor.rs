//! Cameras.
use crate::geometry::Ray;
use crate::math::{Transform, Vec2, Vec3};

/// A camera, as validated data. It looks along its local +z with +x to the left of the image (Mitsuba's convention).
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Camera to world; rotation, translation and uniform scale.
    pub to_world: Transform,
    /// Horizontal field of view [radians]: `fov_axis` has been resolved.
    pub fov_x: f32,
    /// Principal point offset, in fractions of the image size.
    pub principal_point: Vec2,
    /// Image size [pixels].
    pub resolution: [u32; 2],
    /// Near and far clip distances along the optical axis.
    pub clip: [f32; 2],
    /// Thin lens, or none for a pinhole.
    pub lens: Option<Lens>,
}

/// A thin lens.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    /// Aperture radius [scene units].
    pub radius: f32,
    /// Distance of the plane in focus [scene units].
    pub focus_distance: f32,
}

impl Sensor {
    /// The ray of weight one through image position `pixel` [pixels, from the top left corner]; `u` chooses the point on the lens.
    #[must_use]
    pub fn ray(&self, _pixel: Vec2, _u: Vec2) -> Ray {
        unimplemented!()
    }
    /// Centre of the lens, or the pinhole, in the world.
    #[must_use]
    pub fn position(&self) -> Vec3 {
        self.to_world.point(Vec3::ZERO)
    }
    /// Side of a pixel's footprint on a surface facing the camera at `distance` [scene units].
    #[must_use]
    pub fn pixel_footprint(&self, distance: f32) -> f32 {
        2.0 * distance * crate::math::tan(0.5 * self.fov_x) / self.resolution[0] as f32
    }
}

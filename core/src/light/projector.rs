//! A slide projector.

use super::Even;
use crate::geometry::Ray;
use crate::math::{Frame, PI, Transform, Vec2, Vec3, atan2, tan};
use crate::spectrum::Spectrum;
use crate::texture::{Texture, TexturePoint};

/// A point light that throws an image.
#[derive(Clone, Debug)]
pub(super) struct Projector {
    position: Vec3,
    /// Its axis is +z, and the image's left and top lie along +x and +y.
    frame: Frame,
    /// Half the width and half the height of the image on that plane.
    half_size: Vec2,
    image: Texture,
    /// Factor on the image.
    scale: f32,
    even: Even,
}

impl Projector {
    /// `to_world` moves, turns and mirrors only; `fov_x` \[radians\] is the angle that the image's width is seen under, and `aspect` its
    /// width over its height.
    pub(super) fn new(to_world: &Transform, fov_x: f32, aspect: f32, image: Texture, scale: f32, even: Even) -> Self {
        let half_width = tan(0.5 * fov_x);
        Self {
            position: to_world.point(Vec3::ZERO),
            frame: axes(to_world),
            half_size: Vec2::new(half_width, half_width / aspect),
            image,
            scale,
            even,
        }
    }

    /// The light where `to_world` puts it.
    pub(super) fn moved(&self, to_world: &Transform) -> Self {
        Self {
            position: to_world.point(Vec3::ZERO),
            frame: axes(to_world),
            ..self.clone()
        }
    }

    pub(super) fn position(&self) -> Vec3 {
        self.position
    }

    /// Intensity [W/sr] along the unit vector `direction`. At an angle theta from the axis the plane is `1 / cos theta` away and
    /// tilted by theta: its irradiance is the intensity times `cos^3 theta`.
    pub(super) fn intensity(&self, direction: Vec3) -> Spectrum {
        self.locate(direction)
            .map_or(Spectrum::ZERO, |(uv, cos)| match self.even {
                Even::Plane => self.irradiance(uv) / (cos * cos * cos),
                Even::Directions => self.shown(uv) * self.scale,
            })
    }

    /// Solid-angle density of the directions of light paths [1/sr].
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        self.locate(direction).map_or(0.0, |(_, cos)| self.pdf_at(cos))
    }

    /// A ray through a point uniform on the image, its intensity over the density of its direction, and that density [1/sr].
    pub(super) fn emit(&self, u: Vec2) -> (Ray, Spectrum, f32) {
        let local = ((Vec2::ONE - 2.0 * u) * self.half_size).extend(1.0).normalize();
        let ray = Ray {
            origin: self.position,
            direction: self.frame.to_world(local).normalize(),
            max_distance: f32::INFINITY,
        };
        let pdf = self.pdf_at(local.z);
        let flux = match self.even {
            Even::Plane => self.irradiance(u) * self.area(),
            Even::Directions => self.shown(u) * (self.scale / pdf),
        };
        (ray, flux, pdf)
    }

    /// Luminance of the power; of an image that is even by directions, as if it were the same everywhere.
    pub(super) fn power(&self) -> f32 {
        let measure = match self.even {
            Even::Plane => PI * self.area(),
            Even::Directions => self.solid_angle(),
        };
        self.scale * self.image.mean().luminance() * measure
    }

    /// Where a direction meets the image, and its cosine with the axis; `None` beside the image.
    fn locate(&self, direction: Vec3) -> Option<(Vec2, f32)> {
        let local = self.frame.to_local(direction);
        let at = local.truncate() / local.z / self.half_size;
        let inside = local.z > 0.0 && at.abs().max_element() <= 1.0;
        inside.then_some((0.5 * (Vec2::ONE - at), local.z))
    }

    /// What the image shows.
    fn shown(&self, uv: Vec2) -> Spectrum {
        self.image.eval(&TexturePoint {
            position: self.position,
            ..TexturePoint::of_uv(uv)
        })
    }

    /// Irradiance of the plane [W/unit^2]: that by which a white surface has the image's radiance.
    fn irradiance(&self, uv: Vec2) -> Spectrum {
        self.shown(uv) * (PI * self.scale)
    }

    /// Solid angle of the image \[sr\]: of a rectangle with the half sides a and b at distance 1, 4 arctan(a b / sqrt(1 + a^2 + b^2)).
    fn solid_angle(&self) -> f32 {
        let half = self.half_size;
        4.0 * atan2(half.x * half.y, (1.0 + half.length_squared()).sqrt())
    }

    /// Area of the image on the plane.
    fn area(&self) -> f32 {
        4.0 * self.half_size.x * self.half_size.y
    }

    fn pdf_at(&self, cos: f32) -> f32 {
        1.0 / (self.area() * cos * cos * cos)
    }
}

/// The directions of the axes; a mirrored frame stays mirrored.
pub(super) fn axes(to_world: &Transform) -> Frame {
    let axis = |local: Vec3| to_world.vector(local).normalize();
    Frame {
        s: axis(Vec3::X),
        t: axis(Vec3::Y),
        n: axis(Vec3::Z),
    }
}

//! Cameras.

mod perspective;
mod spherical;
mod square;
#[cfg(test)]
mod tests;

pub use perspective::Lens;

use crate::geometry::Ray;
use crate::math::warp::{square_to_cosine_hemisphere, square_to_disk};
use crate::math::{FRAC_1_PI, Frame, PI, TAU, Transform, Vec2, Vec3, atan2, sin_cos, sqr, tan};
use glam::{DMat4, DVec3};

/// A camera, as validated data. It looks along its local +z with +x to the left of the image (Mitsuba's convention).
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Camera to world: rotation, translation and mirroring; any affine map for an orthographic camera.
    pub to_world: Transform,
    /// How points of the image become rays.
    pub projection: Projection,
    /// Image size \[pixels\].
    pub resolution: [u32; 2],
    /// Near and far clip distances along the optical axis [scene units].
    pub clip: [f32; 2],
}

/// How points of the image become rays.
#[derive(Clone, Copy, Debug)]
pub enum Projection {
    /// Rays through one point, or through a lens.
    Perspective {
        /// Horizontal field of view \[radians\]: `fov_axis` has been resolved.
        fov_x: f32,
        /// Principal point offset, in fractions of the image size.
        principal_point: Vec2,
        /// Thin lens, or none for a pinhole.
        lens: Option<Lens>,
    },
    /// Parallel rays. The image spans [-1, 1] in local x and the same scale in local y; `to_world` gives its size.
    Orthographic,
    /// Rays in all directions from one point: longitude across and latitude down, the upper edge is local +y, as in an image of
    /// Mitsuba's `envmap`.
    Spherical,
    /// Rays from everywhere on the square [-1, 1]^2 of the local plane z = 0, by the cosine about its normal: a pixel is the part of the
    /// square that it has of the image, and its value, times pi, the irradiance there.
    Irradiance {
        /// Whether the normal is local -z.
        flipped: bool,
    },
}

/// The density of a camera ray among those of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct SensorPdf {
    /// Solid-angle density of its direction [1/sr]; where rays are parallel, of its place by area that faces the camera [1/unit^2].
    pub pdf: f32,
    /// Cosine of the direction with the camera's axis.
    pub cos: f32,
    /// Density of its point on the lens [1/unit^2]; none without a lens.
    pub pdf_lens: Option<f32>,
    /// Whether all rays are parallel.
    pub parallel: bool,
    /// Distance from the lens to the near plane, where the ray starts [scene units]; 0 where rays are parallel.
    pub clipped: f32,
}

/// A connection of a surface point with the camera.
#[derive(Clone, Copy, Debug)]
pub struct SensorSample {
    /// Image position [pixels, from the top left corner].
    pub pixel: Vec2,
    /// The density of the camera ray that goes the same way.
    pub pdf: SensorPdf,
    /// Unit direction to the camera.
    pub direction: Vec3,
    /// Distance to the lens, or where rays are parallel to the near plane [scene units].
    pub distance: f32,
}

impl SensorSample {
    /// How much of the way must be free for the camera to see the point [scene units].
    #[must_use]
    pub fn visible_distance(&self) -> f32 {
        self.distance - self.pdf.clipped
    }

    /// Density by area that faces the camera [1/unit^2] of camera rays at the point.
    #[must_use]
    pub fn pdf_area(&self) -> f32 {
        if self.pdf.parallel {
            self.pdf.pdf
        } else {
            self.pdf.pdf / sqr(self.distance)
        }
    }
}

/// The way from a surface point to the camera.
#[derive(Clone, Copy, Debug)]
pub struct Towards {
    /// Unit direction to the pinhole or the centre of the lens; against the rays of an orthographic camera.
    pub direction: Vec3,
    /// Bound on the angle between `direction` and the directions to points of the lens \[radians\]; 0 without a lens, pi inside
    /// the sphere around it.
    pub lens_angle: f32,
}

impl Sensor {
    /// The ray of weight one through image position `pixel` [pixels, from the top left corner]; `u` chooses the point on the lens.
    ///
    /// It starts on the plane `clip[0]` before the lens and ends on the plane `clip[1]`. As in Mitsuba, the start of an
    /// orthographic ray scales with `to_world` along the axis while its length, `clip[1] - clip[0]`, does not.
    #[must_use]
    pub fn ray(&self, pixel: Vec2, u: Vec2) -> Ray {
        let [width, height] = self.resolution.map(|n| n as f32);
        let at = pixel / Vec2::new(width, height);
        match self.projection {
            Projection::Perspective {
                fov_x,
                principal_point,
                lens,
            } => {
                let at = on_image_plane(at + principal_point, height / width);
                self.perspective_ray((tan(0.5 * fov_x) * at).extend(1.0), lens, u)
            }
            Projection::Orthographic => {
                let start = on_image_plane(at, height / width).extend(self.clip[0]);
                Ray {
                    origin: self.to_world.point(start),
                    direction: self.to_world.vector(Vec3::Z).normalize(),
                    max_distance: self.clip[1] - self.clip[0],
                }
            }
            Projection::Spherical => {
                let (sin_phi, cos_phi) = sin_cos(TAU * at.x);
                let (sin_theta, cos_theta) = sin_cos(PI * at.y);
                let local = Vec3::new(sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi);
                let direction = self.to_world.vector(local).normalize();
                Ray {
                    origin: self.to_world.point(Vec3::ZERO) + self.clip[0] * direction,
                    direction,
                    max_distance: self.clip[1] - self.clip[0],
                }
            }
            Projection::Irradiance { flipped } => {
                let normal = self.plane_normal(flipped);
                let direction = Frame::from_normal(normal)
                    .to_world(square_to_cosine_hemisphere(u))
                    .normalize();
                let place = self.to_world.point((2.0 * at - Vec2::ONE).extend(0.0));
                // Off the surface that lies there, as far as its points are rounded.
                let rounding = 64.0 * f32::EPSILON * (place.abs().max_element() + self.plane_radius());
                Ray {
                    origin: place + rounding * normal,
                    direction,
                    max_distance: f32::INFINITY,
                }
            }
        }
    }

    /// The factor that turns the mean over a pixel's rays into what the sensor measures: 1 for a camera, which measures radiance.
    #[must_use]
    pub fn response(&self) -> f32 {
        match self.projection {
            Projection::Irradiance { .. } => PI,
            Projection::Perspective { .. } | Projection::Orthographic | Projection::Spherical => 1.0,
        }
    }

    /// The camera whose image is the window of `size` pixels at `offset` of this one's, which must be a camera for a plane image.
    #[must_use]
    pub fn cropped(&self, offset: [u32; 2], size: [u32; 2]) -> Self {
        let [whole, at, part] = [self.resolution, offset, size].map(|pixels| Vec2::from(pixels.map(|n| n as f32)));
        let (projection, to_world) = match self.projection {
            // Image position s in fractions of the film lies at slope * (1 - 2 (s + principal_point)) on the plane before the camera.
            Projection::Perspective {
                fov_x,
                principal_point,
                lens,
            } => {
                let slope = tan(0.5 * fov_x) * part.x / whole.x;
                let corner = whole / part * (Vec2::ONE - 2.0 * at / whole - 2.0 * principal_point);
                let narrowed = Projection::Perspective {
                    fov_x: 2.0 * atan2(slope, 1.0),
                    principal_point: 0.5 * (Vec2::ONE - corner),
                    lens,
                };
                (narrowed, self.to_world)
            }
            Projection::Orthographic => {
                let middle = on_image_plane((at + 0.5 * part) / whole, whole.y / whole.x);
                (self.projection, self.to_world.after(&window(middle, part.x / whole.x)))
            }
            other @ (Projection::Spherical | Projection::Irradiance { .. }) => (other, self.to_world),
        };
        Self {
            to_world,
            projection,
            resolution: size,
            clip: self.clip,
        }
    }

    /// Number of pixels.
    fn pixels(&self) -> f32 {
        self.resolution[0] as f32 * self.resolution[1] as f32
    }

    /// The density with which camera rays through one pixel leave along the ray, which must be one of [`Self::ray`].
    #[must_use]
    pub fn pdf_we(&self, ray: &Ray) -> SensorPdf {
        let axis = self.to_world.vector(Vec3::Z).normalize();
        let cos = ray.direction.dot(axis);
        match self.projection {
            Projection::Perspective { lens, .. } => SensorPdf {
                pdf: 1.0 / (self.pixel_area() * cos * cos * cos),
                cos,
                pdf_lens: lens.map(Lens::pdf),
                parallel: false,
                clipped: self.clip[0] / cos,
            },
            Projection::Orthographic => SensorPdf {
                pdf: 1.0 / self.pixel_area(),
                cos: 1.0,
                pdf_lens: None,
                parallel: true,
                clipped: 0.0,
            },
            Projection::Spherical => {
                let up = self.to_world.vector(Vec3::Y).normalize();
                // The sine of the angle from the pole; of the poles themselves no pixel is the middle.
                let sine = up.cross(ray.direction).length().max(f32::MIN_POSITIVE);
                SensorPdf {
                    pdf: self.pixels() / (2.0 * PI * PI * sine),
                    cos: 1.0,
                    pdf_lens: None,
                    parallel: false,
                    clipped: self.clip[0],
                }
            }
            Projection::Irradiance { flipped } => {
                let cos = ray.direction.dot(self.plane_normal(flipped)).max(0.0);
                SensorPdf {
                    // Of one pixel's rays all start on its part of the square: there they are denser than over the whole square.
                    pdf: self.pixels() * cos * FRAC_1_PI,
                    cos,
                    pdf_lens: None,
                    parallel: false,
                    clipped: 0.0,
                }
            }
        }
    }

    /// The part of the plane at distance one, or of an orthographic camera's cross-section [scene units squared], that a pixel shows.
    fn pixel_area(&self) -> f32 {
        sqr(self.pixel_footprint(1.0))
    }

    /// Connects a surface point with the camera through the point `u` of the lens; `None` where the camera does not see it, whatever
    /// is in the way.
    #[must_use]
    pub fn sample_we(&self, position: Vec3, u: Vec2) -> Option<SensorSample> {
        let local = self.to_world.inverted().point(position);
        match self.projection {
            Projection::Spherical => self.sample_spherical(position, local),
            Projection::Irradiance { .. } => self.sample_plane(position, u),
            Projection::Perspective { lens, .. } => {
                let on_lens = lens.map_or(Vec3::ZERO, |lens| (lens.radius * square_to_disk(u)).extend(0.0));
                let offset = local - on_lens;
                let distance = offset.length();
                let ray = Ray {
                    origin: self.to_world.point(on_lens),
                    direction: (position - self.to_world.point(on_lens)).try_normalize()?,
                    max_distance: distance,
                };
                (offset.z > self.clip[0] && offset.z < self.clip[1]).then(|| SensorSample {
                    pixel: self.pixel_of(self.through(on_lens, offset)),
                    pdf: self.pdf_we(&ray),
                    direction: -ray.direction,
                    distance,
                })
            }
            Projection::Orthographic => {
                let axis = self.to_world.vector(Vec3::Z);
                let depth = (local.z - self.clip[0]) * axis.length();
                let ray = Ray {
                    origin: position,
                    direction: axis.normalize(),
                    max_distance: depth,
                };
                (depth > 0.0 && depth < self.clip[1] - self.clip[0]).then(|| SensorSample {
                    pixel: self.pixel_of(local.truncate()),
                    pdf: self.pdf_we(&ray),
                    direction: -ray.direction,
                    distance: depth,
                })
            }
        }
    }

    /// The image position \[pixels\] of camera coordinates for a half width of one.
    fn pixel_of(&self, at: Vec2) -> Vec2 {
        let [width, height] = self.resolution.map(|n| n as f32);
        let principal_point = match self.projection {
            Projection::Perspective { principal_point, .. } => principal_point,
            Projection::Orthographic | Projection::Spherical | Projection::Irradiance { .. } => Vec2::ZERO,
        };
        let at = Vec2::new(0.5 * (1.0 - at.x), 0.5 * (1.0 - at.y * width / height)) - principal_point;
        at * Vec2::new(width, height)
    }

    /// The way from a surface point to the camera; `None` at the camera's own position.
    #[must_use]
    pub fn direction_from(&self, position: Vec3) -> Option<Towards> {
        let lens = match self.projection {
            Projection::Perspective { lens, .. } => lens,
            Projection::Orthographic => {
                return Some(Towards {
                    direction: -self.to_world.vector(Vec3::Z).normalize(),
                    lens_angle: 0.0,
                });
            }
            Projection::Spherical => None,
            // The square lies within this disc's sphere.
            Projection::Irradiance { .. } => Some(Lens {
                radius: self.plane_radius(),
                focus_distance: f32::INFINITY,
            }),
        };
        let way = self.to_world.point(Vec3::ZERO) - position;
        let lens_angle = lens.map_or(0.0, |Lens { radius, .. }| {
            let tangent2 = way.length_squared() - sqr(radius);
            if tangent2 > 0.0 {
                atan2(radius, tangent2.sqrt())
            } else {
                PI
            }
        });
        Some(Towards {
            direction: way.try_normalize()?,
            lens_angle,
        })
    }

    /// Side of a square as large as a pixel's footprint on a surface facing the camera at `distance` [scene units].
    #[must_use]
    pub fn pixel_footprint(&self, distance: f32) -> f32 {
        let width = self.resolution[0] as f32;
        match self.projection {
            Projection::Perspective { fov_x, .. } => 2.0 * distance * tan(0.5 * fov_x) / width,
            Projection::Orthographic => {
                let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| self.to_world.vector(axis));
                2.0 * x.cross(y).dot(z.normalize()).abs().sqrt() / width
            }
            // The mean over all directions.
            Projection::Spherical => distance * (4.0 * PI / self.pixels()).sqrt(),
            // Every pixel sees a hemisphere.
            Projection::Irradiance { .. } => distance,
        }
    }
}

/// Maps the image of an orthographic camera to the part of it about `middle`, in camera coordinates, that is `share` as wide.
pub(crate) fn window(middle: Vec2, share: f32) -> Transform {
    let translation = DMat4::from_translation(middle.extend(0.0).as_dvec3());
    let scale = DMat4::from_scale(DVec3::new(share.into(), share.into(), 1.0));
    Transform::from_matrix(translation * scale).unwrap_or_default()
}

/// Camera coordinates of an image position in fractions of the image, for a half width of one.
fn on_image_plane(at: Vec2, aspect: f32) -> Vec2 {
    Vec2::new(1.0 - 2.0 * at.x, (1.0 - 2.0 * at.y) * aspect)
}

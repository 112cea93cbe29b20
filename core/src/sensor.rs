//! Cameras.
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
    /// Image size [pixels].
    pub resolution: [u32; 2],
    /// Near and far clip distances along the optical axis [scene units].
    pub clip: [f32; 2],
}

/// How points of the image become rays.
#[derive(Clone, Copy, Debug)]
pub enum Projection {
    /// Rays through one point, or through a lens.
    Perspective {
        /// Horizontal field of view [radians]: `fov_axis` has been resolved.
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

/// A thin lens.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    /// Aperture radius [scene units].
    pub radius: f32,
    /// Distance of the plane in focus [scene units].
    pub focus_distance: f32,
}

impl Lens {
    /// Density of its points [1/unit^2].
    fn pdf(self) -> f32 {
        FRAC_1_PI / sqr(self.radius)
    }
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
    /// Bound on the angle between `direction` and the directions to points of the lens [radians]; 0 without a lens, pi inside
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

    /// The normal of the square of an irradiance meter.
    fn plane_normal(&self, flipped: bool) -> Vec3 {
        let normal = self.to_world.normal(Vec3::Z);
        if flipped { -normal } else { normal }
    }

    /// Distance of the corners of that square from its middle, at most [scene units].
    fn plane_radius(&self) -> f32 {
        self.to_world.vector(Vec3::X).length() + self.to_world.vector(Vec3::Y).length()
    }

    /// Number of pixels.
    fn pixels(&self) -> f32 {
        self.resolution[0] as f32 * self.resolution[1] as f32
    }

    /// The ray through the point `through` of the plane at distance one, in focus or not.
    fn perspective_ray(&self, through: Vec3, lens: Option<Lens>, u: Vec2) -> Ray {
        let (start, direction) = match lens {
            None => (Vec3::ZERO, through.normalize()),
            Some(Lens { radius, focus_distance }) => {
                let start = (radius * square_to_disk(u)).extend(0.0);
                (start, (focus_distance * through - start).normalize())
            }
        };
        let [near, far] = self.clip.map(|distance| distance / direction.z);
        let world_direction = self.to_world.vector(direction).normalize();
        Ray {
            origin: self.to_world.point(start) + near * world_direction,
            direction: world_direction,
            max_distance: far - near,
        }
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

    /// As [`Self::sample_we`], of the camera in the middle of all directions.
    fn sample_spherical(&self, position: Vec3, local: Vec3) -> Option<SensorSample> {
        let offset = position - self.to_world.point(Vec3::ZERO);
        let distance = offset.length();
        let ray = Ray {
            origin: position,
            direction: offset.try_normalize()?,
            max_distance: distance,
        };
        let turn = atan2(local.x, -local.z) / TAU;
        let at = Vec2::new(
            if turn < 0.0 { turn + 1.0 } else { turn },
            atan2(Vec2::new(local.x, local.z).length(), local.y) * FRAC_1_PI,
        );
        (distance > self.clip[0] && distance < self.clip[1]).then(|| SensorSample {
            pixel: at * Vec2::from(self.resolution.map(|n| n as f32)),
            pdf: self.pdf_we(&ray),
            direction: -ray.direction,
            distance,
        })
    }

    /// As [`Self::sample_we`], of the point `u` of the square that measures irradiance.
    fn sample_plane(&self, position: Vec3, u: Vec2) -> Option<SensorSample> {
        let offset = position - self.to_world.point((2.0 * u - Vec2::ONE).extend(0.0));
        let distance = offset.length();
        let ray = Ray {
            origin: position,
            direction: offset.try_normalize()?,
            max_distance: distance,
        };
        let pdf = self.pdf_we(&ray);
        (pdf.cos > 0.0).then(|| SensorSample {
            pixel: u * Vec2::from(self.resolution.map(|n| n as f32)),
            pdf,
            direction: -ray.direction,
            distance,
        })
    }

    /// Where a ray that comes from the scene, or `from_infinity`, and is free up to the distance `free` meets the lens; `None` where it
    /// does not, or there is no lens. What lies before the near plane hides nothing.
    #[must_use]
    pub fn hit_lens(&self, ray: &Ray, free: f32, from_infinity: bool) -> Option<SensorSample> {
        let Projection::Perspective { lens: Some(lens), .. } = self.projection else {
            return None;
        };
        let to_local = self.to_world.inverted();
        let (origin, direction) = (to_local.point(ray.origin), to_local.vector(ray.direction).normalize());
        let farthest = if from_infinity { f32::INFINITY } else { self.clip[1] };
        if direction.z >= 0.0 || origin.z <= self.clip[0] || origin.z >= farthest {
            return None;
        }
        let distance = origin.z / -direction.z;
        let on_lens = (origin + distance * direction).truncate().extend(0.0);
        let near = (origin.z - self.clip[0]) / -direction.z;
        if on_lens.length_squared() >= sqr(lens.radius) || near > free {
            return None;
        }
        let back = Ray {
            direction: -ray.direction,
            ..*ray
        };
        Some(SensorSample {
            pixel: self.pixel_of(self.through(on_lens, -direction)),
            pdf: self.pdf_we(&back),
            direction: ray.direction,
            distance,
        })
    }

    /// The point of the plane at distance one through which the camera's ray goes that leaves the lens at `on_lens` along `offset`,
    /// over half the width of the image; in camera coordinates.
    fn through(&self, on_lens: Vec3, offset: Vec3) -> Vec2 {
        let Projection::Perspective { fov_x, lens, .. } = self.projection else {
            return offset.truncate();
        };
        let slope = offset.truncate() / offset.z;
        let through = lens.map_or(slope, |lens| slope + on_lens.truncate() / lens.focus_distance);
        through / tan(0.5 * fov_x)
    }

    /// The image position [pixels] of camera coordinates for a half width of one.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{PathRandom, Stream};
    use glam::{DMat4, DVec4};

    /// `look_at` from (1, 2, 3) to (4, -1, 7), up (0.1, 1, 0.2).
    fn sensor() -> Sensor {
        let matrix = DMat4::from_cols(
            DVec4::new(0.812_031_7, 0.035_305_73, -0.582_544_5, 0.0),
            DVec4::new(0.275_497_17, 0.856_765_87, 0.435_951_53, 0.0),
            DVec4::new(0.514_495_8, -0.514_495_8, 0.685_994_4, 0.0),
            DVec4::new(1.0, 2.0, 3.0, 1.0),
        );
        Sensor {
            to_world: Transform::from_matrix(matrix).unwrap(),
            projection: perspective(Vec2::new(0.1, -0.07), None),
            resolution: [64, 36],
            clip: [0.5, 80.0],
        }
    }

    fn perspective(principal_point: Vec2, lens: Option<Lens>) -> Projection {
        Projection::Perspective {
            fov_x: 50.0_f32.to_radians(),
            principal_point,
            lens,
        }
    }

    const LENS: Lens = Lens {
        radius: 0.2,
        focus_distance: 5.0,
    };

    /// `sensor` with its principal point in the centre and `lens`.
    fn centred(lens: Option<Lens>) -> Sensor {
        Sensor {
            projection: perspective(Vec2::ZERO, lens),
            ..sensor()
        }
    }

    /// An orthographic camera like `sensor`, scaled.
    fn orthographic(scale: [f64; 3], resolution: [u32; 2]) -> Sensor {
        let scale = Transform::from_matrix(DMat4::from_scale(scale.into())).unwrap();
        Sensor {
            to_world: sensor().to_world.after(&scale),
            projection: Projection::Orthographic,
            resolution,
            ..sensor()
        }
    }

    fn assert_ray(ray: &Ray, origin: [f32; 3], direction: [f32; 3], max_distance: f32) {
        assert!((ray.origin - Vec3::from(origin)).length() < 2e-6, "{ray:?}");
        assert!((ray.direction - Vec3::from(direction)).length() < 2e-6, "{ray:?}");
        assert!((ray.max_distance - max_distance).abs() < 2e-4, "{ray:?}");
    }

    /// As below, of the camera that looks everywhere, but for the rows at the poles.
    #[test]
    fn what_a_ray_of_all_directions_shows_is_seen_at_its_pixel() {
        let camera = Sensor {
            projection: Projection::Spherical,
            ..sensor()
        };
        let mut random = PathRandom::new(9, 1, Stream::Camera, 0);
        for _ in 0..1_000 {
            let pixel = Vec2::ONE + random.next_2d() * Vec2::new(62.0, 34.0);
            let (ray, distance) = (camera.ray(pixel, Vec2::ZERO), 0.5 + 20.0 * random.next_1d());
            let point = ray.origin + distance * ray.direction;
            let seen = camera.sample_we(point, Vec2::ZERO).expect("the camera sees it");
            assert!((seen.pixel - pixel).length() < 2e-3, "{} at {pixel}", seen.pixel);
            assert!((seen.direction + ray.direction).length() < 1e-4);
            assert!((seen.visible_distance() - distance).abs() < 1e-3);
            let moved = |offset: Vec2| camera.ray(pixel + offset, Vec2::ZERO).direction;
            let [x, y] = [Vec2::X, Vec2::Y].map(|axis| moved(0.1 * axis) - moved(-0.1 * axis));
            let solid_angle = x.cross(y).length() / sqr(0.2);
            assert!(
                (solid_angle * seen.pdf.pdf - 1.0).abs() < 0.01,
                "{pixel}: {solid_angle}, {seen:?}"
            );
        }
        let up = camera.to_world.vector(Vec3::Y);
        assert!((camera.ray(Vec2::new(20.0, 0.0), Vec2::ZERO).direction - up).length() < 1e-5);
        let middle = camera.ray(Vec2::new(32.0, 18.0), Vec2::ZERO).direction;
        assert!((middle - camera.to_world.vector(Vec3::Z)).length() < 1e-5);
    }

    /// Points that a camera ray passes are seen at the pixel of the ray, by the same way, with the density that moving the pixel gives.
    #[test]
    fn what_a_ray_shows_is_seen_at_its_pixel() {
        let unlike = Lens {
            radius: 0.7,
            focus_distance: 3.0,
        };
        for camera in [
            sensor(),
            centred(Some(LENS)),
            Sensor {
                projection: perspective(Vec2::new(0.1, -0.07), Some(unlike)),
                ..sensor()
            },
            orthographic([2.5, 1.5, 3.0], [64, 36]),
        ] {
            let mut random = PathRandom::new(8, 1, Stream::Camera, 0);
            for _ in 0..1_000 {
                let (pixel, u) = (random.next_2d() * Vec2::new(64.0, 36.0), random.next_2d());
                let ray = camera.ray(pixel, u);
                let distance = 0.5 + 20.0 * random.next_1d();
                let point = ray.origin + distance * ray.direction;
                let seen = camera.sample_we(point, u).expect("the camera sees it");
                assert!(
                    (seen.pixel - pixel).length() < 2e-3,
                    "{camera:?}: {} at {pixel}",
                    seen.pixel
                );
                assert!((seen.direction + ray.direction).length() < 1e-4);
                assert!((seen.visible_distance() - distance).abs() < 1e-4 * (1.0 + distance));
                let moved = |offset: Vec2| {
                    let beside = camera.ray(pixel + offset, u);
                    let along = (point - beside.origin).dot(ray.direction) / beside.direction.dot(ray.direction);
                    beside.origin + along * beside.direction
                };
                let [x, y] = [Vec2::X, Vec2::Y].map(|axis| moved(0.05 * axis) - moved(-0.05 * axis));
                let area = x.cross(y).length() / sqr(0.1);
                assert!(
                    (area * seen.pdf_area() - 1.0).abs() < 0.01,
                    "{camera:?}: {area}, {seen:?}"
                );
                let back = Ray {
                    origin: point,
                    direction: -ray.direction,
                    max_distance: f32::INFINITY,
                };
                match camera.hit_lens(&back, distance * 1.001, false) {
                    Some(hit) => {
                        assert!(
                            (hit.pixel - pixel).length() < 5e-3,
                            "{camera:?}: {} at {pixel}",
                            hit.pixel
                        );
                        assert!((hit.distance - seen.distance).abs() < 1e-3);
                        assert!(
                            camera.hit_lens(&back, 0.9 * distance, false).is_none(),
                            "something is in the way"
                        );
                    }
                    None => {
                        let has_lens = matches!(camera.projection, Projection::Perspective { lens: Some(_), .. });
                        assert!(!has_lens || u.max_element() > 0.999 || u.min_element() < 0.001);
                    }
                }
            }
        }
        let behind = sensor().to_world.point(Vec3::new(0.0, 0.0, -3.0));
        assert!(sensor().sample_we(behind, Vec2::ZERO).is_none());
        let beyond = sensor().to_world.point(Vec3::new(0.0, 0.0, 81.0));
        assert!(sensor().sample_we(beyond, Vec2::ZERO).is_none());
    }

    /// Expected values: Mitsuba 3.9.1, `scalar_rgb`, `Sensor.sample_ray` of the same camera.
    #[test]
    fn pinhole_rays_are_those_of_mitsuba() {
        let ray = |x: f32, y: f32| sensor().ray(Vec2::new(x * 64.0, y * 36.0), Vec2::ZERO);
        let expected = [0.446_643_3, -0.483_901_86, 0.752_561_45];
        assert_ray(
            &ray(0.5, 0.5),
            [1.224_440_6, 1.756_836_8, 3.378_166_2],
            expected,
            79.898_35,
        );
        let expected = [0.744_940_9, -0.365_704_27, 0.557_963_67];
        assert_ray(
            &ray(0.1, 0.3),
            [1.390_355_7, 1.808_367_7, 3.292_378],
            expected,
            83.317_43,
        );
        let expected = [0.092_434_92, -0.571_495_06, 0.815_382_96];
        assert_ray(
            &ray(0.9, 0.8),
            [1.051_299_3, 1.682_833, 3.452_519_4],
            expected,
            88.241_45,
        );
    }

    /// The lens point of Mitsuba's ray is taken from its origin; the rest is expected from Mitsuba as above.
    #[test]
    fn lens_rays_meet_in_the_plane_of_focus_and_cover_the_lens() {
        let (sensor, pinhole) = (centred(Some(LENS)), centred(None));
        let centre = sensor.to_world.point(Vec3::ZERO);
        let axis = sensor.to_world.vector(Vec3::Z);
        let mut random = PathRandom::new(5, 1, Stream::Camera, 0);
        let (mut moments, samples) = (Vec2::ZERO, 10_000);
        for _ in 0..samples {
            let pixel = random.next_2d() * Vec2::new(64.0, 36.0);
            let ray = sensor.ray(pixel, random.next_2d());
            let through = pinhole.ray(pixel, Vec2::ZERO);
            let in_focus = |r: &Ray| {
                let depth = (r.origin - centre).dot(axis);
                r.origin + r.direction * ((5.0 - depth) / r.direction.dot(axis))
            };
            assert!((in_focus(&ray) - in_focus(&through)).length() < 1e-5);
            assert!(((ray.origin - centre).dot(axis) - 0.5).abs() < 1e-5);
            let end = ray.origin + ray.direction * ray.max_distance - centre;
            assert!((end.dot(axis) - 80.0).abs() < 1e-3);
            let start = ray.origin - ray.direction * (0.5 / ray.direction.dot(axis)) - centre;
            let on_lens = Vec2::new(
                start.dot(sensor.to_world.vector(Vec3::X)),
                start.dot(sensor.to_world.vector(Vec3::Y)),
            );
            assert!(on_lens.length() < 0.2 + 1e-5 && start.dot(axis).abs() < 1e-5);
            moments += on_lens * on_lens;
        }
        // The mean square of a coordinate on a uniform disc is r^2 / 4, with variance r^4 / 16.
        let deviations = (moments / samples as f32 - Vec2::splat(0.01)) / (0.01 / 100.0);
        assert!(deviations.abs().max_element() < 4.0, "{deviations}: false alarm 1.3e-4");
    }

    #[test]
    fn a_lens_ray_is_that_of_mitsuba() {
        let ray = centred(Some(LENS)).ray(Vec2::new(0.9 * 64.0, 0.8 * 36.0), Vec2::new(0.3, 0.7));
        let direction = [0.161_866_4, -0.623_934_15, 0.764_529_65];
        assert_ray(&ray, [1.056_790_7, 1.710_570_2, 3.469_203_7], direction, 85.598_56);
    }

    /// Chi-square of pixel position (within a cell of the image) and lens point against the uniform density.
    #[test]
    fn lens_points_are_uniform_by_area() {
        use crate::chi_square::{Domain, chi_square};
        let sensor = Sensor {
            to_world: Transform::default(),
            clip: [0.0, 10.0],
            ..centred(Some(Lens { radius: 2.0, ..LENS }))
        };
        let domain = Domain {
            lower: [0.0, -std::f64::consts::PI],
            upper: [4.0, std::f64::consts::PI],
            cells: [16, 16],
        };
        let outcome = chi_square(
            &domain,
            200_000,
            11,
            |random| {
                let origin = sensor.ray(random.next_2d() * 30.0, random.next_2d()).origin.as_dvec3();
                Some([origin.length_squared(), libm::atan2(origin.y, origin.x)])
            },
            |_| 1.0 / (8.0 * std::f64::consts::PI),
        );
        assert!(outcome.passes(1), "{outcome:?}");
    }

    /// Expected values as above. The second camera scales its axes unevenly: its rays start 3 * 0.5 before the plane of the
    /// camera and are no longer for it.
    #[test]
    fn orthographic_rays_are_those_of_mitsuba() {
        let axis = [0.514_495_8, -0.514_495_8, 0.685_994_4];
        let camera = orthographic([2.5, 2.5, 1.0], [64, 36]);
        let ray = |x: f32, y: f32| camera.ray(Vec2::new(x * 64.0, y * 36.0), Vec2::ZERO);
        assert_ray(&ray(0.5, 0.5), [1.257_248_2, 1.742_752_3, 3.342_997], axis, 79.5);
        assert_ray(&ray(0.1, 0.3), [3.036_278_2, 2.295_294_3, 2.423_131], axis, 79.5);
        assert_ray(&ray(0.9, 0.8), [-0.599_265_46, 0.949_244_6, 4.140_252], axis, 79.5);
        let camera = orthographic([2.5, 1.5, 3.0], [36, 64]);
        let ray = |x: f32, y: f32| camera.ray(Vec2::new(x * 36.0, y * 64.0), Vec2::ZERO);
        assert_ray(&ray(0.5, 0.5), [1.771_744, 1.228_256_6, 4.028_991_7], axis, 79.5);
        assert_ray(&ray(0.1, 0.3), [3.689_670_6, 2.212_751_4, 3.328_917_5], axis, 79.5);
        assert_ray(&ray(0.9, 0.8), [-0.293_114_3, -0.213_180_07, 4.496_558], axis, 79.5);
    }

    /// Every ray, followed back from a point on it, leaves along `direction_from` within the lens angle, and some come close to it.
    #[test]
    fn the_direction_to_the_camera_is_against_its_rays() {
        for (camera, nearest) in [
            (sensor(), 0.0),
            (centred(Some(Lens { radius: 1.5, ..LENS })), 0.8),
            (orthographic([2.5, 1.5, 3.0], [64, 36]), 0.0),
        ] {
            let mut random = PathRandom::new(6, 1, Stream::Camera, 0);
            let mut largest = 0.0_f32;
            for _ in 0..10_000 {
                let ray = camera.ray(random.next_2d() * Vec2::new(64.0, 36.0), random.next_2d());
                let point = ray.origin + ray.direction * (1.0 + 9.0 * random.next_1d());
                let towards = camera.direction_from(point).unwrap();
                assert!((towards.direction.length() - 1.0).abs() < 1e-6);
                let angle = (towards.direction + ray.direction).length();
                assert!(
                    angle < towards.lens_angle + 1e-5,
                    "{camera:?} {point}: {angle} {towards:?}"
                );
                if towards.lens_angle > 0.0 {
                    largest = largest.max(angle / towards.lens_angle);
                }
            }
            assert!(largest >= nearest, "{camera:?}: {largest}");
        }
        let inside = centred(Some(LENS)).to_world.point(Vec3::new(0.0, 0.1, 0.1));
        assert_eq!(centred(Some(LENS)).direction_from(inside).unwrap().lens_angle, PI);
        assert!(sensor().direction_from(Vec3::new(1.0, 2.0, 3.0)).is_none());
    }

    /// The footprint is the distance between the points where the rays through neighbouring pixels meet a plane facing the camera.
    #[test]
    fn a_footprint_is_the_distance_of_neighbouring_rays() {
        for camera in [centred(None), orthographic([2.5, 2.5, 3.0], [64, 36])] {
            let axis = camera.to_world.vector(Vec3::Z).normalize();
            let at = |x: f32, y: f32| {
                let ray = camera.ray(Vec2::new(x, y), Vec2::ZERO);
                let depth = (ray.origin - Vec3::new(1.0, 2.0, 3.0)).dot(axis);
                ray.origin + ray.direction * ((7.0 - depth) / ray.direction.dot(axis))
            };
            let footprint = camera.pixel_footprint(7.0);
            for neighbour in [at(33.0, 18.0), at(32.0, 19.0)] {
                let side = (neighbour - at(32.0, 18.0)).length();
                assert!(
                    (side / footprint - 1.0).abs() < 1e-4,
                    "{camera:?}: {side} and {footprint}"
                );
            }
        }
    }
}

//! The rays of a scene's sensor: those of its camera, or of a meter on one of its shapes.

use crate::geometry::{Ray, SurfacePoint};
use crate::math::warp::square_to_cosine_hemisphere;
use crate::math::{DVec2, FRAC_1_PI, Frame, ONE_MINUS_EPSILON, Vec2, Vec3};
use crate::path::{Tracer, Way};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::sensor::{SensorPdf, SensorSample};
use crate::spectrum::Spectrum;

/// A ray of the sensor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CameraRay {
    pub(crate) ray: Ray,
    /// The normal where it starts, of a meter.
    pub(crate) normal: Option<Vec3>,
}

impl Scene {
    /// The ray of weight one through image position `pixel` [pixels, from the top left corner]; `u` chooses the point on the lens.
    ///
    /// A meter on a shape has one pixel: the position in it chooses a point uniform by area, and `u` a direction by the cosine with
    /// the normal there, so that the mean over the rays times pi is the mean irradiance of the shape's outer side.
    pub(crate) fn camera_ray(&self, pixel: Vec2, u: Vec2) -> CameraRay {
        match self.meter_point(pixel) {
            Some(point) => {
                let normal = point.geometric_normal;
                let direction = Frame::from_normal(normal).to_world(square_to_cosine_hemisphere(u));
                CameraRay {
                    ray: point.ray_towards(direction.normalize()),
                    normal: Some(normal),
                }
            }
            None => CameraRay {
                ray: self.sensor.ray(pixel, u),
                normal: self.sensor.meter_normal(),
            },
        }
    }

    /// The point of a meter's shape that a point of the unit square chooses, with density `1 / area`.
    fn meter_point(&self, u: Vec2) -> Option<SurfacePoint> {
        let u = u.clamp(Vec2::ZERO, Vec2::splat(ONE_MINUS_EPSILON));
        self.meter
            .as_ref()?
            .sample(&self.geometry, DVec2::new(u.x.into(), u.y.into()))
    }

    /// The density with which camera rays through one pixel leave along the ray.
    pub(crate) fn pdf_we(&self, camera: &CameraRay) -> SensorPdf {
        match camera.normal {
            Some(normal) => self.meter_pdf(normal.dot(camera.ray.direction)),
            None => self.sensor.pdf_we(&camera.ray),
        }
    }

    /// Connects a surface point with the sensor through the point `u` of the lens, or of the shape of a meter; `None` where the sensor
    /// does not see it, whatever is in the way.
    pub(crate) fn sample_we(&self, position: Vec3, u: Vec2) -> Option<SensorSample> {
        let Some(point) = self.meter_point(u) else {
            return self.sensor.sample_we(position, u);
        };
        let offset = position - point.position;
        let distance = offset.length();
        let direction = offset.try_normalize()?;
        let cos = point.geometric_normal.dot(direction);
        (cos > 0.0).then(|| SensorSample {
            pixel: Vec2::splat(0.5),
            pdf: self.meter_pdf(cos),
            direction: -direction,
            distance,
        })
    }

    /// The density of a ray of a meter that makes an angle of this cosine with the normal. Of one pixel's rays all start on its part of
    /// the shape: there they are denser than over all of it.
    fn meter_pdf(&self, cos: f32) -> SensorPdf {
        let cos = cos.max(0.0);
        let [width, height] = self.sensor.resolution.map(|n| n as f32);
        SensorPdf {
            pdf: width * height * cos * FRAC_1_PI,
            cos,
            pdf_lens: None,
            parallel: false,
            clipped: 0.0,
        }
    }
}

impl Tracer<'_> {
    /// What lights that no ray finds, such as point lights, send to a meter where a ray of it starts: their irradiance over pi, as the mean
    /// of the radiance over the rays is counted. Of other lights the rays of the meter tell.
    pub(crate) fn unseen_light(&mut self, start: Vec3, normal: Vec3, random: &mut PathRandom) -> Spectrum {
        let (choice, u) = (random.next_choice(), random.next_choice_2d());
        let Scene { lights, geometry, .. } = self.scene;
        let Some(light) = lights
            .sample_direct(geometry, start, choice, u)
            .filter(|light| light.delta)
        else {
            return Spectrum::ZERO;
        };
        let cos = normal.dot(light.wi);
        if cos <= 0.0 {
            return Spectrum::ZERO;
        }
        let way = Way {
            ray: Ray {
                origin: start,
                direction: light.wi,
                max_distance: light.distance,
            },
            length: light.distance,
            space: self.scene.space_of_camera(),
        };
        self.transmittance(&way, random).share * light.radiance * (cos * FRAC_1_PI / light.pdf)
    }
}

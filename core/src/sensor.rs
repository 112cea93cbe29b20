//! Cameras.
use crate::geometry::Ray;
use crate::math::warp::square_to_disk;
use crate::math::{Transform, Vec2, Vec3, tan};

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
    /// Near and far clip distances along the optical axis [scene units of the world].
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
    ///
    /// It starts on the plane `clip[0]` before the lens and ends on the plane `clip[1]`.
    #[must_use]
    pub fn ray(&self, pixel: Vec2, u: Vec2) -> Ray {
        let [width, height] = self.resolution.map(|n| n as f32);
        let at = pixel / Vec2::new(width, height) + self.principal_point;
        let slope = tan(0.5 * self.fov_x);
        let through = Vec3::new(
            slope * (1.0 - 2.0 * at.x),
            slope * (1.0 - 2.0 * at.y) * height / width,
            1.0,
        );
        let (start, direction) = match self.lens {
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
    /// Centre of the lens, or the pinhole, in the world.
    #[must_use]
    pub fn position(&self) -> Vec3 {
        self.to_world.point(Vec3::ZERO)
    }
    /// Side of a pixel's footprint on a surface facing the camera at `distance` [scene units].
    #[must_use]
    pub fn pixel_footprint(&self, distance: f32) -> f32 {
        2.0 * distance * tan(0.5 * self.fov_x) / self.resolution[0] as f32
    }
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
            fov_x: 50.0_f32.to_radians(),
            principal_point: Vec2::new(0.1, -0.07),
            resolution: [64, 36],
            clip: [0.5, 80.0],
            lens: None,
        }
    }

    fn assert_ray(ray: &Ray, origin: [f32; 3], direction: [f32; 3], max_distance: f32) {
        assert!((ray.origin - Vec3::from(origin)).length() < 2e-6, "{ray:?}");
        assert!((ray.direction - Vec3::from(direction)).length() < 2e-6, "{ray:?}");
        assert!((ray.max_distance - max_distance).abs() < 2e-4, "{ray:?}");
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
        let lens = Some(Lens {
            radius: 0.2,
            focus_distance: 5.0,
        });
        let sensor = Sensor {
            principal_point: Vec2::ZERO,
            lens,
            ..sensor()
        };
        let pinhole = Sensor {
            lens: None,
            ..sensor.clone()
        };
        let axis = sensor.to_world.vector(Vec3::Z);
        let mut random = PathRandom::new(5, 1, Stream::Camera, 0);
        let (mut moments, samples) = (Vec2::ZERO, 10_000);
        for _ in 0..samples {
            let pixel = random.next_2d() * Vec2::new(64.0, 36.0);
            let ray = sensor.ray(pixel, random.next_2d());
            let through = pinhole.ray(pixel, Vec2::ZERO);
            let in_focus = |r: &Ray| {
                let depth = (r.origin - sensor.position()).dot(axis);
                r.origin + r.direction * ((5.0 - depth) / r.direction.dot(axis))
            };
            assert!((in_focus(&ray) - in_focus(&through)).length() < 1e-5);
            assert!(((ray.origin - sensor.position()).dot(axis) - 0.5).abs() < 1e-5);
            let end = ray.origin + ray.direction * ray.max_distance - sensor.position();
            assert!((end.dot(axis) - 80.0).abs() < 1e-3);
            let start = ray.origin - ray.direction * (0.5 / ray.direction.dot(axis)) - sensor.position();
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
        let lens = Some(Lens {
            radius: 0.2,
            focus_distance: 5.0,
        });
        let sensor = Sensor {
            principal_point: Vec2::ZERO,
            lens,
            ..sensor()
        };
        let ray = sensor.ray(Vec2::new(0.9 * 64.0, 0.8 * 36.0), Vec2::new(0.3, 0.7));
        let direction = [0.161_866_4, -0.623_934_15, 0.764_529_65];
        assert_ray(&ray, [1.056_790_7, 1.710_570_2, 3.469_203_7], direction, 85.598_56);
    }

    /// Chi-square of pixel position (within a cell of the image) and lens point against the uniform density.
    #[test]
    fn lens_points_are_uniform_by_area() {
        use crate::chi_square::{Domain, chi_square};
        let sensor = Sensor {
            to_world: Transform::default(),
            lens: Some(Lens {
                radius: 2.0,
                focus_distance: 5.0,
            }),
            clip: [0.0, 10.0],
            ..sensor()
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
}

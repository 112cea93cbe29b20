//! Where media lie in a scene.

use super::{Boundary, Media, Medium, MediumId};
use crate::geometry::{Ray, SurfacePoint};
use crate::light::{EmissionSample, Origin};
use crate::material::Material;
use crate::math::{Vec2, Vec3};
use crate::scene::Scene;
use std::sync::Arc;

/// Boundaries that a look for the medium about a place goes through, at most.
const MOST_SURFACES: usize = 64;

impl Scene {
    /// The medium of an id; `None` for empty space.
    #[inline]
    pub(crate) fn medium(&self, id: Option<MediumId>) -> Option<(MediumId, &Medium)> {
        let (id, media) = (id?, self.media.as_ref()?);
        Some((id, media.get(id)))
    }

    /// What lies on the two sides of a surface to which a path has come through `through`: a surface that bounds no medium stands in it.
    #[inline]
    pub(crate) fn media_about(&self, point: &SurfacePoint, through: Option<MediumId>) -> Boundary {
        self.binding(point.shape).boundary.unwrap_or(Boundary::within(through))
    }

    /// Whether a surface does nothing but bound media: light goes straight through it.
    #[inline]
    pub(crate) fn is_passed(&self, point: &SurfacePoint) -> bool {
        self.media.is_some() && matches!(self.material(point), Material::Null)
    }

    /// The medium that a light path starts in.
    #[inline]
    pub(crate) fn medium_of_light(&self, start: &EmissionSample) -> Option<MediumId> {
        let media = self.media.as_ref()?;
        match &start.origin {
            Origin::Area(light, point) => {
                let about = self.media_about(point, media.lights[light.0 as usize]);
                // On the inner side of a light that shines on both, the normal is turned; that of the frame is not.
                let turned = point.geometric_normal.dot(point.frame.n) < 0.0;
                about.towards(
                    start.ray.direction,
                    if turned {
                        -point.geometric_normal
                    } else {
                        point.geometric_normal
                    },
                )
            }
            Origin::Normals(light) | Origin::Point(light) => media.lights[light.0 as usize],
            Origin::Directional | Origin::Background | Origin::Portal(_) => media.around,
        }
    }

    /// Finds what the camera and the lights are in. The scene file may say it of the camera, by `named`; all else follows from
    /// the boundaries.
    pub(crate) fn settle_media(&mut self, media: Vec<Medium>, named: Option<MediumId>) {
        if media.is_empty() {
            return;
        }
        let [width, height] = self.sensor.resolution.map(|size| size as f32);
        let eye = self
            .camera_ray(Vec2::new(0.5 * width, 0.5 * height), Vec2::splat(0.5))
            .ray
            .origin;
        let about_camera = self.medium_at(eye);
        let around = self
            .medium_around()
            .or(about_camera.is_none().then_some(named))
            .flatten();
        let camera = named.or(about_camera.unwrap_or(around));
        let place = |light: usize| self.lights.a_place(&self.geometry, light);
        let lights = (0..self.lamps.len()).map(|light| match place(light) {
            Some(place) => self.medium_at(place).unwrap_or(around),
            None => around,
        });
        self.media = Some(Arc::new(Media {
            grey: media.iter().all(Medium::is_grey),
            lights: lights.collect(),
            media,
            around,
            camera,
        }));
    }

    /// What lies on this side of the nearest surface that bounds a medium, along some line; `None` where there is no such surface.
    fn medium_at(&self, place: Vec3) -> Option<Option<MediumId>> {
        // No axis, and no diagonal: many surfaces lie along those.
        self.medium_along(place, Vec3::new(0.36, 0.48, 0.8))
    }

    /// What lies outside of the shapes that bound media, as seen from the ends of the axes.
    fn medium_around(&self) -> Option<Option<MediumId>> {
        let (lower, upper) = self.geometry.bounds();
        let (middle, size) = (0.5 * (lower + upper), (upper - lower).length());
        let axes = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
        axes.into_iter()
            .find_map(|axis| self.medium_along(middle + axis * size, -axis))
    }

    fn medium_along(&self, origin: Vec3, direction: Vec3) -> Option<Option<MediumId>> {
        let mut ray = Ray {
            origin,
            direction,
            max_distance: f32::INFINITY,
        };
        for _ in 0..MOST_SURFACES {
            let point = self.geometry.intersect(&ray)?;
            if let Some(boundary) = self.binding(point.shape).boundary {
                return Some(boundary.towards(-ray.direction, point.geometric_normal));
            }
            ray = point.ray_towards(ray.direction);
        }
        None
    }
}

//! Where media lie in a scene.

use super::{Body, Media, Medium, MediumId, Sides, Space};
use crate::geometry::{Ray, SurfacePoint};
use crate::light::{EmissionSample, Origin};
use crate::material::Material;
use crate::math::{Vec2, Vec3};
use crate::scene::Scene;
use std::sync::Arc;

/// Boundaries that a look for the medium about a place goes through, at most.
const MOST_SURFACES: usize = 64;

/// Surfaces that a look for the bodies about a place goes through, at most.
const MOST_SURFACES_OF_BODIES: usize = 4096;

/// The line along which is looked: no axis, and no diagonal, since many surfaces lie along those.
const LINE: Vec3 = Vec3::new(0.36, 0.48, 0.8);

impl Scene {
    /// The medium that fills a space; `None` where it is empty.
    #[inline]
    pub(crate) fn medium(&self, space: Space) -> Option<(MediumId, &Medium)> {
        let media = self.media.as_ref()?;
        let id = match space.holds() {
            None => space.base,
            Some(body) => media.bodies[body.0 as usize].medium,
        }?;
        Some((id, media.get(id)))
    }

    /// What lies on the two sides of a surface to which a path has come along `direction` through `through`: a surface that bounds neither
    /// body nor medium stands in it.
    #[inline]
    pub(crate) fn sides(&self, point: &SurfacePoint, through: Space, direction: Vec3) -> Sides {
        let binding = self.binding(point.shape);
        match (binding.body, binding.boundary) {
            (Some(body), _) => Sides::of_body(body, through, direction.dot(point.geometric_normal) > 0.0),
            (None, Some(boundary)) => Sides::of_boundary(boundary, through),
            (None, None) => Sides::within(through),
        }
    }

    /// Whether light that has come along `direction` through `through` goes straight through a surface: it does nothing but bound media, or
    /// a body holds on both of its sides.
    #[inline]
    pub(crate) fn is_passed(&self, point: &SurfacePoint, through: Space, direction: Vec3) -> bool {
        self.media.is_some()
            && (matches!(self.material(point), Material::Null)
                || through.holds().is_some() && self.is_covered(point, through, direction))
    }

    fn is_covered(&self, point: &SurfacePoint, through: Space, direction: Vec3) -> bool {
        let binding = self.binding(point.shape);
        match binding.body {
            Some(body) => {
                let outside = self.sides(point, through, direction).exterior();
                outside.holds().is_some_and(|holds| holds <= body)
            }
            // Bodies hold before all that says no priority.
            None => binding.boundary.is_some() && binding.light.is_none(),
        }
    }

    /// The index of refraction of what a body's surface stands in over that of empty space: indices of materials are over the latter.
    #[inline]
    pub(crate) fn index_outside(&self, point: &SurfacePoint, sides: &Sides) -> f32 {
        match (&self.media, self.binding(point.shape).body, sides.exterior().holds()) {
            (Some(media), Some(_), Some(outside)) => media.bodies[outside.0 as usize].index,
            _ => 1.0,
        }
    }

    /// What the camera is in.
    #[inline]
    pub(crate) fn space_of_camera(&self) -> Space {
        self.media.as_ref().map_or(Space::EMPTY, |media| media.camera)
    }

    /// What a light path starts in.
    #[inline]
    pub(crate) fn space_of_light(&self, start: &EmissionSample) -> Space {
        let Some(media) = &self.media else {
            return Space::EMPTY;
        };
        match &start.origin {
            Origin::Area(light, point) => {
                let about = self.sides(point, media.lights[light.0 as usize], start.ray.direction);
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
            Origin::Directional | Origin::Background | Origin::Portal(_) => Space::filled(media.around),
        }
    }

    /// Finds what the camera and the lights are in. The scene file may say it of the camera, by `named`; all else follows from
    /// the boundaries.
    pub(crate) fn settle_media(&mut self, media: Vec<Medium>, bodies: Vec<Body>, named: Option<MediumId>) {
        if media.is_empty() && bodies.is_empty() {
            return;
        }
        let [width, height] = self.sensor.resolution.map(|size| size as f32);
        let eye = self
            .camera_ray(Vec2::new(0.5 * width, 0.5 * height), Vec2::splat(0.5))
            .ray
            .origin;
        let within = |place: Vec3, base: Option<MediumId>| match bodies.is_empty() {
            true => Space::filled(base),
            false => self.within_bodies(place, base),
        };
        // Within a body, what is named can be nothing but that which fills it.
        let named = named.filter(|_| within(eye, None).holds().is_none());
        let about_camera = self.medium_at(eye);
        let around = self
            .medium_around()
            .or(about_camera.is_none().then_some(named))
            .flatten();
        let camera = within(eye, named.or(about_camera.unwrap_or(around)));
        let place = |light: usize| self.lights.a_place(&self.geometry, light);
        let lights = (0..self.lamps.len()).map(|light| match place(light) {
            Some(place) => within(place, self.medium_at(place).unwrap_or(around)),
            None => Space::filled(around),
        });
        let lights = lights.collect();
        self.media = Some(Arc::new(Media {
            grey: media.iter().all(Medium::is_grey),
            lights,
            media,
            bodies,
            around,
            camera,
        }));
    }

    /// What lies on this side of the nearest surface that bounds a medium, along some line; `None` where there is no such surface.
    fn medium_at(&self, place: Vec3) -> Option<Option<MediumId>> {
        self.medium_along(place, LINE)
    }

    /// What a place lies in, with `base` outside of all bodies: that from which a path would come to it which started outside of the scene.
    fn within_bodies(&self, place: Vec3, base: Option<MediumId>) -> Space {
        let mut ray = Ray {
            origin: place,
            direction: LINE,
            max_distance: f32::INFINITY,
        };
        let mut surfaces = Vec::new();
        while let Some(point) = self.geometry.intersect(&ray)
            && surfaces.len() < MOST_SURFACES_OF_BODIES
        {
            ray = point.ray_towards(LINE);
            surfaces.push(point);
        }
        let bodies = surfaces.iter().rev();
        let bodies = bodies.filter_map(|point| Some((self.binding(point.shape).body?, point.geometric_normal)));
        bodies.fold(Space::filled(base), |space, (body, normal)| {
            Sides::of_body(body, space, LINE.dot(normal) < 0.0).towards(-LINE, normal)
        })
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

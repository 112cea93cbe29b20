//! Why a picture stays black, as far as a few rays tell.

use super::Scene;
use crate::geometry::{Ray, SurfacePoint};
use crate::math::{DVec2, Vec2, Vec3};
use crate::settings::IntegratorSettings;

/// Rays along each side of the picture.
const RAYS: u32 = 24;
/// Numbers that choose a light and a point on it.
const LIGHT_SAMPLES: [DVec2; 4] = [
    DVec2::new(0.3, 0.3),
    DVec2::new(0.7, 0.3),
    DVec2::new(0.3, 0.7),
    DVec2::new(0.7, 0.7),
];

/// What the camera sees.
#[derive(Default)]
struct Seen {
    /// Rays that meet a shape.
    surfaces: u32,
    /// Those that meet the black back of a material with one side.
    backs: u32,
    /// Those that meet a surface that some light shines on directly.
    lit: u32,
}

impl Scene {
    /// A sentence that says why a picture of the scene by `settings` is black.
    #[must_use]
    pub fn why_black(&self, settings: &IntegratorSettings) -> String {
        let seen = self.seen();
        if seen.surfaces == 0 {
            let axis = self.camera_ray(self.position(0.5, 0.5), Vec2::ZERO).ray;
            let (lower, upper) = self.geometry.bounds();
            return format!(
                "the camera meets no shape: it looks from {} along {}, and the shapes lie between {lower} and {upper}",
                axis.origin, axis.direction
            );
        }
        if settings.max_depth() == Some(1) {
            return "`max_depth` is 1, so that nothing but lights themselves is seen".into();
        }
        if let Some(reason) = settings.why_black() {
            return reason.into();
        }
        if seen.backs == seen.surfaces {
            return "the camera sees only the backs of materials with one side, which are black: put them into \
                    <bsdf type=\"twosided\">, or turn the shapes by `flip_normals`"
                .into();
        }
        if seen.lit > 0 {
            return "what the camera sees is lit, but sends no light to it: its colours may be black".into();
        }
        let hint = self
            .hints(settings)
            .first()
            .map_or(String::new(), |hint| format!("; {hint}"));
        format!(
            "no light shines directly on what the camera sees: lights may stand behind or within something, or shine \
             away from it (an area light shines from the outer side of its shape; `flip_normals` turns it){hint}"
        )
    }

    fn seen(&self) -> Seen {
        let mut seen = Seen::default();
        for (y, x) in (0..RAYS).flat_map(|y| (0..RAYS).map(move |x| (y, x))) {
            let share = |i: u32| (i as f32 + 0.5) / RAYS as f32;
            let ray = self.camera_ray(self.position(share(x), share(y)), Vec2::splat(0.5)).ray;
            let Some(point) = self.geometry.intersect(&ray) else {
                continue;
            };
            seen.surfaces += 1;
            if self.is_black_back(&point, -ray.direction) {
                seen.backs += 1;
            } else if self.is_lit(&point) {
                seen.lit += 1;
            }
        }
        seen
    }

    /// The position in the picture at these shares of its sides \[pixels\].
    fn position(&self, x: f32, y: f32) -> Vec2 {
        let [width, height] = self.film.resolution.map(|n| n as f32);
        Vec2::new(x * width, y * height)
    }

    fn is_black_back(&self, point: &SurfacePoint, wo: Vec3) -> bool {
        self.material(point).is_one_sided() && point.geometric_normal.dot(wo) < 0.0
    }

    /// Whether one of a few points on lights is seen from the point.
    fn is_lit(&self, point: &SurfacePoint) -> bool {
        [0.1, 0.3, 0.5, 0.7, 0.9].into_iter().any(|choice| {
            LIGHT_SAMPLES.into_iter().any(|u| {
                let light = self.lights.sample_direct(&self.geometry, point.position, choice, u);
                light.is_some_and(|light| {
                    let ray = Ray {
                        max_distance: light.distance * 0.999,
                        ..point.ray_towards(light.wi)
                    };
                    !self.geometry.occluded(&ray)
                })
            })
        })
    }
}

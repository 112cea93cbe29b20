//! Photons where light collides with a medium.

use crate::density::Passable;
use crate::geometry::Ray;
use crate::math::Vec3;
use crate::medium::MediumId;
use crate::path::States;
use crate::spectrum::Spectrum;

/// Light that a medium scatters at a place.
#[derive(Clone, Copy, Debug)]
pub(super) struct MediumPhoton {
    pub(super) position: Vec3,
    /// Unit direction that it came from.
    pub(super) wi: Vec3,
    /// Flux that is scattered \[W\].
    pub(super) flux: Spectrum,
    /// Distance within which it counts \[scene units\].
    pub(super) radius: f32,
    pub(super) medium: MediumId,
    /// Edges of its light path.
    pub(super) edges: u8,
    /// Where its path is among the words of the scene's path expression, before it is scattered.
    pub(super) states: States,
}

impl Passable for MediumPhoton {
    /// Distance along the ray of the point that lies next to the photon.
    type Found = f32;

    fn bounds(&self) -> (Vec3, Vec3) {
        (self.position - self.radius, self.position + self.radius)
    }

    /// A ray of length 0 is the point of its origin. Others find photons whose nearest point on the line lies on the ray: the photon counts on a disc across it.
    #[inline]
    fn pass(&self, ray: &Ray) -> Option<f32> {
        let to = self.position - ray.origin;
        let along = match ray.max_distance == 0.0 {
            true => 0.0,
            false => to.dot(ray.direction),
        };
        if !(0.0..=ray.max_distance).contains(&along) {
            return None;
        }
        let distance2 = (to - ray.direction * along).length_squared();
        (distance2 < self.radius * self.radius).then_some(along)
    }
}

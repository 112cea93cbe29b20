//! Merging: the end of a camera path takes the light paths that end near it for its own.

use super::{End, Estimator, Observer, RenderError};
use crate::density::{NearPoints, PointMap, count_edges, disc_height, radius_at};
use crate::integrator::Found;
use crate::math::Vec3;
use crate::path::{Partial, States, Towards};
use crate::spectrum::Spectrum;

/// The end of a light path, as the map keeps it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MergePayload {
    /// Unit direction back along the path.
    pub(super) wi: Vec3,
    /// Flux that arrives \[W\], corrected for the shading normal.
    pub(super) flux: Spectrum,
    /// The path's sums, that of its edge times how often the edge is connected.
    pub(super) partial: Partial,
    /// From the light.
    pub(super) edges: u8,
    /// Where the path is among the words of the scene's path expression.
    pub(super) states: States,
}

/// The end of a camera path that is to be merged.
pub(super) struct MergeQuery<'s> {
    pub(super) end: End<'s>,
    /// Index of the pixel, row by row from the top left.
    pub(super) pixel: u32,
}

impl Estimator<'_> {
    /// Merges the ends of camera paths with all light paths that end within `radius` of them, in an order that depends on the ends alone.
    pub(super) fn merge(
        &self,
        queries: &[Vec<MergeQuery>],
        map: &PointMap<MergePayload>,
        radius: f32,
        observer: &dyn Observer,
    ) -> Result<Vec<Vec<Found>>, RenderError> {
        let disc = |query: &MergeQuery| {
            let position = query.end.vertex.position();
            (position, radius_at(radius, position))
        };
        let merged = map.answer(
            queries,
            disc,
            || observer.cancelled(),
            |query, near| self.merge_one(query, disc(query), near),
        );
        merged.ok_or(RenderError::Cancelled)
    }

    fn merge_one(&self, query: &MergeQuery, disc: (Vec3, f32), near: &NearPoints<MergePayload>) -> Found {
        let (position, radius) = disc;
        let MergeQuery { end, pixel } = query;
        let vertex = &end.vertex;
        let limit = count_edges(self.plan.max_edges - vertex.counted_edges);
        let camera_edge = self.camera_edges.of(vertex.edges);
        let (mut sum, mut counted) = (Spectrum::ZERO, 0);
        let read = near.query(position, radius, |light_end| {
            if light_end.edges > limit || light_end.states & vertex.states.smooth == 0 {
                return;
            }
            let Towards { f, pdf, pdf_rev } = vertex.towards(light_end.wi);
            if f.is_black() {
                return;
            }
            counted += 1;
            let others = light_end.partial.over_merge(pdf, 1.0, self.merges)
                + end.partial.over_merge(pdf_rev, camera_edge, self.merges);
            sum += f * light_end.flux * self.share(others);
        });
        Found {
            pixel: *pixel,
            value: vertex.beta * sum * (disc_height(radius) / self.plan.light_paths as f32),
            read,
            counted,
        }
    }
}

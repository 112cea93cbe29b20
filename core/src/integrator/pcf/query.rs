//! A query: what a camera path wants to know from the map, and at which vertex it asks.

use crate::density::count_edges;
use crate::geometry::Ray;
use crate::integrator::GLOSSY_ROUGHNESS;
use crate::math::Vec3;
use crate::path::{Crossed, States, Vertex};
use crate::scene::Scene;
use crate::settings::LookupVertex;
use crate::spectrum::Spectrum;

/// How a surface scatters to the query; a medium is a rough one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Surface {
    Rough,
    Glossy,
    Delta,
}

impl Surface {
    pub(super) fn of(vertex: &Vertex) -> Self {
        if vertex.is_delta() {
            Self::Delta
        } else if vertex.is_glossier_than(GLOSSY_ROUGHNESS) {
            Self::Glossy
        } else {
            Self::Rough
        }
    }
}

/// Radiance wanted at a camera vertex.
#[derive(Clone, Copy, Debug)]
pub(super) struct Query {
    pub(super) position: Vec3,
    /// Unit direction in which the radiance leaves: back along the camera path.
    pub(super) direction: Vec3,
    /// Geometric normal; zero in a medium.
    pub(super) normal: Vec3,
    /// Share of the radiance that the camera path carries to its pixel.
    pub(super) throughput: Spectrum,
    /// Edges of the camera path.
    pub(super) camera_edges: u32,
    /// Most edges of a light path that counts.
    pub(super) limit: u8,
    /// Where the camera path is among the words of the scene's path expression.
    pub(super) states: States,
    pub(super) surface: Surface,
    /// Pixel, counted from the first of the pass.
    pub(super) pixel: u32,
    /// Sum over the cones found so far.
    pub(super) radiance: Spectrum,
}

impl Query {
    /// A query at one point of what a camera path of at most `max_edges` has crossed of a medium, chosen about as collisions are: what is wanted there is
    /// what the medium scatters to the camera, per volume. `None` where nothing can be found.
    pub(super) fn in_medium(scene: &Scene, crossed: Crossed, pixel: usize, max_edges: u32) -> Option<Self> {
        let limit = count_edges(max_edges.saturating_sub(crossed.counted_edges));
        if limit == 0 || crossed.states == 0 || crossed.beta.is_black() {
            return None;
        }
        let (_, medium) = scene.medium(crossed.space)?;
        if medium.scattered_colour().is_black() {
            return None;
        }
        let Ray { origin, direction, .. } = crossed.ray;
        let (distance, share) = medium.choose_distance(&crossed.ray, crossed.random)?;
        Some(Self {
            position: origin + direction * distance,
            direction: -direction,
            normal: Vec3::ZERO,
            throughput: crossed.beta * share,
            camera_edges: crossed.counted_edges,
            limit,
            states: crossed.states,
            surface: Surface::Rough,
            pixel: pixel as u32,
            radiance: Spectrum::ZERO,
        })
    }
}

/// Whether camera paths look the map of surfaces up at a vertex: at the one with this number, or, where that lies in a medium, at the first on a
/// surface after it. Paths that cross media have vertices on surfaces only.
pub(super) fn is_lookup(lookup: LookupVertex, vertex: &Vertex) -> bool {
    match lookup {
        LookupVertex::Fixed(k) => vertex.edges >= k && vertex.surface().is_some(),
        LookupVertex::Auto => is_automatic_lookup(vertex),
    }
}

/// Whether camera paths look the map up at such a vertex with `lookup_vertex=auto`. Along its delta lobes they walk on.
pub(super) fn is_automatic_lookup(vertex: &Vertex) -> bool {
    !vertex.is_glossier_than(GLOSSY_ROUGHNESS)
}

#[cfg(test)]
impl Query {
    /// A query on a rough surface for light paths of any length.
    pub(super) fn at(position: Vec3, direction: Vec3, normal: Vec3) -> Self {
        Self {
            position,
            direction,
            normal,
            throughput: Spectrum::ONE,
            camera_edges: 1,
            limit: u8::MAX,
            states: crate::path::ANY,
            surface: Surface::Rough,
            pixel: 0,
            radiance: Spectrum::ZERO,
        }
    }
}

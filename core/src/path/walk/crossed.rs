//! Camera subpaths that no medium scatters, and the pieces of their edges that lie in media.

use super::Walk;
use crate::geometry::Ray;
use crate::material::TransportMode;
use crate::medium::{Medium, MediumId, Space};
use crate::path::expression::{ANY, Event, States};
use crate::path::vertex::{Vertex, VertexStates};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

/// A piece of a camera subpath's edge in one medium.
#[derive(Clone, Debug)]
pub(crate) struct Crossed {
    /// Up to the end of the piece.
    pub(crate) ray: Ray,
    pub(crate) medium: MediumId,
    /// What the piece lies in.
    pub(crate) space: Space,
    /// Share of the radiance which arrives at the start of the piece that reaches the camera.
    pub(crate) beta: Spectrum,
    /// Edges of the subpath that limits count, this one among them.
    pub(crate) counted_edges: u32,
    /// Where light must be among the words of the scene's path expression before the medium scatters it on the piece.
    pub(crate) states: States,
    /// Numbers by which the subpath has crossed the piece.
    pub(crate) random: PathRandom,
}

impl Walk {
    /// A camera subpath that is scattered at `distance` of a piece which it has crossed, and carries `weight` there; with its vertex.
    pub(crate) fn scattered<'s>(
        scene: &'s Scene,
        piece: &Crossed,
        distance: f32,
        weight: Spectrum,
        random: &mut PathRandom,
    ) -> Option<(Self, Vertex<'s>)> {
        let (_, medium) = scene.medium(piece.space)?;
        let position = piece.ray.origin + piece.ray.direction * distance;
        let wo = -piece.ray.direction;
        let mut vertex = Vertex::in_medium(position, piece.space, &medium.phase, wo, TransportMode::Radiance);
        vertex.beta = weight;
        (vertex.edges, vertex.counted_edges) = (piece.counted_edges, piece.counted_edges);
        vertex.states = VertexStates {
            arrived: piece.states,
            smooth: piece.states,
            delta: piece.states,
        };
        let walk = Self {
            edges: piece.counted_edges,
            counted_edges: piece.counted_edges,
            space: piece.space,
            ..Self::new(scene, piece.ray, weight, TransportMode::Radiance, random)
        };
        Some((walk, vertex))
    }

    /// From now on media let the subpath go straight through, with the share of light that comes through, and do not scatter it.
    pub(crate) fn cross_media(&mut self) {
        self.crossed = Some(Vec::new());
    }

    /// Whether the subpath crosses media.
    pub(crate) fn crosses_media(&self) -> bool {
        self.crossed.is_some()
    }

    /// The pieces of the last edge, in their order, which are then forgotten.
    pub(crate) fn take_crossed(&mut self) -> impl Iterator<Item = Crossed> + '_ {
        self.crossed.iter_mut().flat_map(|crossed| crossed.drain(..))
    }

    /// Edges that limits of the length of paths count, the next one among them.
    pub(crate) fn counted_with_next(&self) -> u32 {
        self.counted_edges + u32::from(!self.straight)
    }

    /// Crosses a medium on the way to what lies at `distance`.
    pub(super) fn cross(
        &mut self,
        scene: &Scene,
        (id, medium): (MediumId, &Medium),
        distance: f32,
        random: &mut PathRandom,
    ) {
        let ray = Ray {
            max_distance: distance,
            ..self.ray
        };
        let (beta, random) = (self.carried.beta(), random.apart());
        let crossing = medium.cross(&ray, random.clone());
        self.glow += beta * crossing.glow;
        self.carried.crossed(crossing.share);
        let paths = scene.paths.as_ref();
        let states = paths.map_or(ANY, |paths| paths.before(self.states, Event::Volume));
        let counted_edges = self.counted_edges;
        self.crossed.get_or_insert_default().push(Crossed {
            ray,
            medium: id,
            space: self.space,
            beta,
            counted_edges,
            states,
            random,
        });
    }
}

//! Sorts of places, each with maps of its own: surfaces, and each of the scene's media. A cone counts for queries of the same sort only.

use crate::medium::MediumId;
use crate::path::Vertex;
use crate::scene::Scene;

/// Where a cone or a query lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    Surface,
    Medium(MediumId),
}

impl Place {
    /// That of a vertex; `None` nowhere.
    pub(super) fn of(vertex: &Vertex, scene: &Scene) -> Option<Self> {
        match vertex.surface() {
            Some(_) => Some(Self::Surface),
            None => Some(Self::Medium(scene.medium(vertex.space_towards(vertex.wo))?.0)),
        }
    }

    /// Its number: surfaces, then the media in the scene's order.
    pub(super) fn index(self) -> usize {
        match self {
            Self::Surface => 0,
            Self::Medium(id) => 1 + usize::from(id.0),
        }
    }
}

/// A list for each place, as far as there is something at it.
pub(super) struct ByPlace<T>(Vec<Vec<T>>);

impl<T> Default for ByPlace<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> ByPlace<T> {
    pub(super) fn list(&mut self, place: Place) -> &mut Vec<T> {
        let index = place.index();
        if self.0.len() <= index {
            self.0.resize_with(index + 1, Vec::new);
        }
        &mut self.0[index]
    }

    /// For each of `places` places the lists of all tasks, in their order.
    pub(super) fn sort(tasks: Vec<Self>, places: usize) -> Vec<Vec<Vec<T>>> {
        let mut sorted: Vec<Vec<Vec<T>>> = (0..places).map(|_| Vec::with_capacity(tasks.len())).collect();
        for mut task in tasks {
            task.0.resize_with(places, Vec::new);
            for (lists, list) in sorted.iter_mut().zip(task.0) {
                lists.push(list);
            }
        }
        sorted
    }
}

//! What a picture's file says of the scene, for who writes it without having loaded that.

use crate::integrator::layers::Layers;
use crate::scene::Scene;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeSet;

/// Most bytes that the names of a scene's objects take in a picture's file, and those of its materials, with two for each.
pub const NAMES_BYTES: usize = 1 << 16;

/// What a picture's file says of the scene.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFacts {
    /// Pixels across and down of the picture, where a window of it is rendered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub picture: Option<[u32; 2]>,
    /// Names of objects, each once, where a layer tells these apart: the first ones, in [`NAMES_BYTES`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<String>,
    /// The same of materials.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub materials: Vec<String>,
}

impl SceneFacts {
    /// What the file of a picture with these layers says.
    #[must_use]
    pub fn of(scene: &Scene, layers: &Layers) -> Self {
        let [objects, materials] = layers.lists();
        let names = &scene.names;
        Self {
            picture: scene.film.window.map(|_| scene.film.resolution),
            objects: first_names(names.objects().filter(|_| objects)),
            materials: first_names(names.materials().filter(|_| materials)),
        }
    }

    /// Whether there is nothing to say.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Whether they are within their limits, whoever they came from.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let bytes = |names: &[String]| names.iter().map(|name| name.len() + 2).sum::<usize>();
        [&self.objects, &self.materials]
            .into_iter()
            .all(|names| bytes(names) <= NAMES_BYTES)
    }
}

fn first_names<'n>(names: impl Iterator<Item = Cow<'n, str>>) -> Vec<String> {
    let (mut seen, mut bytes) = (BTreeSet::new(), 0);
    let mut first = Vec::new();
    for name in names {
        if seen.contains(&name) {
            continue;
        }
        bytes += name.len() + 2;
        if bytes > NAMES_BYTES {
            break;
        }
        first.push(name.clone().into_owned());
        seen.insert(name);
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_within_their_limit() {
        let many: Vec<String> = (0..20_000).map(|number| format!("object {}", number / 2)).collect();
        let first = first_names(many.iter().map(Cow::from));
        assert_eq!((first.len(), &*first[5_040]), (5_126, "object 5040"));
        let mut facts = SceneFacts {
            objects: first,
            ..SceneFacts::default()
        };
        assert!(facts.is_valid());
        facts.objects.push("one more name".into());
        assert!(!facts.is_valid() && SceneFacts::default().is_valid());
    }
}

//! What a scene holds, counted.

use super::description::{Description, Kind};
use super::format::Format;
use serde::Serialize;
use std::collections::BTreeMap;

/// What a scene holds, as its files say it: also what nothing refers to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SceneContents {
    /// The format of the scene file, for people.
    pub format: &'static str,
    /// Shapes by type.
    pub shapes: BTreeMap<String, u64>,
    /// Emitters by type.
    pub lights: BTreeMap<String, u64>,
    /// BSDFs by type.
    pub materials: BTreeMap<String, u64>,
    /// Textures by type.
    pub textures: BTreeMap<String, u64>,
    /// Triangles of all meshes; what is instanced counts once.
    pub triangles: u64,
    /// Vertices of all meshes.
    pub vertices: u64,
    /// Texels of all images.
    pub texels: u64,
}

impl SceneContents {
    /// What is counted before meshes and images are read.
    pub(crate) fn of(format: Format, description: &Description) -> Self {
        let count = |kind: Kind| {
            let mut types = BTreeMap::new();
            for object in description.objects.iter().filter(|object| object.kind == kind) {
                *types.entry(object.plugin.clone()).or_insert(0) += 1;
            }
            types
        };
        Self {
            format: format.name(),
            shapes: count(Kind::Shape),
            lights: count(Kind::Emitter),
            materials: count(Kind::Bsdf),
            textures: count(Kind::Texture),
            triangles: 0,
            vertices: 0,
            texels: 0,
        }
    }
}

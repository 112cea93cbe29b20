//! What a scene calls its objects and materials.

use std::borrow::Cow;
use std::sync::Arc;

/// The names of a scene's objects and materials. Several may have one name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Names {
    /// By [`ShapeId`](crate::geometry::ShapeId), of the shapes that belong to no group.
    pub(super) objects: Vec<Option<Arc<str>>>,
    /// By [`ShapeBinding::material`](super::ShapeBinding::material).
    pub(super) materials: Vec<Option<Arc<str>>>,
}

impl Names {
    /// Names of the objects: the shapes and instances of the scene, in their order. Each is called by its id, or by its node in glTF, else
    /// as what it is part of or an instance of, else `shape-` and its number from 1.
    pub fn objects(&self) -> impl Iterator<Item = Cow<'_, str>> {
        named(&self.objects, "shape")
    }

    /// Names of the materials, by their ids, or as glTF and pbrt call them, else `material-` and the number from 1.
    pub fn materials(&self) -> impl Iterator<Item = Cow<'_, str>> {
        named(&self.materials, "material")
    }
}

fn named<'a>(names: &'a [Option<Arc<str>>], kind: &'a str) -> impl Iterator<Item = Cow<'a, str>> {
    names.iter().zip(1..).map(move |(name, number): (_, usize)| match name {
        Some(name) => Cow::Borrowed(&**name),
        None => Cow::Owned(format!("{kind}-{number}")),
    })
}

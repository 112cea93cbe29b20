//! Attributes of meshes, such as colours of vertices and faces, and the textures that show them.

use super::Builder;
use super::texture::Role;
use crate::geometry::TriangleMesh;
use crate::scene::description::{Description, Kind, ObjectId};
use crate::scene::error::SceneError;
use crate::scene::mesh::RawAttribute;
use crate::scene::reader::{ANY, Reader};
use crate::spectrum::Spectrum;
use crate::texture::{AttributeTexture, Texture};
use std::collections::BTreeSet;
use std::sync::Arc;

/// The attributes of the mesh whose material is built.
#[derive(Debug, Default)]
pub(super) struct MeshAttributes {
    /// What the material and the light of the mesh ask for.
    asked: BTreeSet<String>,
    mesh: Option<Arc<TriangleMesh>>,
    found: Vec<RawAttribute>,
}

impl MeshAttributes {
    /// What textures within `objects` ask of the mesh that they are on.
    pub(super) fn asked_by(description: &Description, objects: impl Iterator<Item = ObjectId>) -> Self {
        let (mut pending, mut seen) = (Vec::from_iter(objects), BTreeSet::new());
        let mut asked = BTreeSet::new();
        while let Some(object) = pending.pop() {
            if !seen.insert(object) {
                continue;
            }
            let reader = Reader::new(description, object);
            if reader.object.kind == Kind::Texture
                && let Some(name) = attribute_of(&reader)
            {
                asked.insert(name);
            }
            pending.extend(reader.object.children.iter().map(|child| child.target));
        }
        Self {
            asked,
            ..Self::default()
        }
    }

    /// Whether nothing is asked for.
    pub(super) fn is_empty(&self) -> bool {
        self.asked.is_empty()
    }

    pub(super) fn names(&self) -> Vec<String> {
        self.asked.iter().cloned().collect()
    }

    /// Keeps what is asked for of the attributes of `mesh`.
    pub(super) fn found(&mut self, mesh: &Arc<TriangleMesh>, mut attributes: Vec<RawAttribute>) {
        attributes.retain(|attribute| self.asked.contains(&attribute.name));
        if !attributes.is_empty() {
            (self.mesh, self.found) = (Some(Arc::clone(mesh)), attributes);
        }
    }
}

/// The attribute that a texture shows; `None` for a texture of another type.
fn attribute_of(reader: &Reader) -> Option<String> {
    match reader.object.plugin.as_str() {
        "vertexcolors" => Some("vertex_color".to_owned()),
        "mesh_attribute" => Some(
            reader
                .string("name")
                .ok()
                .flatten()
                .unwrap_or("vertex_color")
                .to_owned(),
        ),
        _ => None,
    }
}

impl Builder<'_, '_> {
    /// A texture that shows an attribute of the mesh that it is on.
    pub(super) fn mesh_attribute(&mut self, reader: &Reader, role: Role) -> Result<Texture, SceneError> {
        let name = attribute_of(reader).unwrap_or_default();
        let scale = match reader.object.plugin.as_str() {
            "mesh_attribute" => reader.float_or("scale", ANY, 1.0)? as f32,
            _ => 1.0,
        };
        let found = self.attributes.found.iter().find(|attribute| attribute.name == name);
        let (Some(mesh), Some(attribute)) = (&self.attributes.mesh, found) else {
            let message = format!("the shape has no attribute `{name}`: an even grey of 0.5 stands in for it");
            reader.warn(reader.place(), message);
            return Ok(Texture::Constant(Spectrum::splat(0.5)));
        };
        let most = role.most();
        let mut beyond = false;
        let mut bounded = |value: &Spectrum| {
            let scaled = value.to_rgb().map(|channel| channel * scale);
            let kept = scaled.map(|channel| channel.clamp(0.0, most));
            beyond |= kept != scaled;
            let colour = Spectrum::from_rgb(kept);
            match role.number {
                true => Spectrum::splat(colour.number()),
                false => colour,
            }
        };
        let values = attribute.values.iter().map(&mut bounded).collect();
        if beyond {
            let message = format!("values of the attribute `{name}` below 0 and above {most} count as these");
            reader.warn(reader.place(), message);
        }
        Ok(Texture::Attribute(Arc::new(AttributeTexture {
            mesh: Arc::clone(mesh),
            values,
            of_faces: attribute.of_faces,
        })))
    }
}

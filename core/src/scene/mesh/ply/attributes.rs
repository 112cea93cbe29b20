//! Attributes of vertices and faces, by Mitsuba's names.

use super::super::{MeshFile, RawAttribute, RawMesh};
use super::header::{Element, Scalar};
use crate::scene::linear_image::srgb_to_linear;
use crate::spectrum::Spectrum;

/// Where a vertex's coordinates lie among its properties.
pub(super) fn columns<const N: usize>(element: &Element, names: [&str; N]) -> Option<[usize; N]> {
    let mut found = [0; N];
    for (slot, name) in found.iter_mut().zip(names) {
        *slot = element
            .properties
            .iter()
            .position(|p| p.name == name && p.length.is_none())?;
    }
    Some(found)
}

/// An attribute among the properties of an element.
pub(super) struct Attribute {
    name: String,
    /// One column, or three.
    pub(super) columns: Vec<usize>,
    scalar: Scalar,
    /// Whether it is a colour.
    colour: bool,
}

impl Attribute {
    /// The value in a row. Integers are parts of the largest of their type; as colours they are sRGB values.
    pub(super) fn value(&self, row: &[f32]) -> Spectrum {
        let largest = match self.scalar {
            Scalar::I8 => f32::from(i8::MAX),
            Scalar::U8 => f32::from(u8::MAX),
            Scalar::I16 => f32::from(i16::MAX),
            Scalar::U16 => f32::from(u16::MAX),
            Scalar::I32 => i32::MAX as f32,
            Scalar::U32 => u32::MAX as f32,
            Scalar::F32 | Scalar::F64 => 1.0,
        };
        let encoded = self.colour && largest != 1.0;
        let channel = |index: usize| {
            let value = row[self.columns[index.min(self.columns.len() - 1)]] / largest;
            if encoded { srgb_to_linear(value) } else { value }
        };
        Spectrum::from_rgb([channel(0), channel(1), channel(2)])
    }
}

/// The attributes of an element that are asked for, by Mitsuba's rules: `r g b` or `red green blue` are `color`; `NAME_x NAME_y NAME_z` are
/// `NAME`, and so are names that end in `0 1 2` or `1 2 3`; `NAME_r NAME_g NAME_b` are `NAME_color`. The first of three may stand alone.
pub(super) fn attributes(file: &MeshFile, element: &Element, prefix: &str) -> Vec<Attribute> {
    let mut found = Vec::new();
    let mut add = |name: String, columns: Vec<usize>, colour: bool| {
        let scalar = element.properties[columns[0]].scalar;
        let name = format!("{prefix}{name}");
        if file.asks_for(&name) {
            found.push(Attribute {
                name,
                columns,
                scalar,
                colour,
            });
        }
    };
    if let Some(rgb) = columns(element, ["r", "g", "b"]).or_else(|| columns(element, ["red", "green", "blue"])) {
        add("color".to_owned(), rgb.to_vec(), true);
    }
    for property in &element.properties {
        let Some((name, first)) = property.name.rsplit_once('_') else {
            continue;
        };
        let after_0 = columns(element, [&format!("{name}_0")]).is_some();
        let ends = match first {
            "x" => ["x", "y", "z"],
            "r" => ["r", "g", "b"],
            "0" => ["0", "1", "2"],
            "1" if !after_0 => ["1", "2", "3"],
            _ => continue,
        };
        let [a, b, c] = ends.map(|end| format!("{name}_{end}"));
        let colour = first == "r";
        let name = if colour {
            format!("{name}_color")
        } else {
            name.to_owned()
        };
        if let Some(three) = columns(element, [&a, &b, &c]) {
            add(name, three.to_vec(), colour);
        } else if columns(element, [&b]).is_none()
            && let Some(one) = columns(element, [&a])
        {
            add(name, one.to_vec(), colour);
        }
    }
    found
}

/// Keeps the values of attributes with their names.
pub(super) fn keep(mesh: &mut RawMesh, asked: Vec<Attribute>, values: Vec<Vec<Spectrum>>, of_faces: bool) {
    let named = asked.into_iter().zip(values).map(|(attribute, values)| RawAttribute {
        name: attribute.name,
        of_faces,
        values,
    });
    mesh.attributes.extend(named);
}

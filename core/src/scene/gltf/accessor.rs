//! Numbers of accessors (section 3.6.2 of the specification): any component type, normalised, strided and sparse, each checked against the bytes
//! that are there before memory is taken.

use super::document::{Accessor, Document};
use crate::scene::error::{Place, SceneError, shortened, within};
use crate::scene::limits::Limits;
use bytes::Bytes;

/// The document's accessors over its buffers.
pub(super) struct Accessors<'a> {
    document: &'a Document,
    buffers: Vec<Option<Bytes>>,
    place: Place,
    limits: &'a Limits,
}

/// Part of a buffer. The error says what is wrong with it.
pub(super) fn part(buffers: &[Option<Bytes>], buffer: usize, offset: u64, length: u64) -> Result<Bytes, String> {
    let count = buffers.len();
    let content = buffers
        .get(buffer)
        .ok_or_else(|| format!("there is no buffer {buffer}; the file has {count}"))?;
    let content = content
        .as_ref()
        .ok_or_else(|| format!("buffer {buffer} has no content: no URI and no chunk of a GLB"))?;
    match offset.checked_add(length).filter(|end| *end <= content.len() as u64) {
        Some(end) => Ok(content.slice(offset as usize..end as usize)),
        None => Err(format!(
            "bytes {offset} and {length} more reach beyond the buffer's {}",
            content.len()
        )),
    }
}

/// Component types, as in OpenGL.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(number: u32) -> Option<Self> {
        Some(match number {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    /// As [`Self::of`] takes it.
    pub(super) fn number(self) -> u32 {
        match self {
            Self::I8 => 5120,
            Self::U8 => 5121,
            Self::I16 => 5122,
            Self::U16 => 5123,
            Self::U32 => 5125,
            Self::F32 => 5126,
        }
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The number that `bytes` begin with. Normalised integers are shares of their type's largest value.
    fn read(self, bytes: &[u8], normalized: bool) -> f64 {
        let (value, largest) = match self {
            Self::I8 => (f64::from(bytes[0] as i8), 127.0),
            Self::U8 => (f64::from(bytes[0]), 255.0),
            Self::I16 => (f64::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32767.0),
            Self::U16 => (f64::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65535.0),
            Self::U32 => (
                f64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
                f64::from(u32::MAX),
            ),
            Self::F32 => {
                return f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
            }
        };
        if normalized { (value / largest).max(-1.0) } else { value }
    }
}

/// Components of an element.
pub(super) fn width(kind: &str) -> Option<usize> {
    Some(match kind {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" | "MAT2" => 4,
        "MAT3" => 9,
        "MAT4" => 16,
        _ => return None,
    })
}

/// Elements that lie at even distances in bytes.
struct Elements {
    bytes: Bytes,
    stride: usize,
    component: Component,
    width: usize,
    normalized: bool,
}

impl Elements {
    /// Calls `each` with the numbers of element `index`, which lies within the bytes.
    fn numbers(&self, index: usize) -> impl Iterator<Item = f64> {
        let begin = index * self.stride;
        let size = self.component.bytes();
        (0..self.width).map(move |i| {
            let at = begin + i * size;
            self.component.read(&self.bytes[at..at + size], self.normalized)
        })
    }
}

impl<'a> Accessors<'a> {
    pub(super) fn new(document: &'a Document, buffers: Vec<Option<Bytes>>, place: &Place, limits: &'a Limits) -> Self {
        Self {
            document,
            buffers,
            place: place.clone(),
            limits,
        }
    }

    pub(super) fn wrong(&self, field: impl Into<String>, reason: impl Into<String>) -> SceneError {
        SceneError::value(&self.place, field, reason)
    }

    fn get(&self, index: usize, used: &str) -> Result<&'a Accessor, SceneError> {
        let accessors = &self.document.accessors;
        accessors.get(index).ok_or_else(|| {
            let reason = format!("there is no accessor {index}; the file has {}", accessors.len());
            self.wrong(used, reason)
        })
    }

    /// The number of elements of an accessor.
    pub(super) fn count(&self, index: usize, used: &str) -> Result<u64, SceneError> {
        Ok(self.get(index, used)?.count)
    }

    fn width_of(&self, accessor: &Accessor, index: usize) -> Result<usize, SceneError> {
        width(&accessor.kind).ok_or_else(|| {
            let reason = format!("there is no type `{}`", shortened(&accessor.kind));
            self.wrong(format!("accessors[{index}].type"), reason)
        })
    }

    /// The bytes of a buffer view.
    pub(super) fn view(&self, index: usize, used: &str) -> Result<Bytes, SceneError> {
        let views = &self.document.buffer_views;
        let view = views.get(index).ok_or_else(|| {
            self.wrong(
                used,
                format!("there is no buffer view {index}; the file has {}", views.len()),
            )
        })?;
        part(&self.buffers, view.buffer, view.byte_offset, view.byte_length)
            .map_err(|reason| self.wrong(format!("bufferViews[{index}]"), reason))
    }

    pub(super) fn unsupported(&self, context: String, what: &str, instead: &str) -> SceneError {
        SceneError::Unsupported {
            place: self.place.clone(),
            context,
            what: what.to_owned(),
            instead: instead.to_owned(),
        }
    }

    /// `count` elements in a buffer view, all of which are there.
    fn elements(
        &self,
        (view, offset): (usize, u64),
        (component, width): (Component, usize),
        normalized: bool,
        count: u64,
        field: &str,
    ) -> Result<Elements, SceneError> {
        let bytes = self.view(view, field)?;
        let size = (component.bytes() * width) as u64;
        let stride = self.document.buffer_views[view].byte_stride.unwrap_or(size).max(1);
        let needed = match count {
            0 => Some(0),
            _ => (count - 1).checked_mul(stride).and_then(|all| all.checked_add(size)),
        };
        let begin = usize::try_from(offset).ok();
        let part = begin
            .filter(|begin| *begin <= bytes.len())
            .map(|begin| bytes.slice(begin..));
        match (part, needed) {
            (Some(part), Some(needed)) if needed <= part.len() as u64 => Ok(Elements {
                bytes: part,
                stride: stride as usize,
                component,
                width,
                normalized,
            }),
            _ => {
                let reason = format!(
                    "{count} elements of {size} bytes, {stride} apart from byte {offset} on, reach beyond the {} bytes of buffer view {view}",
                    bytes.len()
                );
                Err(self.wrong(field, reason))
            }
        }
    }

    fn component(&self, number: u32, field: &str) -> Result<Component, SceneError> {
        let allowed = "5120 to 5123, 5125, 5126";
        Component::of(number).ok_or_else(|| {
            self.wrong(
                field,
                format!("there is no component type {number}; allowed: {allowed}"),
            )
        })
    }

    /// All elements as numbers, `width` for each. `used` names what asks for them.
    pub(super) fn numbers(&self, index: usize, widths: &[usize], used: &str) -> Result<Vec<f32>, SceneError> {
        let accessor = self.get(index, used)?;
        let field = format!("accessors[{index}]");
        let width = self.width_of(accessor, index)?;
        if !widths.contains(&width) {
            let reason = format!("type {} does not fit `{used}`", accessor.kind);
            return Err(self.wrong(format!("{field}.type"), reason));
        }
        let component = self.component(accessor.component_type, &format!("{field}.componentType"))?;
        // Matrices of small components have padded columns, which no attribute that is read has.
        if width > 4 && component != Component::F32 {
            return Err(self.wrong(field, "matrices are of floats"));
        }
        let normalized = accessor.normalized;
        let elements = match accessor.buffer_view {
            Some(view) => Some(self.elements(
                (view, accessor.byte_offset),
                (component, width),
                normalized,
                accessor.count,
                &field,
            )?),
            None => None,
        };
        within(
            &self.place,
            &format!("number of elements of {field}"),
            accessor.count,
            self.limits.vertices,
        )?;
        let count = accessor.count as usize;
        let mut numbers = Vec::with_capacity(count * width);
        match elements {
            Some(elements) => {
                for i in 0..count {
                    numbers.extend(elements.numbers(i).map(|number| number as f32));
                }
            }
            None => numbers.resize(count * width, 0.0),
        }
        if let Some(sparse) = &accessor.sparse {
            let places = self.component(sparse.indices.component_type, &format!("{field}.sparse.indices"))?;
            let indices = self.elements(
                (sparse.indices.buffer_view, sparse.indices.byte_offset),
                (places, 1),
                false,
                sparse.count,
                &format!("{field}.sparse.indices"),
            )?;
            let values = self.elements(
                (sparse.values.buffer_view, sparse.values.byte_offset),
                (component, width),
                normalized,
                sparse.count,
                &format!("{field}.sparse.values"),
            )?;
            for i in 0..sparse.count as usize {
                let at = indices.numbers(i).next().unwrap_or(0.0);
                if !(0.0..count as f64).contains(&at) {
                    let reason = format!("element {at} is out of range; there are {count}");
                    return Err(self.wrong(format!("{field}.sparse.indices"), reason));
                }
                let at = at as usize * width;
                for (number, value) in numbers[at..at + width].iter_mut().zip(values.numbers(i)) {
                    *number = value as f32;
                }
            }
        }
        if let Some(bad) = numbers.iter().position(|number| !number.is_finite()) {
            let reason = format!("element {} is not finite", bad / width);
            return Err(self.wrong(field, reason));
        }
        Ok(numbers)
    }

    /// Elements of `N` numbers.
    pub(super) fn vectors<const N: usize>(&self, index: usize, used: &str) -> Result<Vec<[f32; N]>, SceneError> {
        let numbers = self.numbers(index, &[N], used)?;
        let (vectors, _) = numbers.as_chunks::<N>();
        Ok(vectors.to_vec())
    }

    /// Whole numbers, one for each element.
    pub(super) fn indices(&self, index: usize, used: &str) -> Result<Vec<u32>, SceneError> {
        let accessor = self.get(index, used)?;
        let field = format!("accessors[{index}]");
        let component = self.component(accessor.component_type, &format!("{field}.componentType"))?;
        let whole = matches!(component, Component::U8 | Component::U16 | Component::U32);
        let (Some(view), true, 1) = (accessor.buffer_view, whole, self.width_of(accessor, index)?) else {
            let reason = format!("`{used}` takes single unsigned integers in a buffer view");
            return Err(self.wrong(field, reason));
        };
        let elements = self.elements(
            (view, accessor.byte_offset),
            (component, 1),
            false,
            accessor.count,
            &field,
        )?;
        let most = self.limits.triangles.saturating_mul(3);
        within(
            &self.place,
            &format!("number of elements of {field}"),
            accessor.count,
            most,
        )?;
        let count = accessor.count as usize;
        Ok((0..count)
            .flat_map(|i| elements.numbers(i))
            .map(|number| number as u32)
            .collect())
    }
}

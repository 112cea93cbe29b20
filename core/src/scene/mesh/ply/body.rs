//! The elements of a PLY file, record by record.

use super::super::MeshFile;
use super::header::{Element, Encoding, LineEnd, Property, Scalar};
use crate::scene::error::SceneError;
use crate::scene::faults::FileFaults;
use crate::scene::number::{leading_digits, leading_f32, leading_f64};

pub(super) struct Body<'a, 'f> {
    pub(super) file: &'a MeshFile<'f>,
    pub(super) encoding: Encoding,
    pub(super) rest: &'a [u8],
    pub(super) line_end: LineEnd,
    pub(super) line: u32,
    pub(super) faults: &'a mut FileFaults,
}

impl<'a> Body<'a, '_> {
    pub(super) fn broken(&self, reason: impl Into<String>) -> SceneError {
        self.file
            .broken(if self.encoding == Encoding::Text { self.line } else { 0 }, reason)
    }

    /// Notes what is wrong with a number or a face; the next ones can be read nevertheless.
    pub(super) fn note(&mut self, result: Result<(), String>) -> Result<(), SceneError> {
        match result {
            Ok(()) => Ok(()),
            Err(reason) => self.faults.note(self.broken(reason)),
        }
    }

    /// Calls `store` with a number, or with 0 in place of a broken one, so that no other fault follows from it.
    fn store(
        &mut self,
        number: Result<f64, String>,
        store: impl FnOnce(f64) -> Result<(), String>,
    ) -> Result<(), SceneError> {
        let stored = store(*number.as_ref().unwrap_or(&0.0));
        self.note(number.and(stored))
    }

    /// Refuses a count that the rest of the file cannot hold.
    pub(super) fn check_count(&self, element: &Element) -> Result<(), SceneError> {
        let scalar = |scalar: Scalar| {
            if self.encoding == Encoding::Text {
                2
            } else {
                scalar.size()
            }
        };
        let smallest: usize = element
            .properties
            .iter()
            .map(|p| scalar(p.length.unwrap_or(p.scalar)))
            .sum();
        // The last line of a text may lack its line break.
        if element.count.saturating_mul(smallest as u64) > self.rest.len() as u64 + 1 {
            let Element { name, count, .. } = element;
            return Err(self.broken(format!(
                "the file ends before the {count} elements `{name}` of its header"
            )));
        }
        Ok(())
    }

    /// Reads one record; `value` and `item` get the property's index and a number (`item`: of a list).
    pub(super) fn record(
        &mut self,
        element: &Element,
        mut value: impl FnMut(usize, f64) -> Result<(), String>,
        mut item: impl FnMut(usize, f64) -> Result<(), String>,
    ) -> Result<(), SceneError> {
        for (index, property) in element.properties.iter().enumerate() {
            let Some(length) = property.length else {
                let number = self.number(property.scalar)?;
                self.store(number, |number| value(index, number))?;
                continue;
            };
            // What follows a broken length cannot be told apart.
            let length = self.number(length)?.map_err(|reason| self.broken(reason))?;
            if length < 0.0 {
                return Err(self.broken(format!("a list of length {length}")));
            }
            for _ in 0..length as u64 {
                let number = self.number(property.scalar)?;
                self.store(number, |number| item(index, number))?;
            }
        }
        Ok(())
    }

    /// The next number, or what is wrong with it; the error ends the reading.
    fn number(&mut self, scalar: Scalar) -> Result<Result<f64, String>, SceneError> {
        if self.encoding == Encoding::Text {
            return self.text_number(scalar);
        }
        let size = scalar.size();
        if self.rest.len() < size {
            return Err(self.broken("the file ends too early"));
        }
        let (head, rest) = self.rest.split_at(size);
        self.rest = rest;
        Ok(Ok(self.binary(scalar, head)))
    }

    /// The number that binary `bytes` begin with.
    fn binary(&self, scalar: Scalar, bytes: &[u8]) -> f64 {
        binary_number(scalar, bytes, self.encoding == Encoding::BigEndian)
    }

    /// The records of an element without lists in a binary file, which all take as many bytes.
    pub(super) fn rows(&mut self, element: &Element) -> Result<Option<Rows<'a>>, SceneError> {
        if self.encoding == Encoding::Text || element.properties.iter().any(|property| property.length.is_some()) {
            return Ok(None);
        }
        let mut columns = Vec::new();
        let mut stride = 0;
        for property in &element.properties {
            columns.push((stride, property.scalar));
            stride += property.scalar.size();
        }
        let bytes = stride as u64 * element.count;
        let Some((bytes, rest)) = self.rest.split_at_checked(bytes as usize) else {
            return Err(self.broken("the file ends too early"));
        };
        self.rest = rest;
        Ok(Some(Rows {
            bytes,
            stride,
            columns,
            big_endian: self.encoding == Encoding::BigEndian,
        }))
    }

    /// Where property `list` lies in the records of a binary file, if it is the only list.
    pub(super) fn list_layout(&self, element: &Element, list: usize) -> Option<ListLayout> {
        let (before, after) = (&element.properties[..list], &element.properties[list + 1..]);
        let fixed = before.iter().chain(after).all(|property| property.length.is_none());
        let size = |properties: &[Property]| properties.iter().map(|property| property.scalar.size()).sum();
        (self.encoding != Encoding::Text && fixed).then(|| ListLayout {
            before: size(before),
            length: element.properties[list].length.unwrap_or(Scalar::U8),
            scalar: element.properties[list].scalar,
            after: size(after),
        })
    }

    /// Reads the items of the next record's list, where `layout` says where it lies.
    pub(super) fn list(&mut self, layout: &ListLayout, items: &mut Vec<f64>) -> Result<(), SceneError> {
        let items_at = layout.before + layout.length.size();
        if self.rest.len() < items_at {
            return Err(self.broken("the file ends too early"));
        }
        let length = self.binary(layout.length, &self.rest[layout.before..]);
        if length < 0.0 {
            return Err(self.broken(format!("a list of length {length}")));
        }
        // A polygon is as many triangles, less two.
        self.file.check_triangles(length as u64)?;
        let size = layout.scalar.size();
        let after = items_at as u64 + length as u64 * size as u64;
        let Some((record, rest)) = self.rest.split_at_checked(after as usize + layout.after) else {
            return Err(self.broken("the file ends too early"));
        };
        self.rest = rest;
        let words = record[items_at..after as usize].chunks_exact(size);
        // Most files have these.
        if layout.scalar == Scalar::I32 && self.encoding == Encoding::LittleEndian {
            items.extend(words.map(|word| binary_number(Scalar::I32, word, false)));
        } else {
            items.extend(words.map(|word| self.binary(layout.scalar, word)));
        }
        Ok(())
    }

    /// Reads the triangles that come next, at most `most`, and returns how many there are. The first record of another kind ends them, and so
    /// does a layout that few files have.
    pub(super) fn triangles(&mut self, layout: &ListLayout, most: u64, triangles: &mut Vec<[u32; 3]>) -> u64 {
        let largest = match layout.scalar {
            Scalar::I32 => i32::MAX as u32,
            Scalar::U32 => u32::MAX,
            _ => return 0,
        };
        if self.encoding != Encoding::LittleEndian || layout.length.size() != 1 {
            return 0;
        }
        let size = layout.before + 13 + layout.after;
        let triangle = |record: &[u8]| {
            let list = &record[layout.before..layout.before + 13];
            let corners = [1, 5, 9].map(|at| u32::from_le_bytes(ordered(&list[at..], false)));
            (list[0] == 3 && corners.iter().all(|corner| *corner <= largest)).then_some(corners)
        };
        let before = triangles.len();
        triangles.extend(self.rest.chunks_exact(size).take(most as usize).map_while(triangle));
        let found = triangles.len() - before;
        self.rest = &self.rest[found * size..];
        found as u64
    }

    fn text_number(&mut self, scalar: Scalar) -> Result<Result<f64, String>, SceneError> {
        let last = self.line_end.last_byte();
        let start = self.rest.iter().position(|byte| {
            if *byte == last {
                self.line += 1;
            }
            !byte.is_ascii_whitespace()
        });
        let Some(start) = start else {
            return Err(self.broken("the file ends too early"));
        };
        let word = &self.rest[start..];
        let short = match scalar {
            Scalar::F32 => leading_f32(word).map(|(number, length)| (f64::from(number), length)),
            Scalar::F64 => leading_f64(word),
            _ => leading_digits(word).map(|(number, length)| (f64::from(number), length)),
        };
        if let Some((number, length)) = short
            && word.get(length).is_none_or(u8::is_ascii_whitespace)
        {
            self.rest = &word[length..];
            return Ok(Ok(number));
        }
        let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
        self.rest = &word[end..];
        let text = std::str::from_utf8(&word[..end]).unwrap_or("?");
        let number = match scalar {
            Scalar::F32 => text.parse::<f32>().ok().map(f64::from),
            Scalar::F64 => text.parse::<f64>().ok(),
            _ => text.parse::<i64>().ok().map(|n| n as f64),
        };
        Ok(number.ok_or_else(|| format!("`{text:.40}` is not a number of the property's type")))
    }
}

/// Records of one length.
pub(super) struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    /// Where each property begins.
    columns: Vec<(usize, Scalar)>,
    big_endian: bool,
}

impl Rows<'_> {
    /// Some properties of all records, in single precision.
    pub(super) fn groups<const N: usize>(&self, columns: [usize; N]) -> impl Iterator<Item = [f32; N]> {
        let places = columns.map(|column| self.columns[column]);
        // Most files have these.
        let plain = !self.big_endian && places.iter().all(|(_, scalar)| *scalar == Scalar::F32);
        self.bytes.chunks_exact(self.stride).map(move |record| {
            places.map(|(at, scalar)| match plain {
                true => f32::from_le_bytes(ordered(&record[at..], false)),
                false => binary_number(scalar, &record[at..], self.big_endian) as f32,
            })
        })
    }

    /// A property of a record.
    pub(super) fn number(&self, record: usize, column: usize) -> f64 {
        let (offset, scalar) = self.columns[column];
        binary_number(scalar, &self.bytes[record * self.stride + offset..], self.big_endian)
    }
}

/// Where a list lies in a record: bytes before and behind it, and the types of its length and its items.
pub(super) struct ListLayout {
    before: usize,
    length: Scalar,
    scalar: Scalar,
    after: usize,
}

#[inline(always)]
fn binary_number(scalar: Scalar, bytes: &[u8], big_endian: bool) -> f64 {
    match scalar {
        Scalar::I8 => f64::from(bytes[0] as i8),
        Scalar::U8 => f64::from(bytes[0]),
        Scalar::I16 => f64::from(i16::from_le_bytes(ordered(bytes, big_endian))),
        Scalar::U16 => f64::from(u16::from_le_bytes(ordered(bytes, big_endian))),
        Scalar::I32 => f64::from(i32::from_le_bytes(ordered(bytes, big_endian))),
        Scalar::U32 => f64::from(u32::from_le_bytes(ordered(bytes, big_endian))),
        Scalar::F32 => f64::from(f32::from_le_bytes(ordered(bytes, big_endian))),
        Scalar::F64 => f64::from_le_bytes(ordered(bytes, big_endian)),
    }
}

/// The first bytes, the least significant one first.
#[inline(always)]
fn ordered<const N: usize>(bytes: &[u8], big_endian: bool) -> [u8; N] {
    let mut first = [0; N];
    first.copy_from_slice(&bytes[..N]);
    if big_endian {
        first.reverse();
    }
    first
}

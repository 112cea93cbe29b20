//! PLY, in text and both binary byte orders: `vertex` with `x y z`, `nx ny nz`, `u v` (or `s t`), and `face` with
//! `vertex_indices` (or `vertex_index`). Polygons become fans. Attributes of vertices and faces that are asked for have Mitsuba's names;
//! other elements and properties are skipped.

use super::{MeshFile, RawAttribute, RawMesh};
use crate::math::{Vec2, Vec3};
use crate::scene::error::SceneError;
use crate::scene::faults::FileFaults;
use crate::scene::linear_image::srgb_to_linear;
use crate::scene::text;
use crate::spectrum::Spectrum;
use std::collections::BTreeSet;

/// The longest header.
const HEADER_BYTES: usize = 1 << 16;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Encoding {
    Text,
    LittleEndian,
    BigEndian,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// How the lines of a file end. Its first line tells, since the bytes after a binary file's header may be line ends by chance.
#[derive(Clone, Copy, Debug, PartialEq)]
enum LineEnd {
    /// LF, or CR LF.
    Lf,
    /// A lone CR.
    Cr,
}

impl LineEnd {
    fn of(bytes: &[u8]) -> Self {
        match bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r')) {
            Some(end) if bytes[end] == b'\r' && bytes.get(end + 1) != Some(&b'\n') => Self::Cr,
            _ => Self::Lf,
        }
    }

    fn last_byte(self) -> u8 {
        match self {
            Self::Lf => b'\n',
            Self::Cr => b'\r',
        }
    }
}

struct Property {
    name: String,
    /// The type of a list's length; `None` for a single value.
    length: Option<Scalar>,
    scalar: Scalar,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

struct Header {
    encoding: Encoding,
    line_end: LineEnd,
    elements: Vec<Element>,
    /// Bytes and lines of the header.
    bytes: usize,
    lines: u32,
}

pub(super) fn read(file: &MeshFile, flip_v: bool, faults: &mut FileFaults) -> Result<RawMesh, SceneError> {
    let header = header(file)?;
    let mut body = Body {
        file,
        encoding: header.encoding,
        rest: &file.bytes[header.bytes..],
        line_end: header.line_end,
        line: header.lines + 1,
        faults,
    };
    let mut mesh = RawMesh::default();
    for element in &header.elements {
        body.check_count(element)?;
        match element.name.as_str() {
            "vertex" => vertices(&mut body, element, flip_v, &mut mesh)?,
            "face" => faces(&mut body, element, &mut mesh)?,
            _ if element.properties.is_empty() => {}
            _ => {
                for _ in 0..element.count {
                    body.record(element, |_, _| Ok(()), |_, _| Ok(()))?;
                }
            }
        }
    }
    if mesh.positions.is_empty() {
        return Err(file.broken(0, "the file has no vertices"));
    }
    let count = mesh.positions.len() as u32;
    let beyond = mesh.triangles.iter().flatten().filter(|index| **index >= count);
    for bad in beyond.collect::<BTreeSet<_>>() {
        let reason = format!("vertex index {bad} is out of range: the file has {count} vertices");
        body.faults.note(file.broken(0, reason))?;
    }
    Ok(mesh)
}

fn header(file: &MeshFile) -> Result<Header, SceneError> {
    if file.bytes.is_empty() {
        return Err(file.broken(0, "the file is empty"));
    }
    let mut header = Header {
        encoding: Encoding::Text,
        line_end: LineEnd::of(file.bytes),
        elements: Vec::new(),
        bytes: file.bytes.len() - text::without_mark(file.bytes).len(),
        lines: 0,
    };
    let mut format = false;
    loop {
        let rest = &file.bytes[header.bytes..];
        let last = header.line_end.last_byte();
        let end = rest.iter().take(HEADER_BYTES).position(|byte| *byte == last);
        header.lines += 1;
        let broken = |reason: &str| file.broken(header.lines, reason);
        let Some(end) = end.filter(|_| header.bytes < HEADER_BYTES) else {
            return Err(broken("the header has no `end_header` within its first 64 KiB"));
        };
        // Comments and names may be in any encoding.
        let line = String::from_utf8_lossy(&rest[..end]);
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        header.bytes += end + 1;
        if header.lines == 1 {
            if words != ["ply"] {
                return Err(broken("a PLY file starts with the line `ply`"));
            }
            continue;
        }
        match words[..] {
            [] | ["comment" | "obj_info", ..] => {}
            ["format", encoding, "1.0"] => {
                format = true;
                header.encoding = match encoding {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::LittleEndian,
                    "binary_big_endian" => Encoding::BigEndian,
                    _ => {
                        return Err(broken(
                            "unknown format; allowed: ascii, binary_little_endian, binary_big_endian",
                        ));
                    }
                };
            }
            ["element", name, count] => {
                let count = count
                    .parse()
                    .map_err(|_| broken("the count of an element is not a number"))?;
                header.elements.push(Element {
                    name: name.into(),
                    count,
                    properties: Vec::new(),
                });
            }
            ["property", "list", length, scalar, name] => property(&mut header, name, Some(length), scalar, file)?,
            ["property", scalar, name] => property(&mut header, name, None, scalar, file)?,
            ["end_header"] if format => return Ok(header),
            ["end_header"] => return Err(broken("the header has no `format`")),
            _ => return Err(broken("the header's line is not understood")),
        }
    }
}

fn property(
    header: &mut Header,
    name: &str,
    length: Option<&str>,
    scalar: &str,
    file: &MeshFile,
) -> Result<(), SceneError> {
    let broken = |reason: &str| file.broken(header.lines, reason);
    let known = |name: &str| Scalar::named(name).ok_or_else(|| broken("unknown type of a property"));
    let (length, scalar) = (length.map(known).transpose()?, known(scalar)?);
    if matches!(length, Some(Scalar::F32 | Scalar::F64)) {
        return Err(broken("the length of a list must be an integer"));
    }
    let element = header
        .elements
        .last_mut()
        .ok_or_else(|| file.broken(header.lines, "`property` before `element`"))?;
    if element.properties.iter().any(|property| property.name == name) {
        return Err(file.broken(header.lines, format!("property `{name}` is given twice")));
    }
    element.properties.push(Property {
        name: name.into(),
        length,
        scalar,
    });
    Ok(())
}

struct Body<'a, 'f> {
    file: &'a MeshFile<'f>,
    encoding: Encoding,
    rest: &'a [u8],
    line_end: LineEnd,
    line: u32,
    faults: &'a mut FileFaults,
}

impl Body<'_, '_> {
    fn broken(&self, reason: impl Into<String>) -> SceneError {
        self.file
            .broken(if self.encoding == Encoding::Text { self.line } else { 0 }, reason)
    }

    /// Notes what is wrong with a number or a face; the next ones can be read nevertheless.
    fn note(&mut self, result: Result<(), String>) -> Result<(), SceneError> {
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
    fn check_count(&self, element: &Element) -> Result<(), SceneError> {
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
    fn record(
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
        let mut bytes = [0; 8];
        bytes[..size].copy_from_slice(head);
        if self.encoding == Encoding::BigEndian {
            bytes[..size].reverse();
        }
        let word = u64::from_le_bytes(bytes);
        Ok(Ok(match scalar {
            Scalar::I8 => f64::from(word as i8),
            Scalar::U8 => f64::from(word as u8),
            Scalar::I16 => f64::from(word as i16),
            Scalar::U16 => f64::from(word as u16),
            Scalar::I32 => f64::from(word as i32),
            Scalar::U32 => f64::from(word as u32),
            Scalar::F32 => f64::from(f32::from_bits(word as u32)),
            Scalar::F64 => f64::from_bits(word),
        }))
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

/// Where a vertex's coordinates lie among its properties.
fn columns<const N: usize>(element: &Element, names: [&str; N]) -> Option<[usize; N]> {
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
struct Attribute {
    name: String,
    /// One column, or three.
    columns: Vec<usize>,
    scalar: Scalar,
    /// Whether it is a colour.
    colour: bool,
}

impl Attribute {
    /// The value in a row. Integers are parts of the largest of their type; as colours they are sRGB values.
    fn value(&self, row: &[f32]) -> Spectrum {
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
fn attributes(file: &MeshFile, element: &Element, prefix: &str) -> Vec<Attribute> {
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

fn vertices(body: &mut Body, element: &Element, flip_v: bool, mesh: &mut RawMesh) -> Result<(), SceneError> {
    if !mesh.positions.is_empty() {
        return Err(body.broken("two elements are named `vertex`"));
    }
    let count = body.file.check_vertices(element.count)? as usize;
    let place =
        columns(element, ["x", "y", "z"]).ok_or_else(|| body.broken("vertices have no properties x, y and z"))?;
    let normal = columns(element, ["nx", "ny", "nz"]);
    let uv = columns(element, ["u", "v"]).or_else(|| columns(element, ["s", "t"]));
    mesh.positions.reserve_exact(count);
    mesh.normals.reserve_exact(if normal.is_some() { count } else { 0 });
    mesh.uvs.reserve_exact(if uv.is_some() { count } else { 0 });
    let asked = attributes(body.file, element, "vertex_");
    let mut values = vec![Vec::new(); asked.len()];
    let mut row = vec![0.0_f32; element.properties.len()];
    for index in 0..count {
        let used = |column: usize| {
            place.contains(&column)
                || asked.iter().any(|attribute| attribute.columns.contains(&column))
                || normal.is_some_and(|n| n.contains(&column))
                || uv.is_some_and(|uv| uv.contains(&column))
        };
        let store = |column: usize, number: f64| {
            row[column] = number as f32;
            if used(column) && !row[column].is_finite() {
                let name = &element.properties[column].name;
                return Err(format!("vertex {index}: `{name}` is {number}, not a finite number"));
            }
            Ok(())
        };
        body.record(element, store, |_, _| Ok(()))?;
        mesh.positions.push(Vec3::from_array(place.map(|column| row[column])));
        if let Some(normal) = normal {
            // A normal without direction is a missing one.
            let normal = Vec3::from_array(normal.map(|column| row[column]));
            mesh.normals.push(normal.normalize_or_zero());
        }
        if let Some([u, v]) = uv {
            mesh.uvs
                .push(Vec2::new(row[u], if flip_v { 1.0 - row[v] } else { row[v] }));
        }
        for (values, attribute) in values.iter_mut().zip(&asked) {
            values.push(attribute.value(&row));
        }
    }
    keep(mesh, asked, values, false);
    Ok(())
}

/// Keeps the values of attributes with their names.
fn keep(mesh: &mut RawMesh, asked: Vec<Attribute>, values: Vec<Vec<Spectrum>>, of_faces: bool) {
    let named = asked.into_iter().zip(values).map(|(attribute, values)| RawAttribute {
        name: attribute.name,
        of_faces,
        values,
    });
    mesh.attributes.extend(named);
}

fn faces(body: &mut Body, element: &Element, mesh: &mut RawMesh) -> Result<(), SceneError> {
    body.file.check_triangles(element.count)?;
    let list = element.properties.iter().position(|property| {
        property.length.is_some() && ["vertex_indices", "vertex_index"].contains(&property.name.as_str())
    });
    let list = list.ok_or_else(|| body.broken("faces have no list `vertex_indices`"))?;
    let asked = attributes(body.file, element, "face_");
    let mut values = vec![Vec::new(); asked.len()];
    let mut row = vec![0.0_f32; element.properties.len()];
    let mut polygon: Vec<u32> = Vec::new();
    for index in 0..element.count {
        polygon.clear();
        let value = |column: usize, number: f64| {
            row[column] = number as f32;
            let used = asked.iter().any(|attribute| attribute.columns.contains(&column));
            if used && !row[column].is_finite() {
                let name = &element.properties[column].name;
                return Err(format!("face {index}: `{name}` is {number}, not a finite number"));
            }
            Ok(())
        };
        let store = |column: usize, number: f64| {
            if column == list {
                // A broken corner counts as one, so that no other fault follows from it.
                let valid = number >= 0.0 && number <= f64::from(u32::MAX) && number.fract() == 0.0;
                polygon.push(if valid { number as u32 } else { 0 });
                if !valid {
                    return Err(format!("face {index}: {number} is not a vertex index"));
                }
            }
            Ok(())
        };
        body.record(element, value, store)?;
        if polygon.len() < 3 {
            let reason = format!("face {index} has {} corners; 3 or more are needed", polygon.len());
            body.note(Err(reason))?;
            continue;
        }
        body.file
            .check_triangles((mesh.triangles.len() + polygon.len()) as u64)?;
        mesh.triangles
            .extend(polygon[1..].windows(2).map(|pair| [polygon[0], pair[0], pair[1]]));
        for (values, attribute) in values.iter_mut().zip(&asked) {
            values.resize(mesh.triangles.len(), attribute.value(&row));
        }
    }
    keep(mesh, asked, values, true);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{mesh_error, with_file};
    use super::*;

    const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nproperty float s\nproperty float t\nelement face 1\n\
        property list uchar int vertex_indices\nend_header\n";

    fn parse(bytes: &[u8]) -> Result<RawMesh, Vec<SceneError>> {
        with_file(bytes, |file| file.ply(false))
    }

    #[test]
    fn text_and_both_byte_orders_give_the_same_mesh() {
        let text = format!("{HEADER}0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n4 0 1 2 3");
        let mesh = parse(text.as_bytes()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
        assert_eq!(mesh.uvs[3], Vec2::new(0.0, 1.0));
        for (name, big) in [("binary_little_endian", false), ("binary_big_endian", true)] {
            let mut bytes = HEADER.replace("ascii", name).into_bytes();
            for (position, uv) in mesh.positions.iter().zip(&mesh.uvs) {
                for value in [position.x, position.y, position.z, uv.x, uv.y] {
                    bytes.extend(if big { value.to_be_bytes() } else { value.to_le_bytes() });
                }
            }
            bytes.push(4);
            for index in 0..4_i32 {
                bytes.extend(if big { index.to_be_bytes() } else { index.to_le_bytes() });
            }
            assert_eq!(parse(&bytes).unwrap(), mesh);
        }
    }

    /// Byte order marks, comments in Latin-1, lone CRs, and normals without direction.
    #[test]
    fn files_of_other_programs_are_read() {
        let text = "ply\nformat ascii 1.0\ncomment @\nelement vertex 3\nproperty float x\nproperty float y\n\
            property float z\nproperty float nx\nproperty float ny\nproperty float nz\nelement face 1\n\
            property list uchar int vertex_indices\nend_header\n0 0 0 0 0 0\n1 0 0 0 0 1\n0 1 0 0 0 2\n3 0 1 2\n";
        let latin1 = |text: &str| {
            text.bytes()
                .map(|b| if b == b'@' { 0xe9 } else { b })
                .collect::<Vec<u8>>()
        };
        let mesh = parse(&latin1(text)).unwrap();
        assert_eq!(mesh.normals, [Vec3::ZERO, Vec3::Z, Vec3::Z]);
        for end in ["\r\n", "\r"] {
            let text = text.replace('\n', end);
            assert_eq!(parse(&latin1(&text)).unwrap(), mesh, "{end:?}");
            assert_eq!(
                parse(&[b"\xef\xbb\xbf", &latin1(&text)[..]].concat()).unwrap(),
                mesh,
                "{end:?}"
            );
            mesh_error(
                parse(&latin1(&text.replace("0 1 0 0 0 2", "0 1 x 0 0 2"))),
                16,
                "not a number",
            );
        }
        // A binary body may begin with the byte of a line feed, here that of a coordinate.
        let header = HEADER
            .replace("ascii", "binary_little_endian")
            .replace('\n', "\r")
            .replace("vertex 4", "vertex 3");
        let mut bytes = header.into_bytes();
        let first = f32::from_le_bytes([b'\n', 0, 0, 0x40]);
        for value in [first, 0., 0., 0., 0., 1., 0., 0., 0., 0., 0., 1., 0., 0., 0.] {
            bytes.extend(value.to_le_bytes());
        }
        bytes.push(3);
        bytes.extend([0_i32, 1, 2].iter().flat_map(|index| index.to_le_bytes()));
        assert_eq!(parse(&bytes).unwrap().positions[0].x, first);
    }

    #[test]
    fn lies_in_the_header_are_found_before_memory_is_taken() {
        let huge = HEADER.replace("vertex 4", "vertex 18446744073709551615");
        mesh_error(parse(huge.as_bytes()), 12, "ends before");
        let text = HEADER.replace("vertex 4", "vertex 1").replace("face 1", "face 1000000");
        mesh_error(parse(format!("{text}0 0 0 0 0\n").as_bytes()), 12, "ends before");
    }

    #[test]
    fn broken_files_are_refused_with_their_line() {
        let three = "1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n";
        let four = format!("0 0 0 0 0\n{three}");
        for (body, line, reason) in [
            (format!("{HEADER}{four}3 0 1 4"), 0, "out of range"),
            (format!("{HEADER}{four}3 0 1 -1"), 16, "not a vertex index"),
            (format!("{HEADER}{four}2 0 1"), 16, "3 or more"),
            (format!("{HEADER}{four}-1 0 1"), 16, "length -1"),
            (format!("{HEADER}{four}200 0 1"), 16, "too early"),
            (
                format!("{HEADER}0 0 nan 0 0\n{three}3 0 1 2"),
                12,
                "not a finite number",
            ),
            (format!("{HEADER}0 0 x 0 0\n{three}3 0 1 2"), 12, "not a number"),
            (HEADER.replace("float x", "float q"), 12, "ends before"),
            (
                HEADER.replace("vertex 4", "vertex 0").replace("face 1", "face 0"),
                0,
                "no vertices",
            ),
            (HEADER.replace("float x", "real x"), 4, "unknown type"),
            (HEADER.replace("1.0", "2.0"), 2, "not understood"),
            ("ply\nformat ascii 1.0\nelement vertex 1\n".into(), 4, "end_header"),
            ("obj\n".into(), 1, "starts with"),
            (String::new(), 0, "the file is empty"),
        ] {
            mesh_error(parse(body.as_bytes()), line, reason);
        }
    }

    #[test]
    fn every_broken_number_and_face_is_told() {
        let header = HEADER.replace("face 1", "face 4");
        let text =
            format!("{header}0 0 x 0 0\n1 nan 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n3 0 1 -1\n2 0 1\n4 0 1 2 9\n3 y 0 1\n");
        let told: Vec<String> = parse(text.as_bytes())
            .unwrap_err()
            .iter()
            .map(ToString::to_string)
            .collect();
        let expected = [
            "mesh:12: `x` is not a number of the property's type",
            "mesh:13: vertex 1: `y` is NaN, not a finite number",
            "mesh:16: face 0: -1 is not a vertex index",
            "mesh:17: face 1 has 2 corners; 3 or more are needed",
            "mesh:19: `y` is not a number of the property's type",
            "mesh: vertex index 9 is out of range: the file has 4 vertices",
        ];
        assert_eq!(told, expected);
    }
}

//! The header of a PLY file: what its elements are.

use super::super::MeshFile;
use crate::scene::error::SceneError;
use crate::scene::text;

/// The longest header.
const HEADER_BYTES: usize = 1 << 16;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Encoding {
    Text,
    LittleEndian,
    BigEndian,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Scalar {
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

    pub(super) fn size(self) -> usize {
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
pub(super) enum LineEnd {
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

    pub(super) fn last_byte(self) -> u8 {
        match self {
            Self::Lf => b'\n',
            Self::Cr => b'\r',
        }
    }
}

pub(super) struct Property {
    pub(super) name: String,
    /// The type of a list's length; `None` for a single value.
    pub(super) length: Option<Scalar>,
    pub(super) scalar: Scalar,
}

pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) line_end: LineEnd,
    pub(super) elements: Vec<Element>,
    /// Bytes and lines of the header.
    pub(super) bytes: usize,
    pub(super) lines: u32,
}

pub(super) fn header(file: &MeshFile) -> Result<Header, SceneError> {
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

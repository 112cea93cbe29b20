//! Little-endian numbers of a file, one after the other.

use crate::scene::error::{Place, SceneError, shortened};

/// A place in the bytes of a file.
#[derive(Clone)]
pub(super) struct Bytes<'a> {
    place: &'a Place,
    /// What messages call the file.
    what: &'static str,
    data: &'a [u8],
    at: usize,
}

/// The longest name that is read \[bytes\].
const LONGEST_NAME: u32 = 1 << 16;

impl<'a> Bytes<'a> {
    pub(super) fn new(place: &'a Place, what: &'static str, data: &'a [u8]) -> Self {
        Self {
            place,
            what,
            data,
            at: 0,
        }
    }

    pub(super) fn place(&self) -> &'a Place {
        self.place
    }

    pub(super) fn broken(&self, reason: impl std::fmt::Display) -> SceneError {
        SceneError::data(self.place, format!("broken {} file: {reason}", self.what))
    }

    pub(super) fn at(&self) -> u64 {
        self.at as u64
    }

    /// Goes on at a byte of the file.
    pub(super) fn seek(&mut self, to: u64) -> Result<(), SceneError> {
        match usize::try_from(to).ok().filter(|to| *to <= self.data.len()) {
            Some(to) => {
                self.at = to;
                Ok(())
            }
            None => Err(self.broken(format!("byte {to} is named, and there are {}", self.data.len()))),
        }
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], SceneError> {
        let rest = &self.data[self.at..];
        match rest.get(..count) {
            Some(taken) => {
                self.at += count;
                Ok(taken)
            }
            None => Err(self.broken(format!(
                "it ends at byte {}, where {count} more are expected after byte {}",
                self.data.len(),
                self.at
            ))),
        }
    }

    /// Bytes whose number the file says.
    pub(super) fn take_long(&mut self, count: u64) -> Result<&'a [u8], SceneError> {
        self.take(usize::try_from(count).unwrap_or(usize::MAX))
    }

    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], SceneError> {
        let taken = self.take(N)?;
        Ok(std::array::from_fn(|index| taken[index]))
    }

    pub(super) fn u8(&mut self) -> Result<u8, SceneError> {
        self.array::<1>().map(|bytes| bytes[0])
    }

    pub(super) fn u16(&mut self) -> Result<u16, SceneError> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, SceneError> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Result<u64, SceneError> {
        self.array().map(u64::from_le_bytes)
    }

    pub(super) fn i64(&mut self) -> Result<i64, SceneError> {
        self.array().map(i64::from_le_bytes)
    }

    pub(super) fn f32(&mut self) -> Result<f32, SceneError> {
        self.array().map(f32::from_le_bytes)
    }

    pub(super) fn f64(&mut self) -> Result<f64, SceneError> {
        self.array().map(f64::from_le_bytes)
    }

    pub(super) fn coordinates(&mut self) -> Result<[i32; 3], SceneError> {
        let words: [[u8; 4]; 3] = [self.array()?, self.array()?, self.array()?];
        Ok(words.map(i32::from_le_bytes))
    }

    /// A text after its length.
    pub(super) fn text(&mut self) -> Result<String, SceneError> {
        let length = self.u32()?;
        if length > LONGEST_NAME {
            return Err(self.broken(format!(
                "a name of {length} bytes before byte {}; at most {LONGEST_NAME} are read",
                self.at
            )));
        }
        Ok(String::from_utf8_lossy(self.take(length as usize)?).into_owned())
    }

    /// The error for something that is not read, with what is.
    pub(super) fn unknown(&self, what: &str, found: &str, known: &str) -> SceneError {
        let (found, file) = (shortened(found), self.what);
        SceneError::data(
            self.place,
            format!("{what} `{found}` of {file} files is not read here; {known}"),
        )
    }
}

//! The values of a node's image in pieces, as they arrive or are read, and what they may be.

use photonfarm_core::film::{FilmError, VALUES_PER_PIXEL, can_be};

/// The values of little-endian bytes.
#[must_use]
pub fn values(bytes: &[u8]) -> Vec<f32> {
    let (values, _) = bytes.as_chunks();
    values.iter().map(|value| f32::from_le_bytes(*value)).collect()
}

/// Writes values as little-endian bytes.
pub fn write(to: &mut [u8], values: &[f32]) {
    let (to, _) = to.as_chunks_mut();
    to.iter_mut()
        .zip(values)
        .for_each(|(to, value)| *to = value.to_le_bytes());
}

/// Looks at planes of values, piece by piece: none is negative or not finite.
#[derive(Debug)]
pub struct Pixels {
    width: u64,
    /// Values before the statistics.
    image: u64,
    /// Statistics of each pixel.
    statistics: u64,
    /// Values seen.
    seen: u64,
    /// The first bytes of a value of which the others have not come.
    part: Vec<u8>,
    /// The first value that cannot be.
    bad: Option<FilmError>,
}

impl Pixels {
    /// For planes of so many pixels across and down, with so many statistics of each.
    #[must_use]
    pub fn new([width, height]: [u32; 2], statistics: u16) -> Self {
        Self {
            width: width.into(),
            image: u64::from(width) * u64::from(height) * VALUES_PER_PIXEL as u64,
            statistics: statistics.into(),
            seen: 0,
            part: Vec::with_capacity(4),
            bad: None,
        }
    }

    /// Looks at the next bytes.
    pub fn look_at(&mut self, mut piece: &[u8]) {
        if !self.part.is_empty() {
            let (end, rest) = piece.split_at(piece.len().min(4 - self.part.len()));
            self.part.extend_from_slice(end);
            piece = rest;
            if let Ok(value) = <[u8; 4]>::try_from(self.part.as_slice()) {
                self.part.clear();
                self.look_at_values(&value);
            }
        }
        let (whole, rest) = piece.split_at(piece.len() / 4 * 4);
        self.look_at_values(whole);
        self.part.extend_from_slice(rest);
    }

    /// The first value that cannot be.
    #[must_use]
    pub fn bad(&self) -> Option<&FilmError> {
        self.bad.as_ref()
    }

    fn look_at_values(&mut self, bytes: &[u8]) {
        let values = bytes
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        // All are compared without a branch, many at a time; only where one is bad does it matter which.
        let good = values.clone().fold(true, |good, value| good & can_be(value));
        if !good && self.bad.is_none() {
            self.bad = values
                .enumerate()
                .find(|(_, value)| !can_be(*value))
                .map(|(index, value)| {
                    let at = self.seen + index as u64;
                    let pixel = match at {
                        _ if at < self.image => at / VALUES_PER_PIXEL as u64,
                        _ => (at - self.image) / self.statistics,
                    };
                    FilmError::Pixel {
                        x: (pixel % self.width) as u32,
                        y: (pixel / self.width) as u32,
                        value,
                    }
                });
        }
        self.seen += bytes.len() as u64 / 4;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::JobId;
    use crate::node::{NodeHeader, NodeKey, decode_node};

    /// What is found in planes that come in pieces of `length` bytes.
    fn found(header: &NodeHeader, planes: &[u8], length: usize) -> Option<String> {
        let mut pixels = Pixels::new([header.width, header.height], header.statistics);
        planes.chunks(length).for_each(|piece| pixels.look_at(piece));
        assert_eq!(pixels.seen, planes.len() as u64 / 4);
        pixels.bad.map(|error| error.to_string())
    }

    #[test]
    fn a_bad_value_is_found_where_it_is_whatever_the_pieces() {
        [0, 2].into_iter().for_each(check_bad_values);
    }

    fn check_bad_values(statistics: u16) {
        let header = NodeHeader {
            job: JobId(1),
            key: NodeKey::leaf(0),
            width: 3,
            height: 2,
            statistics,
        };
        let values = (header.plane_bytes() / 4) as usize;
        for bad in [f32::NAN, f32::INFINITY, -1.0] {
            for index in 0..=values {
                let value = |at| if at == index { bad } else { 0.5_f32 };
                let planes: Vec<u8> = (0..values).flat_map(|at| value(at).to_le_bytes()).collect();
                let whole = [&header.to_bytes()[..], &planes].concat();
                let expected = decode_node(&whole, &Default::default())
                    .err()
                    .map(|error| error.to_string());
                assert_eq!(expected.is_none(), index == values);
                for length in [1, 2, 3, 4, 5, 7, 64, 1000] {
                    assert_eq!(
                        found(&header, &planes, length),
                        expected,
                        "{bad} at {index}, pieces of {length}"
                    );
                }
            }
        }
    }
}

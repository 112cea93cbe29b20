//! What the pixels of an image may be, told as it comes in pieces: none is negative or not finite.

use photonfarm_core::film::FilmError;
use photonfarm_core::spectrum::CHANNELS;
use photonfarm_proto::node::NodeHeader;

/// Looks at planes of values.
pub(super) struct Pixels {
    width: u64,
    /// Values of the plane of sums.
    sums: u64,
    /// Values seen.
    seen: u64,
    /// The first bytes of a value of which the others have not come.
    part: Vec<u8>,
    /// The first value that cannot be.
    pub(super) bad: Option<FilmError>,
}

impl Pixels {
    pub(super) fn of(header: &NodeHeader) -> Self {
        let width = u64::from(header.width);
        Self {
            width,
            sums: width * u64::from(header.height) * CHANNELS as u64,
            seen: 0,
            part: Vec::with_capacity(4),
            bad: None,
        }
    }

    /// Looks at the next bytes.
    pub(super) fn look_at(&mut self, mut piece: &[u8]) {
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

    fn look_at_values(&mut self, bytes: &[u8]) {
        let values = bytes
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let can_be = |value: f32| (0.0..f32::INFINITY).contains(&value);
        // All are compared without a branch, many at a time; only where one is bad does it matter which.
        let good = values.clone().fold(true, |good, value| good & can_be(value));
        if !good && self.bad.is_none() {
            self.bad = values
                .enumerate()
                .find(|(_, value)| !can_be(*value))
                .map(|(index, value)| {
                    let at = self.seen + index as u64;
                    let pixel = at.checked_sub(self.sums).unwrap_or(at / CHANNELS as u64);
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
    use photonfarm_proto::id::JobId;
    use photonfarm_proto::node::{NodeKey, decode_node};

    /// What is found in planes that come in pieces of `length` bytes.
    fn found(header: &NodeHeader, planes: &[u8], length: usize) -> Option<String> {
        let mut pixels = Pixels::of(header);
        planes.chunks(length).for_each(|piece| pixels.look_at(piece));
        assert_eq!(pixels.seen, planes.len() as u64 / 4);
        pixels.bad.map(|error| error.to_string())
    }

    #[test]
    fn a_bad_value_is_found_where_it_is_whatever_the_pieces() {
        let header = NodeHeader {
            job: JobId(1),
            key: NodeKey::leaf(0),
            width: 3,
            height: 2,
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

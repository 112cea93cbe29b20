//! The frame of worker messages: magic number, version, kind, then bincode.
//!
//! bincode stays in this module. Decoding is bounded: a message claims at most [`MESSAGE_BYTES`] bytes, whatever
//! counts it contains, and nothing may follow it.

use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

/// Version of the worker protocol. Both sides must have the same.
pub const PROTOCOL_VERSION: u16 = 8;

/// The media type of framed messages.
pub const MESSAGE_MEDIA_TYPE: &str = "application/vnd.photonfarm";

/// Most bytes of a framed message.
pub const MESSAGE_BYTES: usize = 8 << 20;

const MAGIC: [u8; 4] = *b"PHFM";
const FRAME_BYTES: usize = 8;

/// A message that has a kind of its own, so that one is never read as another.
pub trait Message: Serialize + DeserializeOwned {
    /// Number of the kind, unique among messages.
    const KIND: u16;
}

/// Why bytes are not the message expected.
#[derive(Debug, Error)]
pub enum CodecError {
    /// Fewer bytes than a frame has.
    #[error("the message is cut short")]
    Short,
    /// More bytes than a message may have.
    #[error("the message has {0} bytes, more than {MESSAGE_BYTES}")]
    Long(usize),
    /// No magic number.
    #[error("not a message of Photonfarm: the magic number is missing")]
    Magic,
    /// Another version of the protocol.
    #[error("the message has protocol version {found}, this program has {PROTOCOL_VERSION}")]
    Version {
        /// The version found.
        found: u16,
    },
    /// Another message.
    #[error("the message is of kind {found}, expected {expected}")]
    Kind {
        /// The kind found.
        found: u16,
        /// The kind expected.
        expected: u16,
    },
    /// Bytes after the message.
    #[error("{0} bytes follow the message")]
    Trailing(usize),
    /// A body that cannot be read.
    #[error("the message is damaged: {0}")]
    Damaged(#[source] bincode::error::DecodeError),
    /// A value that cannot be written.
    #[error("the message cannot be written: {0}")]
    Unwritable(#[source] bincode::error::EncodeError),
}

fn config() -> Configuration<LittleEndian, Fixint, Limit<MESSAGE_BYTES>> {
    bincode::config::standard()
        .with_little_endian()
        .with_fixed_int_encoding()
        .with_limit()
}

/// A message in its frame.
pub fn encode<M: Message>(message: &M) -> Result<Vec<u8>, CodecError> {
    let mut bytes = Vec::with_capacity(256);
    bytes.extend_from_slice(&MAGIC);
    bytes.extend_from_slice(&PROTOCOL_VERSION.to_le_bytes());
    bytes.extend_from_slice(&M::KIND.to_le_bytes());
    bincode::serde::encode_into_std_write(message, &mut bytes, config()).map_err(CodecError::Unwritable)?;
    if bytes.len() > MESSAGE_BYTES {
        return Err(CodecError::Long(bytes.len()));
    }
    Ok(bytes)
}

/// Reads a message from its frame. The version is checked before anything that could have changed with it.
pub fn decode<M: Message>(bytes: &[u8]) -> Result<M, CodecError> {
    if bytes.len() > MESSAGE_BYTES {
        return Err(CodecError::Long(bytes.len()));
    }
    let (frame, body) = bytes.split_at_checked(FRAME_BYTES).ok_or(CodecError::Short)?;
    if frame[..4] != MAGIC {
        return Err(CodecError::Magic);
    }
    let number = |at: usize| u16::from_le_bytes([frame[at], frame[at + 1]]);
    if number(4) != PROTOCOL_VERSION {
        return Err(CodecError::Version { found: number(4) });
    }
    if number(6) != M::KIND {
        return Err(CodecError::Kind {
            found: number(6),
            expected: M::KIND,
        });
    }
    let (message, used) = bincode::serde::decode_from_slice(body, config()).map_err(CodecError::Damaged)?;
    if used != body.len() {
        return Err(CodecError::Trailing(body.len() - used));
    }
    Ok(message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;
    use std::collections::BTreeMap;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Sample {
        number: u64,
        text: String,
        list: Vec<Vec<u32>>,
        map: BTreeMap<String, Option<f32>>,
    }
    impl Message for Sample {
        const KIND: u16 = 900;
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Other {
        number: u64,
    }
    impl Message for Other {
        const KIND: u16 = 901;
    }

    fn sample() -> Sample {
        Sample {
            number: 1 << 60,
            text: "light".into(),
            list: vec![vec![1, 2], vec![], vec![3]],
            map: BTreeMap::from([("a".into(), Some(1.5)), ("b".into(), None)]),
        }
    }

    #[test]
    fn a_message_survives() {
        let bytes = encode(&sample()).unwrap();
        assert_eq!(decode::<Sample>(&bytes).unwrap(), sample());
    }

    #[test]
    fn frames_of_others_are_refused_clearly() {
        let bytes = encode(&sample()).unwrap();
        assert!(matches!(
            decode::<Other>(&bytes),
            Err(CodecError::Kind {
                found: 900,
                expected: 901
            })
        ));
        let mut newer = bytes.clone();
        newer[4] = PROTOCOL_VERSION as u8 + 1;
        let error = decode::<Sample>(&newer).unwrap_err();
        let found = PROTOCOL_VERSION + 1;
        assert!(matches!(error, CodecError::Version { found: other } if other == found));
        assert!(error.to_string().contains(&format!("version {found}")));
        let mut http = bytes.clone();
        http[..4].copy_from_slice(b"<htm");
        assert!(matches!(decode::<Sample>(&http), Err(CodecError::Magic)));
        let longer = [bytes.as_slice(), &[0]].concat();
        assert!(matches!(decode::<Sample>(&longer), Err(CodecError::Trailing(1))));
    }

    #[test]
    fn every_truncation_is_an_error() {
        let bytes = encode(&sample()).unwrap();
        for length in 0..bytes.len() {
            assert!(decode::<Sample>(&bytes[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn no_flipped_bit_makes_a_panic() {
        let bytes = encode(&sample()).unwrap();
        for bit in 0..bytes.len() * 8 {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            let _ = decode::<Sample>(&damaged);
        }
    }

    #[test]
    fn huge_counts_are_refused_before_memory_is_taken() {
        let bytes = encode(&sample()).unwrap();
        let count_of_text = FRAME_BYTES + 8;
        let count_of_list = count_of_text + 8 + "light".len();
        for at in [count_of_text, count_of_list, count_of_list + 8] {
            for count in [u64::MAX, u64::MAX / 8, 1 << 40, MESSAGE_BYTES as u64] {
                let mut damaged = bytes.clone();
                damaged[at..at + 8].copy_from_slice(&count.to_le_bytes());
                assert!(
                    matches!(decode::<Sample>(&damaged), Err(CodecError::Damaged(_))),
                    "{at} {count}"
                );
            }
        }
    }
}

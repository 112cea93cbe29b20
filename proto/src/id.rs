//! Names of things: jobs, workers, leases, and blobs by their content.

use crate::hex::{Hex, bytes_of};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;
use utoipa::ToSchema;

macro_rules! number_id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema,
        )]
        #[serde(transparent)]
        #[schema(example = 1)]
        pub struct $name(pub u64);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }

        impl FromStr for $name {
            type Err = std::num::ParseIntError;
            fn from_str(text: &str) -> Result<Self, Self::Err> {
                text.parse().map(Self)
            }
        }
    };
}

number_id! {
    /// A job. Numbers rise in the order of submission and are never used again.
    JobId
}
number_id! {
    /// A worker process, from its registration to its end.
    WorkerId
}
number_id! {
    /// A check. Numbers are random, so that none is used again after a start of the coordinator.
    CheckId
}

/// The fencing token of a lease. Nobody but its worker knows the nonce: to know a lease's number is not to hold it.
///
/// In JSON it is a pair of numbers; farms of older versions kept the number alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LeaseToken {
    /// Rises for ever, across restarts of the coordinator.
    pub number: u64,
    /// Random bits.
    pub nonce: u64,
}

impl fmt::Display for LeaseToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.number.fmt(f)
    }
}

impl Serialize for LeaseToken {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (self.number, self.nonce).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for LeaseToken {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Kept {
            Pair(u64, u64),
            Number(u64),
        }
        let (number, nonce) = if deserializer.is_human_readable() {
            match Kept::deserialize(deserializer)? {
                Kept::Pair(number, nonce) => (number, nonce),
                Kept::Number(number) => (number, 0),
            }
        } else {
            <(u64, u64)>::deserialize(deserializer)?
        };
        Ok(Self { number, nonce })
    }
}

/// The BLAKE3 hash of some bytes: 64 lower-case hexadecimal digits in JSON, 32 bytes in bincode.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, ToSchema)]
#[schema(value_type = String, pattern = "^[0-9a-f]{64}$")]
pub struct BlobHash(pub [u8; 32]);

impl BlobHash {
    /// The hash of `bytes`.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }
}

impl From<blake3::Hash> for BlobHash {
    fn from(hash: blake3::Hash) -> Self {
        Self(*hash.as_bytes())
    }
}

impl fmt::Display for BlobHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Hex(&self.0).fmt(f)
    }
}

impl fmt::Debug for BlobHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Not 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("a hash is 64 lower-case hexadecimal digits")]
pub struct HashError;

impl FromStr for BlobHash {
    type Err = HashError;

    fn from_str(text: &str) -> Result<Self, HashError> {
        bytes_of(text).map(Self).ok_or(HashError)
    }
}

impl Serialize for BlobHash {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            serializer.collect_str(self)
        } else {
            self.0.serialize(serializer)
        }
    }
}

impl<'de> Deserialize<'de> for BlobHash {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            let text = String::deserialize(deserializer)?;
            text.parse().map_err(serde::de::Error::custom)
        } else {
            <[u8; 32]>::deserialize(deserializer).map(Self)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hash_survives_its_text() {
        let hash = BlobHash::of(b"photon");
        assert_eq!(hash.to_string().parse(), Ok(hash));
        let json = serde_json::to_string(&hash).unwrap();
        assert_eq!(json, format!("\"{hash}\""));
        assert_eq!(serde_json::from_str::<BlobHash>(&json).unwrap(), hash);
    }

    #[test]
    fn a_token_survives_its_text_and_that_of_older_farms() {
        let token = LeaseToken {
            number: 9,
            nonce: u64::MAX,
        };
        let json = serde_json::to_string(&token).unwrap();
        assert_eq!(serde_json::from_str::<LeaseToken>(&json).unwrap(), token);
        assert_eq!(
            serde_json::from_str::<LeaseToken>("7").unwrap(),
            LeaseToken { number: 7, nonce: 0 }
        );
        assert_eq!(token.to_string(), "9", "texts for people do not give the nonce away");
    }

    #[test]
    fn a_damaged_hash_is_refused() {
        let text = BlobHash::of(b"photon").to_string();
        for bad in [&text[1..], &text.to_uppercase(), &format!("{text}0"), "", "é"] {
            assert_eq!(bad.parse::<BlobHash>(), Err(HashError), "{bad}");
        }
        assert_eq!(format!("{}é", &text[..62]).parse::<BlobHash>(), Err(HashError));
    }
}

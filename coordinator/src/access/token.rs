//! Tokens as they are made and sent.

use photonfarm_proto::id::BlobHash;
use std::fmt;

/// What every token begins with, so that people and scanners know it for what it is.
const PREFIX: &str = "phf_";
/// Random bytes of a token.
const BYTES: usize = 32;

/// A token as its bearer holds it: the prefix and 256 random bits in hexadecimal digits. Its debug text hides it.
pub struct Secret(String);

impl Secret {
    /// A new one, from the system's random numbers.
    ///
    /// # Errors
    /// A system without random numbers.
    pub fn random() -> Result<Self, getrandom::Error> {
        let mut bytes = [0; BYTES];
        getrandom::fill(&mut bytes)?;
        Ok(Self(format!("{PREFIX}{}", BlobHash(bytes))))
    }

    /// The token in clear, to be shown once.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// What is kept of it.
    #[must_use]
    pub fn hash(&self) -> BlobHash {
        hash(&self.0)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret")
    }
}

/// 256 random bits cannot be guessed from their hash, so a fast hash without salt is enough.
pub(super) fn hash(token: &str) -> BlobHash {
    BlobHash::of(token.as_bytes())
}

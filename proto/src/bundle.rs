//! Scenes as they travel: a list of files by content.

use crate::id::BlobHash;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

/// A scene: every file it needs, by content. Names are those that the scene uses, with `/` between their parts; they are keys, and no paths
/// of the farm.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BundleManifest {
    /// The files by name.
    pub files: BTreeMap<String, FileEntry>,
}

/// A file of a bundle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FileEntry {
    /// BLAKE3 hash of its bytes.
    pub hash: BlobHash,
    /// Its size.
    pub bytes: u64,
}

impl FileEntry {
    /// The entry of a file with this content.
    #[must_use]
    pub fn of(content: &[u8]) -> Self {
        Self {
            hash: BlobHash::of(content),
            bytes: content.len() as u64,
        }
    }
}

impl BundleManifest {
    /// The name of the bundle: a hash over names, hashes and sizes in the order of the names.
    #[must_use]
    pub fn hash(&self) -> BlobHash {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"photonfarm bundle 1\n");
        for (name, file) in &self.files {
            hasher.update(&(name.len() as u64).to_le_bytes());
            hasher.update(name.as_bytes());
            hasher.update(&file.hash.0);
            hasher.update(&file.bytes.to_le_bytes());
        }
        hasher.finalize().into()
    }

    /// Every distinct content with its size.
    #[must_use]
    pub fn blobs(&self) -> BTreeSet<(BlobHash, u64)> {
        self.files.values().map(|file| (file.hash, file.bytes)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_depends_on_every_part() {
        let one = |name: &str, content: &[u8]| BundleManifest {
            files: BTreeMap::from([(name.to_owned(), FileEntry::of(content))]),
        };
        let reference = one("a", b"x").hash();
        assert_eq!(reference, one("a", b"x").hash());
        assert_ne!(reference, one("b", b"x").hash());
        assert_ne!(reference, one("a", b"y").hash());
        let mut longer = one("a", b"x");
        longer.files.get_mut("a").unwrap().bytes += 1;
        assert_ne!(reference, longer.hash());
        assert_ne!(reference, BundleManifest::default().hash());
    }

    #[test]
    fn unknown_fields_are_refused() {
        let error = serde_json::from_str::<BundleManifest>(r#"{"files": {}, "file": 1}"#).unwrap_err();
        assert!(error.to_string().contains("file"));
    }
}

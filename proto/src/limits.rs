//! What a farm accepts. Checked before work starts and before memory is taken.

use crate::bundle::BundleManifest;
use photonfarm_core::scene::normalise;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use utoipa::ToSchema;

/// Limits of a farm.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Files in a bundle.
    pub bundle_files: u64,
    /// Bytes of all files of a bundle.
    pub bundle_bytes: u64,
    /// Bytes of one file of a bundle.
    pub file_bytes: u64,
    /// Bytes of a file name in a bundle.
    pub file_name_bytes: u64,
    /// Bytes of a JSON body.
    pub json_bytes: u64,
    /// Iterations of a job.
    pub iterations: u64,
    /// Pixels of an image.
    pub pixels: u64,
    /// Definitions (`-D name=value`) of a job.
    pub defines: u64,
    /// Bytes of a definition, name and value.
    pub define_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            bundle_files: 4096,
            bundle_bytes: 4 << 30,
            file_bytes: 2 << 30,
            file_name_bytes: 255,
            json_bytes: 4 << 20,
            iterations: 1 << 20,
            pixels: 1 << 26,
            defines: 256,
            define_bytes: 1024,
        }
    }
}

/// Something asked for more than the farm accepts, or for something that cannot be.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum LimitError {
    /// A number beyond its limit.
    #[error("{what} is {value}: the limit `{name}` is {limit}, on every farm")]
    Exceeded {
        /// What was counted.
        what: String,
        /// The value asked for.
        value: u64,
        /// The field of [`Limits`].
        name: &'static str,
        /// Its value.
        limit: u64,
    },
    /// A field with a value that no job can have.
    #[error("{field}: {reason}")]
    Invalid {
        /// Path of the field.
        field: String,
        /// What is wrong.
        reason: String,
    },
}

impl LimitError {
    /// A field with a value that no job can have.
    pub fn invalid(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Invalid {
            field: field.into(),
            reason: reason.into(),
        }
    }
}

/// Checks a value against the limit of that name.
pub(crate) fn within(what: &str, value: u64, name: &'static str, limit: u64) -> Result<(), LimitError> {
    if value <= limit {
        return Ok(());
    }
    Err(LimitError::Exceeded {
        what: what.to_owned(),
        value,
        name,
        limit,
    })
}

impl Limits {
    /// Checks a manifest: names, number of files, sizes.
    pub fn check_bundle(&self, manifest: &BundleManifest) -> Result<(), LimitError> {
        let files = manifest.files.len() as u64;
        within("the number of files", files, "bundle_files", self.bundle_files)?;
        if files == 0 {
            return Err(LimitError::invalid("files", "a bundle has at least one file"));
        }
        let mut total = 0u64;
        for (name, file) in &manifest.files {
            let length = name.len() as u64;
            within(
                "a file name's length in bytes",
                length,
                "file_name_bytes",
                self.file_name_bytes,
            )?;
            check_name(name).map_err(|reason| LimitError::invalid(format!("files.{name:?}"), reason))?;
            within(
                &format!("the size of {name:?} in bytes"),
                file.bytes,
                "file_bytes",
                self.file_bytes,
            )?;
            total = total.saturating_add(file.bytes);
        }
        within(
            "the size of the bundle in bytes",
            total,
            "bundle_bytes",
            self.bundle_bytes,
        )
    }

    /// Checks a number of iterations.
    pub fn check_iterations(&self, iterations: u32) -> Result<(), LimitError> {
        if iterations == 0 {
            return Err(LimitError::invalid("iterations", "a job has at least one iteration"));
        }
        within("iterations", iterations.into(), "iterations", self.iterations)
    }

    /// Checks an image size.
    pub fn check_resolution(&self, width: u32, height: u32) -> Result<(), LimitError> {
        if width == 0 || height == 0 {
            return Err(LimitError::invalid(
                "resolution",
                format!("{width} x {height} has no pixel"),
            ));
        }
        let pixels = u64::from(width) * u64::from(height);
        within("the number of pixels", pixels, "pixels", self.pixels)
    }
}

/// Checks that a name has the plain form of a scene's file names ([`normalise`]), so that it has one spelling only.
pub fn check_name(name: &str) -> Result<(), String> {
    match normalise(name) {
        Ok(plain) if plain == name => Ok(()),
        Ok(plain) => Err(format!("a file name is written in its plain form, here {plain:?}")),
        Err(error) => Err(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::FileEntry;
    use crate::id::BlobHash;

    fn manifest(files: &[(&str, u64)]) -> BundleManifest {
        let entry = |bytes| FileEntry {
            hash: BlobHash::of(b""),
            bytes,
        };
        BundleManifest {
            files: files.iter().map(|(n, b)| ((*n).to_owned(), entry(*b))).collect(),
        }
    }

    #[test]
    fn names_have_one_spelling() {
        for good in [
            "scene.xml",
            "textures/wood.png",
            "a b/ü.obj",
            "..a/b..",
            "../../x",
            "/usr/x",
        ] {
            assert_eq!(check_name(good), Ok(()), "{good}");
        }
        for bad in ["", "..", "/../x", "a/../x", "a//b", "a/", "./a", "a\\b", "a\0b", "a\nb"] {
            assert!(check_name(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn bundles_beyond_a_limit_are_refused_by_its_name() {
        let limits = Limits {
            bundle_files: 2,
            bundle_bytes: 10,
            file_bytes: 8,
            ..Limits::default()
        };
        let refused = |files: &[(&str, u64)]| limits.check_bundle(&manifest(files)).unwrap_err().to_string();
        assert!(limits.check_bundle(&manifest(&[("a", 5), ("b", 5)])).is_ok());
        assert!(refused(&[("a", 1), ("b", 1), ("c", 1)]).contains("bundle_files"));
        assert!(refused(&[("a", 9)]).contains("file_bytes"));
        assert!(refused(&[("a", 6), ("b", 6)]).contains("bundle_bytes"));
        assert!(refused(&[("a/../b", 1)]).contains("plain form"));
        assert!(refused(&[]).contains("at least one"));
        let huge = Limits {
            file_bytes: u64::MAX,
            ..Limits::default()
        };
        assert!(
            huge.check_bundle(&manifest(&[("a", u64::MAX), ("b", u64::MAX)]))
                .is_err()
        );
    }

    #[test]
    fn image_sizes_are_bounded() {
        let limits = Limits {
            pixels: 100,
            ..Limits::default()
        };
        assert!(limits.check_resolution(10, 10).is_ok());
        assert!(limits.check_resolution(101, 1).is_err());
        assert!(limits.check_resolution(0, 5).is_err());
        assert!(limits.check_resolution(u32::MAX, u32::MAX).is_err());
    }
}

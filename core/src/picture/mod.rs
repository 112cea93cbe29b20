//! Pictures as files: OpenEXR with metadata, PNG by a tone curve, and tables of what was measured.

mod facts;
mod metadata;
mod openexr;
mod table;
mod tone;

pub use facts::{NAMES_BYTES, SceneFacts};
pub use metadata::PictureMetadata;
pub use openexr::{Beside, DecodedExr, decode_exr, encode_exr, read_metadata};
pub use table::encode_csv;
pub use tone::{ToneCurve, encode_png};

use crate::integrator::layers::LayerError;
use thiserror::Error;

/// Why a picture cannot be written or read.
#[derive(Debug, Error)]
pub enum PictureError {
    /// The image's buffers do not have the length that its size says.
    #[error("an image of {width} x {height} pixels has {pixels} pixels and {standard_errors} standard errors")]
    Size {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// Length of the pixel buffer.
        pixels: usize,
        /// Length of the buffer of standard errors.
        standard_errors: usize,
    },
    /// More pixels than the caller allows.
    #[error("the image has {width} x {height} pixels; the limit is {limit} pixels")]
    TooLarge {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Most pixels allowed.
        limit: usize,
    },
    /// Not a readable OpenEXR file.
    #[error("not a readable OpenEXR file: {0}")]
    Exr(#[from] exr::error::Error),
    /// Not writable as PNG.
    #[error("cannot write PNG: {0}")]
    Png(#[from] image::ImageError),
    /// An image that is not the stack of a picture and its layers.
    #[error(transparent)]
    Layers(#[from] LayerError),
    /// Metadata of this project that does not parse.
    #[error("the picture's metadata: {0}")]
    Metadata(#[from] serde_json::Error),
}

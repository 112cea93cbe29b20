//! What images are decoded into.

use crate::spectrum::Spectrum;

/// Pixels in linear colour, row by row from the top left. All are finite and none is negative.
#[derive(Debug)]
pub(crate) struct LinearImage {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) texels: Vec<Spectrum>,
}

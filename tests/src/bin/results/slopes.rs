//! Fitted slopes of variance and bias.

use crate::Options;
use anyhow::Result;

/// Writes the slopes to the folder `options.out`.
pub(crate) fn run(_options: &Options) -> Result<()> {
    Ok(())
}

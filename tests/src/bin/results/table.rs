//! The singularity table.

use crate::Options;
use anyhow::Result;

/// Writes the table to the folder `options.out`.
pub(crate) fn run(_options: &Options) -> Result<()> {
    Ok(())
}

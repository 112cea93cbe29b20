//! Pictures and plots of example scenes.

use crate::Options;
use anyhow::Result;

/// Writes the figures to the folder `options.out`.
pub(crate) fn run(_options: &Options) -> Result<()> {
    Ok(())
}

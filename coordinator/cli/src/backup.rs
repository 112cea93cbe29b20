//! `photonfarm backup`: saves a farm while it runs.

use crate::args::BackupArgs;
use crate::say;
use anyhow::{Context, Result};
use photonfarm_coordinator::Config;
use photonfarm_coordinator::store::back_up;

/// Runs the command.
pub(crate) fn run(args: BackupArgs) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(async {
        let config = Config::new(args.data.unwrap_or_default());
        let (state, blobs) = (args.state.unwrap_or(config.state), args.blobs.unwrap_or(config.blobs));
        let backup = back_up(&state, &blobs, &args.to)
            .await
            .with_context(|| format!("cannot save {state} and {blobs} to {}", args.to.display()))?;
        say::tell(format_args!(
            "{}: {} files of scenes, {} images",
            args.to.display(),
            backup.files,
            backup.images
        ));
        if !backup.missing.is_empty() {
            say::tell(format_args!(
                "{} images are missing or damaged in the farm itself: their iterations are rendered again after a restore",
                backup.missing.len()
            ));
        }
        Ok(())
    })
}

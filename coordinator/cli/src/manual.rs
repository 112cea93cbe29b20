//! What the system knows of the program: completions for shells, and manual pages.

use crate::args::Cli;
use crate::say;
use anyhow::{Context, Result};
use clap::CommandFactory;
use clap_complete::Shell;
use std::path::Path;

/// Prints the completions for a shell.
pub(crate) fn completions(shell: Shell) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "photonfarm", &mut script);
    say::line(String::from_utf8(script)?.trim_end())
}

/// Writes a manual page for each command.
pub(crate) fn pages(folder: &Path) -> Result<()> {
    let written = std::fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(Cli::command(), folder));
    written.with_context(|| format!("cannot write manual pages to {}", folder.display()))?;
    say::tell(format_args!(
        "manual pages are in {}; `man -l {}` shows the first",
        folder.display(),
        folder.join("photonfarm.1").display()
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_a_page_for_every_command() {
        let folder = tempfile::tempdir().unwrap();
        let pages_at = folder.path().join("man1");
        pages(&pages_at).unwrap();
        let page = |name: &str| std::fs::read_to_string(pages_at.join(name)).unwrap();
        assert!(page("photonfarm.1").contains("photonfarm\\-render"));
        for command in Cli::command().get_subcommands() {
            let text = page(&format!("photonfarm-{}.1", command.get_name()));
            assert!(text.contains(".SH SYNOPSIS"), "{text}");
        }
    }
}

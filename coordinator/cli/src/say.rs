//! What is said to the user: results on standard output, everything else on standard error. Either's reader may leave
//! early, as `head` does; a program that panics then would be one that fails at nothing.

use anyhow::Result;
use serde::Serialize;
use std::fmt::Display;
use std::io::{ErrorKind, Write};

/// Whoever read standard output has left. There is nobody to tell, and nothing has gone wrong.
#[derive(Debug, thiserror::Error)]
#[error("standard output was closed")]
pub(crate) struct ReaderLeft;

/// Writes a line to standard output.
///
/// # Errors
/// [`ReaderLeft`]; whatever else keeps a line from being written, as a full disk.
pub(crate) fn line(text: impl Display) -> Result<()> {
    let mut output = std::io::stdout().lock();
    match writeln!(output, "{text}").and_then(|()| output.flush()) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Err(ReaderLeft.into()),
        Err(error) => Err(anyhow::Error::new(error).context("cannot write to standard output")),
    }
}

/// Writes a value as JSON to standard output; errors as those of [`line()`].
pub(crate) fn json(value: &impl Serialize) -> Result<()> {
    line(serde_json::to_string_pretty(value)?)
}

/// An error with its causes, but for those that the text before them contains already.
pub(crate) fn causes(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |text, cause| {
        let cause = cause.to_string();
        match text.is_empty() {
            true => cause,
            false if text.contains(&cause) => text,
            false => format!("{text}: {cause}"),
        }
    })
}

/// Says that a list is empty.
///
/// # Errors
/// None.
pub(crate) fn none(what: &str) -> Result<()> {
    tell(format_args!("no {what}"));
    Ok(())
}

/// Writes a line to standard error, if anybody reads it.
pub(crate) fn tell(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_is_said_once() {
        let error = anyhow::anyhow!("b").context("a: b").context("c");
        assert_eq!(causes(&error), "c: a: b");
    }
}

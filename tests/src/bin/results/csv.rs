//! Comma-separated values.

use anyhow::{Context, Result};
use std::path::Path;

/// Writes `header` and `rows` to `path`, a line each.
///
/// # Panics
/// If a row has another number of cells than the header, or a cell holds a comma, a quote or a line break.
pub(crate) fn write(path: &Path, header: &[&str], rows: &[Vec<String>]) -> Result<()> {
    let mut text = header.join(",") + "\n";
    for row in rows {
        assert_eq!(row.len(), header.len(), "{row:?}");
        assert!(!row.iter().any(|cell| cell.contains([',', '"', '\n'])), "{row:?}");
        text += &(row.join(",") + "\n");
    }
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// A number as a cell: six significant digits.
pub(crate) fn number(value: f64) -> String {
    if value == 0.0 || (1e-3..1e6).contains(&value.abs()) {
        let digits = if value == 0.0 {
            0
        } else {
            value.abs().log10().floor() as i32
        };
        format!("{value:.*}", (5 - digits).max(0) as usize)
    } else {
        format!("{value:.5e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_six_digits() {
        let cells = [0.0, 1.0, -12.345_678_9, 0.001_234_567_8, 1.234_567_8e-7, 4e9].map(number);
        assert_eq!(
            cells,
            [
                "0.00000",
                "1.00000",
                "-12.3457",
                "0.00123457",
                "1.23457e-7",
                "4.00000e9"
            ]
        );
    }
}

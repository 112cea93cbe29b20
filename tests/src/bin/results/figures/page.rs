//! A page of Markdown.

use anyhow::{Context, Result};
use std::path::Path;

/// A page that is being written.
#[derive(Debug, Default)]
pub(super) struct Page {
    text: String,
}

/// A picture beside the page, with what is written above it.
pub(super) struct Picture {
    pub(super) caption: String,
    /// Its file name.
    pub(super) file: String,
}

impl Page {
    pub(super) fn heading(&mut self, level: usize, title: &str) {
        self.paragraph(&format!("{} {title}", "#".repeat(level)));
    }

    pub(super) fn paragraph(&mut self, text: &str) {
        if !self.text.is_empty() {
            self.text.push('\n');
        }
        self.text += text;
        self.text.push('\n');
    }

    /// Pictures side by side.
    pub(super) fn pictures(&mut self, pictures: &[Picture]) {
        let captions: Vec<&str> = pictures.iter().map(|p| p.caption.as_str()).collect();
        let images = pictures
            .iter()
            .map(|p| format!("![{}]({})", p.caption, p.file))
            .collect();
        self.table(&captions, &[images]);
    }

    /// A table; every row has a cell for each column of `header`.
    pub(super) fn table(&mut self, header: &[&str], rows: &[Vec<String>]) {
        let mut lines = vec![line(header), line(&vec!["---"; header.len()])];
        lines.extend(rows.iter().map(|row| {
            assert_eq!(row.len(), header.len(), "{row:?}");
            line(row)
        }));
        self.paragraph(&lines.join("\n"));
    }

    pub(super) fn write(&self, path: &Path) -> Result<()> {
        std::fs::write(path, &self.text).with_context(|| format!("cannot write {}", path.display()))
    }
}

fn line<T: AsRef<str>>(cells: &[T]) -> String {
    let cells: Vec<&str> = cells.iter().map(AsRef::as_ref).collect();
    format!("| {} |", cells.join(" | "))
}

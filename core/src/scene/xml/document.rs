//! One XML file: its text, and the lines of its nodes.

use super::super::error::{Place, SceneError, within};
use super::super::limits::Limits;
use super::super::loader::LoadedFile;
use super::super::text;
use roxmltree::{Node, ParsingOptions};
use std::sync::Arc;

/// A file's text with the starts of its lines.
pub(super) struct Document {
    file: Arc<str>,
    text: String,
    line_starts: Vec<usize>,
}

impl Document {
    pub(super) fn new(file: &LoadedFile) -> Result<Self, SceneError> {
        let name: Arc<str> = file.name.as_str().into();
        let text = text::xml(&file.bytes).map_err(|(line, reason)| SceneError::Xml {
            place: Place {
                file: name.clone(),
                line,
            },
            reason,
        })?;
        let line_starts = text
            .bytes()
            .enumerate()
            .filter(|(_, byte)| *byte == b'\n')
            .map(|(i, _)| i + 1)
            .collect();
        Ok(Self {
            file: name,
            text,
            line_starts,
        })
    }

    pub(super) fn parse(&self, limits: &Limits) -> Result<roxmltree::Document<'_>, SceneError> {
        self.check_tags(limits.attributes)?;
        let nodes_limit = limits.xml_nodes;
        let options = ParsingOptions {
            allow_dtd: false,
            nodes_limit,
            ..ParsingOptions::default()
        };
        roxmltree::Document::parse_with_options(&self.text, options).map_err(|error| match error {
            roxmltree::Error::NodesLimitReached => SceneError::Limit {
                place: Place::whole(&self.file),
                what: "number of XML nodes".into(),
                value: u64::from(nodes_limit) + 1,
                limit: u64::from(nodes_limit),
            },
            _ => SceneError::Xml {
                place: Place {
                    file: self.file.clone(),
                    line: error.pos().row,
                },
                reason: shortened_reason(&error.to_string()),
            },
        })
    }

    /// Bounds the attributes of each tag and refuses namespaces, before the parser does work that grows with the
    /// square of their number.
    fn check_tags(&self, most: u64) -> Result<(), SceneError> {
        let text = self.text.as_bytes();
        let mut at = 0;
        while let Some(start) = text[at..].iter().position(|byte| *byte == b'<').map(|found| at + found) {
            let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")]
                .into_iter()
                .find(|(open, _)| text[start..].starts_with(open.as_bytes()));
            if let Some((open, close)) = skipped {
                let after = start + open.len();
                at = self.text[after..]
                    .find(close)
                    .map_or(text.len(), |found| after + found + close.len());
                continue;
            }
            let (mut quote, mut attributes, mut end) = (None, 0, start + 1);
            while let Some(byte) = text.get(end) {
                match (quote, byte) {
                    (None, b'>') => break,
                    (None, b'"' | b'\'') => {
                        quote = Some(byte);
                        attributes += 1;
                        within(&self.place_at(start), "attributes of one element", attributes, most)?;
                    }
                    (None, b'x') if text[end..].starts_with(b"xmlns") && text[end - 1].is_ascii_whitespace() => {
                        let reason = "the format has no namespaces".to_owned();
                        return Err(SceneError::Xml {
                            place: self.place_at(start),
                            reason,
                        });
                    }
                    (Some(open), _) if open == byte => quote = None,
                    _ => {}
                }
                end += 1;
            }
            at = end;
        }
        Ok(())
    }

    pub(super) fn place(&self, node: Node) -> Place {
        self.place_at(node.range().start)
    }

    fn place_at(&self, offset: usize) -> Place {
        let line = self.line_starts.partition_point(|start| *start <= offset) as u32 + 1;
        Place {
            file: self.file.clone(),
            line,
        }
    }

    /// Text that is not white space, with its place. The format has none.
    pub(super) fn text<'a>(&self, node: Node<'a, '_>) -> Option<(Place, &'a str)> {
        let text = node.text().filter(|text| node.is_text() && !text.trim().is_empty())?;
        let blank = text.len() - text.trim_start().len();
        Some((self.place_at(node.range().start + blank), text.trim()))
    }
}

/// The parser quotes the input in some messages; keep them to a line.
fn shortened_reason(reason: &str) -> String {
    let end = reason.char_indices().nth(200).map_or(reason.len(), |(end, _)| end);
    reason[..end].replace(char::is_control, " ")
}

//! Splits a pbrt file into tokens.
//!
//! A token is a word (a directive, or `true`), a number, a text in quotes, or a bracket; `#` starts a comment that ends with the
//! line. Commas between numbers, which pbrt does not see, separate as spaces do. Lists of numbers, which make up nearly all of a large file, are read in one go.

use crate::scene::error::{Place, SceneError, shortened};
use crate::scene::number::{leading_digits, leading_f64};
use bytes::Bytes;
use std::sync::Arc;

/// A token that is not a number.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Token {
    /// A directive, a keyword, or a number as it is written.
    Word(String),
    /// A text in quotes, without them.
    Text(String),
    /// `[`.
    Open,
    /// `]`.
    Close,
}

/// The tokens of a file, in order.
pub(super) struct Tokens {
    bytes: Bytes,
    at: usize,
    line: u32,
    file: Arc<str>,
}

/// What ends a word.
#[inline(always)]
fn ends_word(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b'\n' | b'\r' | b',' | b'"' | b'[' | b']' | b'#')
}

impl Tokens {
    pub(super) fn new(file: &str, bytes: Bytes) -> Self {
        let at = bytes.len() - crate::scene::text::without_mark(&bytes).len();
        Self {
            bytes,
            at,
            line: 1,
            file: file.into(),
        }
    }

    /// Where the next token stands, or the last one did.
    pub(super) fn place(&self) -> Place {
        Place {
            file: self.file.clone(),
            line: self.line,
        }
    }

    /// An error in the form of the file.
    pub(super) fn broken(&self, reason: impl Into<String>) -> SceneError {
        SceneError::data(&self.place(), reason)
    }

    /// Skips white space and comments, and returns the first byte after them.
    #[inline]
    pub(super) fn peek(&mut self) -> Option<u8> {
        while let Some(byte) = self.bytes.get(self.at) {
            match byte {
                b'\n' => self.line = self.line.saturating_add(1),
                b'\r' if self.bytes.get(self.at + 1) != Some(&b'\n') => self.line = self.line.saturating_add(1),
                b' ' | b'\t' | b'\r' | b',' => {}
                b'#' => {
                    let rest = &self.bytes[self.at..];
                    let end = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
                    self.at += end.unwrap_or(rest.len());
                    continue;
                }
                other => return Some(*other),
            }
            self.at += 1;
        }
        None
    }

    /// The next token; `None` at the end of the file.
    pub(super) fn next(&mut self) -> Result<Option<Token>, SceneError> {
        let Some(first) = self.peek() else { return Ok(None) };
        Ok(Some(match first {
            b'[' | b']' => {
                self.at += 1;
                if first == b'[' { Token::Open } else { Token::Close }
            }
            b'"' => Token::Text(self.text()?),
            _ => {
                let rest = &self.bytes[self.at..];
                let end = rest.iter().position(|byte| ends_word(*byte)).unwrap_or(rest.len());
                let word = String::from_utf8_lossy(&rest[..end]).into_owned();
                self.at += end;
                Token::Word(word)
            }
        }))
    }

    /// The text in quotes that starts here.
    fn text(&mut self) -> Result<String, SceneError> {
        let mut content = Vec::new();
        let mut at = self.at + 1;
        loop {
            match self.bytes.get(at) {
                None => return Err(self.broken("a text in quotes never ends")),
                Some(b'\n' | b'\r') => return Err(self.broken("a text in quotes ends with its line")),
                Some(b'"') => break,
                Some(b'\\') => {
                    at += 1;
                    content.push(match self.bytes.get(at) {
                        Some(b'b') => 8,
                        Some(b'f') => 12,
                        Some(b'n') => b'\n',
                        Some(b'r') => b'\r',
                        Some(b't') => b'\t',
                        Some(byte @ (b'\\' | b'\'' | b'"')) => *byte,
                        _ => return Err(self.broken("after \\ there is one of b, f, n, r, t, \\, ' and \"")),
                    });
                }
                Some(byte) => content.push(*byte),
            }
            at += 1;
        }
        self.at = at + 1;
        Ok(match String::from_utf8(content) {
            Ok(text) => text,
            Err(error) => String::from_utf8_lossy(error.as_bytes()).into_owned(),
        })
    }

    /// The text in quotes that must come here.
    pub(super) fn required_text(&mut self, what: &str) -> Result<String, SceneError> {
        match self.peek() {
            Some(b'"') => self.text(),
            _ => Err(self.broken(format!("{what} is missing: a text in quotes"))),
        }
    }

    /// The number that must come here.
    pub(super) fn required_number(&mut self) -> Result<f64, SceneError> {
        self.peek();
        self.number()
    }

    /// The number that starts here.
    #[inline(always)]
    fn number(&mut self) -> Result<f64, SceneError> {
        let rest = &self.bytes[self.at..];
        let ends = |length: usize| rest.get(length).is_none_or(|byte| ends_word(*byte));
        // Most of the numbers of large meshes.
        if let Some((digits, length)) = leading_digits(rest).filter(|(_, length)| ends(*length)) {
            self.at += length;
            return Ok(f64::from(digits));
        }
        let found = leading_f64(rest).filter(|(_, length)| ends(*length));
        match found {
            Some((value, length)) if (value as f32).is_finite() => {
                self.at += length;
                Ok(value)
            }
            found => {
                let end = rest.iter().position(|byte| ends_word(*byte)).unwrap_or(rest.len());
                let word = shortened(&String::from_utf8_lossy(&rest[..end]));
                Err(self.broken(match found {
                    Some(_) => format!("`{word}` is not a finite number within the range of single precision"),
                    None if word.is_empty() => "a number is missing".to_owned(),
                    None => format!("`{word}` is not a number"),
                }))
            }
        }
    }

    /// Gives each number up to the closing bracket to `add`. The opening bracket has been read.
    pub(super) fn numbers(&mut self, mut add: impl FnMut(f64)) -> Result<(), SceneError> {
        loop {
            match self.peek() {
                Some(b']') => {
                    self.at += 1;
                    return Ok(());
                }
                Some(_) => add(self.number()?),
                None => return Err(self.broken("a list never ends: `]` is missing")),
            }
        }
    }

    /// About how many numbers the list has whose opening bracket has been read: words in comments count as well.
    pub(super) fn count(&self) -> usize {
        let rest = &self.bytes[self.at..];
        let list = &rest[..memchr::memchr(b']', rest).unwrap_or(rest.len())];
        let is_blank = |byte: u8| byte <= b' ' || byte == b',';
        let begins = |(before, byte): (&u8, &u8)| u8::from(is_blank(*before) && !is_blank(*byte));
        let [first, rest @ ..] = list else { return 0 };
        // A byte holds how many words begin among so few pairs, and many bytes are added at once.
        let few = usize::from(u8::MAX);
        let pairs = list.chunks(few).zip(rest.chunks(few));
        let counts = pairs.map(|(before, bytes)| usize::from(before.iter().zip(bytes).map(begins).sum::<u8>()));
        usize::from(!is_blank(*first)) + counts.sum::<usize>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokens(text: &str) -> Tokens {
        Tokens::new("a.pbrt", text.to_owned().into())
    }

    #[test]
    fn words_texts_and_brackets_with_their_lines() {
        let mut file = tokens("\u{feff}Shape# a comment \"]\n\r\"a \\\"b\\\\\"[\r\n-1.5]x\n");
        let mut found = Vec::new();
        while let Some(token) = file.next().unwrap() {
            found.push((token, file.place().line));
        }
        let word = |text: &str| Token::Word(text.to_owned());
        let expected = [
            (word("Shape"), 1),
            (Token::Text("a \"b\\".to_owned()), 3),
            (Token::Open, 3),
            (word("-1.5"), 4),
            (Token::Close, 4),
            (word("x"), 4),
        ];
        assert_eq!(found, expected);
        for (text, reason) in [
            ("\n\"a", "never ends"),
            ("\n\"a\nb\"", "its line"),
            ("\n\"\\x\"", "after \\"),
        ] {
            let error = tokens(text).next().unwrap_err();
            assert!(error.line() == Some(2) && error.to_string().contains(reason), "{error}");
        }
    }

    #[test]
    fn lists_of_numbers_end_with_their_bracket() {
        let mut file = tokens("1, 2\n# 3 ]\n 4.5]");
        assert_eq!(file.count(), 4);
        let mut found = Vec::new();
        file.numbers(|value| found.push(value)).unwrap();
        assert_eq!(found, [1.0, 2.0, 4.5]);
        assert_eq!(file.next().unwrap(), None);
        for (text, reason) in [
            ("1 2", "never ends"),
            ("1 a]", "`a` is not a number"),
            ("1e39]", "single precision"),
        ] {
            let error = tokens(text).numbers(|_| ()).unwrap_err();
            assert!(error.to_string().contains(reason), "{error}");
        }
    }
}

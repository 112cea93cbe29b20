//! Text files as other programs write them: byte order marks, other encodings, and any kind of line end.

use std::borrow::Cow;

const UTF8_MARK: &[u8] = &[0xef, 0xbb, 0xbf];

/// The bytes without a byte order mark of UTF-8.
pub(super) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(UTF8_MARK).unwrap_or(bytes)
}

/// The lines with their numbers, counted from 1. A line ends with LF, CR LF or a lone CR.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (u32, &[u8])> {
    let (mut rest, mut number) = (Some(without_mark(bytes)), 0);
    std::iter::from_fn(move || {
        let text = rest?;
        number += 1;
        let end = memchr::memchr2(b'\n', b'\r', text);
        let (line, after) = match end {
            Some(end) if text[end..].starts_with(b"\r\n") => (&text[..end], Some(&text[end + 2..])),
            Some(end) => (&text[..end], Some(&text[end + 1..])),
            None => (text, None),
        };
        rest = after;
        Some((number, line))
    })
}

/// An XML file as UTF-8: decoded by its byte order mark, or by the encoding that its first line declares.
///
/// Lone CRs become LFs, as XML has it. Comments and the declaration become blanks: comments of other programs hold
/// `--`, which XML forbids, and Latin-1. No line moves. The error comes with its line.
pub(super) fn xml(bytes: &[u8]) -> Result<String, (u32, String)> {
    let mut bytes: Cow<[u8]> = match bytes {
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes)?.into_bytes().into(),
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes)?.into_bytes().into(),
        _ => without_mark(bytes).into(),
    };
    let encoding = match bytes.trim_ascii_start().starts_with(b"<?xml") {
        true => declared_encoding(&bytes)?,
        false => Encoding::Utf8,
    };
    if bytes.contains(&b'\r') || contains(&bytes, b"<!--") || bytes.trim_ascii_start().starts_with(b"<?xml") {
        make_plain(bytes.to_mut());
    }
    match encoding {
        Encoding::Latin1 if !bytes.is_ascii() => Ok(bytes.iter().map(|byte| char::from(*byte)).collect()),
        _ => String::from_utf8(bytes.into_owned()).map_err(|error| {
            let valid = error.utf8_error().valid_up_to();
            let line = 1 + error.as_bytes()[..valid].iter().filter(|byte| **byte == b'\n').count();
            let reason = "the text is not UTF-8; a file in Latin-1 begins with \
                          <?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>";
            (line as u32, reason.to_owned())
        }),
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Utf8,
    Latin1,
}

/// What the XML declaration says. A text in UTF-16 has been decoded already.
fn declared_encoding(bytes: &[u8]) -> Result<Encoding, (u32, String)> {
    let end = bytes.windows(2).position(|pair| pair == b"?>").unwrap_or(bytes.len());
    let declaration = String::from_utf8_lossy(&bytes[..end]);
    let Some((_, after)) = declaration.split_once("encoding") else {
        return Ok(Encoding::Utf8);
    };
    let name = after.trim_start().strip_prefix('=').unwrap_or(after).trim_start();
    let name: String = name
        .trim_start_matches(['"', '\''])
        .chars()
        .take_while(|c| !matches!(c, '"' | '\''))
        .take(40)
        .collect();
    match name.to_ascii_lowercase().as_str() {
        "utf-8" | "utf8" | "us-ascii" | "ascii" | "utf-16" => Ok(Encoding::Utf8),
        "iso-8859-1" | "latin1" | "latin-1" => Ok(Encoding::Latin1),
        _ => {
            let line = 1 + bytes[..end].iter().filter(|byte| **byte == b'\n').count();
            let reason = format!("the encoding `{name}` is not read; allowed: UTF-8, UTF-16, ISO-8859-1, US-ASCII");
            Err((line as u32, reason))
        }
    }
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> Result<String, (u32, String)> {
    let pairs = bytes.chunks_exact(2);
    let complete = pairs.remainder().is_empty();
    let text: Result<String, _> = char::decode_utf16(pairs.map(|pair| unit([pair[0], pair[1]]))).collect();
    text.ok().filter(|_| complete).ok_or_else(|| {
        (
            0,
            "the text is not the UTF-16 that its byte order mark announces".to_owned(),
        )
    })
}

fn contains(bytes: &[u8], part: &[u8]) -> bool {
    bytes.windows(part.len()).any(|window| window == part)
}

/// Turns lone CRs into LFs, and the XML declaration and comments into blanks. Their line ends stay.
fn make_plain(bytes: &mut [u8]) {
    for at in 0..bytes.len() {
        if bytes[at] == b'\r' && bytes.get(at + 1) != Some(&b'\n') {
            bytes[at] = b'\n';
        }
    }
    let start = bytes.len() - bytes.trim_ascii_start().len();
    if bytes[start..].starts_with(b"<?xml") {
        blank(bytes, start, b"?>");
    }
    let mut at = 0;
    while let Some(start) = bytes[at..]
        .iter()
        .position(|byte| *byte == b'<')
        .map(|found| at + found)
    {
        at = match &bytes[start..] {
            rest if rest.starts_with(b"<!--") => blank(bytes, start, b"-->"),
            rest if rest.starts_with(b"<![CDATA[") => end_of(rest, b"]]>").map_or(bytes.len(), |end| start + end),
            rest => start + end_of_tag(rest),
        };
    }
}

/// Blanks what starts at `start`, to the end of the first `close` after it, and returns where that is. What never
/// closes is left to the parser, which says so.
fn blank(bytes: &mut [u8], start: usize, close: &[u8]) -> usize {
    // `<!-->` does not close itself.
    let opened = start + 4;
    let Some(end) = bytes.get(opened..).and_then(|rest| end_of(rest, close)) else {
        return bytes.len();
    };
    for byte in &mut bytes[start..opened + end] {
        if !matches!(byte, b'\n' | b'\r') {
            *byte = b' ';
        }
    }
    opened + end
}

/// Where `close` ends in `bytes`.
fn end_of(bytes: &[u8], close: &[u8]) -> Option<usize> {
    let found = bytes.windows(close.len()).position(|window| window == close);
    found.map(|found| found + close.len())
}

/// Length of a tag; `>` within quotes does not end it.
fn end_of_tag(bytes: &[u8]) -> usize {
    let mut quote = None;
    for (at, byte) in bytes.iter().enumerate() {
        match (quote, byte) {
            (None, b'>') => return at + 1,
            (None, b'"' | b'\'') => quote = Some(*byte),
            (Some(open), _) if open == *byte => quote = None,
            _ => {}
        }
    }
    bytes.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_in_three_ways() {
        let text = b"\xef\xbb\xbfa\nb\r\n\rc\r\r\nd";
        let found: Vec<(u32, &[u8])> = lines(text).collect();
        let expected: [(u32, &[u8]); 6] = [(1, b"a"), (2, b"b"), (3, b""), (4, b"c"), (5, b""), (6, b"d")];
        assert_eq!(found, expected);
        assert_eq!(lines(b"").count(), 1);
    }

    #[test]
    fn comments_become_blanks_and_no_line_moves() {
        let text =
            "<?xml version='1.0'?>\r<a b='<!-- no -->'>\r\n<!-- x -- y\n\u{e9} --> <![CDATA[<!--k-->]]></a><!--->-->";
        let plain = xml(text.as_bytes()).unwrap();
        let expected = format!(
            "{}\n<a b='<!-- no -->'>\r\n{}\n{} <![CDATA[<!--k-->]]></a>{}",
            " ".repeat(21),
            " ".repeat(11),
            " ".repeat(6),
            " ".repeat(9)
        );
        assert_eq!(plain, expected);
        assert_eq!(xml(b"<a/><!-- open").unwrap(), "<a/><!-- open");
    }

    #[test]
    fn encodings_are_those_of_the_mark_or_the_declaration() {
        let text = "<a b=\"\u{e9}\"/>";
        assert_eq!(xml(format!("\u{feff}{text}").as_bytes()).unwrap(), text);
        for (mark, bytes) in [
            ([0xff, 0xfe], u16::to_le_bytes as fn(u16) -> [u8; 2]),
            ([0xfe, 0xff], u16::to_be_bytes),
        ] {
            let encoded: Vec<u8> = mark.into_iter().chain(text.encode_utf16().flat_map(bytes)).collect();
            assert_eq!(xml(&encoded).unwrap(), text);
            assert!(xml(&encoded[..encoded.len() - 1]).is_err());
        }
        let declared = |name: &str| {
            [
                format!("<?xml version=\"1.0\" encoding=\"{name}\"?>").as_bytes(),
                b"<a b=\"\xe9\"/>",
            ]
            .concat()
        };
        assert_eq!(xml(&declared("iso-8859-1")).unwrap().trim_start(), text);
        assert_eq!(xml(&declared("UTF-8")).unwrap_err().0, 1);
        let (line, reason) = xml(&declared("EBCDIC")).unwrap_err();
        assert!(
            line == 1 && reason.contains("`EBCDIC`") && reason.contains("ISO-8859-1"),
            "{reason}"
        );
        // Latin-1 in a comment harms nobody, whatever was declared.
        assert!(xml(b"<a><!-- \xe9 --></a>").is_ok());
    }
}

//! Parts of pictures, as clients ask for them with the conditions and ranges of HTTP (RFC 9110, sections 13 and 14).

use std::ops::Range;

/// What a client wants of a picture: headers of its request.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wanted<'a> {
    /// `If-None-Match`: tags of what it has.
    pub known: Option<&'a str>,
    /// `Range`: the bytes that it wants.
    pub range: Option<&'a str>,
    /// `If-Range`: the tag of the picture that the range is of.
    pub if_range: Option<&'a str>,
}

/// A part of a file, or all of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Section {
    /// Which bytes.
    pub bytes: Range<u64>,
    /// How many the file has.
    pub of: u64,
    /// Whether it was asked for as a part, even if it is the whole file.
    pub partial: bool,
}

impl Wanted<'_> {
    /// Whether the client has the picture with this tag.
    pub(super) fn is_known(&self, etag: &str) -> bool {
        let mut tags = self.known.unwrap_or_default().split(',').map(str::trim);
        tags.any(|tag| tag == "*" || tag.trim_start_matches("W/") == etag)
    }

    /// The part that is wanted of a picture with this tag and so many bytes. A range that is not understood, of several parts, or of
    /// another picture than this, asks for all of it. The error is the length, if none of its bytes are wanted.
    pub(super) fn section(&self, etag: &str, of: u64) -> Result<Section, u64> {
        let whole = Section {
            bytes: 0..of,
            of,
            partial: false,
        };
        if self.if_range.is_some_and(|tag| tag.trim() != etag) {
            return Ok(whole);
        }
        let Some((first, last)) = self.range.and_then(read_range) else {
            return Ok(whole);
        };
        let bytes = match (first, last) {
            (Some(first), last) => first..last.map_or(of, |last| last.saturating_add(1).min(of)),
            (None, last) => of.saturating_sub(last.unwrap_or_default())..of,
        };
        let partial = true;
        match bytes.is_empty() {
            true => Err(of),
            false => Ok(Section { bytes, of, partial }),
        }
    }
}

/// First and last byte of `bytes=FIRST-LAST`, either of which may be left out: without the last it goes to the end, and without the
/// first it is so many bytes before the end.
fn read_range(header: &str) -> Option<(Option<u64>, Option<u64>)> {
    let (unit, range) = header.split_once('=')?;
    let (first, last) = range.split_once('-')?;
    let number = |text: &str| match text.trim() {
        "" => Some(None),
        digits if digits.bytes().all(|byte| byte.is_ascii_digit()) => Some(Some(digits.parse().unwrap_or(u64::MAX))),
        _ => None,
    };
    let range = (number(first)?, number(last)?);
    let sound = match range {
        (Some(first), Some(last)) => first <= last,
        (first, last) => first.is_some() || last.is_some(),
    };
    (sound && unit.trim().eq_ignore_ascii_case("bytes")).then_some(range)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TAG: &str = "\"a\"";

    fn of_ten(range: &str, if_range: Option<&str>) -> Result<(Range<u64>, bool), u64> {
        let wanted = Wanted {
            known: None,
            range: Some(range),
            if_range,
        };
        wanted.section(TAG, 10).map(|section| (section.bytes, section.partial))
    }

    #[test]
    fn tags_are_compared_as_http_says() {
        let knows = |known| {
            let known = Some(known);
            Wanted {
                known,
                ..Wanted::default()
            }
            .is_known(TAG)
        };
        assert!(knows("\"a\"") && knows("W/\"b\", W/\"a\"") && knows("*"));
        assert!(!knows("\"b\"") && !Wanted::default().is_known(TAG));
    }

    #[test]
    fn ranges_are_parts_of_what_is_there() {
        for (range, bytes) in [
            ("bytes=0-", 0..10),
            ("bytes=3-", 3..10),
            ("BYTES = 3 - 5", 3..6),
            ("bytes=9-99999999999999999999999", 9..10),
            ("bytes=-4", 6..10),
            ("bytes=-40", 0..10),
        ] {
            assert_eq!(of_ten(range, None), Ok((bytes, true)), "{range}");
        }
        for range in ["bytes=10-", "bytes=10-20", "bytes=99999999999999999999999-", "bytes=-0"] {
            assert_eq!(of_ten(range, None), Err(10), "{range}");
        }
        for range in [
            "",
            "bytes",
            "bytes=",
            "bytes=-",
            "bytes=5-3",
            "bytes=0-1,4-5",
            "bytes=+1-",
            "lines=0-3",
            "bytes=a-b",
        ] {
            assert_eq!(of_ten(range, None), Ok((0..10, false)), "{range}");
        }
        assert_eq!(Wanted::default().section(TAG, 10).unwrap().bytes, 0..10);
        assert_eq!(of_ten("bytes=0-", Some(TAG)), Ok((0..10, true)));
    }

    #[test]
    fn a_range_of_another_picture_asks_for_all_of_this_one() {
        assert_eq!(of_ten("bytes=3-", Some(TAG)), Ok((3..10, true)));
        for tag in ["\"b\"", "W/\"a\"", "Sat, 28 Nov 2026 23:50:22 GMT", ""] {
            assert_eq!(of_ten("bytes=3-", Some(tag)), Ok((0..10, false)), "{tag}");
            assert_eq!(of_ten("bytes=30-", Some(tag)), Ok((0..10, false)), "{tag}");
        }
    }
}

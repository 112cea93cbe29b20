//! Frames of an animated scene, as `submit --frames` names them.

use std::path::{Path, PathBuf};

/// Most frames of one submission.
const MOST: usize = 10_000;

/// Reads a list such as `1..24`, `1-24` or `1,5,9..12`; both ends belong to a range.
pub(crate) fn frames(text: &str) -> Result<Frames, String> {
    let wrong = || "expected frames such as 1..24, 1-24 or 1,5,9..12".to_owned();
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
    let mut frames = Vec::new();
    for part in text.split(',') {
        let ends = part.split_once("..").or_else(|| part.split_once('-'));
        let (first, last) = match ends {
            Some((first, last)) => (number(first)?, number(last.trim_start_matches('='))?),
            None => (number(part)?, number(part)?),
        };
        if first > last {
            return Err(format!("{part}: the first frame comes after the last"));
        }
        if (last - first) as usize >= MOST - frames.len() {
            return Err(format!("more than {MOST} frames"));
        }
        frames.extend(first..=last);
    }
    Ok(Frames(frames))
}

/// Frames in the order in which they were named.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Frames(pub(crate) Vec<u32>);

/// Where the picture of a frame goes: `out.exr` becomes `out.0007.exr`.
pub(crate) fn picture_of(frame: u32, output: &Path) -> PathBuf {
    let end = output.extension().unwrap_or_default().to_string_lossy();
    output.with_extension(format!("{frame:04}.{end}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_read_with_both_ends() {
        let read = |text| frames(text).map(|frames| frames.0);
        assert_eq!(read("1..3"), Ok(vec![1, 2, 3]));
        assert_eq!(read("1-3"), Ok(vec![1, 2, 3]));
        assert_eq!(read("7"), Ok(vec![7]));
        assert_eq!(read("1, 5,9..=11"), Ok(vec![1, 5, 9, 10, 11]));
        for bad in ["", "a", "3..1", "1..", "-1", "1..4294967295", "0..10000"] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn pictures_are_numbered() {
        assert_eq!(picture_of(7, Path::new("a/out.exr")), Path::new("a/out.0007.exr"));
    }
}

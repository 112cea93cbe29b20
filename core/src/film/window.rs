//! Windows of pictures.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// A window of a picture: the pixels that are rendered. Text has it as `X,Y,WxH`, such as `100,50,320x200`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// Columns of the picture to the left of it.
    pub x: u32,
    /// Rows of the picture above it.
    pub y: u32,
    /// Pixels across, at least 1.
    pub width: u32,
    /// Pixels down, at least 1.
    pub height: u32,
}

/// Why a window is none.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum WindowError {
    /// Not written as one.
    #[error("expected X,Y,WxH: columns to the left, rows above, pixels across and down, such as 100,50,320x200")]
    Form,
    /// Without pixels.
    #[error("a window of {0} x {1} pixels holds none")]
    Empty(u32, u32),
    /// The integrator renders whole pictures.
    #[error(
        "{0} renders no windows: how far an iteration looks for photons depends on those that all pixels of the one before it found"
    )]
    Sequential(&'static str),
    /// Not within the picture.
    #[error("the window {window} is not within the picture, which has {} x {} pixels", picture[0], picture[1])]
    Beyond {
        /// The window.
        window: Window,
        /// Pixels across and down.
        picture: [u32; 2],
    },
}

impl Window {
    /// Pixels across and down.
    #[must_use]
    pub fn size(self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Checks that there are pixels in it.
    ///
    /// # Errors
    /// A side of zero pixels.
    pub fn check(self) -> Result<Self, WindowError> {
        match self.width > 0 && self.height > 0 {
            true => Ok(self),
            false => Err(WindowError::Empty(self.width, self.height)),
        }
    }

    /// The window of a picture of this size; `None` where it is all of it.
    ///
    /// # Errors
    /// A window without pixels, or with some that the picture has not.
    pub fn of(self, picture: [u32; 2]) -> Result<Option<Self>, WindowError> {
        let window = self.check()?;
        let ends = [(self.x, self.width, picture[0]), (self.y, self.height, picture[1])];
        let within =
            |(first, length, whole): (u32, u32, u32)| first.checked_add(length).is_some_and(|end| end <= whole);
        match ends.into_iter().all(within) {
            true => Ok((self.size() != picture).then_some(self)),
            false => Err(WindowError::Beyond { window, picture }),
        }
    }
}

impl fmt::Display for Window {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { x, y, width, height } = self;
        write!(f, "{x},{y},{width}x{height}")
    }
}

impl FromStr for Window {
    type Err = WindowError;

    fn from_str(text: &str) -> Result<Self, WindowError> {
        let number = |text: &str| text.trim().parse().map_err(|_| WindowError::Form);
        let (x, rest) = text.split_once(',').ok_or(WindowError::Form)?;
        let (y, size) = rest.split_once(',').ok_or(WindowError::Form)?;
        let (width, height) = size.split_once('x').ok_or(WindowError::Form)?;
        Self {
            x: number(x)?,
            y: number(y)?,
            width: number(width)?,
            height: number(height)?,
        }
        .check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::{FilmSettings, Filter};

    #[test]
    fn windows_are_read_as_they_are_written() {
        let window: Window = "100, 50,320x200".parse().unwrap();
        assert_eq!((window.x, window.y, window.size()), (100, 50, [320, 200]));
        assert_eq!(window.to_string().parse(), Ok(window));
        for text in [
            "",
            "1,2",
            "1,2,3",
            "1,2,3x",
            "-1,2,3x4",
            "1,2,3x4x5",
            "1,2,3,4",
            "1,2,4294967296x4",
        ] {
            assert_eq!(text.parse::<Window>(), Err(WindowError::Form), "{text}");
        }
        assert_eq!("1,2,0x4".parse::<Window>(), Err(WindowError::Empty(0, 4)));
    }

    #[test]
    fn windows_lie_within_their_picture() {
        let window = |text: &str| text.parse::<Window>().unwrap();
        assert_eq!(window("0,0,7x5").of([7, 5]), Ok(None));
        assert_eq!(window("1,2,6x3").of([7, 5]), Ok(Some(window("1,2,6x3"))));
        for beyond in ["1,0,7x5", "0,1,7x5", "7,0,1x1", "4294967295,0,4294967295x1"] {
            let error = window(beyond).of([7, 5]).unwrap_err().to_string();
            assert!(
                error.contains("is not within the picture, which has 7 x 5 pixels"),
                "{error}"
            );
        }
    }

    #[test]
    fn pixels_of_a_window_are_those_of_the_picture() {
        let film = FilmSettings {
            resolution: [7, 5],
            filter: Filter::Box { radius: 0.5 },
            window: Some("2,1,3x4".parse().unwrap()),
        };
        assert_eq!((film.size(), film.pixel_count()), ([3, 4], 12));
        let inside: Vec<usize> = (0..12).map(|pixel| film.in_picture(pixel)).collect();
        assert_eq!(inside, [9, 10, 11, 16, 17, 18, 23, 24, 25, 30, 31, 32]);
        for pixel in 0..35 {
            assert_eq!(film.rendered(pixel), inside.iter().position(|known| *known == pixel));
        }
    }
}

//! Windows of the plane before a camera.

use crate::math::{Transform, Vec2, atan2, tan};
use crate::scene::error::{SceneError, shortened};
use crate::scene::reader::Reader;
use crate::sensor::window;

/// The part of the plane before the camera that the image shows, in units of half of what `fov` sees, or of an orthographic camera's axes.
/// It runs from left to right and from bottom to top, as in pbrt.
#[derive(Clone, Copy)]
pub(super) struct ScreenWindow {
    middle: Vec2,
    half_width: f32,
}

impl ScreenWindow {
    /// The horizontal field of view \[radians\] and the principal point [share of the image] of a camera whose interval [-1, 1] is seen
    /// under `fov`.
    pub(super) fn of_perspective(self, fov: f32, [width, height]: [u32; 2]) -> (f32, Vec2) {
        let half_width = tan(0.5 * fov) * self.half_width;
        let half_height = self.half_width * height as f32 / width as f32;
        let middle = 0.5 * self.middle / Vec2::new(self.half_width, -half_height);
        (2.0 * atan2(half_width, 1.0), middle)
    }

    /// Maps the image of an orthographic camera to the part of it.
    pub(super) fn of_plane(self) -> Transform {
        let middle = Vec2::new(-self.middle.x, self.middle.y);
        window(middle, self.half_width)
    }
}

/// `screen_window`: four numbers, x from and to, y from and to.
pub(super) fn screen_window(reader: &Reader, resolution: [u32; 2]) -> Result<Option<ScreenWindow>, SceneError> {
    let Some(text) = reader.string("screen_window")? else {
        return Ok(None);
    };
    let words = text.split([' ', ',']).filter(|word| !word.is_empty());
    let numbers: Option<Vec<f32>> = words.map(|word| word.parse().ok()).collect();
    let window = match numbers.as_deref() {
        Some(&[left, right, bottom, top]) if left < right && bottom < top => Some([left, right, bottom, top]),
        _ => None,
    };
    let window = window.filter(|window| window.iter().all(|number| number.abs() <= 1e6));
    let Some([left, right, bottom, top]) = window else {
        let reason = format!(
            "`{}` is not four numbers up to 1e6: x from and to, y from and to",
            shortened(text)
        );
        return Err(reader.wrong("screen_window", reason));
    };
    let (width, height) = (right - left, top - bottom);
    let pixel_aspect = width / height * resolution[1] as f32 / resolution[0] as f32;
    if (pixel_aspect - 1.0).abs() > 1e-3 {
        reader.warn_of(
            "screen_window",
            "pixels are square: the window is as high as its width and the film's shape make it",
        );
    }
    Ok(Some(ScreenWindow {
        middle: Vec2::new(0.5 * (left + right), 0.5 * (bottom + top)),
        half_width: 0.5 * width,
    }))
}

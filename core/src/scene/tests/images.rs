//! Images of every kind, which `images/make.py` makes with other programs: four squares of 8 x 8 pixels, red, green, blue and grey.

use crate::scene::image;
use crate::scene::linear_image::{Channel, Encoding, LinearImage, Reading};
use crate::scene::loader::LoadedFile;
use crate::texture::Texels;

const COLOURS: [[u8; 3]; 4] = [[200, 40, 40], [40, 180, 60], [30, 60, 220], [128, 128, 128]];

macro_rules! images {
    ($($name:literal),*) => {
        [$(($name, include_bytes!(concat!("images/", $name)).as_slice())),*]
    };
}

fn read(name: &str, bytes: &[u8], channel: Channel) -> LinearImage {
    let file = LoadedFile {
        name: name.into(),
        bytes: bytes.to_vec().into(),
    };
    let reading = Reading {
        encoding: Encoding::Linear,
        channel,
        inverted: false,
    };
    let image = image::read(&file, &reading, 256).unwrap_or_else(|faults| panic!("{name}: {faults:?}"));
    assert_eq!((image.width, image.height), (16, 16), "{name}");
    image
}

/// The middle of each square.
fn squares(image: &LinearImage) -> [[f32; 3]; 4] {
    [(3, 3), (12, 3), (3, 12), (12, 12)].map(|(x, y)| image.texels.get(16 * y + x).to_rgb())
}

#[track_caller]
fn assert_squares(name: &str, found: [[f32; 3]; 4], expected: [[f32; 3]; 4], tolerance: f32) {
    for (found, expected) in found.iter().zip(expected) {
        let close = (0..3).all(|c| (found[c] - expected[c]).abs() <= tolerance);
        assert!(close, "{name}: {found:?}, expected {expected:?}");
    }
}

/// What the squares are in images of bytes.
fn colours() -> [[f32; 3]; 4] {
    COLOURS.map(|colour| colour.map(|byte| f32::from(byte) / 255.0))
}

/// The luma of ITU-R 601, to which Pillow turns colours.
fn lumas() -> [[f32; 3]; 4] {
    [88, 124, 69, 128].map(|luma: u8| [f32::from(luma) / 255.0; 3])
}

#[test]
fn colours_of_bytes_come_back_as_they_are() {
    let images = images!(
        "runs.tga",
        "plain.tga",
        "palette.png",
        "alpha.png",
        "plain.bmp",
        "palette.bmp"
    );
    for (name, bytes) in images {
        let image = read(name, bytes, Channel::All);
        assert_squares(name, squares(&image), colours(), 1e-6);
        assert!(matches!(image.texels, Texels::ColourBytes(..)), "{name}");
    }
}

/// JPEG loses a little.
#[test]
fn jpegs_may_be_progressive_and_of_four_inks() {
    for (name, bytes) in images!("progressive.jpg", "cmyk.jpg") {
        let image = read(name, bytes, Channel::All);
        assert_squares(name, squares(&image), colours(), 3.0 / 255.0);
    }
}

#[test]
fn greys_take_a_byte() {
    for (name, bytes) in images!("grey.jpg", "grey-alpha.png") {
        let image = read(name, bytes, Channel::All);
        assert_squares(name, squares(&image), lumas(), 2.0 / 255.0);
        assert!(matches!(image.texels, Texels::GreyBytes(..)), "{name}");
    }
    let [(name, bytes)] = images!("grey-16.png");
    assert_squares(name, squares(&read(name, bytes, Channel::All)), lumas(), 1e-6);
    let [(name, bytes)] = images!("bits.png");
    let expected = [0.0, 1.0, 0.0, 1.0].map(|value| [value; 3]);
    assert_squares(name, squares(&read(name, bytes, Channel::All)), expected, 0.0);
}

#[test]
fn alpha_is_a_channel() {
    let expected = [255, 255, 128, 255].map(|alpha: u8| [f32::from(alpha) / 255.0; 3]);
    for (name, bytes) in images!("runs.tga", "alpha.png", "grey-alpha.png") {
        assert_squares(name, squares(&read(name, bytes, Channel::Alpha)), expected, 1e-6);
    }
    for (name, bytes) in images!("plain.tga", "progressive.jpg", "half.exr", "plain.hdr") {
        assert_squares(name, squares(&read(name, bytes, Channel::Alpha)), [[1.0; 3]; 4], 0.0);
    }
}

/// Halves and the shared exponents of RGBE have 11 and 8 bits.
#[test]
fn floats_come_in_halves_tiles_and_shared_exponents() {
    let expected = COLOURS.map(|colour| colour.map(|byte| f32::from(byte) / 100.0));
    for ((name, bytes), tolerance) in
        images!("half.exr", "tiles.exr", "plain.hdr")
            .into_iter()
            .zip([1e-3, 1e-6, 2.0 / 128.0])
    {
        assert_squares(name, squares(&read(name, bytes, Channel::All)), expected, tolerance);
    }
}

//! Sixels: the graphics of DEC's terminals (VT3xx Graphics Programming, chapter 14).
//!
//! Colours are those of a cube of 6 by 6 by 6, dithered by a matrix of 8 by 8 thresholds (Bayer 1973): of the crates, `icy_sixel` is
//! alive and brings a dozen others to choose a palette.

use std::collections::BTreeSet;
use std::fmt::Write;

/// Steps of each of red, green and blue.
const STEPS: u32 = 6;
/// Rows that one character holds.
const BAND: usize = 6;

/// A picture of 8-bit sRGB, row by row, so many columns wide.
pub(super) fn encode(samples: &[u8], width: usize) -> Vec<u8> {
    let height = samples.len() / (3 * width.max(1));
    let colours: Vec<u8> = (0..width * height)
        .map(|at| colour(&samples[3 * at..3 * at + 3], at % width, at / width))
        .collect();
    // Pixels are square, and what is not drawn stays as it is.
    let mut text = format!("\x1bP0;1q\"1;1;{width};{height}");
    for used in colours.iter().collect::<BTreeSet<_>>() {
        let [red, green, blue] = cube(*used).map(|step| 100 * step / (STEPS - 1));
        let _ = write!(text, "#{used};2;{red};{green};{blue}");
    }
    for (band, rows) in colours.chunks(BAND * width.max(1)).enumerate() {
        if band > 0 {
            text.push('-');
        }
        for (i, used) in rows.iter().collect::<BTreeSet<_>>().into_iter().enumerate() {
            if i > 0 {
                text.push('$');
            }
            let _ = write!(text, "#{used}");
            let bits = |x: usize| {
                let column = rows.iter().skip(x).step_by(width).enumerate();
                column
                    .filter(|(_, colour)| *colour == used)
                    .fold(0u8, |bits, (y, _)| bits | 1 << y)
            };
            run_lengths(&mut text, (0..width).map(bits));
        }
    }
    text.push_str("\x1b\\");
    text.into_bytes()
}

/// Characters of six pixels each; those that repeat are counted, and empty ones at the end left out.
fn run_lengths(text: &mut String, columns: impl Iterator<Item = u8>) {
    let mut runs: Vec<(u8, usize)> = Vec::new();
    for bits in columns {
        match runs.last_mut() {
            Some((last, count)) if *last == bits => *count += 1,
            _ => runs.push((bits, 1)),
        }
    }
    runs.pop_if(|(bits, _)| *bits == 0);
    for (bits, count) in runs {
        let character = char::from(b'?' + bits);
        match count {
            1..4 => (0..count).for_each(|_| text.push(character)),
            _ => _ = write!(text, "!{count}{character}"),
        }
    }
}

/// The number of the colour of a pixel.
fn colour(rgb: &[u8], x: usize, y: usize) -> u8 {
    let step = |value: u8| (u32::from(value) * (STEPS - 1) * 64 + 255 * threshold(x, y)) / (255 * 64);
    let [red, green, blue] = [rgb[0], rgb[1], rgb[2]].map(|value| step(value).min(STEPS - 1));
    ((red * STEPS + green) * STEPS + blue) as u8
}

/// Steps of red, green and blue of a colour.
fn cube(colour: u8) -> [u32; 3] {
    let colour = u32::from(colour);
    [colour / (STEPS * STEPS), colour / STEPS % STEPS, colour % STEPS]
}

/// Bayer's matrix: 0 to 63.
fn threshold(x: usize, y: usize) -> u32 {
    (0..3).fold(0, |sum, bit| {
        let (x, y) = ((x >> bit & 1) as u32, (y >> bit & 1) as u32);
        4 * sum + 2 * (x ^ y) + y
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(text: &str) -> (usize, &str) {
        let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        (text[..end].parse().unwrap(), &text[end..])
    }

    /// What a terminal draws: the colours of all pixels, in hundredths.
    fn decode(bytes: &[u8]) -> (usize, usize, Vec<Option<[usize; 3]>>) {
        let text = std::str::from_utf8(bytes).unwrap();
        let text = text
            .strip_prefix("\x1bP0;1q\"1;1;")
            .unwrap()
            .strip_suffix("\x1b\\")
            .unwrap();
        let (width, text) = number(text);
        let (height, mut text) = number(&text[1..]);
        let mut drawn = vec![None; width * height];
        let (mut palette, mut colour) = (vec![None; 256], None);
        let (mut x, mut top) = (0, 0);
        while let Some(first) = text.chars().next() {
            text = &text[1..];
            match first {
                '#' => {
                    let (index, rest) = number(text);
                    text = rest;
                    if let Some(rest) = text.strip_prefix(";2;") {
                        let (red, rest) = number(rest);
                        let (green, rest) = number(&rest[1..]);
                        let (blue, rest) = number(&rest[1..]);
                        palette[index] = Some([red, green, blue]);
                        text = rest;
                    }
                    colour = palette[index];
                }
                '$' => x = 0,
                '-' => (x, top) = (0, top + BAND),
                _ => {
                    let (count, character) = match first {
                        '!' => {
                            let (count, rest) = number(text);
                            text = &rest[1..];
                            (count, rest.as_bytes()[0])
                        }
                        other => (1, other as u8),
                    };
                    for _ in 0..count {
                        for y in (0..BAND).filter(|y| (character - b'?') >> y & 1 == 1) {
                            drawn[(top + y) * width + x] = colour;
                        }
                        x += 1;
                    }
                }
            }
        }
        (width, height, drawn)
    }

    #[test]
    fn every_pixel_is_drawn_once_near_its_colour() {
        let (width, height) = (37, 20);
        let samples: Vec<u8> = (0..width * height)
            .flat_map(|at| [(at % width * 6) as u8, (at / width * 12) as u8, (at % 256) as u8])
            .collect();
        let (found_width, found_height, drawn) = decode(&encode(&samples, width));
        assert_eq!((found_width, found_height), (width, height));
        for (at, found) in drawn.iter().enumerate() {
            let found = found.unwrap_or_else(|| panic!("pixel {at} is not drawn"));
            for (channel, value) in found.into_iter().enumerate() {
                let expected = f64::from(samples[3 * at + channel]) / 2.55;
                assert!(
                    (value as f64 - expected).abs() < 20.0,
                    "pixel {at}: {value} for {expected}"
                );
            }
        }
    }

    /// Dithering keeps means: 8 by 8 pixels of one colour have it on average.
    #[test]
    fn a_flat_picture_has_its_colour_on_average() {
        for value in [0u8, 1, 90, 128, 200, 255] {
            let (.., drawn) = decode(&encode(&[value; 3 * 64], 8));
            let sum: usize = drawn.iter().map(|pixel| pixel.unwrap()[0]).sum();
            let (mean, expected) = (sum as f64 / 64.0, f64::from(value) / 2.55);
            assert!((mean - expected).abs() < 0.4, "{mean} for {expected}");
        }
    }

    #[test]
    fn thresholds_are_all_there() {
        let all: BTreeSet<u32> = (0..64).map(|at| threshold(at % 8, at / 8)).collect();
        assert_eq!(all, (0..64).collect());
    }
}

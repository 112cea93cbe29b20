//! Profiles of lamps in the format of the Illuminating Engineering Society (ANSI/IES LM-63, all editions): candela by direction.

use super::error::{Place, SceneError, shortened};
use super::loader::LoadedFile;
use super::text;
use crate::spectrum::Spectrum;
use crate::texture::{Bitmap, TextureFilter, WrapMode};

/// The largest file [bytes]; profiles have some 100 kB.
const LARGEST: usize = 16 << 20;
/// Size of the image that a profile becomes: a node each degree around, each half degree down.
const IMAGE_SIZE: [usize; 2] = [360, 361];

/// What a lamp sends in which direction.
#[derive(Debug)]
pub(super) struct Profile {
    /// Angles from the axis, which points down from a lamp at the ceiling \[degrees\]; they rise.
    vertical: Vec<f64>,
    /// Angles about the axis \[degrees\]; they rise.
    horizontal: Vec<f64>,
    /// Intensity \[cd\], by horizontal angle, then by vertical angle.
    candela: Vec<f64>,
}

/// Reads a profile.
pub(super) fn read(file: &LoadedFile) -> Result<Profile, SceneError> {
    let whole = Place::whole(&file.name);
    if file.bytes.len() > LARGEST {
        let (what, value, limit) = (
            "bytes of a lamp's profile".into(),
            file.bytes.len() as u64,
            LARGEST as u64,
        );
        return Err(SceneError::Limit {
            place: whole,
            what,
            value,
            limit,
        });
    }
    let mut lines = text::lines(&file.bytes);
    let tilt = lines.by_ref().find_map(|(line, bytes)| {
        let text = String::from_utf8_lossy(bytes);
        text.trim()
            .strip_prefix("TILT=")
            .map(|tilt| (line, tilt.trim().to_ascii_uppercase()))
    });
    let Some((line, tilt)) = tilt else {
        return Err(SceneError::data(
            &whole,
            "no line `TILT=`: this is no profile of a lamp (LM-63)",
        ));
    };
    let at = |line| Place {
        file: whole.file.clone(),
        line,
    };
    let mut numbers = Numbers {
        found: Vec::new(),
        next: 0,
        whole: whole.clone(),
    };
    for (line, bytes) in lines {
        let text = String::from_utf8_lossy(bytes);
        for word in text
            .split(|c: char| c.is_whitespace() || c == ',')
            .filter(|word| !word.is_empty())
        {
            let number = word.parse::<f64>().ok().filter(|number| number.is_finite());
            let number =
                number.ok_or_else(|| SceneError::data(&at(line), format!("`{}` is not a number", shortened(word))))?;
            numbers.found.push((number, line));
        }
    }
    match tilt.as_str() {
        "NONE" => {}
        "INCLUDE" => {
            // How much a lamp loses when it is tilted: it hangs as it was measured.
            numbers.next("the lamp's orientation")?;
            let count = numbers.count("number of tilts")?;
            numbers.list(2 * count, "tilts and their factors")?;
        }
        _ => {
            let reason = format!("TILT={}: only NONE and INCLUDE are read", shortened(&tilt));
            return Err(SceneError::data(&at(line), reason));
        }
    }
    profile(&mut numbers)
}

/// What stands behind the tilt.
fn profile(numbers: &mut Numbers) -> Result<Profile, SceneError> {
    numbers.list(2, "number of lamps and their lumens")?;
    let multiplier = numbers.next("the multiplier of candela")?;
    let (rows, columns) = (
        numbers.count("number of vertical angles")?,
        numbers.count("number of horizontal angles")?,
    );
    let kind = numbers.next("the type of photometry")?;
    if kind != 1.0 {
        let reason = format!("photometry of type {kind}: only type C, 1, is read");
        return Err(SceneError::data(&numbers.place(), reason));
    }
    numbers.list(4, "units and size")?;
    let (ballast, photometric) = (
        numbers.next("the ballast factor")?,
        numbers.next("the photometric factor")?,
    );
    numbers.list(1, "the watts")?;
    let vertical = numbers.rising(rows, "vertical angles")?;
    let horizontal = numbers.rising(columns, "horizontal angles")?;
    let factor = multiplier * ballast * photometric;
    let values = numbers.list(rows.saturating_mul(columns), "candela")?;
    let candela: Vec<f64> = values.iter().map(|(value, _)| value * factor).collect();
    if let Some(wrong) = candela.iter().find(|value| !(0.0..=1e12).contains(*value)) {
        return Err(SceneError::data(
            &numbers.whole,
            format!("an intensity of {wrong} cd; allowed: 0 to 1e12"),
        ));
    }
    Ok(Profile {
        vertical,
        horizontal,
        candela,
    })
}

/// The numbers of a file, with their lines.
struct Numbers {
    found: Vec<(f64, u32)>,
    next: usize,
    whole: Place,
}

impl Numbers {
    /// Where the last number was.
    fn place(&self) -> Place {
        let line = self.next.checked_sub(1).map_or(0, |last| self.found[last].1);
        Place {
            line,
            ..self.whole.clone()
        }
    }

    fn list(&mut self, count: usize, what: &str) -> Result<&[(f64, u32)], SceneError> {
        let left = self.found.len() - self.next;
        if count > left {
            let reason = format!("the file ends before {what}: {count} numbers are missing, {left} are there");
            return Err(SceneError::data(&self.whole, reason));
        }
        self.next += count;
        Ok(&self.found[self.next - count..self.next])
    }

    fn next(&mut self, what: &str) -> Result<f64, SceneError> {
        self.list(1, what).map(|numbers| numbers[0].0)
    }

    fn count(&mut self, what: &str) -> Result<usize, SceneError> {
        let number = self.next(what)?;
        if number.fract() == 0.0 && (1.0..=1e6).contains(&number) {
            return Ok(number as usize);
        }
        Err(SceneError::data(
            &self.place(),
            format!("{what}: {number}; allowed: 1 to 1000000"),
        ))
    }

    fn rising(&mut self, count: usize, what: &str) -> Result<Vec<f64>, SceneError> {
        let angles: Vec<f64> = self.list(count, what)?.iter().map(|(angle, _)| *angle).collect();
        if angles.windows(2).all(|pair| pair[0] < pair[1]) {
            return Ok(angles);
        }
        Err(SceneError::data(&self.place(), format!("{what} do not rise")))
    }
}

impl Profile {
    /// Intensity \[cd\] at the angle `vertical` from the axis and `horizontal` about it, in [0, 360) \[degrees\]; linear between the angles of
    /// the file, and nothing beyond its vertical angles.
    fn intensity(&self, vertical: f64, horizontal: f64) -> f64 {
        let (first, last) = (self.vertical[0], self.vertical[self.vertical.len() - 1]);
        if !(first..=last).contains(&vertical) {
            return 0.0;
        }
        let (row, down) = between(&self.vertical, vertical);
        let (column, around) = between(&self.horizontal, self.folded(horizontal));
        let value = |column: usize, row: usize| {
            let column = column.min(self.horizontal.len() - 1);
            self.candela[column * self.vertical.len() + row.min(self.vertical.len() - 1)]
        };
        let at = |column| value(column, row) * (1.0 - down) + value(column, row + 1) * down;
        at(column) * (1.0 - around) + at(column + 1) * around
    }

    /// The horizontal angle of the file that has the same intensity: files leave out what is symmetrical.
    fn folded(&self, horizontal: f64) -> f64 {
        let (first, last) = (self.horizontal[0], self.horizontal[self.horizontal.len() - 1]);
        if self.horizontal.len() == 1 {
            first
        } else if (first, last) == (0.0, 90.0) {
            let half = horizontal % 180.0;
            half.min(180.0 - half)
        } else if (first, last) == (0.0, 180.0) {
            horizontal.min(360.0 - horizontal)
        } else if (first, last) == (90.0, 270.0) {
            // Left and right mirror each other at the plane of 90 and 270 degrees.
            match horizontal {
                angle if angle < 90.0 => 180.0 - angle,
                angle if angle > 270.0 => 540.0 - angle,
                angle => angle,
            }
        } else {
            horizontal
        }
    }

    /// The intensity \[cd\] as an image of latitude and longitude whose upper edge is the axis; an angle about the axis of 0 lies a quarter
    /// of a turn from the image's left edge.
    pub(super) fn image(&self) -> Bitmap {
        let [width, height] = IMAGE_SIZE;
        let texel = |index: usize| {
            let (column, row) = (index % width, index / width);
            let vertical = 180.0 * row as f64 / (height - 1) as f64;
            let around = 360.0 * (column as f64 + 0.5) / width as f64;
            Spectrum::splat(self.intensity(vertical, (around + 270.0) % 360.0) as f32)
        };
        Bitmap {
            width,
            height,
            texels: (0..width * height).map(texel).collect::<Vec<_>>().into(),
            wrap: WrapMode::Repeat,
            filter: TextureFilter::Bilinear,
        }
    }
}

/// The entry at or before `value` among rising numbers, and the share of the way to the next one.
fn between(numbers: &[f64], value: f64) -> (usize, f64) {
    let index = numbers.partition_point(|number| *number <= value).saturating_sub(1);
    match numbers.get(index + 1) {
        Some(next) => (
            index,
            ((value - numbers[index]) / (next - numbers[index])).clamp(0.0, 1.0),
        ),
        None => (index, 0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> LoadedFile {
        LoadedFile {
            name: "lamp.ies".into(),
            bytes: text.to_owned().into(),
        }
    }

    const QUADRANT: &str = "IESNA:LM-63-2002\n[TEST] made here\nTILT=NONE\n\
         1 1000 2.0 3 2 1 2 0 0 0\n0.5 1.0 20\n0 45 90\n0 90\n10 20 30\n40,50\n60\n";

    #[test]
    fn a_profile_is_read_with_its_factors_and_symmetry() {
        let profile = read(&file(QUADRANT)).unwrap();
        for (vertical, horizontal, expected) in [
            (0.0, 0.0, 10.0),
            (45.0, 0.0, 20.0),
            (22.5, 0.0, 15.0),
            (90.0, 90.0, 60.0),
            (45.0, 45.0, 35.0),
            (45.0, 180.0, 20.0),
            (45.0, 225.0, 35.0),
            (45.0, 270.0, 50.0),
            (45.0, 315.0, 35.0),
            (91.0, 0.0, 0.0),
        ] {
            let found = profile.intensity(vertical, horizontal);
            assert!((found - expected).abs() < 1e-9, "{vertical} {horizontal}: {found}");
        }
        let image = profile.image();
        assert!((image.texels.get(0)[0] - (10.0 + 30.0 * 89.5 / 90.0)).abs() < 1e-4);
        assert_eq!(image.texels.get(360 * 200), Spectrum::ZERO);
    }

    #[test]
    fn tilts_are_passed_over() {
        let tilted = QUADRANT.replace("TILT=NONE", "TILT=INCLUDE\r\n1\r\n2\r\n0 90\r\n1.0 0.9");
        assert_eq!(
            read(&file(&tilted)).unwrap().candela,
            read(&file(QUADRANT)).unwrap().candela
        );
    }

    #[test]
    fn what_is_broken_is_refused_with_its_line() {
        for (text, expected) in [
            ("hello", "lamp.ies: no line `TILT=`"),
            ("TILT=lamp.tlt\n1", "lamp.ies:1: TILT=LAMP.TLT: only NONE"),
            ("TILT=NONE\n1 2 three", "lamp.ies:2: `three` is not a number"),
            (
                "TILT=NONE\n1 1000 1 3",
                "lamp.ies: the file ends before number of horizontal angles",
            ),
            (
                "TILT=NONE\n1 1000 1 0 2",
                "lamp.ies:2: number of vertical angles: 0; allowed",
            ),
            (
                "TILT=NONE\n1 1000 1 1000000 1000000 1 2 0 0 0 1 1 20 0",
                "lamp.ies: the file ends before vertical",
            ),
            (
                "TILT=NONE\n1 1000 1 1 1 3 2 0 0 0 1 1 20 0 0 1",
                "lamp.ies:2: photometry of type 3",
            ),
            (
                "TILT=NONE\n1 1000 1 2 1 1 2 0 0 0 1 1 20\n9 0\n0 1 1",
                "lamp.ies:3: vertical angles do not rise",
            ),
            (
                "TILT=NONE\n1 1000 -1 1 1 1 2 0 0 0 1 1 20 0 0 5",
                "lamp.ies: an intensity of -5 cd",
            ),
        ] {
            let error = read(&file(text)).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
    }
}

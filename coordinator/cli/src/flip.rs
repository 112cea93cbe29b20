//! FLIP: how different two pictures look to somebody who flips between them (Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström
//! and Fairchild 2020), and its form for radiance (Andersson, Nilsson, Shirley and Akenine-Möller 2021). Equations are those of the
//! first paper unless the second is named.
//!
//! Errors are between 0 and 1. Constants are those of the papers; the screen is theirs too: 0.7 m wide, 3840 pixels, seen from 0.7 m.

use std::f32::consts::PI;
use std::num::NonZeroUsize;

/// Pixels in a degree of sight, for the papers' screen and distance.
const PIXELS_PER_DEGREE: f32 = 0.7 * 3840.0 / 0.7 * PI / 180.0;
/// Exponents and limits of the colour difference (section 4.1.3): q_c, p_c, p_t.
const COLOUR_POWER: f32 = 0.7;
const COLOUR_LIMIT: f32 = 0.4;
const COLOUR_SHARE: f32 = 0.95;
/// Width of the feature detectors \[degrees\] (section 4.2).
const FEATURE_WIDTH: f32 = 0.082;
/// Exponent of the feature difference, q_f (equation 12).
const FEATURE_POWER: f32 = 0.5;
/// The sensitivity of the eye to contrast, as sums of Gaussians (table 1): a_1, b_1, a_2, b_2 for each opponent channel.
const SENSITIVITY: [[f32; 4]; 3] = [
    [1.0, 0.0047, 0.0, 1e-5],
    [1.0, 0.0053, 0.0, 1e-5],
    [34.1, 0.04, 13.5, 0.025],
];
/// Tristimulus values of linear sRGB, row by row, which add up to those of its white.
const XYZ: [[f32; 3]; 3] = [
    [
        10_135_552.0 / 24_577_794.0,
        8_788_810.0 / 24_577_794.0,
        4_435_075.0 / 24_577_794.0,
    ],
    [
        2_613_072.0 / 12_288_897.0,
        8_788_810.0 / 12_288_897.0,
        887_015.0 / 12_288_897.0,
    ],
    [
        1_425_312.0 / 73_733_382.0,
        8_788_810.0 / 73_733_382.0,
        70_074_185.0 / 73_733_382.0,
    ],
];
/// The inverse of [`XYZ`].
const RGB: [[f32; 3]; 3] = [
    [3.241_003_3, -1.537_398_9, -0.498_615_9],
    [-0.969_224_3, 1.875_93, 0.041_554_227],
    [0.055_639_42, -0.204_011_2, 1.057_148_9],
];
/// The tone curve of the second paper, an approximation of ACES: `(a x^2 + b x) / (c x^2 + d x + e)`.
const CURVE: [f32; 5] = [0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14];
/// What the brightest, or the median, of a picture becomes on the screen at the first and the last exposure (section 3.2 of the
/// second paper).
const SHOWN: f32 = 0.85;
/// Least luminance that an exposure is found for.
const DARKEST: f32 = 1e-5;
/// Most exposures, whatever the range of the picture.
const MOST_EXPOSURES: usize = 64;

/// Three values for each pixel.
type Planes = [Vec<f32>; 3];

/// Errors of all pixels, row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ErrorMap(pub(crate) Vec<f32>);

impl ErrorMap {
    /// The mean, which is the papers' number for the whole picture.
    pub(crate) fn mean(&self) -> f64 {
        let sum: f64 = self.0.iter().map(|error| f64::from(*error)).sum();
        sum / self.0.len().max(1) as f64
    }
}

/// Errors of a picture against a reference of the same size, so many columns wide. Both are linear sRGB as a screen shows it; what
/// is not between 0 and 1 is cut off.
pub(crate) fn ldr(picture: &[[f32; 3]], reference: &[[f32; 3]], width: usize) -> ErrorMap {
    let eye = Eye::new(width, PIXELS_PER_DEGREE);
    let [(colour_a, features_a), (colour_b, features_b)] = [picture, reference].map(|picture| eye.see(picture));
    let largest = colour_power(largest_difference());
    let limit = COLOUR_LIMIT * largest;
    let error = |i: usize| {
        let [a, b] = [&colour_a, &colour_b].map(|planes: &Planes| [planes[0][i], planes[1][i], planes[2][i]]);
        let difference = colour_power(hyab(a, b));
        // Equation 9: small differences are spread over most of the range.
        let colour = match difference < limit {
            true => difference * COLOUR_SHARE / limit,
            false => COLOUR_SHARE + (difference - limit) / (largest - limit) * (1.0 - COLOUR_SHARE),
        };
        let features = [0, 1].map(|kind| (features_a[kind][i] - features_b[kind][i]).abs());
        let feature = (features[0].max(features[1]) / 2f32.sqrt())
            .powf(FEATURE_POWER)
            .clamp(0.0, 1.0);
        colour.clamp(0.0, 1.0).powf(1.0 - feature)
    };
    ErrorMap((0..reference.len()).map(error).collect())
}

/// Errors of radiance against a reference: of each pixel the largest at any exposure that shows something of the reference.
pub(crate) fn hdr(picture: &[[f32; 3]], reference: &[[f32; 3]], width: usize) -> ErrorMap {
    let mut largest = vec![0f32; reference.len()];
    for exposure in exposures(reference) {
        let shown = |picture: &[[f32; 3]]| -> Vec<[f32; 3]> {
            let scale = exposure.exp2();
            picture
                .iter()
                .map(|pixel| pixel.map(|value| tone(scale * value)))
                .collect()
        };
        let map = ldr(&shown(picture), &shown(reference), width);
        largest
            .iter_mut()
            .zip(map.0)
            .for_each(|(most, error)| *most = most.max(error));
    }
    ErrorMap(largest)
}

/// The exposures at which a reference is looked at, as powers of two (section 3.2 of the second paper).
fn exposures(reference: &[[f32; 3]]) -> Vec<f32> {
    let [a, b, c, d, e] = CURVE;
    // Where the curve has the value SHOWN: the larger root of a quadratic equation.
    let (square, linear, constant) = (a - SHOWN * c, b - SHOWN * d, -SHOWN * e);
    let half = -0.5 * linear / square;
    let brightness = half + (half * half - constant / square).sqrt();
    let mut luminances: Vec<f32> = reference
        .iter()
        .map(|[r, g, b]| 0.2126 * r + 0.7152 * g + 0.0722 * b)
        .collect();
    if luminances.is_empty() {
        return Vec::new();
    }
    let middle = luminances.len() / 2;
    let median = *luminances.select_nth_unstable_by(middle, f32::total_cmp).1;
    let most = luminances.into_iter().fold(0.0, f32::max);
    let [first, last] = [most, median].map(|luminance| (brightness / luminance.max(DARKEST)).log2());
    let count = ((last - first).ceil().max(2.0) as usize).min(MOST_EXPOSURES);
    let step = (last - first) / (count - 1) as f32;
    (0..count).map(|i| first + i as f32 * step).collect()
}

/// The tone curve; what is no brightness is black.
fn tone(value: f32) -> f32 {
    let [a, b, c, d, e] = CURVE;
    let value = f64::from(value.clamp(0.0, 1e15));
    let [a, b, c, d, e] = [a, b, c, d, e].map(f64::from);
    let shown = (a * value * value + b * value) / (c * value * value + d * value + e);
    shown.clamp(0.0, 1.0) as f32
}

/// What somebody sees of a picture.
struct Eye {
    width: usize,
    /// For each Gaussian of the sensitivities: its weights, and its share by channel.
    sensitivity: Vec<Gaussian>,
    /// Weights across an edge, across a line, and along both.
    edge: Vec<f32>,
    point: Vec<f32>,
    along: Vec<f32>,
}

struct Gaussian {
    channel: usize,
    share: f32,
    weights: Vec<f32>,
}

impl Eye {
    fn new(width: usize, pixels_per_degree: f32) -> Self {
        let widest = SENSITIVITY
            .iter()
            .flat_map(|[_, b1, _, b2]| [*b1, *b2])
            .fold(0.0, f32::max);
        let radius = (3.0 * (widest / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as i32;
        let mut sensitivity = Vec::new();
        for (channel, [a1, b1, a2, b2]) in SENSITIVITY.into_iter().enumerate() {
            // Equation 3, transformed: a sqrt(pi / b) exp(-pi^2 x^2 / b), which is a product of rows and columns.
            let bells = [(a1, b1), (a2, b2)].into_iter().filter(|(a, _)| *a > 0.0);
            let mut bells: Vec<Gaussian> = bells
                .map(|(a, b)| {
                    let at = |x: i32| (-(PI * x as f32 / pixels_per_degree).powi(2) / b).exp();
                    let weights: Vec<f32> = (-radius..=radius).map(at).collect();
                    let sum: f32 = weights.iter().sum();
                    Gaussian {
                        channel,
                        share: a * (PI / b).sqrt() * sum * sum,
                        weights: weights.into_iter().map(|weight| weight / sum).collect(),
                    }
                })
                .collect();
            let total: f32 = bells.iter().map(|bell| bell.share).sum();
            bells.iter_mut().for_each(|bell| bell.share /= total);
            sensitivity.append(&mut bells);
        }
        let deviation = 0.5 * FEATURE_WIDTH * pixels_per_degree;
        let radius = (3.0 * deviation).ceil() as i32;
        let bell = |x: i32| (-0.5 * (x as f32 / deviation).powi(2)).exp();
        let detector = |slope: &dyn Fn(f32) -> f32| {
            let weights: Vec<f32> = (-radius..=radius).map(|x| slope(x as f32) * bell(x)).collect();
            let sum = |sign: f32| weights.iter().map(|weight| (sign * weight).max(0.0)).sum::<f32>();
            let (above, below) = (sum(1.0), sum(-1.0));
            // Section 4.2: what is positive adds up to 1, and what is negative to -1.
            let scaled = weights
                .iter()
                .map(|weight| weight / if *weight < 0.0 { below } else { above });
            scaled.collect()
        };
        let along: Vec<f32> = (-radius..=radius).map(bell).collect();
        let sum: f32 = along.iter().sum();
        Self {
            width,
            sensitivity,
            edge: detector(&|x| -x),
            point: detector(&|x| (x / deviation).powi(2) - 1.0),
            along: along.into_iter().map(|weight| weight / sum).collect(),
        }
    }

    /// The colours of a picture as they are seen, and how much of an edge and of a point there is at each pixel.
    fn see(&self, picture: &[[f32; 3]]) -> (Planes, [Vec<f32>; 2]) {
        let opponents: Vec<[f32; 3]> = picture
            .iter()
            .map(|pixel| opponent(pixel.map(|value| value.clamp(0.0, 1.0))))
            .collect();
        let plane = |channel: usize| -> Vec<f32> { opponents.iter().map(|pixel| pixel[channel]).collect() };
        let mut seen: Planes = std::array::from_fn(|_| vec![0.0; picture.len()]);
        for Gaussian {
            channel,
            share,
            weights,
        } in &self.sensitivity
        {
            let blurred = self.filtered(&plane(*channel), weights, weights);
            let sum = seen[*channel].iter_mut().zip(blurred);
            sum.for_each(|(sum, value)| *sum += share * value);
        }
        let [first, second, third] = &mut seen;
        for ((a, b), c) in first.iter_mut().zip(second).zip(third) {
            [*a, *b, *c] = perceived(shown([*a, *b, *c]).map(|value| value.clamp(0.0, 1.0)));
        }
        let grey: Vec<f32> = opponents.iter().map(|[y, ..]| (y + 16.0) / 116.0).collect();
        let features = [&self.edge, &self.point].map(|across| {
            let columns = self.filtered(&grey, across, &self.along);
            let rows = self.filtered(&grey, &self.along, across);
            columns.iter().zip(rows).map(|(x, y)| x.hypot(y)).collect()
        });
        (seen, features)
    }

    /// A plane filtered along its rows and then along its columns. Beyond its edges lies what is at them.
    fn filtered(&self, plane: &[f32], along_rows: &[f32], along_columns: &[f32]) -> Vec<f32> {
        let width = self.width;
        let height = plane.len() / width.max(1);
        let rows = in_parallel(plane.len(), width, |row, line| {
            let values = &plane[row * width..(row + 1) * width];
            for (x, sum) in line.iter_mut().enumerate() {
                *sum = weighted(along_rows, x, width, |x| values[x]);
            }
        });
        in_parallel(plane.len(), width, |row, line| {
            for (i, weight) in along_columns.iter().enumerate() {
                let from = (row + i).saturating_sub(along_columns.len() / 2).min(height - 1);
                let values = &rows[from * width..(from + 1) * width];
                line.iter_mut()
                    .zip(values)
                    .for_each(|(sum, value)| *sum += weight * value);
            }
        })
    }
}

/// The sum of values around `at` by weights, among `count` values.
fn weighted(weights: &[f32], at: usize, count: usize, value: impl Fn(usize) -> f32) -> f32 {
    let reach = weights.len() / 2;
    let place = |i: usize| (at + i).saturating_sub(reach).min(count - 1);
    weights
        .iter()
        .enumerate()
        .map(|(i, weight)| weight * value(place(i)))
        .sum()
}

/// A plane whose rows are made by several threads, each row by one.
fn in_parallel(length: usize, width: usize, fill: impl Fn(usize, &mut [f32]) + Sync) -> Vec<f32> {
    let mut plane = vec![0.0; length];
    let height = length / width.max(1);
    let threads = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let rows = height.div_ceil(threads).max(1);
    std::thread::scope(|scope| {
        for (part, lines) in plane.chunks_mut(rows * width.max(1)).enumerate() {
            let fill = &fill;
            scope.spawn(move || {
                let lines = lines.chunks_mut(width).enumerate();
                lines.for_each(|(row, line)| fill(part * rows + row, line));
            });
        }
    });
    plane
}

fn times(matrix: &[[f32; 3]; 3], [x, y, z]: [f32; 3]) -> [f32; 3] {
    matrix.map(|[a, b, c]| a * x + b * y + c * z)
}

/// Tristimulus values over those of white.
fn relative(rgb: [f32; 3]) -> [f32; 3] {
    let (xyz, white) = (times(&XYZ, rgb), times(&XYZ, [1.0; 3]));
    std::array::from_fn(|i| xyz[i] / white[i])
}

/// YCxCz, which is CIELAB without its cube roots (section 4.1.1), of linear sRGB.
fn opponent(rgb: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = relative(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Linear sRGB of [`opponent`].
fn shown([y, cx, cz]: [f32; 3]) -> [f32; 3] {
    let white = times(&XYZ, [1.0; 3]);
    let y = (y + 16.0) / 116.0;
    let relative = [y + cx / 500.0, y, y - cz / 200.0];
    times(&RGB, std::array::from_fn(|i| relative[i] * white[i]))
}

/// CIELAB of linear sRGB, with less colour where it is dark (Hunt's effect; equation 5).
fn perceived(rgb: [f32; 3]) -> [f32; 3] {
    let root = |value: f32| {
        const DELTA: f32 = 6.0 / 29.0;
        match value > DELTA.powi(3) {
            true => value.cbrt(),
            false => value / (3.0 * DELTA * DELTA) + 4.0 / 29.0,
        }
    };
    let [x, y, z] = relative(rgb).map(root);
    let lightness = 116.0 * y - 16.0;
    [
        lightness,
        0.01 * lightness * 500.0 * (x - y),
        0.01 * lightness * 200.0 * (y - z),
    ]
}

/// The distance of colours by HyAB (equation 6).
fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

fn colour_power(distance: f32) -> f32 {
    distance.powf(COLOUR_POWER)
}

/// That of pure green and pure blue, the largest of the cube (equation 8).
fn largest_difference() -> f32 {
    hyab(perceived([0.0, 1.0, 0.0]), perceived([0.0, 0.0, 1.0]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_survive_the_opponent_space() {
        for rgb in [[0.0; 3], [1.0; 3], [0.2, 0.5, 0.9], [1.0, 0.0, 0.3]] {
            let back = shown(opponent(rgb));
            assert!((0..3).all(|i| (back[i] - rgb[i]).abs() < 2e-6), "{rgb:?} {back:?}");
        }
        let [lightness, a, b] = perceived([1.0; 3]);
        assert!((lightness - 100.0).abs() < 1e-4 && a.abs() < 1e-4 && b.abs() < 1e-4);
    }

    /// Without edges only colours differ: equation 9 by hand.
    #[test]
    fn constant_pictures_differ_by_their_colours_alone() {
        let (width, count) = (24, 24 * 20);
        let map = |a: [f32; 3], b: [f32; 3]| ldr(&vec![a; count], &vec![b; count], width);
        assert!(map([0.3; 3], [0.3; 3]).0.iter().all(|error| *error == 0.0));
        let opposite = map([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        assert!(
            opposite.0.iter().all(|error| (error - 1.0).abs() < 1e-4),
            "{opposite:?}"
        );
        let (dark, bright) = ([0.1; 3], [0.12; 3]);
        let difference = colour_power(perceived(bright)[0] - perceived(dark)[0]);
        let expected = COLOUR_SHARE * difference / (COLOUR_LIMIT * colour_power(largest_difference()));
        let found = map(bright, dark);
        assert!(
            found.0.iter().all(|error| (error - expected).abs() < 1e-4),
            "{expected}"
        );
        assert!((found.mean() - f64::from(expected)).abs() < 1e-4);
    }

    /// The same difference of colour is seen better where it makes a point.
    #[test]
    fn features_make_errors_larger() {
        let (width, count) = (33, 33 * 33);
        let (grey, mut point) = (vec![[0.2; 3]; count], vec![[0.2; 3]; count]);
        point[16 * width + 16] = [0.9; 3];
        let map = ldr(&point, &grey, width);
        assert!(map.0[16 * width + 16] > 10.0 * map.0[0]);
        assert_eq!(map.0[0], 0.0, "it is out of reach");
    }

    #[test]
    fn exposures_show_the_brightest_and_the_median() {
        let mut reference = vec![[0.01; 3]; 99];
        reference.extend([[50.0; 3]; 2]);
        let found = exposures(&reference);
        let shown = |exposure: f32, value: f32| tone(exposure.exp2() * value);
        let (first, last) = (found[0], *found.last().unwrap());
        assert!((shown(first, 50.0) - SHOWN).abs() < 1e-3, "{found:?}");
        assert!((shown(last, 0.01) - SHOWN).abs() < 1e-3, "{found:?}");
        assert_eq!(found.len(), 13, "a step is at most a stop");
        assert_eq!(exposures(&[[0.0; 3]; 4]).len(), 2, "of a black picture as well");
        assert_eq!(hdr(&reference, &reference, 101).mean(), 0.0);
    }
}

//! Chi-square test of a sampler against its density: the test of every direction, light and camera sampler.
//!
//! The domain is cut into cells. The density is integrated over each cell, many samples are drawn with a fixed seed,
//! and Pearson's statistic compares the counts with the expectations. Samples that fail (`None`) or miss the domain
//! are a cell of their own, expected as often as the density is short of one.

use crate::math::Vec3;
use crate::random::{PathRandom, Stream};
use std::f64::consts::PI;

/// Probability that any test of a family raises a false alarm. Seeds are fixed, so a test that passes once passes always.
pub(crate) const FAMILY_FALSE_ALARM: f64 = 0.01;
/// Cells with fewer expected samples are pooled, for the statistic to follow the chi-square distribution.
const LEAST_EXPECTED: f64 = 5.0;
/// Error that quadrature may make in the integral over the whole domain.
const MASS_TOLERANCE: f64 = 1e-3;
/// Absolute and relative error, by its own estimate, at which quadrature is content with a cell.
const CELL_ERROR: f64 = 1e-6;
const RELATIVE_ERROR: f64 = 1e-4;
/// Quadrature splits every cell this often, to see narrow peaks, before it trusts its own error estimate.
const FORCED_SPLITS: u32 = 2;
/// Quadrature never splits a cell more often than this.
const MOST_SPLITS: u32 = 9;

/// A rectangle cut into equal cells.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Domain {
    /// Lower corner.
    pub(crate) lower: [f64; 2],
    /// Upper corner.
    pub(crate) upper: [f64; 2],
    /// Cells along each axis.
    pub(crate) cells: [usize; 2],
}

impl Domain {
    /// All directions, as (theta, phi) about +z; z = 0 bounds cells. Densities per solid angle become densities here by
    /// the factor sin theta. In theta, unlike cos theta, a density that is smooth at the poles stays smooth.
    pub(crate) const SPHERE: Self = Self {
        lower: [0.0, -PI],
        upper: [PI, PI],
        cells: [24, 32],
    };

    fn cell_size(&self, axis: usize) -> f64 {
        (self.upper[axis] - self.lower[axis]) / self.cells[axis] as f64
    }

    /// Index of the cell that holds `point`, row by row; the upper edges belong to the last cells.
    fn cell_of(&self, point: [f64; 2]) -> Option<usize> {
        let mut index = [0; 2];
        for axis in 0..2 {
            if !(self.lower[axis]..=self.upper[axis]).contains(&point[axis]) {
                return None;
            }
            let position = (point[axis] - self.lower[axis]) / self.cell_size(axis);
            index[axis] = (position as usize).min(self.cells[axis] - 1);
        }
        Some(index[0] * self.cells[1] + index[1])
    }

    /// Integral of `density` over each cell, in the order of [`Self::cell_of`].
    pub(crate) fn integrate(&self, mut density: impl FnMut([f64; 2]) -> f64) -> Vec<f64> {
        let size = [self.cell_size(0), self.cell_size(1)];
        let mut integrals = Vec::with_capacity(self.cells[0] * self.cells[1]);
        for i in 0..self.cells[0] {
            for j in 0..self.cells[1] {
                let lower = [self.lower[0] + i as f64 * size[0], self.lower[1] + j as f64 * size[1]];
                let whole = gauss(&mut density, lower, size);
                integrals.push(adapt(&mut density, lower, size, whole, 0));
            }
        }
        integrals
    }
}

/// Gauss-Legendre quadrature with 3 x 3 points over the rectangle.
fn gauss(density: &mut impl FnMut([f64; 2]) -> f64, lower: [f64; 2], size: [f64; 2]) -> f64 {
    const POINTS: [(f64, f64); 3] = [
        (0.112_701_665_379_258_3, 5.0 / 18.0),
        (0.5, 8.0 / 18.0),
        (0.887_298_334_620_741_7, 5.0 / 18.0),
    ];
    let mut sum = 0.0;
    for (x, weight_x) in POINTS {
        for (y, weight_y) in POINTS {
            sum += weight_x * weight_y * density([lower[0] + x * size[0], lower[1] + y * size[1]]);
        }
    }
    sum * size[0] * size[1]
}

/// Splits the rectangle into quarters until the sum over them agrees with `whole`, relatively, or absolutely as a share
/// of an error of [`CELL_ERROR`] per cell.
fn adapt(density: &mut impl FnMut([f64; 2]) -> f64, lower: [f64; 2], size: [f64; 2], whole: f64, splits: u32) -> f64 {
    let half = [size[0] / 2.0, size[1] / 2.0];
    let corners =
        [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)].map(|(i, j)| [lower[0] + i * half[0], lower[1] + j * half[1]]);
    let quarters = corners.map(|corner| gauss(density, corner, half));
    let sum: f64 = quarters.iter().sum();
    let share = CELL_ERROR / f64::from(1_u32 << (2 * splits));
    let converged = (sum - whole).abs() <= share.max(RELATIVE_ERROR * sum.abs());
    if splits >= FORCED_SPLITS && (converged || splits >= MOST_SPLITS) {
        return sum;
    }
    corners
        .into_iter()
        .zip(quarters)
        .map(|(corner, quarter)| adapt(density, corner, half, quarter, splits + 1))
        .sum()
}

/// What the test found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outcome {
    /// Probability of counts at least this far from the expectation if sampler and density agree.
    pub(crate) p_value: f64,
    /// Integral of the density over the domain.
    pub(crate) density_mass: f64,
    /// Share of the samples that fell into the domain.
    pub(crate) sampled_mass: f64,
    /// Cells compared, after pooling.
    cells: usize,
    samples: u32,
}

impl Outcome {
    /// Whether sampler and density agree as one of `tests` tests (Sidak's correction of [`FAMILY_FALSE_ALARM`]).
    pub(crate) fn passes(&self, tests: usize) -> bool {
        let expected = self.density_mass.min(1.0);
        let deviation = (expected * (1.0 - expected) / f64::from(self.samples)).sqrt();
        self.cells > 1
            && self.density_mass <= 1.0 + MASS_TOLERANCE
            && (self.sampled_mass - self.density_mass).abs() <= 6.0 * deviation + MASS_TOLERANCE
            && self.p_value >= sidak(tests)
    }
}

/// Significance of one of `tests` independent tests such that all of them together raise a false alarm with
/// probability [`FAMILY_FALSE_ALARM`] (Sidak 1967).
pub(crate) fn sidak(tests: usize) -> f64 {
    -libm::expm1(libm::log1p(-FAMILY_FALSE_ALARM) / tests as f64)
}

/// Compares `samples` draws of `sampler` with `density`, per unit area of the domain.
pub(crate) fn chi_square(
    domain: &Domain,
    samples: u32,
    seed: u64,
    mut sampler: impl FnMut(&mut PathRandom) -> Option<[f64; 2]>,
    density: impl FnMut([f64; 2]) -> f64,
) -> Outcome {
    let integrals = domain.integrate(density);
    let density_mass: f64 = integrals.iter().sum();
    let mut counts = vec![0_u32; integrals.len()];
    let mut missed = 0_u32;
    for path in 0..samples {
        let mut random = PathRandom::new(seed, 1, Stream::Camera, u64::from(path));
        match sampler(&mut random).and_then(|point| domain.cell_of(point)) {
            Some(cell) => counts[cell] += 1,
            None => missed += 1,
        }
    }
    let total = f64::from(samples);
    let mut cells: Vec<(f64, f64)> = integrals
        .into_iter()
        .zip(counts)
        .map(|(mass, count)| (mass * total, f64::from(count)))
        .collect();
    cells.push(((1.0 - density_mass).max(0.0) * total, f64::from(missed)));
    let pooled = pool(cells);
    let statistic: f64 = pooled
        .iter()
        .map(|(expected, count)| (count - expected) * (count - expected) / expected)
        .sum();
    let finite = density_mass.is_finite() && statistic.is_finite();
    Outcome {
        p_value: if finite {
            survival(statistic, pooled.len() - 1)
        } else {
            0.0
        },
        density_mass,
        sampled_mass: 1.0 - f64::from(missed) / total,
        cells: pooled.len(),
        samples,
    }
}

/// Merges (expected, counted) cells, the rarest first, until each has [`LEAST_EXPECTED`] expected samples.
fn pool(mut cells: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    cells.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut rare = (0.0, 0.0);
    while let Some(&(expected, count)) = cells.last() {
        if expected >= LEAST_EXPECTED && (rare.0 >= LEAST_EXPECTED || rare == (0.0, 0.0)) {
            break;
        }
        rare = (rare.0 + expected, rare.1 + count);
        cells.pop();
    }
    if rare != (0.0, 0.0) {
        cells.push(rare);
    }
    cells
}

/// Compares `samples` draws of a sampler of unit directions with its density per solid angle, over the whole sphere.
pub(crate) fn chi_square_directions(
    samples: u32,
    seed: u64,
    mut sampler: impl FnMut(&mut PathRandom) -> Option<Vec3>,
    mut density: impl FnMut(Vec3) -> f32,
) -> Outcome {
    chi_square(
        &Domain::SPHERE,
        samples,
        seed,
        |random| sampler(random).map(to_angles),
        |point| f64::from(density(from_angles(point))) * libm::sin(point[0]),
    )
}

/// [`chi_square_directions`] with many samples; panics with the figures where sampler and density disagree. `tests`: how
/// many such tests the family has.
pub(crate) fn assert_directions(
    label: &str,
    tests: usize,
    sampler: impl FnMut(&mut PathRandom) -> Option<Vec3>,
    density: impl FnMut(Vec3) -> f32,
) {
    let outcome = chi_square_directions(1 << 18, 0x00c0_ffee, sampler, density);
    assert!(
        outcome.passes(tests),
        "{label}: {outcome:?}, significance {:e}",
        sidak(tests)
    );
}

/// Compares a sampler of unit directions with its density per solid angle within a cone of half angle `theta` about `axis`, however
/// narrow: in the coordinates `(1 - cos) / (1 - cos theta)` and longitude, in which equal areas stand for equal solid angles.
pub(crate) fn assert_narrow(
    label: &str,
    tests: usize,
    (axis, theta): (Vec3, f32),
    mut sampler: impl FnMut(&mut PathRandom) -> Option<Vec3>,
    mut density: impl FnMut(Vec3) -> f32,
) {
    let frame = crate::math::Frame::from_normal(axis);
    let whole = f64::from(crate::math::warp::one_minus_cos(theta));
    let domain = Domain {
        lower: [0.0, -PI],
        upper: [1.0, PI],
        cells: [16, 16],
    };
    // Rounding throws samples off the rim and the middle.
    let cut = |part: f64| {
        if part < 1.0 + 4e-6 / f64::from(theta) {
            part.min(1.0)
        } else {
            part
        }
    };
    let coordinates = |direction: Vec3| {
        let local = frame.to_local(direction).as_dvec3();
        let one_minus_cos = if local.z > 0.0 {
            (local.x * local.x + local.y * local.y) / (1.0 + local.z)
        } else {
            1.0 - local.z
        };
        [cut(one_minus_cos / whole), libm::atan2(local.y, local.x)]
    };
    let direction = |[part, phi]: [f64; 2]| {
        let one_minus_cos = part * whole;
        let sine = (one_minus_cos * (2.0 - one_minus_cos)).max(0.0).sqrt();
        let local = glam::DVec3::new(sine * libm::cos(phi), sine * libm::sin(phi), 1.0 - one_minus_cos);
        frame.to_world(local.as_vec3()).normalize()
    };
    let outcome = chi_square(
        &domain,
        1 << 17,
        0x00c0_ffee,
        |random| sampler(random).map(coordinates),
        |point| f64::from(density(direction(point))) * whole,
    );
    assert!(
        outcome.passes(tests),
        "{label}: {outcome:?}, significance {:e}",
        sidak(tests)
    );
}

/// Integral of `f` over all directions.
pub(crate) fn integrate_sphere(mut f: impl FnMut(Vec3) -> f64) -> f64 {
    Domain::SPHERE
        .integrate(|point| f(from_angles(point)) * libm::sin(point[0]))
        .into_iter()
        .sum()
}

/// (theta, phi) of a unit direction, theta in [0, pi] and phi in (-pi, pi].
pub(crate) fn to_angles(direction: Vec3) -> [f64; 2] {
    let d = direction.as_dvec3();
    [libm::atan2(libm::hypot(d.x, d.y), d.z), libm::atan2(d.y, d.x)]
}

/// The unit direction of (theta, phi).
pub(crate) fn from_angles([theta, phi]: [f64; 2]) -> Vec3 {
    let sine = libm::sin(theta);
    glam::DVec3::new(sine * libm::cos(phi), sine * libm::sin(phi), libm::cos(theta)).as_vec3()
}

/// Probability that a chi-square variable with `degrees` degrees of freedom exceeds `statistic`.
fn survival(statistic: f64, degrees: usize) -> f64 {
    if degrees == 0 {
        return 1.0;
    }
    upper_gamma(degrees as f64 / 2.0, statistic / 2.0)
}

/// Regularised upper incomplete gamma function Q(a, x): series below `a + 1`, Legendre's continued fraction, evaluated
/// by Lentz's method, above.
fn upper_gamma(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    let front = libm::exp(a * libm::log(x) - x - libm::lgamma(a));
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-16 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        return 1.0 - front * sum;
    }
    let mut b = x + 1.0 - a;
    let (mut c, mut d) = (1e300, 1.0 / b);
    let mut fraction = d;
    for i in 1..10_000 {
        let numerator = -f64::from(i) * (f64::from(i) - a);
        b += 2.0;
        d = 1.0 / (numerator * d + b);
        c = b + numerator / c;
        fraction *= d * c;
        if (d * c - 1.0).abs() < 1e-15 {
            break;
        }
    }
    front * fraction
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{FRAC_1_PI, warp};

    #[test]
    fn incomplete_gamma_agrees_with_closed_forms() {
        for x in [0.1, 1.0, 3.0, 20.0] {
            assert!((upper_gamma(1.0, x) - libm::exp(-x)).abs() < 1e-14);
            assert!((upper_gamma(0.5, x) - libm::erfc(x.sqrt())).abs() < 1e-14);
            let three = libm::exp(-x) * (1.0 + x + x * x / 2.0);
            assert!((upper_gamma(3.0, x) - three).abs() < 1e-14);
        }
    }

    #[test]
    fn the_warps_match_their_densities() {
        assert_directions(
            "cosine hemisphere",
            3,
            |random| Some(warp::square_to_cosine_hemisphere(random.next_2d())),
            |d| warp::cosine_hemisphere_pdf(d.z),
        );
        assert_directions(
            "sphere",
            3,
            |random| Some(warp::square_to_sphere(random.next_2d())),
            |_| (1.0 / (4.0 * PI)) as f32,
        );
        let cone = warp::Cone::of_angle(0.8);
        assert_directions(
            "cone",
            3,
            |random| Some(cone.sample(random.next_2d())),
            |d| if d.z >= crate::math::cos(0.8) { cone.pdf() } else { 0.0 },
        );
        let axis = Vec3::new(0.48, -0.6, 0.64);
        for theta in [3.0, 1.0, 1e-2, 1e-3, 1e-4] {
            let cone = warp::Cone::of_angle(theta);
            assert_narrow(
                &format!("cone of {theta}"),
                5,
                (axis, theta),
                |random| Some(cone.sample_about(axis, random.next_2d())),
                |direction| if cone.holds(axis, direction) { cone.pdf() } else { 0.0 },
            );
        }
    }

    #[test]
    fn failures_count_as_missing_mass() {
        let outcome = chi_square_directions(
            100_000,
            1,
            |random| (random.next_1d() < 0.25).then(|| warp::square_to_sphere(random.next_2d())),
            |_| (0.25 / (4.0 * PI)) as f32,
        );
        assert!(outcome.passes(1), "{outcome:?}");
        assert!((outcome.density_mass - 0.25).abs() < 1e-6);
    }

    #[test]
    fn a_wrong_density_is_caught() {
        let hemisphere = |random: &mut PathRandom| Some(warp::square_to_cosine_hemisphere(random.next_2d()));
        let run = |density: fn(Vec3) -> f32| chi_square_directions(1 << 18, 1, hemisphere, density);
        let (uniform, tilted, partial) = (
            run(|d| if d.z > 0.0 { 0.5 * FRAC_1_PI } else { 0.0 }),
            run(|d| d.z.max(0.0) * FRAC_1_PI * (1.0 + 0.05 * d.x)),
            run(|d| 0.97 * d.z.max(0.0) * FRAC_1_PI),
        );
        assert!(uniform.p_value < 1e-12 && tilted.p_value < 1e-6 && !partial.passes(1000));
        let outside = run(|d| if d.z > 0.1 { d.z * FRAC_1_PI / 0.99 } else { 0.0 });
        assert!((outside.density_mass - 1.0).abs() < 1e-3 && outside.p_value < 1e-12);
    }

    #[test]
    fn significance_shrinks_with_the_size_of_the_family() {
        assert!((sidak(1) - FAMILY_FALSE_ALARM).abs() < 1e-15);
        let family = 1.0 - libm::pow(1.0 - sidak(40), 40.0);
        assert!((family - FAMILY_FALSE_ALARM).abs() < 1e-12);
    }
}

use super::{DVec2, to_unit_f32};
use std::sync::Arc;

/// A choice among finitely many, with given probabilities.
///
/// Sums and uniform numbers have double precision: among numbers of 24 bits a share below 2^-24 would be chosen never, or, as
/// the first one, by 0 alone and so with the share 2^-24.
#[derive(Clone, Debug, Default)]
pub(crate) struct Discrete {
    /// For each entry the probability of it or an earlier one; exactly 1 from the last entry of positive weight.
    cumulative: Arc<[f64]>,
    /// Sum of the weights.
    total: f64,
}

impl Discrete {
    /// Probabilities in proportion to `weights`, finite and not negative.
    pub(crate) fn new(weights: impl Iterator<Item = f64>) -> Self {
        let mut cumulative = Vec::new();
        let total = push_cumulative(&mut cumulative, weights);
        Self {
            cumulative: cumulative.into(),
            total,
        }
    }

    /// Sum of the weights.
    pub(crate) fn total(&self) -> f64 {
        self.total
    }

    /// The probability of an entry; zero if every weight is zero.
    pub(crate) fn probability(&self, index: usize) -> f64 {
        if self.total <= 0.0 {
            return 0.0;
        }
        self.cumulative[index] - below(&self.cumulative, index)
    }

    /// The entry for the uniform number `u`, and a new uniform number made of what `u` has left. `None` if every
    /// weight is zero. An entry of weight zero is never returned.
    pub(crate) fn sample(&self, u: f64) -> Option<(usize, f32)> {
        if self.total <= 0.0 {
            return None;
        }
        Some(sample_cumulative(&self.cumulative, u))
    }
}

/// A choice of a row among finitely many, then of an entry in it. The entries of all rows lie in one table.
#[derive(Clone, Debug)]
pub(crate) struct DiscreteRows {
    rows: Discrete,
    /// Row by row as in [`Discrete`].
    cumulative: Arc<[f64]>,
    /// Entries of a row.
    columns: usize,
}

impl DiscreteRows {
    /// Probabilities in proportion to the weights in each of `rows`, finite and not negative; each row has `columns` of them.
    pub(crate) fn new(columns: usize, rows: impl Iterator<Item = impl Iterator<Item = f64>>) -> Self {
        let mut cumulative = Vec::new();
        let rows = Discrete::new(rows.map(|weights| push_cumulative(&mut cumulative, weights)));
        Self {
            rows,
            cumulative: cumulative.into(),
            columns,
        }
    }

    /// Sum of the weights.
    pub(crate) fn total(&self) -> f64 {
        self.rows.total()
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.rows.cumulative.len()
    }

    /// Column and row for the uniform numbers `u`, each with a new uniform number, as [`Discrete::sample`].
    pub(crate) fn sample(&self, u: DVec2) -> Option<[(usize, f32); 2]> {
        let (row, rest) = self.rows.sample(u.y)?;
        let entries = &self.cumulative[row * self.columns..(row + 1) * self.columns];
        Some([sample_cumulative(entries, u.x), (row, rest)])
    }
}

/// Appends the probabilities of each of the `weights` or an earlier one, and returns the sum of the weights.
fn push_cumulative(cumulative: &mut Vec<f64>, weights: impl Iterator<Item = f64>) -> f64 {
    let (first, mut total) = (cumulative.len(), 0.0);
    cumulative.extend(weights.map(|weight| {
        total += weight;
        total
    }));
    for sum in &mut cumulative[first..] {
        *sum = if *sum < total { *sum / total } else { 1.0 };
    }
    total
}

/// The entry for the uniform number `u` by bisection, and a new uniform number; some entry has a weight.
fn sample_cumulative(cumulative: &[f64], u: f64) -> (usize, f32) {
    let index = entry(cumulative, |probability| *probability <= u);
    let below = below(cumulative, index);
    let rest = (u - below) / (cumulative[index] - below);
    (index, to_unit_f32(rest))
}

/// The first entry whose probability, with that of all before it, is not below the number that is looked for, or the last one.
fn entry(cumulative: &[f64], is_below: impl FnMut(&f64) -> bool) -> usize {
    cumulative.partition_point(is_below).min(cumulative.len() - 1)
}

/// The probability of the entries before `index`.
fn below(cumulative: &[f64], index: usize) -> f64 {
    index.checked_sub(1).map_or(0.0, |before| cumulative[before])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of values that a uniform number of 53 bits takes.
    const GRID: u64 = 1 << 53;

    /// The largest uniform number.
    const LAST: f64 = (GRID - 1) as f64 / GRID as f64;

    #[test]
    fn entries_are_chosen_in_proportion_and_the_rest_is_uniform() {
        let discrete = Discrete::new([0.0, 1.0, 0.0, 3.0, 0.0].into_iter());
        assert_eq!(discrete.total(), 4.0);
        assert_eq!(discrete.sample(0.0), Some((1, 0.0)));
        assert_eq!(discrete.sample(0.125), Some((1, 0.5)));
        assert_eq!(discrete.sample(0.25), Some((3, 0.0)));
        assert_eq!(discrete.sample(0.625), Some((3, 0.5)));
        let (last, rest) = discrete.sample(LAST).unwrap();
        assert!(last == 3 && rest < 1.0);
        assert_eq!(Discrete::new([0.0, 0.0].into_iter()).sample(0.5), None);
        assert_eq!(Discrete::new(std::iter::empty()).sample(0.5), None);
    }

    /// A choice among `n` looks at `log2 n` entries, rounded up, and one more.
    #[test]
    fn choosing_takes_steps_by_the_logarithm() {
        for bits in [0, 7, 17, 20] {
            let entries = 1_usize << bits;
            let discrete = Discrete::new(std::iter::repeat_n(1.0, entries));
            for u in [0.0, 0.3, 0.5, LAST] {
                let mut looked_at = 0;
                let chosen = entry(&discrete.cumulative, |probability| {
                    looked_at += 1;
                    *probability <= u
                });
                assert_eq!(chosen, (u * entries as f64) as usize);
                assert!(looked_at <= bits + 1, "{looked_at} of {entries} entries");
            }
        }
    }

    /// How many of the [`GRID`] uniform numbers choose each entry. The entry does not decrease with the number, so that
    /// bisection finds where each begins.
    fn chosen(discrete: &Discrete, entries: usize) -> Vec<u64> {
        let entry = |number: u64| discrete.sample(number as f64 / GRID as f64).unwrap().0;
        let begin = |index: usize| {
            let (mut low, mut high) = (0, GRID);
            while low < high {
                let middle = low + (high - low) / 2;
                if entry(middle) < index {
                    low = middle + 1;
                } else {
                    high = middle;
                }
            }
            low
        };
        let begins: Vec<u64> = (0..=entries).map(begin).collect();
        begins.windows(2).map(|pair| pair[1] - pair[0]).collect()
    }

    /// Over the whole grid of uniform numbers each entry is chosen with its share, the first and the last one as well.
    #[test]
    fn tiny_shares_are_met_over_all_uniform_numbers() {
        let tiny = 1.0 / f64::from(1_u32 << 30);
        let many: Vec<f64> = (0..100_000).map(|i| 1.0 + f64::from(i % 7) * 1e6).collect();
        for weights in [
            vec![1e-9, 1.0, tiny],
            vec![1.0, 1e-9, 0.0, tiny],
            vec![tiny, 1e-9, 1.0, 1e-12, 0.0],
            vec![0.0, 1e9, 1.0],
            many,
        ] {
            let discrete = Discrete::new(weights.iter().copied());
            let some = weights.len().min(300);
            for (index, count) in chosen(&discrete, some).into_iter().enumerate() {
                let share = weights[index] / discrete.total();
                let met = count as f64 / GRID as f64;
                assert!((met - share).abs() <= 1e-3 * share, "entry {index}: {met} for {share}");
                assert!((discrete.probability(index) - met).abs() <= 1.0 / GRID as f64);
            }
            assert!(weights[discrete.sample(0.0).unwrap().0] > 0.0);
            assert!(weights[discrete.sample(LAST).unwrap().0] > 0.0);
        }
    }
}

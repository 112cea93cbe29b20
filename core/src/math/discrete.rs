use super::ONE_MINUS_EPSILON;

/// A choice among finitely many, with given probabilities.
#[derive(Clone, Debug, Default)]
pub(crate) struct Discrete {
    /// For each entry the probability of it or an earlier one; exactly 1 from the last entry of positive weight.
    cumulative: Vec<f32>,
    /// Sum of the weights.
    total: f64,
}

impl Discrete {
    /// Probabilities in proportion to `weights`, finite and not negative.
    pub(crate) fn new(weights: impl Iterator<Item = f64>) -> Self {
        let mut total = 0.0;
        let sums: Vec<f64> = weights
            .map(|weight| {
                total += weight;
                total
            })
            .collect();
        let cumulative = sums
            .iter()
            .map(|sum| if *sum < total { (sum / total) as f32 } else { 1.0 })
            .collect();
        Self { cumulative, total }
    }

    /// Sum of the weights.
    pub(crate) fn total(&self) -> f64 {
        self.total
    }

    /// The entry for the uniform number `u`, and a new uniform number made of what `u` has left. `None` if every
    /// weight is zero. An entry of weight zero is never returned.
    pub(crate) fn sample(&self, u: f32) -> Option<(usize, f32)> {
        if self.total <= 0.0 {
            return None;
        }
        let index = self
            .cumulative
            .partition_point(|c| *c <= u)
            .min(self.cumulative.len() - 1);
        let lower = if index > 0 { self.cumulative[index - 1] } else { 0.0 };
        let rest = (u - lower) / (self.cumulative[index] - lower);
        Some((index, rest.clamp(0.0, ONE_MINUS_EPSILON)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_chosen_in_proportion_and_the_rest_is_uniform() {
        let discrete = Discrete::new([0.0, 1.0, 0.0, 3.0, 0.0].into_iter());
        assert_eq!(discrete.total(), 4.0);
        assert_eq!(discrete.sample(0.0), Some((1, 0.0)));
        assert_eq!(discrete.sample(0.125), Some((1, 0.5)));
        assert_eq!(discrete.sample(0.25), Some((3, 0.0)));
        assert_eq!(discrete.sample(0.625), Some((3, 0.5)));
        assert_eq!(discrete.sample(ONE_MINUS_EPSILON).unwrap().0, 3);
        assert_eq!(Discrete::new([0.0, 0.0].into_iter()).sample(0.5), None);
        assert_eq!(Discrete::new(std::iter::empty()).sample(0.5), None);
    }
}

//! Axes with linear or logarithmic scale behind one type.

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use std::ops::Range;

/// How values are laid out along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    /// In proportion.
    Linear,
    /// By their logarithm.
    Log,
}

/// An axis from `low` to `high`.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    scale: Scale,
    low: f64,
    high: f64,
}

impl Axis {
    /// An axis that shows `values` with a little room; `None` where none can be shown.
    pub(super) fn around(scale: Scale, values: &[f64]) -> Option<Self> {
        let places = || values.iter().filter(|v| can_show(scale, **v)).map(|v| place(scale, *v));
        let low = places().reduce(f64::min)?;
        let high = places().reduce(f64::max)?;
        let room = if high > low { 0.03 * (high - low) } else { 0.5 };
        Some(Self {
            scale,
            low: low - room,
            high: high + room,
        })
    }

    /// Whether the scale has a place for `value`.
    pub(super) fn shows(&self, value: f64) -> bool {
        can_show(self.scale, value)
    }

    /// `value`, or the lower end of the axis where the scale has no place for it.
    pub(super) fn clamp(&self, value: f64) -> f64 {
        if self.shows(value) && place(self.scale, value) >= self.low {
            value
        } else {
            self.value_at(self.low)
        }
    }

    fn value_at(&self, place: f64) -> f64 {
        match self.scale {
            Scale::Linear => place,
            Scale::Log => 10.0_f64.powf(place),
        }
    }

    /// Places of at most `count` round values.
    fn round_places(&self, count: usize) -> Vec<f64> {
        let span = self.high - self.low;
        if self.scale == Scale::Log && span < 1.5 {
            return self.within_decades(count);
        }
        let smallest = if self.scale == Scale::Log { 1.0 } else { 0.0 };
        let decade = 10.0_f64.powf((span / count.max(1) as f64).log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0, 20.0]
            .map(|m| (m * decade).max(smallest))
            .into_iter()
            .find(|step| span / step <= count as f64)
            .unwrap_or(span);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        (first..=last).map(|i| i as f64 * step).collect()
    }

    /// Places of 1, 2 and 5 times powers of ten, or of all multiples if there is room.
    fn within_decades(&self, count: usize) -> Vec<f64> {
        let decades = self.low.floor() as i32..=self.high.ceil() as i32;
        let among = |multiples: &[f64]| -> Vec<f64> {
            let all = decades
                .clone()
                .flat_map(|d| multiples.iter().map(move |m| f64::from(d) + m.log10()));
            all.filter(|p| (self.low..=self.high).contains(p)).collect()
        };
        let fine = among(&[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
        if fine.len() <= count {
            fine
        } else {
            among(&[1.0, 2.0, 5.0])
        }
    }
}

fn can_show(scale: Scale, value: f64) -> bool {
    value.is_finite() && (scale == Scale::Linear || value > 0.0)
}

fn place(scale: Scale, value: f64) -> f64 {
    match scale {
        Scale::Linear => value,
        Scale::Log => value.log10(),
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (place(self.scale, *value) - self.low) / (self.high - self.low);
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        let places = self.round_places(hint.bold_points());
        places.into_iter().map(|p| self.value_at(p)).collect()
    }

    fn range(&self) -> Range<f64> {
        self.value_at(self.low)..self.value_at(self.high)
    }
}

impl ValueFormatter<f64> for Axis {
    fn format(value: &f64) -> String {
        let rounded: f64 = format!("{value:.4e}").parse().expect("a number that was written");
        if rounded == 0.0 || (1e-3..1e5).contains(&rounded.abs()) {
            rounded.to_string()
        } else {
            format!("{rounded:e}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_round_and_few() {
        let marks = |scale, low, high| {
            let axis = Axis::around(scale, &[low, high]).unwrap();
            axis.key_points(8).iter().map(Axis::format).collect::<Vec<_>>()
        };
        assert_eq!(
            marks(Scale::Linear, 0.0, 3.0),
            ["0", "0.5", "1", "1.5", "2", "2.5", "3"]
        );
        assert_eq!(
            marks(Scale::Log, 1e-5, 10.0),
            ["1e-5", "1e-4", "0.001", "0.01", "0.1", "1", "10"]
        );
        assert_eq!(marks(Scale::Log, 1.0, 10.0), ["1", "2", "5", "10"]);
    }

    #[test]
    fn what_has_no_logarithm_is_not_shown() {
        assert!(Axis::around(Scale::Log, &[0.0, -1.0]).is_none());
        let axis = Axis::around(Scale::Log, &[1.0, 100.0]).unwrap();
        assert!(!axis.shows(0.0) && axis.shows(0.5));
        assert_eq!(axis.map(&10.0, (0, 100)), 50);
    }
}

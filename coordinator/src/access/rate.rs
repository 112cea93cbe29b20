//! Token buckets: how many requests somebody may send in a time.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::Instant;

/// Most buckets kept; full ones are forgotten first, since they say nothing.
const BUCKETS: usize = 16_384;

/// Buckets that fill with `rate` requests a second up to two seconds' worth.
#[derive(Debug)]
pub(crate) struct Buckets<K> {
    rate: f64,
    levels: HashMap<K, (f64, Instant)>,
}

impl<K: Eq + Hash> Buckets<K> {
    pub(crate) fn new(rate: u32) -> Self {
        Self {
            rate: f64::from(rate.max(1)),
            levels: HashMap::new(),
        }
    }

    fn burst(&self) -> f64 {
        2.0 * self.rate
    }

    fn level(&self, (level, at): (f64, Instant), now: Instant) -> f64 {
        let filled = now.saturating_duration_since(at).as_secs_f64() * self.rate;
        (level + filled).min(self.burst())
    }

    /// Takes one request out of the bucket of `key`, or says after how many seconds there will be one.
    pub(crate) fn take(&mut self, key: K, now: Instant) -> Result<(), u16> {
        let found = self.levels.get(&key).copied();
        if found.is_none() && self.levels.len() >= BUCKETS {
            let levels = std::mem::take(&mut self.levels);
            let kept = levels
                .into_iter()
                .filter(|(_, bucket)| self.level(*bucket, now) < self.burst());
            self.levels = kept.collect();
            if self.levels.len() >= BUCKETS {
                return Err(1);
            }
        }
        let level = found.map_or(self.burst(), |bucket| self.level(bucket, now));
        let taken = level >= 1.0;
        self.levels.insert(key, (level - f64::from(u8::from(taken)), now));
        match taken {
            true => Ok(()),
            false => Err(((1.0 - level) / self.rate).ceil().max(1.0) as u16),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_bucket_empties_and_fills() {
        let mut buckets = Buckets::new(5);
        let start = Instant::now();
        assert!((0..10).all(|_| buckets.take("a", start).is_ok()));
        assert_eq!(buckets.take("a", start), Err(1));
        assert_eq!(buckets.take("b", start), Ok(()));
        let later = start + Duration::from_millis(450);
        assert!((0..2).all(|_| buckets.take("a", later).is_ok()));
        assert_eq!(buckets.take("a", later), Err(1));
        let much_later = start + Duration::from_secs(3600);
        assert!((0..10).all(|_| buckets.take("a", much_later).is_ok()));
        assert!(buckets.take("a", much_later).is_err());
    }

    #[test]
    fn what_is_remembered_is_bounded() {
        let mut buckets = Buckets::new(1);
        let start = Instant::now();
        for key in 0..BUCKETS {
            assert_eq!(buckets.take(key, start), Ok(()));
        }
        assert!(buckets.take(BUCKETS, start).is_err());
        let later = start + Duration::from_secs(2);
        assert_eq!(buckets.take(BUCKETS, later), Ok(()));
        assert_eq!(buckets.levels.len(), 1);
    }
}

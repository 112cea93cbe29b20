//! Ordered maps and sets of the scheduler. In tests they count the entries that are looked at, so that what an event
//! costs is a number that a test can hold.

use std::borrow::Borrow;
use std::collections::BTreeMap;
use std::ops::{Index, RangeBounds};

#[cfg(test)]
thread_local! {
    /// Entries looked at in this thread.
    pub(super) static LOOKS: std::cell::Cell<u64> = const { std::cell::Cell::new(0) };
}

/// An entry is looked at.
fn look() {
    #[cfg(test)]
    LOOKS.set(LOOKS.get() + 1);
}

/// An ordered map: what it does to one entry takes logarithmic time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Table<K, V>(BTreeMap<K, V>);

/// An ordered set.
pub(super) type Set<K> = Table<K, ()>;

impl<K, V> Default for Table<K, V> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl<K: Ord, V> FromIterator<(K, V)> for Table<K, V> {
    fn from_iter<I: IntoIterator<Item = (K, V)>>(entries: I) -> Self {
        Self(entries.into_iter().collect())
    }
}

impl<K: Ord, V> Index<&K> for Table<K, V> {
    type Output = V;

    fn index(&self, key: &K) -> &V {
        look();
        &self.0[key]
    }
}

impl<K: Ord, V> Table<K, V> {
    pub(super) fn get<Q: Ord + ?Sized>(&self, key: &Q) -> Option<&V>
    where
        K: Borrow<Q>,
    {
        look();
        self.0.get(key)
    }

    pub(super) fn get_mut(&mut self, key: &K) -> Option<&mut V> {
        look();
        self.0.get_mut(key)
    }

    pub(super) fn get_or_default(&mut self, key: K) -> &mut V
    where
        V: Default,
    {
        look();
        self.0.entry(key).or_default()
    }

    pub(super) fn contains_key(&self, key: &K) -> bool {
        self.get(key).is_some()
    }

    pub(super) fn insert(&mut self, key: K, value: V) {
        look();
        self.0.insert(key, value);
    }

    pub(super) fn remove(&mut self, key: &K) -> Option<V> {
        look();
        self.0.remove(key)
    }

    pub(super) fn range(&self, range: impl RangeBounds<K>) -> impl DoubleEndedIterator<Item = (&K, &V)> + Clone {
        self.0.range(range).inspect(|_| look())
    }

    pub(super) fn iter(&self) -> impl DoubleEndedIterator<Item = (&K, &V)> + Clone {
        self.0.iter().inspect(|_| look())
    }

    pub(super) fn keys(&self) -> impl DoubleEndedIterator<Item = &K> + Clone {
        self.iter().map(|(key, _)| key)
    }

    pub(super) fn values(&self) -> impl DoubleEndedIterator<Item = &V> + Clone {
        self.iter().map(|(_, value)| value)
    }

    pub(super) fn for_each_mut(&mut self, mut change: impl FnMut(&mut V)) {
        for value in self.0.values_mut() {
            look();
            change(value);
        }
    }

    pub(super) fn first(&self) -> Option<(&K, &V)> {
        self.iter().next()
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl<K: Ord> Set<K> {
    /// Puts a key into the set, or takes it out.
    pub(super) fn set(&mut self, key: K, inside: bool) {
        match inside {
            true => self.insert(key, ()),
            false => _ = self.remove(&key),
        }
    }
}

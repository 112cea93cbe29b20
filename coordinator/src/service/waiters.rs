//! Workers that wait for work. Whatever may bring work wakes one of those that can do the same, and whoever is given
//! some wakes the next: an event costs the same however many wait.

use crate::scheduler::Skill;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::Notify;

/// Who waits, by what they can do.
#[derive(Debug, Default)]
pub(super) struct Waiters {
    rooms: Mutex<BTreeMap<Arc<Skill>, Arc<Notify>>>,
}

impl Waiters {
    /// Where workers of a skill wait.
    pub(super) fn room(&self, skill: Arc<Skill>) -> Arc<Notify> {
        let mut rooms = self.rooms.lock().unwrap_or_else(PoisonError::into_inner);
        rooms.entry(skill).or_default().clone()
    }

    /// There may be work: one of each skill looks. Rooms in which nobody waits are given up.
    pub(super) fn wake(&self) {
        let mut rooms = self.rooms.lock().unwrap_or_else(PoisonError::into_inner);
        rooms.retain(|_, room| {
            room.notify_one();
            Arc::strong_count(room) > 1
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::FutureExt;
    use std::pin::pin;

    fn skill(renderer: &str) -> Arc<Skill> {
        Arc::new(Skill {
            renderer: renderer.into(),
            tags: Default::default(),
            memory_mb: None,
        })
    }

    #[test]
    fn one_of_each_skill_is_woken_and_wakes_the_next() {
        let waiters = Waiters::default();
        let (a, b) = (waiters.room(skill("a")), waiters.room(skill("b")));
        let (mut first, mut second, mut other) = (pin!(a.notified()), pin!(a.notified()), pin!(b.notified()));
        for waiter in [first.as_mut(), second.as_mut(), other.as_mut()] {
            waiter.enable();
        }
        waiters.wake();
        assert!(first.as_mut().now_or_never().is_some() && other.as_mut().now_or_never().is_some());
        assert!(second.as_mut().now_or_never().is_none());
        waiters.room(skill("a")).notify_one();
        assert!(second.as_mut().now_or_never().is_some());
    }

    #[test]
    fn empty_rooms_are_given_up() {
        let waiters = Waiters::default();
        let kept = waiters.room(skill("a"));
        drop(waiters.room(skill("b")));
        waiters.wake();
        assert_eq!(waiters.rooms.lock().unwrap().len(), 1);
        drop(kept);
    }
}

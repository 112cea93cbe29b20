//! How many connections there may be at once: of all addresses, and of each.

use crate::access::network;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// The slots of each address: so many connections may it have at once.
#[derive(Clone)]
pub(super) struct Slots {
    most: usize,
    taken: Arc<Mutex<HashMap<IpAddr, usize>>>,
}

/// A slot that is free again when it is dropped.
pub(super) struct Slot {
    address: IpAddr,
    taken: Arc<Mutex<HashMap<IpAddr, usize>>>,
}

impl Slots {
    pub(super) fn new(most: usize) -> Self {
        Self {
            most,
            taken: Arc::default(),
        }
    }

    /// A slot for a connection from this address, if it has one left.
    pub(super) fn take(&self, peer: IpAddr) -> Option<Slot> {
        let address = network(peer);
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        let number = taken.entry(address).or_default();
        if *number == self.most {
            return None;
        }
        *number += 1;
        Some(Slot {
            address,
            taken: self.taken.clone(),
        })
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(number) = taken.get_mut(&self.address) {
            *number -= 1;
            if *number == 0 {
                taken.remove(&self.address);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_address_has_its_slots() {
        let slots = Slots::new(2);
        let take = |address: &str| slots.take(address.parse().unwrap());
        let first = take("10.0.0.1");
        let second = take("::ffff:10.0.0.1");
        assert!(first.is_some() && second.is_some() && take("10.0.0.1").is_none());
        assert!(take("10.0.0.2").is_some(), "another address");
        drop(first);
        assert!(take("10.0.0.1").is_some());
        drop(second);
        assert!(
            slots.taken.lock().unwrap().is_empty(),
            "nothing is remembered of who has gone"
        );
    }
}

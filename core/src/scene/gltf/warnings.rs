//! What is told about a file besides its faults.

use crate::scene::error::Place;
use crate::scene::warning::Warnings;
use std::rc::Rc;

/// Warnings of one file, which has no lines that mean anything to its author.
pub(super) struct Told {
    place: Place,
    warnings: Rc<Warnings>,
}

impl Told {
    pub(super) fn new(place: &Place, warnings: &Rc<Warnings>) -> Self {
        Self {
            place: place.clone(),
            warnings: warnings.clone(),
        }
    }

    pub(super) fn place(&self) -> &Place {
        &self.place
    }

    pub(super) fn warn(&self, message: impl Into<String>) {
        self.warnings.note(&self.place, message);
    }
}

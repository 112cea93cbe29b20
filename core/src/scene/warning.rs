//! What is allowed in a scene and probably not meant, or is not rendered as it is written.

use super::error::Place;
use std::cell::RefCell;
use std::fmt;

/// Something in a scene that is allowed and probably not meant, that was decided for its author, or that is left out of the picture. It
/// starts with the place, `file:line`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneWarning {
    /// Where.
    pub place: Place,
    /// What is strange, and what to do about it or what it does to the picture.
    pub message: String,
}

impl fmt::Display for SceneWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.message)
    }
}

/// The most warnings and the most remarks of a scene that are told.
const MOST: usize = 50;

/// Warnings and remarks so far.
#[derive(Debug, Default)]
pub(crate) struct Warnings {
    warnings: List,
    remarks: List,
}

impl Warnings {
    /// Notes a warning. What is said twice is told once, with the number of places.
    pub(crate) fn note(&self, place: &Place, message: impl Into<String>) {
        self.warnings.note(place, message.into());
    }

    /// Notes what is accepted and changes nothing in the picture, for those who ask.
    pub(crate) fn remark(&self, place: &Place, message: impl Into<String>) {
        self.remarks.note(place, message.into());
    }

    /// Takes all warnings out.
    pub(crate) fn take(&self) -> Vec<SceneWarning> {
        self.warnings.take("warnings")
    }

    /// Takes all remarks out.
    pub(crate) fn take_remarks(&self) -> Vec<SceneWarning> {
        self.remarks.take("notes")
    }
}

/// What is said, in the order in which it was found.
#[derive(Debug, Default)]
struct List {
    /// Each with the number of further places that it holds for.
    told: RefCell<Vec<(SceneWarning, u64)>>,
    /// The first place beyond [`MOST`] of them, and how many there are.
    others: RefCell<Option<(Place, u64)>>,
}

impl List {
    fn note(&self, place: &Place, message: String) {
        let mut told = self.told.borrow_mut();
        if let Some((first, more)) = told.iter_mut().find(|(warning, _)| warning.message == message) {
            *more += u64::from(first.place != *place);
        } else if told.len() < MOST {
            let place = place.clone();
            told.push((SceneWarning { place, message }, 0));
        } else {
            self.others.borrow_mut().get_or_insert_with(|| (place.clone(), 0)).1 += 1;
        }
    }

    fn take(&self, what: &str) -> Vec<SceneWarning> {
        let told = self.told.take().into_iter().map(|(mut warning, more)| {
            match more {
                0 => {}
                1 => warning.message.push_str(" (and at 1 more place)"),
                _ => warning.message.push_str(&format!(" (and at {more} more places)")),
            }
            warning
        });
        let others = self.others.take().map(|(place, count)| SceneWarning {
            place,
            message: format!("from here on there are {count} more {what}"),
        });
        told.chain(others).collect()
    }
}

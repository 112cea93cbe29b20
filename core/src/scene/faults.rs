//! All faults of a scene, found in one reading.

use super::error::{SceneError, within};
use std::cell::RefCell;
use std::fmt;

/// The most faults that one reading finds: with so many, few are of their own.
const MOST: u64 = 20;

/// Everything that is wrong with a scene, each fault once, in the order in which they were found. There is at least one.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFaults(Vec<SceneError>);

impl SceneFaults {
    /// The first fault.
    #[must_use]
    pub fn first(&self) -> &SceneError {
        &self.0[0]
    }

    /// All faults.
    #[must_use]
    pub fn all(&self) -> &[SceneError] {
        &self.0
    }
}

/// The fault, or their number and each in a line of its own.
impl fmt::Display for SceneFaults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0[..] {
            [fault] => write!(f, "{fault}"),
            faults => {
                write!(f, "{} faults:", faults.len())?;
                faults.iter().try_for_each(|fault| write!(f, "\n  {fault}"))
            }
        }
    }
}

impl std::error::Error for SceneFaults {}

/// Faults that were found so far.
#[derive(Debug, Default)]
pub(crate) struct Faults(RefCell<Vec<SceneError>>);

impl Faults {
    /// Notes a fault, so that reading can go on.
    ///
    /// # Errors
    /// A fault that ends the reading: a limit, which may be that of faults.
    pub(crate) fn note(&self, fault: SceneError) -> Result<(), SceneError> {
        if matches!(fault, SceneError::Limit { .. }) {
            return Err(fault);
        }
        let mut faults = self.0.borrow_mut();
        if faults.contains(&fault) {
            return Ok(());
        }
        within(fault.place(), "number of faults", faults.len() as u64 + 1, MOST)?;
        faults.push(fault);
        Ok(())
    }

    pub(crate) fn any(&self) -> bool {
        !self.0.borrow().is_empty()
    }

    /// What a reading found that ended with `result`.
    pub(crate) fn settle<T>(&self, result: Result<Option<T>, SceneError>) -> Result<T, SceneFaults> {
        let mut faults = self.0.take();
        match result {
            Ok(Some(value)) if faults.is_empty() => return Ok(value),
            Ok(_) => {}
            Err(last) => faults.push(last),
        }
        Err(SceneFaults(faults))
    }
}

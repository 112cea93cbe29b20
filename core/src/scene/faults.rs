//! All faults of a scene, found in one reading.

use super::error::{Place, SceneError, within};
use super::warning::{SceneWarning, Warnings};
use std::cell::RefCell;
use std::fmt;

/// The most faults that one reading finds: with so many, few are of their own.
const MOST: u64 = 20;

/// Everything that is wrong with a scene, each fault once, in the order in which they were found. There is at least one.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFaults {
    faults: Vec<SceneError>,
    /// What was warned about besides: a fault may follow from it, as from a name that is misspelt.
    warnings: Vec<SceneWarning>,
}

impl SceneFaults {
    /// The first fault.
    #[must_use]
    pub fn first(&self) -> &SceneError {
        &self.faults[0]
    }

    /// All faults.
    #[must_use]
    pub fn all(&self) -> &[SceneError] {
        &self.faults
    }

    /// What was warned about besides.
    #[must_use]
    pub fn warnings(&self) -> &[SceneWarning] {
        &self.warnings
    }
}

/// The fault, or their number and each in a line of its own; then the warnings.
impl fmt::Display for SceneFaults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.faults[..] {
            [fault] => write!(f, "{fault}")?,
            faults => {
                write!(f, "{} faults:", faults.len())?;
                faults.iter().try_for_each(|fault| write!(f, "\n  {fault}"))?;
            }
        }
        let mut warnings = self.warnings.iter();
        warnings.try_for_each(|warning| write!(f, "\n  warning: {warning}"))
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

    /// Notes all faults but the last, which comes back; so does one that ends the reading.
    pub(crate) fn all_but_last(&self, faults: Vec<SceneError>) -> SceneError {
        let mut faults = faults.into_iter();
        let mut last = faults.next().expect("who failed has a fault");
        for fault in faults {
            if let Err(end) = self.note(std::mem::replace(&mut last, fault)) {
                return end;
            }
        }
        last
    }

    pub(crate) fn any(&self) -> bool {
        !self.0.borrow().is_empty()
    }

    /// What a reading found that ended with `result` and has warned about `warnings`.
    pub(crate) fn settle<T>(
        &self,
        result: Result<Option<T>, SceneError>,
        warnings: &Warnings,
    ) -> Result<T, SceneFaults> {
        let mut faults = self.0.take();
        match result {
            Ok(Some(value)) if faults.is_empty() => return Ok(value),
            Ok(_) => {}
            Err(last) => faults.push(last),
        }
        let warnings = warnings.take();
        Err(SceneFaults { faults, warnings })
    }
}

/// The most faults of one mesh, image or spectrum file that are told.
const MOST_OF_FILE: usize = 10;

/// Faults beyond those that are told, after which a file is not read on.
const MOST_OTHERS: u64 = 1000;

/// Faults of one mesh, image or spectrum file.
#[derive(Debug, Default)]
pub(crate) struct FileFaults {
    told: Vec<SceneError>,
    /// How many more there are.
    others: u64,
}

impl FileFaults {
    /// Notes a fault, so that reading can go on.
    ///
    /// # Errors
    /// A fault that ends the reading: there are too many.
    pub(crate) fn note(&mut self, fault: SceneError) -> Result<(), SceneError> {
        if self.told.len() < MOST_OF_FILE {
            self.told.push(fault);
        } else if self.others < MOST_OTHERS {
            self.others += 1;
        } else {
            let reason = format!("and more than {MOST_OTHERS} more faults; the file was not read on");
            self.others = 0;
            return Err(SceneError::data(&Place::whole(fault.file()), reason));
        }
        Ok(())
    }

    /// The result of a reading, if nothing was noted, or all faults.
    pub(crate) fn settle<T>(mut self, result: Result<T, SceneError>) -> Result<T, Vec<SceneError>> {
        let last = match result {
            Ok(value) if self.told.is_empty() => return Ok(value),
            Ok(_) => None,
            Err(last) => Some(last),
        };
        if let (1.., Some(first)) = (self.others, self.told.first()) {
            let reason = format!("and {} more faults", self.others);
            self.told.push(SceneError::data(&Place::whole(first.file()), reason));
        }
        self.told.extend(last);
        Err(self.told)
    }
}

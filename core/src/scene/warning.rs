//! What is allowed in a scene and probably not meant.

use super::error::Place;
use std::fmt;

/// Something in a scene that is allowed and probably not meant, or that was decided for its author. It starts with the
/// place, `file:line`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneWarning {
    /// Where.
    pub place: Place,
    /// What is strange, and what to do about it.
    pub message: String,
}

impl fmt::Display for SceneWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.message)
    }
}

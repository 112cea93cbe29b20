//! glTF 2.0: from files to a [`Description`].

use super::description::Description;
use super::error::{Place, SceneError};
use super::faults::Faults;
use super::loader::{LoadedFile, Loader};
use super::warning::Warnings;
use std::rc::Rc;

/// Reads a scene file and what it includes.
pub(crate) fn read(
    _loader: &mut Loader,
    file: &LoadedFile,
    _faults: &Rc<Faults>,
    _warnings: &Rc<Warnings>,
) -> Result<Description, SceneError> {
    let place = Place::whole(&file.name);
    let context = "scene file".to_owned();
    let (what, instead) = ("the format of glTF".to_owned(), "there is: Mitsuba's XML".to_owned());
    Err(SceneError::Unsupported {
        place,
        context,
        what,
        instead,
    })
}

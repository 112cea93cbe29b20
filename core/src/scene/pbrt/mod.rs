//! The text format of pbrt-v4, and the names of pbrt-v3 that changed: from files to a [`Description`].
//!
//! A file is a list of directives that change a state and add objects in it. What they mean is that of pbrt-v4's own sources
//! (`parser.cpp`, `scene.cpp` and the `Create` functions of its parts) and of its documentation of the format; the objects that come
//! out are those that Mitsuba's format has, under the names of pbrt.
//!
//! The world of pbrt is left-handed: its camera looks along +z with +x to the right and +y up, while ours has +x to the left. Points
//! stay as they are written, and the camera alone is mirrored.

mod camera;
mod colour;
mod curve;
mod directive;
mod grid;
mod heat;
mod light;
mod material;
mod medium;
mod old_material;
mod parameter;
mod quadric;
mod shape;
mod state;
mod subdivision;
#[cfg(test)]
mod tests;
mod texture;
mod token;
mod values;
mod volume;

use super::description::{Description, Draft, Kind, ObjectId, Value};
use super::error::{Place, SceneError, within};
use super::faults::Faults;
use super::loader::{LoadedFile, Loader};
use super::warning::Warnings;
use crate::math::{AnimatedTransform, Transform};
use camera::Views;
use curve::Strands;
use glam::DMat4;
use state::{Block, State};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;
use texture::Tint;
use token::Tokens;

/// Reads a scene file and what it includes.
pub(crate) fn read(
    loader: &mut Loader,
    file: &LoadedFile,
    faults: &Rc<Faults>,
    warnings: &Rc<Warnings>,
) -> Result<Description, SceneError> {
    let place = Place::whole(&file.name);
    let search: Arc<[String]> = [file.folder().to_owned()].into();
    let mut reading = Reading {
        loader,
        draft: Draft::new(place.clone(), search.clone(), faults, warnings),
        search,
        faults: faults.clone(),
        warnings: warnings.clone(),
        state: State::default(),
        blocks: Vec::new(),
        systems: BTreeMap::new(),
        materials: BTreeMap::new(),
        media: BTreeMap::new(),
        textures: BTreeMap::new(),
        groups: BTreeMap::new(),
        group: None,
        times: [0.0, 1.0],
        views: Views::default(),
        strands: None,
        in_world: false,
        shapes: 0,
        open_files: Vec::new(),
        included: 0,
        bytes: 0,
        volume_bytes: 0,
        old: false,
    };
    reading.file(file, &place)?;
    reading.finish()
}

/// A scene as it is read.
struct Reading<'r, 'f> {
    loader: &'r mut Loader<'f>,
    draft: Draft,
    /// The folder in which files are looked for: that of the main file.
    search: Arc<[String]>,
    faults: Rc<Faults>,
    warnings: Rc<Warnings>,
    state: State,
    /// What has begun and not ended: the state that comes back, and where it began.
    blocks: Vec<(Block, State, Place)>,
    /// Coordinate systems by name.
    systems: BTreeMap<String, [DMat4; 2]>,
    /// Materials by name.
    materials: BTreeMap<String, ObjectId>,
    /// Media by name; `None` for those that are left out.
    media: BTreeMap<String, Option<ObjectId>>,
    /// Textures by whether they are of numbers, and by name.
    textures: BTreeMap<(bool, String), Tint>,
    /// Groups of shapes by the name of their object.
    groups: BTreeMap<String, ObjectId>,
    /// The group that an `ObjectBegin` has begun.
    group: Option<ObjectId>,
    /// The times of the two transforms.
    times: [f64; 2],
    views: Views,
    /// Curves that may go on.
    strands: Option<Strands>,
    /// Whether `WorldBegin` was read.
    in_world: bool,
    shapes: u64,
    /// Names of the files being read, outermost first.
    open_files: Vec<String>,
    included: u64,
    /// Bytes of text read, repetitions included.
    bytes: u64,
    /// Bytes of the lattices of media.
    volume_bytes: u64,
    /// Whether something in the file is of pbrt-v3 alone.
    old: bool,
}

impl Reading<'_, '_> {
    /// Reads the directives of a file that is used at `place`.
    fn file(&mut self, file: &LoadedFile, place: &Place) -> Result<(), SceneError> {
        if self.open_files.contains(&file.name) {
            let chain = [&self.open_files[..], std::slice::from_ref(&file.name)]
                .concat()
                .join(" -> ");
            let place = place.clone();
            return Err(SceneError::IncludeCycle { place, chain });
        }
        let limits = self.loader.limits;
        let depth = self.open_files.len() as u64 + 1;
        within(place, "nesting of files", depth, limits.depth.into())?;
        self.bytes += file.bytes.len() as u64;
        within(
            place,
            "bytes of scene files, repetitions included",
            self.bytes,
            limits.total_bytes,
        )?;
        self.open_files.push(file.name.clone());
        let mut tokens = Tokens::new(&file.name, file.bytes.clone());
        self.directives(&mut tokens)?;
        self.open_files.pop();
        Ok(())
    }

    /// Reads the file `name` in the place of the directive that names it.
    fn include(&mut self, place: &Place, name: &str) -> Result<(), SceneError> {
        self.included += 1;
        within(
            place,
            "number of included files",
            self.included,
            self.loader.limits.includes,
        )?;
        let mut search = self.search.to_vec();
        if let Some((folder, _)) = self.open_files.last().and_then(|file| file.rsplit_once('/')) {
            search.push(folder.to_owned());
        }
        match self.loader.open(place, &search, name) {
            Ok(file) => self.file(&file, place),
            Err(fault) => self.faults.note(fault),
        }
    }

    fn finish(mut self) -> Result<Description, SceneError> {
        for (block, _, place) in &self.blocks {
            let message = format!("{}: the scene ends before it does", block.begin());
            self.warnings.note(place, message);
        }
        self.finish_strands()?;
        self.view()?;
        Ok(self.draft.finish())
    }

    /// Adds an object that is called what `parameters` are.
    fn add(&mut self, kind: Kind, plugin: &str, parameters: &parameter::Parameters) -> ObjectId {
        self.draft
            .add(kind, plugin, Some(&parameters.context), &parameters.place)
    }

    /// Sets `to_world` of an object: a map, or two at the times of `TransformTimes`.
    fn set_to_world(&mut self, object: ObjectId, [start, end]: [DMat4; 2]) -> Result<(), SceneError> {
        let to_world = if start == end {
            Transform::from_matrix(start).map(|transform| Value::Transform(Box::new(transform)))
        } else {
            let keyframes = Transform::from_matrix(start).zip(Transform::from_matrix(end));
            let [open, close] = self.times;
            keyframes
                .and_then(|(start, end)| AnimatedTransform::new(vec![(open, start), (close, end)]))
                .map(Value::Animation)
        };
        match to_world {
            Some(value) => self.draft.set(object, "to_world", value),
            None => {
                let object = &self.draft.objects[object];
                let written = object.written.as_deref().unwrap_or_default();
                let reason = "the transform here has no finite inverse, projects, or mirrors at one time only";
                self.faults.note(SceneError::value(&object.place, written, reason))?;
            }
        }
        Ok(())
    }
}

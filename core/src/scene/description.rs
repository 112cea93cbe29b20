//! The scene as written: untrusted, only checked for its form.

use super::error::{Place, SceneError};
use super::faults::Faults;
use super::loader::LoadedFile;
use super::mesh::RawMesh;
use super::warning::Warnings;
use crate::light::Portal;
use crate::math::{AnimatedTransform, Transform};
use crate::medium::Grid;
use glam::DVec3;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;

/// A scene file with all that it includes. Object 0 is the `<scene>`.
#[derive(Debug)]
pub(crate) struct Description {
    pub(crate) objects: Vec<Object>,
    /// Objects by id.
    pub(crate) ids: BTreeMap<String, ObjectId>,
    /// What objects are called that have no id, or not alone.
    pub(crate) called: BTreeMap<ObjectId, Arc<str>>,
    /// What is wrong with the scene.
    pub(crate) faults: Rc<Faults>,
    /// What is left out, or probably not meant.
    pub(crate) warnings: Rc<Warnings>,
}

impl Description {
    /// The result of reading an object. A fault is noted, and the object counts as left out.
    ///
    /// # Errors
    /// A fault that ends the reading.
    pub(crate) fn attempt<T>(&self, object: ObjectId, result: Result<T, SceneError>) -> Result<Option<T>, SceneError> {
        let fault = match result {
            Ok(value) => return Ok(Some(value)),
            Err(fault) => fault,
        };
        // What is missing or does not fit together may follow from a fault that was told.
        let follows = matches!(fault, SceneError::Missing { .. } | SceneError::Value { .. });
        if !(self.objects[object].faulty.replace(true) && follows) {
            self.faults.note(fault)?;
        }
        Ok(None)
    }
}

/// A description that a front end writes object by object. Object 0 is the scene.
pub(crate) struct Draft {
    pub(crate) objects: Vec<Object>,
    pub(crate) ids: BTreeMap<String, ObjectId>,
    called: BTreeMap<ObjectId, Arc<str>>,
    pub(crate) faults: Rc<Faults>,
    pub(crate) warnings: Rc<Warnings>,
}

impl Draft {
    /// A scene without objects. `search` are the folders in which its files are looked for.
    pub(crate) fn new(place: Place, search: Arc<[String]>, faults: &Rc<Faults>, warnings: &Rc<Warnings>) -> Self {
        Self {
            objects: vec![Object::new(Kind::Scene, "", None, place, search)],
            ids: BTreeMap::new(),
            called: BTreeMap::new(),
            faults: faults.clone(),
            warnings: warnings.clone(),
        }
    }

    /// Adds an object that nothing refers to yet. `written` is what messages call it, where that is not the element of the XML format.
    pub(crate) fn add(&mut self, kind: Kind, plugin: &str, written: Option<&str>, place: &Place) -> ObjectId {
        let search = self.objects[0].search.clone();
        self.objects
            .push(Object::new(kind, plugin, written, place.clone(), search));
        self.objects.len() - 1
    }

    /// Says what an object is called; several may be called the same. An empty name says nothing.
    pub(crate) fn call(&mut self, object: ObjectId, name: &str) {
        if !name.is_empty() {
            self.called.insert(object, name.into());
        }
    }

    /// Makes `target` a child of `parent`, with the name that says what it is for.
    pub(crate) fn link(&mut self, parent: ObjectId, name: Option<&str>, target: ObjectId) {
        let place = self.objects[target].place.clone();
        let name = name.map(str::to_owned);
        self.objects[parent].children.push(Child { name, place, target });
    }

    /// Sets a property of an object, at the place of the object.
    pub(crate) fn set(&mut self, object: ObjectId, name: &str, value: Value) {
        let place = self.objects[object].place.clone();
        self.set_at(object, name, value, place);
    }

    /// Sets a property of an object, written at `place`.
    pub(crate) fn set_at(&mut self, object: ObjectId, name: &str, value: Value, place: Place) {
        let property = Property { value, place };
        self.objects[object].properties.insert(name.to_owned(), property);
    }

    pub(crate) fn finish(self) -> Description {
        Description {
            objects: self.objects,
            ids: self.ids,
            called: self.called,
            faults: self.faults,
            warnings: self.warnings,
        }
    }
}

/// Index into [`Description::objects`].
pub(crate) type ObjectId = usize;

/// An element that stands for a plugin: `<bsdf type="diffuse">`.
#[derive(Debug)]
pub(crate) struct Object {
    pub(crate) kind: Kind,
    /// The `type` attribute; empty for `<scene>`.
    pub(crate) plugin: String,
    /// What messages call it; `None` stands for the element of the XML format.
    pub(crate) written: Option<Arc<str>>,
    pub(crate) place: Place,
    /// Folders in which file names are looked for, in order.
    pub(crate) search: Arc<[String]>,
    /// Values by normalised name.
    pub(crate) properties: BTreeMap<String, Property>,
    pub(crate) children: Vec<Child>,
    /// Whether it stands in a file for Mitsuba 0.x, where some types mean something else than in Mitsuba 3.
    pub(crate) old_dialect: bool,
    /// Whether a fault of it was noted; what follows from that is not told.
    pub(crate) faulty: Cell<bool>,
}

impl Object {
    pub(crate) fn new(kind: Kind, plugin: &str, written: Option<&str>, place: Place, search: Arc<[String]>) -> Self {
        Self {
            kind,
            plugin: plugin.to_owned(),
            written: written.map(Into::into),
            place,
            search,
            properties: BTreeMap::new(),
            children: Vec::new(),
            old_dialect: false,
            faulty: Cell::new(false),
        }
    }
}

/// A value with its place.
#[derive(Debug)]
pub(crate) struct Property {
    pub(crate) value: Value,
    pub(crate) place: Place,
}

/// A nested or referenced object.
#[derive(Debug)]
pub(crate) struct Child {
    /// The `name` attribute, which says what a texture is for.
    pub(crate) name: Option<String>,
    pub(crate) place: Place,
    pub(crate) target: ObjectId,
}

/// What an object is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Scene,
    Integrator,
    Sensor,
    Film,
    Sampler,
    Filter,
    Shape,
    Bsdf,
    Emitter,
    Texture,
    Medium,
    Volume,
    Phase,
    Subsurface,
}

impl Kind {
    /// Element names, in the order of messages.
    pub(crate) const ELEMENTS: [(&'static str, Kind); 14] = [
        ("scene", Kind::Scene),
        ("integrator", Kind::Integrator),
        ("sensor", Kind::Sensor),
        ("film", Kind::Film),
        ("sampler", Kind::Sampler),
        ("rfilter", Kind::Filter),
        ("shape", Kind::Shape),
        ("bsdf", Kind::Bsdf),
        ("emitter", Kind::Emitter),
        ("texture", Kind::Texture),
        ("medium", Kind::Medium),
        ("volume", Kind::Volume),
        ("phase", Kind::Phase),
        ("subsurface", Kind::Subsurface),
    ];

    /// What a scene is without objects of this kind, of which none is rendered.
    pub(crate) fn left_out(self) -> Option<&'static str> {
        match self {
            Self::Subsurface => Some("light leaves a surface where it arrives"),
            _ => None,
        }
    }

    pub(crate) fn element(self) -> &'static str {
        Self::ELEMENTS
            .iter()
            .find(|(_, kind)| *kind == self)
            .map_or("", |(name, _)| name)
    }
}

/// A typed value. Numbers are finite.
#[derive(Debug)]
pub(crate) enum Value {
    Float(f64),
    Integer(i64),
    Boolean(bool),
    String(String),
    /// A point or a vector.
    Vector(DVec3),
    Rgb([f64; 3]),
    Spectrum(SpectrumValue),
    Transform(Box<Transform>),
    Animation(AnimatedTransform),
    /// The triangles of a shape of type `mesh`, which other formats hold in the scene file itself.
    Mesh(SharedMesh),
    /// The lattice of a volume that a scene file holds itself, as scene files of pbrt do.
    Grid(Arc<Grid>),
    /// What a light at infinity shines through, which scene files of pbrt have alone.
    Portal(Portal),
    /// A file in place of its name, where the scene file holds its content.
    File(LoadedFile),
}

impl Value {
    pub(crate) fn type_name(&self) -> &'static str {
        match self {
            Self::Float(_) => "float",
            Self::Integer(_) => "integer",
            Self::Boolean(_) => "boolean",
            Self::String(_) => "string",
            Self::Vector(_) => "point or vector",
            Self::Rgb(_) => "rgb",
            Self::Spectrum(_) => "spectrum",
            Self::Transform(_) => "transform",
            Self::Animation(_) => "animation",
            Self::Mesh(_) => "mesh",
            Self::Grid(_) => "grid",
            Self::Portal(_) => "portal",
            Self::File(_) => "file",
        }
    }
}

/// Triangles that several shapes may have.
#[derive(Debug)]
pub(crate) struct SharedMesh(RefCell<Arc<RawMesh>>);

impl SharedMesh {
    /// The triangles.
    pub(crate) fn get(&self) -> Arc<RawMesh> {
        self.0.borrow().clone()
    }

    /// The triangles, for the last one who needs them: none are left, and so memory need not hold them twice.
    pub(crate) fn take(&self) -> Arc<RawMesh> {
        self.0.take()
    }
}

impl From<RawMesh> for SharedMesh {
    fn from(mesh: RawMesh) -> Self {
        Arc::new(mesh).into()
    }
}

impl From<Arc<RawMesh>> for SharedMesh {
    fn from(mesh: Arc<RawMesh>) -> Self {
        Self(RefCell::new(mesh))
    }
}

/// A `<spectrum>`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum SpectrumValue {
    /// The same at every wavelength.
    Uniform(f64),
    /// Piecewise linear; wavelengths \[nm\] rise strictly, and there are at least two.
    Sampled(Vec<(f64, f64)>),
}

//! What small scenes of pbrt become.

mod faults;
mod lights;
mod media;
mod surfaces;
mod views;

use super::read;
use crate::geometry::Ray;
use crate::math::{DVec3, Vec3};
use crate::scene::description::{Description, Kind, Object, Value};
use crate::scene::faults::Faults;
use crate::scene::loader::Loader;
use crate::scene::warning::Warnings;
use crate::scene::{Limits, Scene, SceneFaults};
use crate::spectrum::Spectrum;
use std::collections::BTreeMap;
use std::rc::Rc;

/// A scene file with other files beside it.
fn files(text: &str, others: &[(&str, &[u8])]) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::from([("main.pbrt".to_owned(), text.as_bytes().to_vec())]);
    files.extend(others.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())));
    files
}

fn load_with(text: &str, others: &[(&str, &[u8])]) -> Result<Scene, SceneFaults> {
    Scene::load(&files(text, others), "main.pbrt", &BTreeMap::new(), &Limits::default())
}

fn load(text: &str) -> Scene {
    load_with(text, &[]).unwrap_or_else(|faults| panic!("{faults}"))
}

/// What a text becomes, and its warnings.
fn describe_with(text: &str, others: &[(&str, &[u8])]) -> (Description, Vec<String>) {
    let (files, limits) = (files(text, others), Limits::default());
    let mut loader = Loader::new(&files, &limits);
    let (faults, warnings) = (Rc::new(Faults::default()), Rc::new(Warnings::default()));
    let place = crate::scene::Place::whole("main.pbrt");
    let file = loader.open(&place, &[String::new()], "main.pbrt").unwrap();
    let description = read(&mut loader, &file, &faults, &warnings).unwrap_or_else(|error| panic!("{error}"));
    let told = faults.settle::<()>(Ok(Some(())), &Warnings::default());
    assert!(told.is_ok(), "{}", told.unwrap_err());
    (description, warnings.take().iter().map(ToString::to_string).collect())
}

fn describe(text: &str) -> Description {
    describe_with(text, &[]).0
}

impl Description {
    /// The only object of a kind with a plugin.
    fn the(&self, kind: Kind, plugin: &str) -> &Object {
        let mut found = self
            .objects
            .iter()
            .filter(|object| object.kind == kind && object.plugin == plugin);
        let first = found.next().unwrap_or_else(|| panic!("there is no {plugin}"));
        assert!(found.next().is_none(), "there is another {plugin}");
        first
    }

    /// The only child of an object, or that of a name.
    fn child(&self, object: &Object, name: Option<&str>) -> &Object {
        let found = object.children.iter().find(|child| child.name.as_deref() == name);
        &self.objects[found
            .unwrap_or_else(|| panic!("{} has no child {name:?}", object.plugin))
            .target]
    }
}

impl Object {
    fn value(&self, name: &str) -> &Value {
        match self.properties.get(name) {
            Some(property) => &property.value,
            None => panic!("{} has no {name}", self.plugin),
        }
    }

    fn number(&self, name: &str) -> f64 {
        match self.value(name) {
            Value::Float(value) => *value,
            Value::Integer(value) => *value as f64,
            other => panic!("{name}: {other:?}"),
        }
    }

    fn rgb(&self, name: &str) -> [f64; 3] {
        match self.value(name) {
            Value::Rgb(rgb) => *rgb,
            other => panic!("{name}: {other:?}"),
        }
    }

    fn text(&self, name: &str) -> &str {
        match self.value(name) {
            Value::String(text) => text,
            other => panic!("{name}: {other:?}"),
        }
    }

    fn is_set(&self, name: &str) -> bool {
        matches!(
            self.properties.get(name).map(|property| &property.value),
            Some(Value::Boolean(true))
        )
    }

    /// Where the object's space has its origin and the ends of its axes in the world.
    fn corners(&self) -> [DVec3; 4] {
        let matrix = match self.value("to_world") {
            Value::Transform(transform) => transform.matrix(),
            other => panic!("to_world: {other:?}"),
        };
        [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|corner| matrix.transform_point3(corner))
    }
}

fn near(actual: [f64; 3], expected: [f64; 3]) {
    for (a, e) in actual.iter().zip(expected) {
        assert!(
            (a - e).abs() <= 1e-6 * e.abs().max(1.0),
            "{actual:?} is not {expected:?}"
        );
    }
}

/// The light that comes back along a ray from `origin` towards `target`: what an area light there shines.
fn seen(scene: &Scene, origin: Vec3, target: Vec3) -> Spectrum {
    let direction = (target - origin).normalize();
    let ray = Ray {
        origin,
        direction,
        max_distance: f32::INFINITY,
    };
    let hit = scene.geometry.intersect(&ray).expect("the ray meets the shape");
    match scene.light_at(&hit) {
        Some(light) => scene.lights.emitted(light, &hit, -direction),
        None => Spectrum::ZERO,
    }
}

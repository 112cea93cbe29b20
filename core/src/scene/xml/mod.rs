//! Mitsuba's XML format: from files to a [`Description`].
//!
//! DTDs are refused, so there are no entities to expand; the number of nodes, the nesting depth and the length of
//! filled-in attributes are bounded.

mod attributes;
mod document;
mod names;
mod parameters;
mod properties;
mod spectra;
mod transform;
mod values;

use super::description::{Child, Description, Kind, Object, ObjectId, Property, Value};
use super::error::{Place, SceneError, nearest, shortened, within};
use super::faults::Faults;
use super::loader::{LoadedFile, Loader};
use super::warning::Warnings;
use attributes::ElementFaults;
use document::Document;
use names::snake_case;
use parameters::Parameters;
use roxmltree::Node;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::sync::Arc;

/// Reads a scene file and what it includes.
pub(crate) fn read(
    loader: &mut Loader,
    file: &LoadedFile,
    defines: &BTreeMap<String, String>,
    faults: &Rc<Faults>,
    warnings: &Rc<Warnings>,
) -> Result<Description, SceneError> {
    let place = Place::whole(&file.name);
    let mut reader = XmlReader {
        loader,
        parameters: Parameters::new(defines),
        objects: Vec::new(),
        ids: BTreeMap::new(),
        references: Vec::new(),
        open_files: Vec::new(),
        included: 0,
        bytes: 0,
        faults: faults.clone(),
        warnings: warnings.clone(),
        incomplete: false,
        old_dialect: false,
    };
    let read = reader.file(file, &place, &[], None, 1);
    read.map_err(|found| faults.all_but_last(found.into_list()))?;
    if let Some(name) = reader.parameters.first_unnamed().filter(|_| !reader.incomplete) {
        let allowed = reader.parameters.names().filter(|n| !defines.contains_key(*n));
        faults.note(SceneError::unknown(&place, "definitions", "parameter", name, allowed))?;
    }
    for name in reader.parameters.unused() {
        warnings.remark(&place, format!("the parameter `{}` is used nowhere", shortened(&name)));
    }
    reader.resolve()
}

struct XmlReader<'r, 'f> {
    loader: &'r mut Loader<'f>,
    parameters: Parameters,
    objects: Vec<Object>,
    ids: BTreeMap<String, (ObjectId, Place)>,
    /// References by the object that holds them, the place among its children, and the id.
    references: Vec<(ObjectId, usize, String)>,
    /// Names of the files being read, outermost first.
    open_files: Vec<String>,
    included: u64,
    /// Bytes of XML read, repetitions and filled-in values included.
    bytes: u64,
    faults: Rc<Faults>,
    warnings: Rc<Warnings>,
    /// Whether a fault has lost what would define ids and parameters.
    incomplete: bool,
    /// Whether the file that is read is one for Mitsuba 0.x.
    old_dialect: bool,
}

/// Where an element stands.
#[derive(Clone, Copy)]
struct Context<'a> {
    document: &'a Document,
    parent: ObjectId,
    depth: u32,
}

impl XmlReader<'_, '_> {
    /// Reads a file whose elements lie `depth` deep. Without a `parent` it is the main file; else its content joins the parent's children.
    fn file(
        &mut self,
        file: &LoadedFile,
        place: &Place,
        search: &[String],
        parent: Option<ObjectId>,
        depth: u32,
    ) -> Result<(), ElementFaults> {
        if self.open_files.contains(&file.name) {
            let chain = list(self.open_files.iter().map(String::as_str).chain([file.name.as_str()]));
            let place = place.clone();
            return Err(SceneError::IncludeCycle { place, chain }.into());
        }
        let outer_dialect = self.old_dialect;
        self.open_files.push(file.name.clone());
        let result = self.content(file, search, parent, depth);
        self.open_files.pop();
        self.old_dialect = outer_dialect;
        result
    }

    fn content(
        &mut self,
        file: &LoadedFile,
        search: &[String],
        parent: Option<ObjectId>,
        depth: u32,
    ) -> Result<(), ElementFaults> {
        self.charge(&Place::whole(&file.name), file.bytes.len())?;
        let document = Document::new(file)?;
        let tree = document.parse(self.limits())?;
        let root = tree.root_element();
        let place = document.place(root);
        let mut attributes = self.attributes(&document, root, &["version", "type", "id", "name"])?;
        // A file that holds one object may leave the version to the one that includes it.
        let version = match root.has_tag_name("scene") {
            true => attributes.take("version"),
            false => attributes.given.remove("version"),
        };
        if let Some(version) = version {
            attributes.check(names::check_version(&place, &version));
            self.old_dialect = version.trim().starts_with("0.");
        }
        for fault in attributes.faults {
            self.faults.note(fault)?;
        }
        let mut folders = vec![file.folder().to_owned()];
        folders.extend(search.iter().filter(|folder| **folder != file.folder()).cloned());
        match (root.tag_name().name(), parent) {
            ("scene", Some(parent)) => {
                let outer = std::mem::replace(&mut self.objects[parent].search, folders.into());
                self.children(&document, root, parent, depth)?;
                self.objects[parent].search = outer;
            }
            ("scene", None) => {
                self.objects
                    .push(Object::new(Kind::Scene, "", None, place, folders.into()));
                self.children(&document, root, 0, depth)?;
            }
            (_, Some(parent)) => {
                let outer = std::mem::replace(&mut self.objects[parent].search, folders.into());
                let context = Context {
                    document: &document,
                    parent,
                    depth,
                };
                let result = self.element(context, root);
                self.objects[parent].search = outer;
                result?;
            }
            (name, None) => {
                return Err(SceneError::unknown(&place, "scene file", "root element", name, ["scene"]).into());
            }
        }
        Ok(())
    }

    /// Counts text that is read against the limit, so that repetition cannot multiply it.
    fn charge(&mut self, place: &Place, bytes: usize) -> Result<(), SceneError> {
        self.bytes += bytes as u64;
        within(
            place,
            "bytes of XML, parameters filled in",
            self.bytes,
            self.limits().xml_bytes,
        )
        .map(|_| ())
    }

    fn limits(&self) -> &super::Limits {
        self.loader.limits
    }

    fn children(&mut self, document: &Document, node: Node, parent: ObjectId, depth: u32) -> Result<(), SceneError> {
        let context = Context {
            document,
            parent,
            depth,
        };
        for child in node.children() {
            if !child.is_element() {
                self.text(document, child, node.tag_name().name());
            } else if let Err(faults) = self.element(context, child) {
                self.note(parent, child, faults)?;
            }
        }
        Ok(())
    }

    /// Warns about text between elements, which Mitsuba skips.
    fn text(&self, document: &Document, node: Node, parent: &str) {
        if let Some((place, text)) = document.text(node) {
            let message = format!("the text `{}` within <{parent}> is left out", shortened(text));
            self.warnings.note(&place, message);
        }
    }

    /// Notes the faults of an element within an object; the element counts as left out.
    fn note(&mut self, parent: ObjectId, element: Node, faults: ElementFaults) -> Result<(), SceneError> {
        self.objects[parent].faulty.set(true);
        for fault in faults.into_list() {
            // A file that is lost may have set any parameter.
            if !(self.incomplete && matches!(fault, SceneError::Unknown { what: "parameter", .. })) {
                self.faults.note(fault)?;
            }
        }
        self.incomplete |= element.has_tag_name("include") || element.has_attribute("id");
        Ok(())
    }

    fn element(&mut self, context: Context, node: Node) -> Result<(), ElementFaults> {
        let place = context.document.place(node);
        let name = node.tag_name().name();
        within(
            &place,
            "nesting depth of elements",
            u64::from(context.depth),
            u64::from(self.limits().depth),
        )?;
        // With a type a spectrum is an object.
        if name == "spectrum" && node.has_attribute("type") {
            return self.object(context, node, Kind::Texture);
        }
        let of_today = names::element(name);
        if let Some((_, kind)) = Kind::ELEMENTS.iter().find(|(element, _)| *element == of_today) {
            return self.object(context, node, *kind);
        }
        match name {
            "transform" => return self.transform(context, node),
            "animation" => return self.animation(context, node),
            "default" => self.default(context, node)?,
            "include" => self.include(context, node)?,
            "path" => self.path(context, node)?,
            "ref" => self.reference(context, node)?,
            "alias" => self.alias(context, node)?,
            // Of a program of old that wrote Mitsuba's format; nothing in the picture hangs on them.
            "hide" | "mode" => {
                self.warnings.note(&place, format!("<{name}> is left out"));
                return Ok(());
            }
            _ if !names::is_other_element(name) => {
                if let Some(misspelt) = names::misspelt_element(&place, name) {
                    return Err(misspelt.into());
                }
                let message = format!("the element <{}> is not known here and left out", shortened(name));
                self.warnings.note(&place, message);
                return Ok(());
            }
            _ => {
                let (name, value) = self.property(context, node)?;
                self.set(context.parent, &place, &name, value)?;
            }
        }
        self.no_children(context.document, node)
    }

    /// Reads an object. One with faulty attributes is read on, for its other faults; without a type it belongs to nothing.
    fn object(&mut self, context: Context, node: Node, kind: Kind) -> Result<(), ElementFaults> {
        let place = context.document.place(node);
        if kind == Kind::Scene {
            let reason = "a scene cannot lie within another element";
            return Err(SceneError::value(&place, "<scene>", reason).into());
        }
        let is_root = node.parent().is_some_and(|parent| parent.is_root());
        let allowed: &[&str] = if is_root {
            &["type", "id", "name", "version"]
        } else {
            &["type", "id", "name"]
        };
        let mut attributes = self.attributes(context.document, node, allowed)?;
        let id = self.objects.len();
        let plugin = attributes.take("type");
        if let (Some(name), Some(_)) = (attributes.given.remove("id"), &plugin) {
            attributes.check(self.define_id(&place, name, id));
        }
        if plugin.is_some() {
            let child = Child {
                name: attributes.given.remove("name").map(|name| snake_case(&name)),
                place: place.clone(),
                target: id,
            };
            self.objects[context.parent].children.push(child);
        }
        let search = self.objects[context.parent].search.clone();
        let plugin = names::plugin(&plugin.unwrap_or_default());
        let mut object = Object::new(kind, &plugin, None, place, search);
        object.old_dialect = self.old_dialect;
        object.faulty.set(!attributes.faults.is_empty());
        self.objects.push(object);
        if !attributes.faults.is_empty() {
            self.note(context.parent, node, attributes.faults.into())?;
        }
        self.children(context.document, node, id, context.depth + 1)?;
        names::upgrade(node.tag_name().name(), &mut self.objects[id]);
        Ok(self.settle_spectrum(context.parent, id)?)
    }

    /// Makes a texture that is a spectrum, and has a name, a property of the object that it belongs to.
    fn settle_spectrum(&mut self, parent: ObjectId, id: ObjectId) -> Result<(), SceneError> {
        let object = &self.objects[id];
        let Some(name) = self.objects[parent]
            .children
            .last()
            .filter(|child| child.target == id)
            .and_then(|child| child.name.clone())
        else {
            return Ok(());
        };
        if object.kind != Kind::Texture {
            return Ok(());
        }
        let place = object.place.clone();
        let value = match spectra::value(object) {
            None => return Ok(()),
            Some(Ok(value)) => value,
            Some(Err((property, reason))) => {
                let field = format!("<spectrum type=\"{}\"> `{property}`", object.plugin);
                return Err(SceneError::value(&place, field, reason));
            }
        };
        self.objects[parent].children.pop();
        self.set(parent, &place, &name, value)
    }

    fn define_id(&mut self, place: &Place, id: String, object: ObjectId) -> Result<(), SceneError> {
        if let Some((_, first)) = self.ids.get(&id) {
            let reason = format!("it is already defined at {first}");
            return Err(SceneError::Reference {
                place: place.clone(),
                id,
                reason,
            });
        }
        self.ids.insert(id, (object, place.clone()));
        Ok(())
    }

    fn set(&mut self, parent: ObjectId, place: &Place, name: &str, value: Value) -> Result<(), SceneError> {
        let object = &mut self.objects[parent];
        let name = snake_case(name);
        if object.kind == Kind::Scene {
            let element = format!("a {} at the top level", value.type_name());
            return Err(SceneError::value(
                place,
                element,
                "it belongs inside an object such as <bsdf>",
            ));
        }
        if object.properties.contains_key(&name) {
            self.warnings
                .note(place, format!("`{name}`: it is given twice; this value counts"));
        }
        object.properties.insert(
            name,
            Property {
                value,
                place: place.clone(),
            },
        );
        Ok(())
    }

    fn default(&mut self, context: Context, node: Node) -> Result<(), ElementFaults> {
        let place = context.document.place(node);
        let mut attributes = self.attributes(context.document, node, &["name", "value"])?;
        let (name, value) = (attributes.take("name"), attributes.take("value"));
        if let Some(name) = &name
            && (name.is_empty() || name.chars().count() > parameters::LONGEST_NAME)
        {
            let reason = format!("it has 1 to {} characters", parameters::LONGEST_NAME);
            attributes
                .faults
                .push(SceneError::value(&place, "<default> name", reason));
        }
        let (name, value) = attributes.settle(name.zip(value))?;
        self.parameters.set_default(&name, &value);
        Ok(())
    }

    fn include(&mut self, context: Context, node: Node) -> Result<(), ElementFaults> {
        let place = context.document.place(node);
        let mut attributes = self.attributes(context.document, node, &["filename"])?;
        let filename = attributes.take("filename");
        let filename = attributes.settle(filename)?;
        self.included += 1;
        within(&place, "number of inclusions", self.included, self.limits().includes)?;
        let search = self.objects[context.parent].search.clone();
        let file = self.loader.open(&place, &search, &filename)?;
        self.file(&file, &place, &search, Some(context.parent), context.depth + 1)
    }

    fn path(&mut self, context: Context, node: Node) -> Result<(), ElementFaults> {
        let place = context.document.place(node);
        let mut attributes = self.attributes(context.document, node, &["value"])?;
        let value = attributes.take("value");
        if self.objects[context.parent].kind != Kind::Scene {
            let reason = "it is allowed directly in <scene> only";
            attributes.faults.push(SceneError::value(&place, "<path>", reason));
        }
        let value = attributes.settle(value)?;
        let search = self.objects[context.parent].search.clone();
        let base = search.first().map_or("", String::as_str);
        let joined = if base.is_empty() || value.starts_with(['/', '\\']) {
            value
        } else {
            format!("{base}/{value}")
        };
        let folder = super::files::normalise_folder(&joined).map_err(|error| error.at(&place))?;
        let folders: Vec<String> = std::iter::once(folder).chain(search.iter().cloned()).collect();
        within(
            &place,
            "number of search folders",
            folders.len() as u64,
            u64::from(self.limits().depth),
        )?;
        self.objects[context.parent].search = Arc::from(folders);
        Ok(())
    }

    fn reference(&mut self, context: Context, node: Node) -> Result<(), ElementFaults> {
        let place = context.document.place(node);
        let mut attributes = self.attributes(context.document, node, &["id", "name"])?;
        let name = attributes.given.remove("name").map(|name| snake_case(&name));
        let id = attributes.take("id");
        let id = attributes.settle(id)?;
        let children = &mut self.objects[context.parent].children;
        self.references.push((context.parent, children.len(), id));
        children.push(Child { name, place, target: 0 });
        Ok(())
    }

    fn alias(&mut self, context: Context, node: Node) -> Result<(), ElementFaults> {
        let place = context.document.place(node);
        let mut attributes = self.attributes(context.document, node, &["id", "as"])?;
        let (id, alias) = (attributes.take("id"), attributes.take("as"));
        let (id, alias) = attributes.settle(id.zip(alias))?;
        let Some((object, _)) = self.ids.get(&id) else {
            return Err(self.no_such_id(place, id, "no object above has this id").into());
        };
        Ok(self.define_id(&place, alias, *object)?)
    }

    fn no_children(&self, document: &Document, node: Node) -> Result<(), ElementFaults> {
        let name = node.tag_name().name();
        let fault = |child: Node| {
            if child.is_element() {
                let (place, child) = (document.place(child), child.tag_name().name());
                return Err(SceneError::unknown(&place, format!("<{name}>"), "element", child, []));
            }
            self.text(document, child, name);
            Ok(())
        };
        let faults: Vec<SceneError> = node.children().filter_map(|child| fault(child).err()).collect();
        if faults.is_empty() { Ok(()) } else { Err(faults.into()) }
    }

    fn no_such_id(&self, place: Place, id: String, problem: &str) -> SceneError {
        let nearest = nearest(&id, self.ids.keys().map(String::as_str));
        let hint = nearest.map_or(String::new(), |nearest| format!("; did you mean `{nearest}`?"));
        let reason = format!("{problem}{hint}");
        SceneError::Reference { place, id, reason }
    }

    fn resolve(mut self) -> Result<Description, SceneError> {
        let mut lost: BTreeMap<ObjectId, BTreeSet<usize>> = BTreeMap::new();
        for (object, child, id) in std::mem::take(&mut self.references) {
            if let Some((target, _)) = self.ids.get(&id) {
                self.objects[object].children[child].target = *target;
                continue;
            }
            lost.entry(object).or_default().insert(child);
            if !self.incomplete {
                let place = self.objects[object].children[child].place.clone();
                self.faults.note(self.no_such_id(place, id, "no object has this id"))?;
            }
        }
        for (object, lost) in lost {
            let mut index = 0..;
            let object = &mut self.objects[object];
            object
                .children
                .retain(|_| index.next().is_none_or(|index| !lost.contains(&index)));
            object.faulty.set(true);
        }
        Ok(Description {
            objects: self.objects,
            ids: self.ids.into_iter().map(|(id, (object, _))| (id, object)).collect(),
            called: BTreeMap::new(),
            faults: self.faults,
            warnings: self.warnings,
        })
    }
}

fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    names.collect::<Vec<_>>().join(", ")
}

//! The directives.

use super::Reading;
use super::colour::ColourSpace;
use super::parameter::Parameters;
use super::state::{ATTRIBUTES, Block, look_at, rotation};
use super::token::{Token, Tokens};
use crate::scene::description::Kind;
use crate::scene::error::{Place, SceneError, shortened, within};
use glam::{DMat4, DVec3};
use std::rc::Rc;

/// All directives, for messages.
const DIRECTIVES: [&str; 41] = [
    "Accelerator",
    "ActiveTransform",
    "AreaLightSource",
    "Attribute",
    "AttributeBegin",
    "AttributeEnd",
    "Camera",
    "ColorSpace",
    "ConcatTransform",
    "CoordSysTransform",
    "CoordinateSystem",
    "Film",
    "Identity",
    "Import",
    "Include",
    "Integrator",
    "LightSource",
    "LookAt",
    "MakeNamedMaterial",
    "MakeNamedMedium",
    "Material",
    "MediumInterface",
    "NamedMaterial",
    "ObjectBegin",
    "ObjectEnd",
    "ObjectInstance",
    "Option",
    "PixelFilter",
    "ReverseOrientation",
    "Rotate",
    "Sampler",
    "Scale",
    "Shape",
    "Texture",
    "Transform",
    "TransformBegin",
    "TransformEnd",
    "TransformTimes",
    "Translate",
    "WorldBegin",
    "WorldEnd",
];

impl Reading<'_, '_> {
    /// Reads directives to the end of the file.
    pub(super) fn directives(&mut self, tokens: &mut Tokens) -> Result<(), SceneError> {
        while let Some(token) = tokens.next()? {
            let Token::Word(word) = token else {
                return Err(tokens.broken("expected a directive, such as Shape"));
            };
            self.directive(&word, tokens)?;
        }
        Ok(())
    }

    fn directive(&mut self, word: &str, tokens: &mut Tokens) -> Result<(), SceneError> {
        let place = tokens.place();
        match word {
            "Include" => {
                let name = tokens.required_text("the file's name")?;
                self.include(&place, &name)
            }
            "Import" => {
                let name = tokens.required_text("the file's name")?;
                let state = self.state.clone();
                self.include(&place, &name)?;
                self.state = state;
                Ok(())
            }
            "Attribute" => self.attribute(&place, tokens),
            "AttributeBegin" => self.begin(Block::Attribute, place),
            "AttributeEnd" => self.end(Block::Attribute, word, &place),
            "TransformBegin" => self.begin(Block::Transform, place),
            "TransformEnd" => self.end(Block::Transform, word, &place),
            "ObjectBegin" => self.object_begin(place, tokens),
            "ObjectEnd" => self.object_end(word, &place),
            "ObjectInstance" => {
                let name = tokens.required_text("the object's name")?;
                self.object_instance(&place, &name)
            }
            "WorldBegin" => {
                self.world_begin();
                Ok(())
            }
            "WorldEnd" => Ok(()),
            "ReverseOrientation" => {
                self.state.reverse_orientation = !self.state.reverse_orientation;
                Ok(())
            }
            "ColorSpace" => self.colour_space(&place, tokens),
            "Option" => self.option(&place, tokens),
            "Material" => {
                let parameters = self.parameters(word, "material", tokens)?;
                self.state.material = Some(self.material(&parameters.0, &parameters.1)?);
                Ok(())
            }
            "MakeNamedMaterial" => {
                let (name, parameters) = self.parameters(word, "material", tokens)?;
                let kind = parameters.text("type")?.unwrap_or("diffuse").to_owned();
                let material = self.material(&kind, &parameters)?;
                self.draft.call(material, &name);
                self.materials.insert(name, material);
                Ok(())
            }
            "NamedMaterial" => {
                let name = tokens.required_text("the material's name")?;
                self.named_material(&place, &name)
            }
            "Texture" => self.texture(&place, tokens),
            "Shape" => {
                let (kind, mut parameters) = self.parameters(word, "shape", tokens)?;
                self.shape(&kind, &mut parameters)
            }
            "LightSource" => {
                let (kind, parameters) = self.parameters(word, "light", tokens)?;
                self.light(&kind, &parameters)
            }
            "AreaLightSource" => {
                let (kind, parameters) = self.parameters(word, "light", tokens)?;
                self.state.area_light = self.area_light(&kind, parameters)?.map(Rc::new);
                Ok(())
            }
            "MakeNamedMedium" => {
                let (name, parameters) = self.parameters(word, "medium", tokens)?;
                self.named_medium(name, parameters)
            }
            "MediumInterface" => self.medium_interface(&place, tokens),
            // pbrt-v2 has an integrator for surfaces and another for media.
            "Camera" | "Film" | "PixelFilter" | "Sampler" | "Integrator" | "SurfaceIntegrator" => {
                let (kind, parameters) = self.parameters(word, "view", tokens)?;
                self.view_directive(word, kind, parameters)
            }
            "Accelerator" | "VolumeIntegrator" | "Renderer" => self.parameters(word, "view", tokens).map(|_| ()),
            "Volume" => {
                let (_, parameters) = self.parameters(word, "medium", tokens)?;
                parameters.ignore_all();
                // pbrt-v2 alone has such.
                let without = "Volume: volumes of pbrt-v2 are left out: space is empty, and light is neither scattered nor absorbed on its way";
                self.warnings.note(&place, without);
                Ok(())
            }
            _ => self.transform_directive(word, &place, tokens),
        }
    }

    /// The type or name that a directive begins with, and its parameters.
    fn parameters(
        &mut self,
        word: &str,
        attribute: &str,
        tokens: &mut Tokens,
    ) -> Result<(String, Parameters), SceneError> {
        let name = tokens.required_text("the type or the name")?;
        let context = format!("{word} \"{}\"", shortened(&name));
        let read = Parameters::read(tokens, context, self.state.space, &self.faults, &self.warnings)?;
        let parameters = match ATTRIBUTES.contains(&attribute) {
            true => read.with_defaults(self.state.defaults(attribute)),
            false => read,
        };
        Ok((name, parameters))
    }

    /// Sets parameters for directives that do not say them.
    fn attribute(&mut self, place: &Place, tokens: &mut Tokens) -> Result<(), SceneError> {
        let (name, parameters) = self.parameters("Attribute", "none", tokens)?;
        match ATTRIBUTES.iter().position(|attribute| *attribute == name) {
            Some(index) => {
                let mut all = (*self.state.defaults[index]).clone();
                all.extend(parameters.into_own());
                within(place, "number of attributes", all.len() as u64, MOST_ATTRIBUTES)?;
                self.state.defaults[index] = Rc::new(all);
                Ok(())
            }
            None => self
                .faults
                .note(SceneError::unknown(place, "Attribute", "name", &name, ATTRIBUTES)),
        }
    }

    fn begin(&mut self, block: Block, place: Place) -> Result<(), SceneError> {
        let depth = self.blocks.len() as u64 + 1;
        within(&place, "nesting of attributes", depth, self.loader.limits.depth.into())?;
        self.blocks.push((block, self.state.clone(), place));
        Ok(())
    }

    fn end(&mut self, block: Block, word: &str, place: &Place) -> Result<(), SceneError> {
        match self.blocks.pop() {
            Some((begun, state, _)) if begun == block => {
                match block {
                    // Since pbrt-v4 this is another name for an attribute block.
                    Block::Transform if self.old => self.state.to_world = state.to_world,
                    _ => self.state = state,
                }
                Ok(())
            }
            None => {
                let message = format!("{word}: there is no {} before it that it ends", block.begin());
                self.warnings.note(place, message);
                Ok(())
            }
            Some((begun, state, at)) => {
                let reason = format!("what ends here is {} of {at}", begun.begin());
                self.blocks.push((begun, state, at));
                self.faults.note(SceneError::value(place, word, reason))
            }
        }
    }

    fn object_begin(&mut self, place: Place, tokens: &mut Tokens) -> Result<(), SceneError> {
        let name = tokens.required_text("the object's name")?;
        if self.group.is_some() {
            let reason = "an object cannot begin in another";
            self.faults.note(SceneError::value(&place, "ObjectBegin", reason))?;
        }
        let written = format!("ObjectBegin \"{}\"", shortened(&name));
        let group = self.draft.add(Kind::Shape, "shapegroup", Some(&written), &place);
        self.draft.call(group, &name);
        if self.groups.insert(name, group).is_some() {
            let message = format!("{written}: it takes the place of an object of the name from here on");
            self.warnings.note(&place, message);
        }
        self.group = Some(group);
        self.begin(Block::Object, place)
    }

    fn object_end(&mut self, word: &str, place: &Place) -> Result<(), SceneError> {
        self.end(Block::Object, word, place)?;
        self.group = None;
        Ok(())
    }

    fn object_instance(&mut self, place: &Place, name: &str) -> Result<(), SceneError> {
        let Some(group) = self.groups.get(name).copied() else {
            let (id, reason) = (
                name.to_owned(),
                "no object of the name has been defined before".to_owned(),
            );
            return self.faults.note(SceneError::Reference {
                place: place.clone(),
                id,
                reason,
            });
        };
        let written = format!("ObjectInstance \"{}\"", shortened(name));
        if self.group.is_some() {
            let reason = "an object cannot hold instances of others";
            return self.faults.note(SceneError::value(place, written, reason));
        }
        self.count_shape(place)?;
        if self.draft.objects[group].children.is_empty() {
            return Ok(());
        }
        let instance = self.draft.add(Kind::Shape, "instance", Some(&written), place);
        self.draft.link(instance, None, group);
        self.draft.link(0, None, instance);
        self.set_to_world(instance, self.state.to_world)
    }

    fn world_begin(&mut self) {
        self.in_world = true;
        self.state.to_world = [DMat4::IDENTITY; 2];
        self.state.active = [true; 2];
        self.systems.insert("world".to_owned(), self.state.to_world);
    }

    fn colour_space(&mut self, place: &Place, tokens: &mut Tokens) -> Result<(), SceneError> {
        let name = tokens.required_text("the colour space's name")?;
        match ColourSpace::NAMES
            .iter()
            .find(|(known, _)| *known == name.to_ascii_lowercase())
        {
            Some((_, space)) => self.state.space = *space,
            None => {
                let allowed = ColourSpace::NAMES.map(|(known, _)| known);
                self.faults
                    .note(SceneError::unknown(place, "ColorSpace", "name", &name, allowed))?;
            }
        }
        Ok(())
    }

    /// Options are about how pbrt runs; two of them are about the picture.
    fn option(&mut self, place: &Place, tokens: &mut Tokens) -> Result<(), SceneError> {
        let name = tokens.required_text("the option's name")?;
        let name = name.rsplit_once(' ').map_or(&*name, |(_, name)| name);
        let value = tokens.next()?;
        if value == Some(Token::Open) {
            while tokens.next()?.is_some_and(|token| token != Token::Close) {}
        }
        if matches!(name, "forcediffuse" | "disabletexturefiltering") && value == Some(Token::Word("true".to_owned())) {
            let message = format!("Option \"{name}\": it is not known here, and surfaces look as their materials say");
            self.warnings.note(place, message);
        }
        Ok(())
    }

    fn named_material(&mut self, place: &Place, name: &str) -> Result<(), SceneError> {
        match self.materials.get(name) {
            Some(material) => self.state.material = Some(*material),
            None => {
                let known = self.materials.keys().map(String::as_str);
                self.faults
                    .note(SceneError::unknown(place, "NamedMaterial", "name", name, known))?;
            }
        }
        Ok(())
    }

    fn transform_directive(&mut self, word: &str, place: &Place, tokens: &mut Tokens) -> Result<(), SceneError> {
        let mut numbers = |count: usize| {
            (0..count)
                .map(|_| tokens.required_number())
                .collect::<Result<Vec<_>, _>>()
        };
        match word {
            "Identity" => self.state.change(|_| DMat4::IDENTITY),
            "Translate" => {
                let v = numbers(3)?;
                let moved = DMat4::from_translation(DVec3::new(v[0], v[1], v[2]));
                self.state.change(|matrix| matrix * moved);
            }
            "Scale" => {
                let v = numbers(3)?;
                let scaled = DMat4::from_scale(DVec3::new(v[0], v[1], v[2]));
                self.state.change(|matrix| matrix * scaled);
            }
            "Rotate" => {
                let v = numbers(4)?;
                match rotation(v[0], DVec3::new(v[1], v[2], v[3])) {
                    Some(turned) => self.state.change(|matrix| matrix * turned),
                    None => self
                        .faults
                        .note(SceneError::value(place, word, "the axis has no length"))?,
                }
            }
            "LookAt" => {
                let v = numbers(9)?;
                let vector = |i: usize| DVec3::new(v[i], v[i + 1], v[i + 2]);
                match look_at(vector(0), vector(3), vector(6)) {
                    Some(seen) => self.state.change(|matrix| matrix * seen),
                    None => {
                        let reason = "eye and target are the same, or the upward direction is the viewing direction";
                        self.faults.note(SceneError::value(place, word, reason))?;
                    }
                }
            }
            "Transform" | "ConcatTransform" => {
                let matrix = matrix(tokens)?;
                match word {
                    "Transform" => self.state.change(|_| matrix),
                    _ => self.state.change(|before| before * matrix),
                }
            }
            "CoordinateSystem" => {
                let name = tokens.required_text("the coordinate system's name")?;
                self.systems.insert(name, self.state.to_world);
            }
            "CoordSysTransform" => {
                let name = tokens.required_text("the coordinate system's name")?;
                match self.systems.get(&name) {
                    Some(system) => self.state.to_world = *system,
                    None => {
                        let known = self.systems.keys().map(String::as_str);
                        self.faults
                            .note(SceneError::unknown(place, word, "coordinate system", &name, known))?;
                    }
                }
            }
            "ActiveTransform" => match tokens.next()? {
                Some(Token::Word(which)) if which == "All" => self.state.active = [true; 2],
                Some(Token::Word(which)) if which == "StartTime" => self.state.active = [true, false],
                Some(Token::Word(which)) if which == "EndTime" => self.state.active = [false, true],
                _ => return Err(tokens.broken("ActiveTransform: expected one of All, StartTime, EndTime")),
            },
            "TransformTimes" => {
                let v = numbers(2)?;
                match v[0] < v[1] {
                    true => self.times = [v[0], v[1]],
                    false => {
                        self.faults
                            .note(SceneError::value(place, word, "the second time is not after the first"))?
                    }
                }
            }
            _ => {
                let reason = "pbrt directive";
                return Err(SceneError::unknown(place, "scene file", reason, word, DIRECTIVES));
            }
        }
        Ok(())
    }

    /// Counts a shape or an instance.
    pub(super) fn count_shape(&mut self, place: &Place) -> Result<(), SceneError> {
        self.shapes += 1;
        within(place, "number of shapes", self.shapes, self.loader.limits.shapes).map(|_| ())
    }
}

/// The most parameters that all `Attribute`s for one thing may set.
const MOST_ATTRIBUTES: u64 = 256;

/// 16 numbers by columns, in brackets.
fn matrix(tokens: &mut Tokens) -> Result<DMat4, SceneError> {
    let listed = tokens.peek() == Some(b'[');
    if listed {
        tokens.next()?;
    }
    let mut values = [0.0; 16];
    for value in &mut values {
        *value = tokens.required_number()?;
    }
    if listed && tokens.next()? != Some(Token::Close) {
        return Err(tokens.broken("a matrix has 16 numbers"));
    }
    let mut matrix = DMat4::from_cols_array(&values);
    // A matrix of another scale is the same map.
    if matrix.row(3).truncate() == DVec3::ZERO && matrix.w_axis.w != 0.0 && matrix.w_axis.w != 1.0 {
        matrix *= 1.0 / matrix.w_axis.w;
    }
    Ok(matrix)
}

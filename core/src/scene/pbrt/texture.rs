//! Textures. Those that are the same everywhere become numbers and colours, also where they are made of such.

use super::Reading;
use super::parameter::Parameters;
use super::token::Tokens;
use crate::math::Transform;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError, shortened};
use crate::scene::spectrum::Use;
use glam::{DMat4, DVec3};

/// What a texture parameter says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Tint {
    /// The same number in every channel.
    Number(f64),
    Rgb([f64; 3]),
    Texture(ObjectId),
}

impl Tint {
    /// The colour, where it is the same everywhere.
    pub(super) fn constant(self) -> Option<[f64; 3]> {
        match self {
            Self::Number(value) => Some([value; 3]),
            Self::Rgb(rgb) => Some(rgb),
            Self::Texture(_) => None,
        }
    }

    /// What two constants make by `combine`.
    fn combined(self, other: Self, combine: impl Fn(f64, f64) -> f64) -> Option<Self> {
        match (self, other) {
            (Self::Number(a), Self::Number(b)) => Some(Self::Number(combine(a, b))),
            _ => {
                let (a, b) = (self.constant()?, other.constant()?);
                Some(Self::Rgb(std::array::from_fn(|i| combine(a[i], b[i]))))
            }
        }
    }
}

const TEXTURES: [&str; 11] = [
    "constant",
    "scale",
    "mix",
    "directionmix",
    "imagemap",
    "checkerboard",
    "dots",
    "fbm",
    "wrinkled",
    "windy",
    "marble",
];

impl Reading<'_, '_> {
    /// The texture or the colour of a parameter.
    pub(super) fn tint(&mut self, parameters: &Parameters, name: &str, used: Use) -> Result<Option<Tint>, SceneError> {
        match parameters.texture(name)? {
            Some(texture) => self.named_texture(parameters, name, texture, false),
            None => Ok(self.colour(parameters, name, used)?.map(Tint::Rgb)),
        }
    }

    /// The texture of numbers, or the number, of a parameter.
    pub(super) fn float_tint(&mut self, parameters: &Parameters, name: &str) -> Result<Option<Tint>, SceneError> {
        match parameters.texture(name)? {
            Some(texture) => self.named_texture(parameters, name, texture, true),
            None => Ok(parameters.float(name)?.map(Tint::Number)),
        }
    }

    /// Textures of numbers and of colours have names of their own.
    fn named_texture(
        &self,
        parameters: &Parameters,
        name: &str,
        texture: &str,
        floats: bool,
    ) -> Result<Option<Tint>, SceneError> {
        let of_kind = |floats| self.textures.get(&(floats, texture.to_owned()));
        match of_kind(floats).or_else(|| of_kind(!floats)) {
            Some(tint) => Ok(Some(*tint)),
            None => parameters.fault(name, format!("there is no texture `{}` before it", shortened(texture))),
        }
    }

    /// Gives an object a colour, a number or a texture.
    pub(super) fn attach(&mut self, object: ObjectId, name: &str, tint: Tint) {
        match tint {
            Tint::Number(value) => self.draft.set(object, name, Value::Float(value)),
            Tint::Rgb(rgb) => self.draft.set(object, name, Value::Rgb(rgb)),
            Tint::Texture(texture) => self.draft.link(object, Some(name), texture),
        }
    }

    /// `Texture "name" "type" "class"`.
    pub(super) fn texture(&mut self, place: &Place, tokens: &mut Tokens) -> Result<(), SceneError> {
        let name = tokens.required_text("the texture's name")?;
        let kind = tokens.required_text("the texture's type")?;
        let class = tokens.required_text("the texture's class")?;
        let context = format!("Texture \"{}\"", shortened(&name));
        let (space, faults, warnings) = (self.state.space, &self.faults, &self.warnings);
        let parameters = Parameters::read(tokens, context.clone(), space, faults, warnings)?
            .with_defaults(self.state.defaults("texture"));
        self.old |= kind == "color";
        let floats = match kind.as_str() {
            "float" => true,
            "spectrum" | "color" => false,
            _ => {
                return self.faults.note(SceneError::unknown(
                    place,
                    context,
                    "type",
                    &kind,
                    ["float", "spectrum"],
                ));
            }
        };
        let tint = self.textured(&class, floats, &parameters)?;
        if let Some(tint) = tint {
            self.textures.insert((floats, name), tint);
        }
        Ok(())
    }

    /// What a texture is made of: a part of it, with its default.
    fn part(&mut self, parameters: &Parameters, name: &str, floats: bool, default: f64) -> Result<Tint, SceneError> {
        let given = match floats {
            true => self.float_tint(parameters, name)?,
            // Whether a colour is a reflectance is known where the texture is used.
            false => self.tint(parameters, name, Use::Constant)?,
        };
        Ok(given.unwrap_or(Tint::Number(default)))
    }

    fn textured(&mut self, class: &str, floats: bool, parameters: &Parameters) -> Result<Option<Tint>, SceneError> {
        let object = |reading: &mut Self, plugin| reading.add(Kind::Texture, plugin, parameters);
        let tint = match class {
            "constant" => self.part(parameters, "value", floats, 1.0)?,
            "scale" => {
                let [first, second] = if parameters.has("tex1") || parameters.has("tex2") {
                    [
                        self.part(parameters, "tex1", floats, 1.0)?,
                        self.part(parameters, "tex2", floats, 1.0)?,
                    ]
                } else {
                    [
                        self.part(parameters, "tex", floats, 1.0)?,
                        self.part(parameters, "scale", true, 1.0)?,
                    ]
                };
                self.product(first, second, parameters)
            }
            "mix" => {
                let [first, second] =
                    [("tex1", 0.0), ("tex2", 1.0)].map(|(name, default)| self.part(parameters, name, floats, default));
                let (first, second) = (first?, second?);
                let amount = self.part(parameters, "amount", true, 0.5)?;
                let mixed = match amount {
                    Tint::Number(amount) => first.combined(second, |a, b| a + (b - a) * amount),
                    _ => None,
                };
                mixed.unwrap_or_else(|| {
                    let mix = object(self, "mix");
                    self.attach(mix, "tex1", first);
                    self.attach(mix, "tex2", second);
                    self.attach(mix, "amount", amount);
                    Tint::Texture(mix)
                })
            }
            "directionmix" => {
                let [first, second] =
                    [("tex1", 0.0), ("tex2", 1.0)].map(|(name, default)| self.part(parameters, name, floats, default));
                let (first, second) = (first?, second?);
                let direction = parameters.vector("dir")?.unwrap_or(DVec3::Y);
                let mix = object(self, "directionmix");
                self.attach(mix, "tex1", first);
                self.attach(mix, "tex2", second);
                let direction = self.state.to_world[0].transform_vector3(direction);
                self.draft.set(mix, "dir", Value::Vector(direction));
                Tint::Texture(mix)
            }
            "imagemap" => match self.image_map(parameters, floats)? {
                Some(texture) => {
                    let scale = parameters.float_or("scale", 1.0)?;
                    self.product(Tint::Texture(texture), Tint::Number(scale), parameters)
                }
                None => return Ok(None),
            },
            "checkerboard" => {
                let [first, second] =
                    [("tex1", 1.0), ("tex2", 0.0)].map(|(name, default)| self.part(parameters, name, floats, default));
                let (first, second) = (first?, second?);
                let board = object(self, "checkerboard");
                self.attach(board, "color0", first);
                self.attach(board, "color1", second);
                // How pbrt-v3 filters it.
                parameters.ignore(&["aamode"]);
                match parameters.integer("dimension")? {
                    Some(3) => {
                        self.draft.set(board, "dimension", Value::Integer(3));
                        self.set_to_world(board, [self.state.to_world[0]; 2])?;
                    }
                    // A square of pbrt has side 1, one of ours side 1/2.
                    _ => self.mapping(board, parameters, DMat4::from_scale(DVec3::new(0.5, 0.5, 1.0)))?,
                }
                Tint::Texture(board)
            }
            "dots" => {
                let inside = self.part(parameters, "inside", floats, 1.0)?;
                let outside = self.part(parameters, "outside", floats, 0.0)?;
                let dots = object(self, "dots");
                self.attach(dots, "inside", inside);
                self.attach(dots, "outside", outside);
                self.mapping(dots, parameters, DMat4::IDENTITY)?;
                Tint::Texture(dots)
            }
            "fbm" | "wrinkled" | "windy" | "marble" => {
                let noise = object(self, class);
                if class != "windy" {
                    let octaves = parameters.integer("octaves")?.unwrap_or(8);
                    self.draft.set(noise, "octaves", Value::Integer(octaves.into()));
                    let roughness = parameters.float_or("roughness", 0.5)?;
                    self.draft.set(noise, "roughness", Value::Float(roughness));
                }
                if class == "marble" {
                    for (name, default) in [("scale", 1.0), ("variation", 0.2)] {
                        let value = parameters.float_or(name, default)?;
                        self.draft.set(noise, name, Value::Float(value));
                    }
                }
                self.set_to_world(noise, [self.state.to_world[0]; 2])?;
                Tint::Texture(noise)
            }
            "bilerp" => {
                let corners = object(self, "bilerp");
                for (name, default) in [("v00", 0.0), ("v10", 0.0), ("v01", 1.0), ("v11", 1.0)] {
                    match self.part(parameters, name, floats, default)? {
                        Tint::Texture(_) => {
                            _ = parameters.fault::<()>(name, "it is a texture, and not a colour or a number")?
                        }
                        corner => self.attach(corners, name, corner),
                    }
                }
                self.mapping(corners, parameters, DMat4::IDENTITY)?;
                Tint::Texture(corners)
            }
            "uv" => {
                let corners = object(self, "bilerp");
                for (name, [u, v]) in [
                    ("v00", [0.0; 2]),
                    ("v10", [1.0, 0.0]),
                    ("v01", [0.0, 1.0]),
                    ("v11", [1.0; 2]),
                ] {
                    self.attach(corners, name, Tint::Rgb([u, v, 0.0]));
                }
                self.draft.set(corners, "repeats", Value::Boolean(true));
                self.mapping(corners, parameters, DMat4::IDENTITY)?;
                Tint::Texture(corners)
            }
            "ptex" => {
                parameters.warn(&format!(
                    "class `{class}` does not exist here: an even grey of 0.5 stands in for it"
                ));
                return Ok(Some(Tint::Number(0.5)));
            }
            _ => {
                let (place, context) = (&parameters.place, parameters.context.clone());
                self.faults
                    .note(SceneError::unknown(place, context, "class", class, TEXTURES))?;
                return Ok(None);
            }
        };
        parameters.finish();
        Ok(Some(tint))
    }

    /// The product of two textures.
    pub(super) fn product(&mut self, first: Tint, second: Tint, parameters: &Parameters) -> Tint {
        if second == Tint::Number(1.0) {
            return first;
        }
        first.combined(second, |a, b| a * b).unwrap_or_else(|| {
            let product = self.add(Kind::Texture, "scale", parameters);
            let (texture, factor) = match first {
                Tint::Texture(_) => (first, second),
                _ => (second, first),
            };
            self.attach(product, "tex", texture);
            self.attach(product, "scale", factor);
            Tint::Texture(product)
        })
    }

    /// An image on the surface.
    fn image_map(&mut self, parameters: &Parameters, floats: bool) -> Result<Option<ObjectId>, SceneError> {
        let Some(file) = parameters.text("filename")? else {
            return parameters.fault("filename", "it is missing");
        };
        let file = file.to_owned();
        let bitmap = self.add(Kind::Texture, "bitmap", parameters);
        self.draft.set(bitmap, "filename", Value::String(file));
        match parameters.text("filter")? {
            Some("point") => self.draft.set(bitmap, "filter_type", Value::String("nearest".into())),
            // Wider filters blur within a pixel, and the samples of a pixel spread over it.
            Some("bilinear" | "trilinear" | "ewa" | "EWA") | None => {}
            Some(other) => {
                let allowed = "allowed: point, bilinear, trilinear, EWA";
                parameters.fault::<()>(
                    "filter",
                    format!("there is no filter `{}`; {allowed}", shortened(other)),
                )?;
            }
        }
        match parameters.text("wrap")? {
            Some("clamp") => self.draft.set(bitmap, "wrap_mode", Value::String("clamp".into())),
            Some("black") => self.draft.set(bitmap, "wrap_mode", Value::String("black".into())),
            Some("repeat") | None => {}
            Some(other) => {
                let allowed = "allowed: repeat, clamp, black";
                parameters.fault::<()>("wrap", format!("there is no mode `{}`; {allowed}", shortened(other)))?;
            }
        }
        let encoding = parameters.text("encoding")?.unwrap_or("sRGB").to_owned();
        let exponent = encoding.strip_prefix("gamma").map(|text| text.trim().parse::<f64>());
        match (encoding.as_str(), exponent) {
            ("sRGB", _) => {}
            ("linear", _) => self.draft.set(bitmap, "raw", Value::Boolean(true)),
            (_, Some(Ok(exponent))) if exponent > 0.0 => self.draft.set(bitmap, "gamma", Value::Float(exponent)),
            _ => {
                let reason = format!("`{encoding:.40}` is none of: sRGB, linear, gamma with a number");
                parameters.fault::<()>("encoding", reason)?;
            }
        }
        if parameters.has("gamma") && !parameters.boolean("gamma", true)? {
            self.draft.set(bitmap, "raw", Value::Boolean(true));
        }
        parameters.ignore(&["maxanisotropy", "trilinear"]);
        if floats && !self.old {
            self.draft
                .set(bitmap, "channel", Value::String("opacity_or_mean".into()));
        }
        if parameters.boolean("invert", false)? {
            self.draft.set(bitmap, "invert", Value::Boolean(true));
        }
        self.mapping(bitmap, parameters, flip())?;
        Ok(Some(bitmap))
    }

    /// Turns an image the way that pbrt has it on surfaces.
    pub(super) fn flip_v(&mut self, bitmap: ObjectId) {
        if let Some(to_uv) = Transform::from_matrix(flip()) {
            self.draft.set(bitmap, "to_uv", Value::Transform(Box::new(to_uv)));
        }
    }

    /// How points of a surface become coordinates of a texture, which `then` maps further.
    fn mapping(&mut self, texture: ObjectId, parameters: &Parameters, then: DMat4) -> Result<(), SceneError> {
        let kind = parameters.text("mapping")?.unwrap_or("uv").to_owned();
        let of_axes = |names: [&str; 2], default| -> Result<[f64; 2], SceneError> {
            Ok([
                parameters.float_or(names[0], default)?,
                parameters.float_or(names[1], default)?,
            ])
        };
        let (mut scale, mut delta) = ([1.0; 2], [0.0; 2]);
        match kind.as_str() {
            "uv" => {
                scale = of_axes(["uscale", "vscale"], 1.0)?;
                delta = of_axes(["udelta", "vdelta"], 0.0)?;
            }
            "planar" => {
                delta = of_axes(["udelta", "vdelta"], 0.0)?;
                for (name, default) in [("v1", DVec3::X), ("v2", DVec3::Y)] {
                    let axis = parameters.vector(name)?.unwrap_or(default);
                    self.draft.set(texture, name, Value::Vector(axis));
                }
            }
            "spherical" | "cylindrical" => {}
            other => {
                let allowed = "allowed: uv, planar, spherical, cylindrical";
                let reason = format!("there is no mapping `{}`; {allowed}", shortened(other));
                return parameters.fault::<()>("mapping", reason).map(|_| ());
            }
        }
        if kind != "uv" {
            self.draft.set(texture, "mapping", Value::String(kind));
            self.set_to_world(texture, [self.state.to_world[0]; 2])?;
        }
        let moved = DMat4::from_translation(DVec3::new(delta[0], delta[1], 0.0));
        let to_uv = then * moved * DMat4::from_scale(DVec3::new(scale[0], scale[1], 1.0));
        match Transform::from_matrix(to_uv) {
            Some(to_uv) => self.draft.set(texture, "to_uv", Value::Transform(Box::new(to_uv))),
            None => _ = parameters.fault::<()>("uscale", "scales of textures are not 0")?,
        }
        Ok(())
    }
}

/// The v of pbrt runs up an image, and ours down.
fn flip() -> DMat4 {
    DMat4::from_translation(DVec3::Y) * DMat4::from_scale(DVec3::new(1.0, -1.0, 1.0))
}

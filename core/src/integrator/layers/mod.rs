//! Layers: further images of a job beside its picture, such as the normals of what is seen, or the light of one lamp.
//!
//! A layer is one or more *planes*: images of the size of the picture that an iteration renders and that are averaged as the picture is,
//! stacked below it in the same [`Node`](crate::film::Node). So what is said of pictures holds for layers: they are means over
//! iterations, with the same bits whoever rendered them. Values of a node are never negative; a layer whose values may be takes two
//! planes, of what is above zero and of what is below.
//!
//! The light of some lamps, or along some paths, is that of the same iteration with a scene of which nothing else counts, by the same random
//! numbers: whatever an integrator does, parts that together hold everything add up to the picture.
//!
//! The picture is that of the job without layers, bit for bit.

mod cryptomatte;
mod matte;
mod surface;

#[cfg(test)]
mod tests;

pub use crate::path::ExpressionError;
pub use matte::Memory;

use super::{Iteration, Job, Observer, RenderError};
use crate::film::Image;
use crate::light::LightId;
use crate::path::PathExpression;
use crate::scene::Scene;
use crate::settings::IntegratorSettings;
use crate::spectrum::Spectrum;
use matte::Matte;
use std::collections::BTreeSet;
use std::str::FromStr;
use surface::{Seen, Surface};
use thiserror::Error;

/// Most layers of a job: what a picture with all of them and the standard error stays below 80 channels with.
pub const MAX_LAYERS: usize = 16;

/// Longest name of a layer [bytes].
const NAME_BYTES: usize = 200;

/// What stands for the lamps that no other layer names.
const OTHERS: &str = "*";

/// An image beside the picture.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Layer {
    /// What the camera's rays meet first.
    Surface(Surface),
    /// Which objects or materials they are.
    Matte(Matte),
    /// How many camera paths each pixel has had.
    Samples,
    /// Two pictures, of the iterations with an odd and with an even index.
    Halves,
    /// The light of some lamps, by their names in the scene; `None` for those that no other layer names.
    Lamps(Option<Vec<String>>),
    /// The light of some paths.
    Paths { name: String, expression: PathExpression },
}

/// Why a layer is none.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum LayerError {
    /// Not a layer's name.
    #[error("there is no layer `{0}`; there are: {known}, `lamp:NAME` for a lamp of the scene, `lamp:NAME+NAME` for several, `lamp:*` for all that no other layer names, and `NAME=EXPRESSION` for some paths, such as `caustic=L S+ D E`", known = NAMES.join(", "))]
    Unknown(String),
    /// Not a path expression.
    #[error("layer `{name}`: {error}")]
    Expression {
        /// The layer as it was asked for.
        name: String,
        /// What is wrong with the expression, its columns counted from the `=` on.
        error: ExpressionError,
    },
    /// A layer that is there twice, or two that a file could not tell apart.
    #[error("two layers are called `{0}`")]
    Twice(String),
    /// Too many.
    #[error("{0} layers; the limit is {MAX_LAYERS}")]
    TooMany(usize),
    /// A name that is too long.
    #[error("the name of a layer has {0} bytes; the limit is {NAME_BYTES}")]
    Long(usize),
    /// The scene has no such lamp.
    #[error("the scene has no lamp `{name}`; it has: {known}")]
    NoLamp {
        /// What was asked for.
        name: String,
        /// The scene's lamps.
        known: String,
    },
    /// The integrator has no layers.
    #[error("{0} renders no layers: its iterations go on from each other, and layers would go on from nothing")]
    Sequential(&'static str),
    /// An image whose size is not that of a stack of planes.
    #[error("an image of {height} rows is no stack of {planes} planes")]
    Stack {
        /// Rows of the image.
        height: u32,
        /// Planes that were expected.
        planes: u32,
    },
}

/// Names of the layers without lamps.
const NAMES: [&str; 9] = [
    "alpha",
    "albedo",
    "normal",
    "depth",
    "position",
    "halves",
    "samples",
    "cryptomatte:object",
    "cryptomatte:material",
];

impl FromStr for Layer {
    type Err = LayerError;

    fn from_str(name: &str) -> Result<Self, LayerError> {
        if name.len() > NAME_BYTES {
            return Err(LayerError::Long(name.len()));
        }
        let unknown = || LayerError::Unknown(name.to_owned());
        if let Some(lamps) = name.strip_prefix("lamp:") {
            let names: Vec<String> = lamps.split('+').map(|name| name.trim().to_owned()).collect();
            return match names.as_slice() {
                [others] if others == OTHERS => Ok(Self::Lamps(None)),
                names if names.iter().any(|name| name.is_empty() || name == OTHERS) => Err(unknown()),
                _ => Ok(Self::Lamps(Some(names))),
            };
        }
        if let Some((called, expression)) = name.split_once('=') {
            let called = called.trim();
            let plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
            if called.is_empty() || !called.chars().all(plain) || NAMES.contains(&called) {
                return Err(unknown());
            }
            let expression = expression.parse().map_err(|error| LayerError::Expression {
                name: name.to_owned(),
                error,
            })?;
            return Ok(Self::Paths {
                name: called.to_owned(),
                expression,
            });
        }
        Ok(match name {
            "alpha" => Self::Surface(Surface::Alpha),
            "albedo" => Self::Surface(Surface::Albedo),
            "normal" => Self::Surface(Surface::Normal),
            "depth" => Self::Surface(Surface::Depth),
            "position" => Self::Surface(Surface::Position),
            "halves" => Self::Halves,
            "samples" => Self::Samples,
            "cryptomatte:object" => Self::Matte(Matte::Object),
            "cryptomatte:material" => Self::Matte(Matte::Material),
            _ => return Err(unknown()),
        })
    }
}

impl Layer {
    fn planes(&self) -> usize {
        match self {
            Self::Surface(surface) => surface.planes(),
            Self::Matte(_) => matte::PLANES,
            Self::Halves => 2,
            Self::Samples | Self::Lamps(_) | Self::Paths { .. } => 1,
        }
    }

    /// What stands before the dot in the names of the layer's channels.
    fn groups(&self) -> Vec<String> {
        let one = match self {
            Self::Surface(surface) => surface.name().to_owned(),
            Self::Matte(matte) => return matte.groups().collect(),
            Self::Samples => "samples".to_owned(),
            Self::Halves => return ["half_a", "half_b"].map(str::to_owned).into(),
            Self::Paths { name, .. } => name.clone(),
            Self::Lamps(None) => "lamp_others".to_owned(),
            Self::Lamps(Some(names)) => {
                let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
                format!("lamp_{}", names.join("_").chars().map(plain).collect::<String>())
            }
        };
        vec![one]
    }
}

/// The layers of a job, in the order in which they were asked for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Layers(Vec<Layer>);

/// A channel of a layer: its name in a file, and its values row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Such as `normal.X`.
    pub name: String,
    /// A value for each pixel.
    pub samples: Vec<f32>,
}

impl Layers {
    /// The layers of these names: `alpha`, `albedo`, `normal`, `depth`, `position`, `halves`, `samples`, `cryptomatte:object`,
    /// `cryptomatte:material`, and `lamp:` with the names of lamps.
    ///
    /// # Errors
    /// A name that no layer has, one that is there twice, or too many.
    pub fn parse<S: AsRef<str>>(names: &[S]) -> Result<Self, LayerError> {
        if names.len() > MAX_LAYERS {
            return Err(LayerError::TooMany(names.len()));
        }
        let layers: Vec<Layer> = names
            .iter()
            .map(|name| name.as_ref().parse())
            .collect::<Result<_, _>>()?;
        let mut taken = BTreeSet::new();
        for group in layers.iter().flat_map(Layer::groups) {
            if taken.contains(&group) {
                return Err(LayerError::Twice(group));
            }
            taken.insert(group);
        }
        Ok(Self(layers))
    }

    /// Checks that an integrator renders them.
    ///
    /// # Errors
    /// Layers of a sequential integrator.
    pub fn check_integrator(&self, settings: &IntegratorSettings) -> Result<(), LayerError> {
        match settings.is_sequential() && !self.0.is_empty() {
            true => Err(LayerError::Sequential(settings.name())),
            false => Ok(()),
        }
    }

    /// Checks that the scene has the lamps that are named.
    ///
    /// # Errors
    /// The first that it lacks.
    pub fn check_scene(&self, scene: &Scene) -> Result<(), LayerError> {
        match self.named_lamps().find(|name| !scene.lamps.contains(name)) {
            Some(name) => Err(LayerError::NoLamp {
                name: name.clone(),
                known: scene.lamps.join(", "),
            }),
            None => Ok(()),
        }
    }

    fn named_lamps(&self) -> impl Iterator<Item = &String> {
        self.0.iter().flat_map(|layer| match layer {
            Layer::Lamps(Some(names)) => names.as_slice(),
            _ => &[],
        })
    }

    /// Images that are stacked in a node: the picture and the planes below it.
    #[must_use]
    pub fn stack(&self) -> u32 {
        1 + self.0.iter().map(Layer::planes).sum::<usize>() as u32
    }

    /// The size of a node's image of a picture with layers.
    #[must_use]
    pub fn stacked(&self, [width, height]: [u32; 2]) -> [u32; 2] {
        [width, height.saturating_mul(self.stack())]
    }

    /// The size of the picture in a node's image.
    #[must_use]
    pub fn picture_size(&self, [width, height]: [u32; 2]) -> [u32; 2] {
        [width, height / self.stack()]
    }

    /// The picture at the top of a stack.
    ///
    /// # Errors
    /// An image that is no such stack.
    pub fn picture(&self, mut stack: Image) -> Result<Image, LayerError> {
        let size = self.check_stack(&stack)?;
        stack.height /= self.stack();
        stack.pixels.truncate(size);
        stack.standard_error.truncate(size);
        Ok(stack)
    }

    /// The channels of the layers in a stack.
    ///
    /// # Errors
    /// An image that is no such stack.
    pub fn channels(&self, stack: &Image) -> Result<Vec<Channel>, LayerError> {
        let size = self.check_stack(stack)?;
        let mut planes = stack.pixels.chunks_exact(size).skip(1);
        let mut channels = Vec::new();
        for layer in &self.0 {
            let planes: Vec<&[Spectrum]> = planes.by_ref().take(layer.planes()).collect();
            channels.extend(layer.channels(&planes, stack));
        }
        Ok(channels)
    }

    /// Which names of the scene a file is to list: of its objects, and of its materials.
    #[must_use]
    pub fn lists(&self) -> [bool; 2] {
        [Matte::Object, Matte::Material].map(|matte| self.0.contains(&Layer::Matte(matte)))
    }

    /// The attributes of a file with the layers, where the scene's objects and materials are called so.
    #[must_use]
    pub fn attributes(&self, objects: &[String], materials: &[String]) -> Vec<(String, String)> {
        let of_layer = |layer: &Layer| match layer {
            Layer::Matte(Matte::Object) => Matte::Object.attributes(objects),
            Layer::Matte(Matte::Material) => Matte::Material.attributes(materials),
            _ => Vec::new(),
        };
        self.0.iter().flat_map(of_layer).collect()
    }

    /// The pixels of one image of a stack.
    fn check_stack(&self, stack: &Image) -> Result<usize, LayerError> {
        let planes = self.stack();
        match stack.height.is_multiple_of(planes) && stack.height > 0 {
            true => Ok(stack.width as usize * (stack.height / planes) as usize),
            false => Err(LayerError::Stack {
                height: stack.height,
                planes,
            }),
        }
    }
}

impl Layer {
    fn channels(&self, planes: &[&[Spectrum]], stack: &Image) -> Vec<Channel> {
        let groups = self.groups();
        let colours = |name: &str, plane: &[Spectrum], scale: f64| -> Vec<Channel> {
            let channel = |(index, letter): (usize, &str)| Channel {
                name: format!("{name}.{letter}"),
                samples: plane
                    .iter()
                    .map(|value| (f64::from(value.to_rgb()[index]) * scale) as f32)
                    .collect(),
            };
            ["R", "G", "B"].iter().copied().enumerate().map(channel).collect()
        };
        match self {
            Self::Surface(surface) => surface.channels(planes),
            Self::Matte(matte) => matte.channels(planes),
            Self::Samples => {
                let total = |mean: &Spectrum| (f64::from(mean.to_rgb()[0]) * stack.iterations as f64).round() as f32;
                vec![Channel {
                    name: format!("{}.Y", groups[0]),
                    samples: planes[0].iter().map(total).collect(),
                }]
            }
            Self::Lamps(_) | Self::Paths { .. } => colours(&groups[0], planes[0], 1.0),
            Self::Halves => {
                let odd = stack.odd_iterations;
                let counts = [odd, stack.iterations - odd];
                let half = |(name, (plane, count)): (&String, (&&[Spectrum], u64))| {
                    // Of a half without iterations nothing is known; its sum is zero.
                    let scale = stack.iterations as f64 / count.max(1) as f64;
                    colours(name, plane, scale)
                };
                groups.iter().zip(planes.iter().zip(counts)).flat_map(half).collect()
            }
        }
    }
}

/// Renders the planes of an iteration, in their order, whose picture is `picture`.
pub(super) fn render(
    job: &Job,
    (layers, memory): (&Layers, &Memory),
    settings: &IntegratorSettings,
    picture: &Iteration,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let mut all = picture.clone();
    let size = picture.pixels.len();
    let black = || std::iter::repeat_n(Spectrum::ZERO, size);
    let seen: Vec<Seen> = layers.0.iter().filter_map(Layer::seen).collect();
    let settled = match seen.iter().any(|seen| matches!(seen, Seen::Matte(_))) {
        true => Some(memory.settled(job, observer)?),
        false => None,
    };
    let mut seen = surface::render(job, &seen, settled.as_deref(), observer, &mut all.counts)?.into_iter();
    for layer in &layers.0 {
        match layer {
            Layer::Surface(_) | Layer::Matte(_) => all.pixels.extend(seen.by_ref().take(layer.planes()).flatten()),
            Layer::Samples => {
                let samples = Spectrum::splat(settings.samples() as f32);
                all.pixels.extend(std::iter::repeat_n(samples, size));
            }
            Layer::Halves if job.iteration % 2 == 1 => {
                all.pixels.extend_from_slice(&picture.pixels);
                all.pixels.extend(black());
            }
            Layer::Halves => {
                all.pixels.extend(black());
                all.pixels.extend_from_slice(&picture.pixels);
            }
            Layer::Lamps(names) => {
                let shines = |LightId(id): LightId| {
                    let name = &job.scene.lamps[id as usize];
                    match names {
                        Some(names) => names.contains(name),
                        None => layers.named_lamps().all(|named| named != name),
                    }
                };
                let scene = Scene {
                    lights: job.scene.lights.only(shines),
                    ..job.scene.clone()
                };
                add_part(job, &scene, settings, &mut all, observer)?;
            }
            Layer::Paths { expression, .. } => {
                let scene = Scene {
                    paths: Some(expression.clone()),
                    ..job.scene.clone()
                };
                add_part(job, &scene, settings, &mut all, observer)?;
            }
        }
    }
    Ok(all)
}

/// Adds the plane of a part of the picture's light: the iteration of a scene of which only that counts.
fn add_part(
    job: &Job,
    scene: &Scene,
    settings: &IntegratorSettings,
    all: &mut Iteration,
    observer: &dyn Observer,
) -> Result<(), RenderError> {
    let part = super::render_job(&Job { scene, ..*job }, settings, &[], observer)?;
    all.pixels.extend(part.pixels);
    all.counts += part.counts;
    Ok(())
}

impl Layer {
    /// What it is of what the camera's rays meet first.
    fn seen(&self) -> Option<Seen> {
        match self {
            Self::Surface(surface) => Some(Seen::Surface(*surface)),
            Self::Matte(matte) => Some(Seen::Matte(*matte)),
            _ => None,
        }
    }
}

//! Media: what they are made of, and which shapes bound them.

use super::Builder;
use super::texture::colour;
use crate::medium::{Boundary, Extinction, Field, GridVolume, Medium, MediumId, Phase, PhaseTable, Volume};
use crate::scene::description::{Child, Kind, ObjectId};
use crate::scene::error::{SceneError, within};
use crate::scene::reader::{NOT_NEGATIVE, Reader};
use crate::scene::spectrum::Use;
use crate::scene::{ShapeBinding, substance};
use crate::spectrum::Spectrum;
use std::sync::Arc;

const MEDIA: [&str; 2] = ["homogeneous", "heterogeneous"];
const VOLUMES: [&str; 4] = ["constvolume", "gridvolume", "hgridvolume", "volcache"];
const PHASES: [&str; 6] = ["isotropic", "hg", "rayleigh", "tabphase", "blendphase", "mixturephase"];
/// Phase functions of Mitsuba 0.6 for particles that are not round.
const ORIENTED: [&str; 2] = ["kkay", "microflake"];
/// How Mitsuba samples a medium, which is not what it looks like.
const OF_SAMPLING: [&str; 10] = [
    "sample_emitters",
    "has_spectral_extinction",
    "strategy",
    "method",
    "step_size",
    "channel",
    "sampling_density",
    "medium_sampling_weight",
    "majorant_resolution_factor",
    "majorant_grid",
];
/// How deep phase functions, and volumes, lie within each other at most.
const DEEPEST: usize = 16;
/// What Mitsuba 0.6 multiplies the coefficients of substances by (`lookupMaterial` in `materials.h`).
const PER_UNIT: f64 = 100.0;
/// Most media of a scene: each has a number of 16 bits.
const MOST_MEDIA: u64 = 1 << 16;

impl Builder<'_, '_> {
    /// What lies on the sides of a shape, where it bounds a medium.
    pub(super) fn boundary(&mut self, reader: &Reader) -> Result<Option<Boundary>, SceneError> {
        let sides = ["interior", "exterior"].map(|side| reader.named_child(side, Kind::Medium));
        let [interior, exterior] = sides;
        let (interior, exterior) = (interior?, exterior?);
        if interior.is_none() && exterior.is_none() {
            return Ok(None);
        }
        Ok(Some(Boundary {
            interior: self.medium_of(interior)?,
            exterior: self.medium_of(exterior)?,
        }))
    }

    /// Notes what lies on the sides of the shape that was added last.
    pub(super) fn bound(&mut self, boundary: Option<Boundary>) {
        if let Some(ShapeBinding { boundary: bound, .. }) = self.bindings.last_mut() {
            *bound = boundary;
        }
    }

    /// The medium of a child, which is built where it is first referred to.
    pub(super) fn medium_of(&mut self, child: Option<&Child>) -> Result<Option<MediumId>, SceneError> {
        match child {
            Some(child) => self.medium(child.target),
            None => Ok(None),
        }
    }

    /// The medium that an object describes; empty space where it has a fault, which is noted.
    pub(super) fn medium(&mut self, object: ObjectId) -> Result<Option<MediumId>, SceneError> {
        if let Some(id) = self.media_of.get(&object) {
            return Ok(*id);
        }
        let reader = self.reader(object);
        within(
            reader.place(),
            "number of media",
            self.media.len() as u64 + 1,
            MOST_MEDIA,
        )?;
        let built = self.new_medium(&reader);
        let medium = self.description.attempt(object, built)?;
        let id = medium.map(|medium| {
            self.media.push(medium);
            MediumId((self.media.len() - 1) as u16)
        });
        self.media_of.insert(object, id);
        Ok(id)
    }

    fn new_medium(&mut self, reader: &Reader) -> Result<Medium, SceneError> {
        if !MEDIA.contains(&reader.object.plugin.as_str()) {
            reader.other_type(&MEDIA, "it is rendered as `homogeneous`, in grey")?;
        }
        let mut scale = 1.0;
        // The names before Mitsuba 0.4 come first.
        for name in ["size_multiplier", "density_multiplier", "scale"] {
            scale = reader.float_or(name, NOT_NEGATIVE, scale)?;
        }
        let scale = scale as f32;
        let phase = match reader.only_child(Kind::Phase)? {
            Some(child) => self.phase(child.target, DEEPEST)?,
            None => Phase::Isotropic,
        };
        reader.accept(&OF_SAMPLING);
        let defaults = self.defaults(reader)?;
        let (extinction, albedo) = match self.coefficients(reader, defaults)? {
            Some((sigma_s, sigma_a)) => {
                let sigma_t = sigma_s + sigma_a;
                (Volume::Constant(sigma_t), Volume::Constant(sigma_s.zip(sigma_t, ratio)))
            }
            None => {
                let (sigma_t, albedo) = match defaults {
                    Some((sigma_s, sigma_a)) => (sigma_s + sigma_a, sigma_s.zip(sigma_s + sigma_a, ratio)),
                    None => (Spectrum::ONE, Spectrum::splat(0.75)),
                };
                let extinction = self.first_volume(reader, &["sigma_t", "density"], Use::Coefficient, sigma_t)?;
                (
                    extinction,
                    self.first_volume(reader, &["albedo"], Use::Reflectance, albedo)?,
                )
            }
        };
        let emission = self.first_volume(reader, &["emission"], Use::Emission, Spectrum::ZERO)?;
        for name in ["orientation", "orientations"] {
            if reader.named_child(name, Kind::Volume)?.is_some() {
                reader.warn(reader.place(), "`orientation` is left out: particles are round here");
            }
        }
        if matches!((&extinction, &emission), (Volume::Constant(_), Volume::Grid(_))) {
            reader.warn_of("emission", "it varies where the extinction does not: it is left out");
        }
        reader.finish();
        Ok(Medium {
            extinction: match extinction {
                Volume::Constant(sigma_t) => Extinction::Uniform(sigma_t * scale),
                Volume::Grid(volume) => Extinction::Varying(Box::new(Field::new(GridVolume {
                    factor: volume.factor * scale,
                    ..*volume
                }))),
            },
            albedo,
            emission,
            phase,
        })
    }

    /// Scattering and absorption coefficients of the substance that a medium is said to be of; Mitsuba 0.6 takes what is the same everywhere for
    /// skin.
    fn defaults(&self, reader: &Reader) -> Result<Option<(Spectrum, Spectrum)>, SceneError> {
        let named = match reader.string("material")? {
            None => None,
            Some(name) => {
                let found = substance::named(name);
                if found.is_none() {
                    reader.fault(reader.no_such("material", "there is no such substance", name, substance::names()))?;
                }
                found
            }
        };
        let skin = reader.object.old_dialect && reader.object.plugin == "homogeneous";
        let substance = named.or(skin.then_some(substance::SKIN));
        let per_unit = |sigma: [f64; 3]| Spectrum::from_rgb(sigma.map(|channel| (channel * PER_UNIT) as f32));
        Ok(substance.map(|substance| (per_unit(substance.sigma_s), per_unit(substance.sigma_a))))
    }

    /// Scattering and absorption coefficients, where a medium says these.
    fn coefficients(
        &mut self,
        reader: &Reader,
        defaults: Option<(Spectrum, Spectrum)>,
    ) -> Result<Option<(Spectrum, Spectrum)>, SceneError> {
        // Mitsuba 0.6 scatters evenly, by as much less as `g` says, besides the medium's phase function.
        let forward = reader.float_or("g", -1.0..=1.0, 0.0)? as f32;
        if !reader.has("sigma_s") && !reader.has("sigma_a") {
            if forward != 0.0 {
                reader.warn_of(
                    "g",
                    "it counts beside `sigma_s` alone: give the phase function `hg` in place of it",
                );
            }
            return Ok(None);
        }
        let (sigma_s, sigma_a) = defaults.unwrap_or_default();
        let sigma_s = colour(reader, "sigma_s", Use::Coefficient)?.unwrap_or(sigma_s) * (1.0 - forward);
        let sigma_a = colour(reader, "sigma_a", Use::Coefficient)?.unwrap_or(sigma_a);
        Ok(Some((sigma_s, sigma_a)))
    }

    /// The volume, or colour, of the first of some names that is there.
    fn first_volume(
        &mut self,
        reader: &Reader,
        names: &[&str],
        used: Use,
        default: Spectrum,
    ) -> Result<Volume, SceneError> {
        for name in names {
            if let Some(child) = reader.named_child(name, Kind::Volume)? {
                let built = self.volume(child.target, used, DEEPEST);
                let volume = self.description.attempt(child.target, built)?;
                return Ok(volume.unwrap_or(Volume::Constant(default)));
            }
            if let Some(value) = colour(reader, name, used)? {
                return Ok(Volume::Constant(value));
            }
        }
        Ok(Volume::Constant(default))
    }

    fn volume(&mut self, object: ObjectId, used: Use, left: usize) -> Result<Volume, SceneError> {
        let reader = self.reader(object);
        if left == 0 {
            let reason = format!("volumes lie within each other more than {DEEPEST} deep");
            return Err(SceneError::value(reader.place(), reader.context(), reason));
        }
        match reader.object.plugin.as_str() {
            // Mitsuba 0.6 keeps values of another volume by it.
            "volcache" => {
                reader.accept(&["block_size", "voxel_width", "memory_limit", "step_size_multiplier"]);
                let to_world = reader.transform("to_world")?.unwrap_or_default();
                let within = reader
                    .only_child(Kind::Volume)?
                    .ok_or_else(|| reader.missing("a <volume>"))?;
                reader.finish();
                Ok(match self.volume(within.target, used, left - 1)? {
                    Volume::Grid(volume) => Volume::Grid(Box::new(GridVolume {
                        to_local: volume.to_local.after(&to_world.inverted()),
                        ..*volume
                    })),
                    even => even,
                })
            }
            "constvolume" => {
                let value = colour(&reader, "value", used)?.unwrap_or(Spectrum::ONE);
                reader.finish();
                Ok(Volume::Constant(value))
            }
            "gridvolume" | "hgridvolume" => self
                .grid_volume(&reader, used)
                .map(|volume| Volume::Grid(Box::new(volume))),
            _ => {
                reader.other_type(&VOLUMES, "its value is 1 everywhere")?;
                Ok(Volume::Constant(Spectrum::ONE))
            }
        }
    }

    fn phase(&mut self, object: ObjectId, left: usize) -> Result<Phase, SceneError> {
        let reader = self.reader(object);
        if left == 0 {
            let reason = format!("phase functions lie within each other more than {DEEPEST} deep");
            return Err(SceneError::value(reader.place(), reader.context(), reason));
        }
        let phase = match reader.object.plugin.as_str() {
            "isotropic" => Phase::Isotropic,
            "hg" => {
                let g = reader.float_or("g", -1.0..=1.0, 0.8)? as f32;
                // At 1 itself nothing is left of scattering but the way straight on.
                Phase::HenyeyGreenstein(g.clamp(-MOST_FORWARD, MOST_FORWARD))
            }
            "rayleigh" => Phase::Rayleigh,
            "tabphase" => self.tabulated(&reader)?,
            "blendphase" => {
                let weight = reader.float_or("weight", 0.0..=1.0, 0.5)? as f32;
                let parts = self.parts(&reader, left)?;
                let [first, second] = &parts[..] else {
                    return Err(reader.missing("two phase functions"));
                };
                mixture([(1.0 - weight, first.clone()), (weight, second.clone())])
            }
            "mixturephase" => {
                let parts = self.parts(&reader, left)?;
                let weights = reader.numbers("weights")?.unwrap_or_default();
                let sum: f64 = weights.iter().sum();
                if weights.len() != parts.len() || weights.iter().any(|weight| *weight < 0.0) || sum <= 0.0 {
                    let reason = format!(
                        "{} weights, none below 0 and not all 0, are needed for as many phase functions",
                        parts.len()
                    );
                    return Err(reader.wrong("weights", reason));
                }
                if reader.object.old_dialect && sum < 1.0 - 1e-6 {
                    reader.warn_of(
                        "weights",
                        "they are scaled to a sum of 1: what is missing is not absorbed here",
                    );
                }
                mixture(weights.iter().map(|weight| (weight / sum) as f32).zip(parts))
            }
            plugin if ORIENTED.contains(&plugin) => {
                reader.warn(
                    reader.place(),
                    "particles are round here: they scatter evenly in all directions",
                );
                reader.accept_rest();
                Phase::Isotropic
            }
            _ => {
                reader.other_type(&PHASES, "it scatters evenly in all directions")?;
                Phase::Isotropic
            }
        };
        reader.finish();
        Ok(phase)
    }

    fn parts(&mut self, reader: &Reader, left: usize) -> Result<Vec<Phase>, SceneError> {
        let children = reader.children(Kind::Phase);
        children
            .iter()
            .map(|child| self.phase(child.target, left - 1))
            .collect()
    }

    fn tabulated(&mut self, reader: &Reader) -> Result<Phase, SceneError> {
        let values = reader
            .numbers("values")?
            .ok_or_else(|| reader.missing("property `values`"))?;
        let table = PhaseTable::new(&values)
            .ok_or_else(|| reader.wrong("values", "at least two numbers are needed, none below 0 and not all 0"))?;
        Ok(Phase::Tabulated(Arc::new(table)))
    }
}

/// The largest mean cosine of Henyey and Greenstein's function: beyond it single precision loses its peak.
const MOST_FORWARD: f32 = 0.9999;

/// A weighted sum without parts of no weight.
fn mixture(parts: impl IntoIterator<Item = (f32, Phase)>) -> Phase {
    let parts: Arc<[(f32, Phase)]> = parts.into_iter().filter(|(weight, _)| *weight > 0.0).collect();
    Phase::Mixture(parts)
}

/// `part / whole`, and zero of nothing.
fn ratio(part: f32, whole: f32) -> f32 {
    if whole > 0.0 { part / whole } else { 0.0 }
}

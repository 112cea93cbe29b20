//! Media: what they are made of, and which shapes bound them.

use super::Builder;
use super::texture::colour;
use crate::math::Transform;
use crate::medium::{
    Boundary, Extinction, Field, GridVolume, Interpolation, Medium, MediumId, Phase, PhaseTable, Volume,
};
use crate::scene::description::{Child, Kind, ObjectId};
use crate::scene::error::{SceneError, within};
use crate::scene::reader::{NOT_NEGATIVE, Reader};
use crate::scene::spectrum::{Use, greatest};
use crate::scene::{ShapeBinding, vol};
use crate::spectrum::Spectrum;
use glam::DMat4;
use std::sync::Arc;

const MEDIA: [&str; 2] = ["homogeneous", "heterogeneous"];
const VOLUMES: [&str; 2] = ["constvolume", "gridvolume"];
const PHASES: [&str; 6] = ["isotropic", "hg", "rayleigh", "tabphase", "blendphase", "mixturephase"];
/// How deep phase functions lie within each other at most.
const DEEPEST: usize = 16;
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
        let scale = reader.float_or("scale", NOT_NEGATIVE, 1.0)? as f32;
        let phase = match reader.only_child(Kind::Phase)? {
            Some(child) => self.phase(child.target, DEEPEST)?,
            None => Phase::Isotropic,
        };
        // How Mitsuba samples a medium is not what it looks like.
        reader.accept(&[
            "sample_emitters",
            "has_spectral_extinction",
            "strategy",
            "method",
            "step_size",
            "majorant_resolution_factor",
            "majorant_grid",
        ]);
        let (extinction, albedo) = match self.coefficients(reader)? {
            Some((sigma_s, sigma_a)) => {
                let sigma_t = sigma_s + sigma_a;
                (Volume::Constant(sigma_t), Volume::Constant(sigma_s.zip(sigma_t, ratio)))
            }
            None => {
                let extinction = self.first_volume(reader, &["sigma_t", "density"], Use::Coefficient, 1.0)?;
                (
                    extinction,
                    self.first_volume(reader, &["albedo"], Use::Reflectance, 0.75)?,
                )
            }
        };
        let emission = self.first_volume(reader, &["emission"], Use::Emission, 0.0)?;
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

    /// Scattering and absorption coefficients, where a medium says these.
    fn coefficients(&mut self, reader: &Reader) -> Result<Option<(Spectrum, Spectrum)>, SceneError> {
        if !reader.has("sigma_s") && !reader.has("sigma_a") {
            return Ok(None);
        }
        let sigma_s = colour(reader, "sigma_s", Use::Coefficient)?.unwrap_or(Spectrum::ZERO);
        let sigma_a = colour(reader, "sigma_a", Use::Coefficient)?.unwrap_or(Spectrum::ZERO);
        Ok(Some((sigma_s, sigma_a)))
    }

    /// The volume, or colour, of the first of some names that is there.
    fn first_volume(&mut self, reader: &Reader, names: &[&str], used: Use, default: f32) -> Result<Volume, SceneError> {
        for name in names {
            if let Some(child) = reader.named_child(name, Kind::Volume)? {
                let built = self.volume(child.target, used);
                let volume = self.description.attempt(child.target, built)?;
                return Ok(volume.unwrap_or(Volume::Constant(Spectrum::splat(default))));
            }
            if let Some(value) = colour(reader, name, used)? {
                return Ok(Volume::Constant(value));
            }
        }
        Ok(Volume::Constant(Spectrum::splat(default)))
    }

    fn volume(&mut self, object: ObjectId, used: Use) -> Result<Volume, SceneError> {
        let reader = self.reader(object);
        match reader.object.plugin.as_str() {
            "constvolume" => {
                let value = colour(&reader, "value", used)?.unwrap_or(Spectrum::ONE);
                reader.finish();
                Ok(Volume::Constant(value))
            }
            "gridvolume" => self
                .grid_volume(&reader, used)
                .map(|volume| Volume::Grid(Box::new(volume))),
            _ => {
                reader.other_type(&VOLUMES, "its value is 1 everywhere")?;
                Ok(Volume::Constant(Spectrum::ONE))
            }
        }
    }

    fn grid_volume(&mut self, reader: &Reader, used: Use) -> Result<GridVolume, SceneError> {
        let to_world = reader.transform("to_world")?.unwrap_or_default();
        let of_file = reader.boolean("use_grid_bbox", false)?;
        let interpolation = reader.choice(
            "filter_type",
            &[
                ("trilinear", Interpolation::Linear),
                ("nearest", Interpolation::Nearest),
            ],
            Interpolation::Linear,
        )?;
        reader.accept(&["raw", "accel", "send_data"]);
        if !reader.choice(
            "wrap_mode",
            &[("clamp", true), ("repeat", false), ("mirror", false)],
            true,
        )? {
            reader.warn_of("wrap_mode", "what lies around the grid has the value of its edge");
        }
        let own = reader.grid("grid");
        let factor = match own {
            Some(_) => colour(reader, "factor", Use::Coefficient)?.unwrap_or(Spectrum::ONE),
            None => Spectrum::ONE,
        };
        reader.property("filename");
        reader.finish();
        let (grid, box_of_file) = match own {
            Some(grid) => (grid, DMat4::IDENTITY),
            None => {
                let file = self.file(reader)?;
                let read = vol::read(&file, self.loader.limits, greatest(used))?;
                let [lower, upper] = read.bounds;
                (
                    Arc::new(read.grid),
                    DMat4::from_translation(lower) * DMat4::from_scale(upper - lower),
                )
            }
        };
        self.voxels += grid.bytes();
        within(
            reader.place(),
            "bytes of volumes",
            self.voxels,
            self.loader.limits.texture_bytes,
        )?;
        let unit = Transform::from_matrix(if of_file { box_of_file } else { DMat4::IDENTITY });
        let unit = unit.ok_or_else(|| reader.wrong("use_grid_bbox", "the box that the file says is empty"))?;
        Ok(GridVolume {
            grid,
            to_local: to_world.after(&unit).inverted(),
            interpolation,
            factor,
        })
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
                mixture(weights.iter().map(|weight| (weight / sum) as f32).zip(parts))
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

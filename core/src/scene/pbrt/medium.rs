//! Media, and what lies on the sides of shapes.

use super::Reading;
use super::parameter::Parameters;
use super::token::Tokens;
use crate::medium::Grid;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError, within};
use crate::scene::spectrum::Use;
use glam::{DMat4, DVec3};
use std::sync::Arc;

const MEDIA: [&str; 5] = ["homogeneous", "uniformgrid", "rgbgrid", "cloud", "nanovdb"];
/// The coefficients of a medium that says none \[1/mm\] (pbrt-v4, `media.cpp`).
const SIGMA_A: [f64; 3] = [0.0011, 0.0024, 0.014];
const SIGMA_S: [f64; 3] = [2.55, 3.21, 3.77];

/// What lies on the inner and on the outer side of shapes; `None` is empty space.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Interface {
    inside: Option<ObjectId>,
    pub(super) outside: Option<ObjectId>,
}

impl Reading<'_, '_> {
    /// Keeps a medium under its name; one that is left out stands for empty space.
    pub(super) fn named_medium(&mut self, name: String, mut parameters: Parameters) -> Result<(), SceneError> {
        let kind = parameters.text("type")?.unwrap_or("homogeneous").to_owned();
        let medium = match kind.as_str() {
            "homogeneous" => Some(self.homogeneous(&parameters)?),
            // pbrt-v3 has another name for it.
            "uniformgrid" | "heterogeneous" => self.uniform_grid(&mut parameters)?,
            "rgbgrid" | "cloud" | "nanovdb" => {
                parameters.warn("media of this type do not exist here: space is empty in its place");
                parameters.ignore_all();
                None
            }
            _ => {
                let (place, context) = (&parameters.place, parameters.context.clone());
                self.faults
                    .note(SceneError::unknown(place, context, "type", &kind, MEDIA))?;
                None
            }
        };
        parameters.finish();
        self.media.insert(name, medium);
        Ok(())
    }

    pub(super) fn medium_interface(&mut self, place: &Place, tokens: &mut Tokens) -> Result<(), SceneError> {
        let inside = tokens.required_text("the medium's name")?;
        let outside = match tokens.peek() {
            Some(b'"') => tokens.required_text("the medium's name")?,
            _ => inside.clone(),
        };
        self.state.interface = Interface {
            inside: self.medium_called(place, &inside)?,
            outside: self.medium_called(place, &outside)?,
        };
        Ok(())
    }

    fn medium_called(&self, place: &Place, name: &str) -> Result<Option<ObjectId>, SceneError> {
        if name.is_empty() {
            return Ok(None);
        }
        if let Some(medium) = self.media.get(name) {
            return Ok(*medium);
        }
        let known = self.media.keys().map(String::as_str);
        self.faults
            .note(SceneError::unknown(place, "MediumInterface", "medium", name, known))?;
        Ok(None)
    }

    /// Says what lies on the sides of a shape, where that is not the same.
    pub(super) fn bound(&mut self, shape: ObjectId) {
        let Interface { inside, outside } = self.state.interface;
        if inside == outside {
            return;
        }
        for (side, medium) in [("interior", inside), ("exterior", outside)] {
            if let Some(medium) = medium {
                self.draft.link(shape, Some(side), medium);
            }
        }
    }

    fn homogeneous(&mut self, parameters: &Parameters) -> Result<ObjectId, SceneError> {
        if parameters.has("preset") {
            parameters.warn_of(
                "preset",
                "the coefficients of substances are not known here: those of the type's defaults count",
            );
            parameters.ignore(&["preset"]);
        }
        let medium = self.add(Kind::Medium, "homogeneous", parameters);
        let [sigma_a, sigma_s] = self.coefficients(parameters, medium)?;
        self.draft.set(medium, "sigma_a", Value::Rgb(sigma_a));
        self.draft.set(medium, "sigma_s", Value::Rgb(sigma_s));
        self.emission(parameters, medium, sigma_a)?;
        Ok(medium)
    }

    /// The coefficients of absorption and scattering, all factors applied; sets the phase function as well.
    fn coefficients(&mut self, parameters: &Parameters, medium: ObjectId) -> Result<[[f64; 3]; 2], SceneError> {
        let scale = parameters.float_or("scale", 1.0)?.max(0.0);
        let g = parameters.float_or("g", 0.0)?;
        let phase = self.add(Kind::Phase, "hg", parameters);
        self.draft.set(phase, "g", Value::Float(g.clamp(-1.0, 1.0)));
        self.draft.link(medium, None, phase);
        let mut coefficient = |name: &str, default: [f64; 3]| {
            let rgb = self.colour(parameters, name, Use::Coefficient)?.unwrap_or(default);
            Ok::<_, SceneError>(rgb.map(|channel| channel * scale))
        };
        Ok([coefficient("sigma_a", SIGMA_A)?, coefficient("sigma_s", SIGMA_S)?])
    }

    /// Emission is absorption times `Le` (pbrt-v4, `HomogeneousMedium::SamplePoint`).
    fn emission(&mut self, parameters: &Parameters, medium: ObjectId, sigma_a: [f64; 3]) -> Result<(), SceneError> {
        let scale = parameters.float_or("Lescale", 1.0)?.max(0.0);
        if let Some(radiance) = self.colour(parameters, "Le", Use::Emission)? {
            let emission = std::array::from_fn(|channel| radiance[channel] * scale * sigma_a[channel]);
            self.draft.set(medium, "emission", Value::Rgb(emission));
        }
        Ok(())
    }

    /// A lattice of densities, by which the coefficients are multiplied, between two corners.
    fn uniform_grid(&mut self, parameters: &mut Parameters) -> Result<Option<ObjectId>, SceneError> {
        let mut size = [1_u32; 3];
        for (size, name) in size.iter_mut().zip(["nx", "ny", "nz"]) {
            let written = parameters.integer(name)?.unwrap_or(1);
            let Ok(count @ 1..) = u32::try_from(written) else {
                return parameters.fault(name, format!("{written} is out of range; allowed: 1 and above"));
            };
            *size = count;
        }
        let voxels = size.iter().map(|size| u64::from(*size)).product();
        within(
            &parameters.place,
            "number of voxels",
            voxels,
            self.loader.limits.image_texels,
        )?;
        let densities = parameters.take_groups::<1>("density")?.unwrap_or_default();
        if densities.len() as u64 != voxels {
            let reason = format!(
                "{} numbers, not the {voxels} of {} x {} x {}",
                densities.len(),
                size[0],
                size[1],
                size[2]
            );
            return parameters.fault("density", reason);
        }
        let memory = |_| SceneError::data(&parameters.place, "memory does not hold the volume");
        let mut grid = Grid::new(size, false).map_err(memory)?;
        for (index, density) in densities.iter().enumerate() {
            let index = index as u32;
            let voxel = [index % size[0], index / size[0] % size[1], index / size[0] / size[1]];
            grid.set(voxel, &density.map(|density| density.max(0.0)))
                .map_err(memory)?;
        }
        let corner = |name: &str, default: DVec3| Ok::<_, SceneError>(parameters.vector(name)?.unwrap_or(default));
        let (lower, upper) = (corner("p0", DVec3::ZERO)?, corner("p1", DVec3::ONE)?);
        let unit = DMat4::from_translation(lower.min(upper)) * DMat4::from_scale((upper - lower).abs());
        if parameters.has("temperature") || parameters.has("Lescale") {
            parameters.warn_of("temperature", "the medium does not glow");
        }
        parameters.ignore(&["temperature", "temperaturecutoff", "temperaturescale", "Le", "Lescale"]);
        let medium = self.add(Kind::Medium, "heterogeneous", parameters);
        let [sigma_a, sigma_s] = self.coefficients(parameters, medium)?;
        let volume = self.add(Kind::Volume, "gridvolume", parameters);
        self.draft.set(volume, "grid", Value::Grid(Arc::new(grid)));
        let sigma_t: [f64; 3] = std::array::from_fn(|channel| sigma_a[channel] + sigma_s[channel]);
        self.draft.set(volume, "factor", Value::Rgb(sigma_t));
        self.set_to_world(volume, self.state.placed(unit))?;
        self.draft.link(medium, Some("sigma_t"), volume);
        let albedo = std::array::from_fn(|channel| match sigma_t[channel] > 0.0 {
            true => sigma_s[channel] / sigma_t[channel],
            false => 0.0,
        });
        self.draft.set(medium, "albedo", Value::Rgb(albedo));
        Ok(Some(medium))
    }
}

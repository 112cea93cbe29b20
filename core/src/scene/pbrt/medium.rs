//! Media, and what lies on the sides of shapes.

use super::Reading;
use super::parameter::Parameters;
use super::token::Tokens;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError};
use crate::scene::spectrum::Use;
use crate::scene::substance;

const MEDIA: [&str; 6] = [
    "homogeneous",
    "heterogeneous",
    "uniformgrid",
    "rgbgrid",
    "cloud",
    "nanovdb",
];
/// The coefficients of a medium that says none in pbrt-v3 \[1/mm\] (`MakeMedium` in `api.cpp`); they are 1 in pbrt-v4 (`media.cpp`).
const OLD_SIGMA_A: [f64; 3] = [0.0011, 0.0024, 0.014];
const OLD_SIGMA_S: [f64; 3] = [2.55, 3.21, 3.77];

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
            "uniformgrid" => self.uniform_grid(&mut parameters, self.old)?,
            // pbrt-v3 has another name for it.
            "heterogeneous" => self.uniform_grid(&mut parameters, true)?,
            "rgbgrid" => self.coloured_grid(&mut parameters)?,
            "cloud" => self.cloud(&parameters)?,
            "nanovdb" => self.tree_of_voxels(&parameters)?,
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
        let medium = self.add(Kind::Medium, "homogeneous", parameters);
        let Coefficients { sigma_a, sigma_s } = self.coefficients(parameters, self.old, medium)?;
        self.draft.set(medium, "sigma_a", Value::Rgb(sigma_a));
        self.draft.set(medium, "sigma_s", Value::Rgb(sigma_s));
        let scale = parameters.float_or("Lescale", 1.0)?.max(0.0);
        if let Some(radiance) = self.colour(parameters, "Le", Use::Emission)? {
            let emission = std::array::from_fn(|channel| radiance[channel] * scale * sigma_a[channel]);
            self.draft.set(medium, "emission", Value::Rgb(emission));
        }
        Ok(medium)
    }

    /// The coefficients of absorption and scattering, all factors applied; sets the phase function as well. `old` says that pbrt-v3's
    /// defaults count.
    pub(super) fn coefficients(
        &mut self,
        parameters: &Parameters,
        old: bool,
        medium: ObjectId,
    ) -> Result<Coefficients, SceneError> {
        let scale = self.scattering(parameters, medium)?;
        let preset = match parameters.text("preset")? {
            None => None,
            Some(name) => {
                let found = substance::named(name);
                if found.is_none() {
                    parameters.warn_of(
                        "preset",
                        "there is no such substance: the coefficients themselves count",
                    );
                }
                found
            }
        };
        let default = match old {
            true => [OLD_SIGMA_A, OLD_SIGMA_S],
            false => [[1.0; 3]; 2],
        };
        let [default_a, default_s] = preset.map_or(default, |substance| [substance.sigma_a, substance.sigma_s]);
        let mut coefficient = |name: &str, default: [f64; 3]| {
            let written = self.colour(parameters, name, Use::Coefficient)?;
            // In pbrt-v4 a substance comes first.
            let rgb = match preset {
                Some(_) if !old => default,
                _ => written.unwrap_or(default),
            };
            Ok::<_, SceneError>(rgb.map(|channel| channel * scale))
        };
        Ok(Coefficients {
            sigma_a: coefficient("sigma_a", default_a)?,
            sigma_s: coefficient("sigma_s", default_s)?,
        })
    }

    /// Sets the phase function of a medium, and gives back the factor on its coefficients.
    pub(super) fn scattering(&mut self, parameters: &Parameters, medium: ObjectId) -> Result<f64, SceneError> {
        let g = parameters.float_or("g", 0.0)?;
        let phase = self.add(Kind::Phase, "hg", parameters);
        self.draft.set(phase, "g", Value::Float(g.clamp(-1.0, 1.0)));
        self.draft.link(medium, None, phase);
        Ok(parameters.float_or("scale", 1.0)?.max(0.0))
    }
}

/// Coefficients of a medium, all factors applied \[1/unit\].
#[derive(Clone, Copy, Debug)]
pub(super) struct Coefficients {
    pub(super) sigma_a: [f64; 3],
    pub(super) sigma_s: [f64; 3],
}

impl Coefficients {
    pub(super) fn sigma_t(self) -> [f64; 3] {
        std::array::from_fn(|channel| self.sigma_a[channel] + self.sigma_s[channel])
    }

    pub(super) fn albedo(self) -> [f64; 3] {
        std::array::from_fn(|channel| match self.sigma_t()[channel] {
            0.0 => 0.0,
            sigma_t => self.sigma_s[channel] / sigma_t,
        })
    }
}

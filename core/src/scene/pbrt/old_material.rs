//! Materials of pbrt-v3 that pbrt-v4 has no more.

use super::Reading;
use super::material::MATERIALS;
use super::parameter::Parameters;
use super::texture::Tint;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::SceneError;
use crate::scene::spectrum::Use;

impl Reading<'_, '_> {
    /// Materials of pbrt-v3 that pbrt-v4 has no more.
    pub(super) fn old_material(&mut self, kind: &str, parameters: &Parameters) -> Result<ObjectId, SceneError> {
        match kind {
            "matte" => {
                self.old = true;
                let reflectance = self.reflectance(parameters, "Kd", 0.5)?;
                let sigma = parameters.float_or("sigma", 0.0)?;
                if sigma == 0.0 {
                    return Ok(self.diffuse(parameters, reflectance));
                }
                let rough = self.add(Kind::Bsdf, "roughdiffuse", parameters);
                self.attach(rough, "reflectance", reflectance);
                // The standard deviation of slopes, of which `alpha` is the root of two.
                let alpha = sigma.to_radians() * std::f64::consts::SQRT_2;
                self.draft.set(rough, "alpha", Value::Float(alpha));
                Ok(self.two_sided(rough, parameters))
            }
            "plastic" | "substrate" | "uber" => {
                self.old = true;
                let default = if kind == "substrate" { 0.5 } else { 0.25 };
                let diffuse = self.reflectance(parameters, "Kd", default)?;
                let specular = self.reflectance(parameters, "Ks", default)?;
                let roughness = self.roughness(parameters, "", 0.1)?;
                parameters.warn("it is rendered as `coateddiffuse`, whose coat and base share the light otherwise");
                let opacity = self.tint(parameters, "opacity", Use::Reflectance)?;
                parameters.ignore(&["Kr", "Kt", "eta", "index"]);
                let coated = self.coated(parameters, diffuse, Some(specular), roughness)?;
                Ok(match opacity {
                    Some(opacity) if opacity.constant() != Some([1.0; 3]) => {
                        let mask = self.add(Kind::Bsdf, "mask", parameters);
                        self.attach(mask, "opacity", opacity);
                        self.draft.link(mask, None, coated);
                        mask
                    }
                    _ => coated,
                })
            }
            "metal" => {
                self.old = true;
                self.conductor(parameters, 0.01)
            }
            "mirror" => {
                self.old = true;
                let reflectance = self.reflectance(parameters, "Kr", 0.9)?;
                let mirror = self.add(Kind::Bsdf, "conductor", parameters);
                self.attach(mirror, "specular_reflectance", reflectance);
                Ok(self.two_sided(mirror, parameters))
            }
            "glass" => {
                self.old = true;
                let name = if parameters.has("index") { "index" } else { "eta" };
                let glass = self.dielectric(parameters, name)?;
                for (name, property) in [("Kr", "specular_reflectance"), ("Kt", "specular_transmittance")] {
                    if let Some(tint) = self.tint(parameters, name, Use::Reflectance)? {
                        self.attach(glass, property, tint);
                    }
                }
                Ok(glass)
            }
            "translucent" => {
                self.old = true;
                parameters.warn("its gloss is left out: it is rendered as `diffusetransmission`");
                parameters.ignore(&["Ks", "roughness", "remaproughness"]);
                let colour = self.reflectance(parameters, "Kd", 0.25)?;
                let both = self.add(Kind::Bsdf, "difftrans", parameters);
                for (name, property) in [("reflect", "reflectance"), ("transmit", "transmittance")] {
                    let share = self.reflectance(parameters, name, 0.5)?;
                    let part = self.product(colour, share, parameters);
                    self.attach(both, property, part);
                }
                Ok(both)
            }
            "disney" => {
                self.old = true;
                self.disney(parameters)
            }
            _ => {
                let (place, context) = (&parameters.place, parameters.context.clone());
                self.faults
                    .note(SceneError::unknown(place, context, "type", kind, MATERIALS))?;
                parameters.ignore_all();
                Ok(self.diffuse(parameters, Tint::Number(0.5)))
            }
        }
    }

    fn disney(&mut self, parameters: &Parameters) -> Result<ObjectId, SceneError> {
        parameters.warn("it is rendered as Mitsuba's `principled`, which is made after the same model");
        let principled = self.add(Kind::Bsdf, "principled", parameters);
        let colour = self.reflectance(parameters, "color", 0.5)?;
        self.attach(principled, "base_color", colour);
        for (name, property) in [
            ("metallic", "metallic"),
            ("roughness", "roughness"),
            ("anisotropic", "anisotropic"),
            ("sheen", "sheen"),
            ("sheentint", "sheen_tint"),
            ("clearcoat", "clearcoat"),
            ("clearcoatgloss", "clearcoat_gloss"),
            ("speculartint", "spec_tint"),
            ("spectrans", "spec_trans"),
        ] {
            if let Some(tint) = self.float_tint(parameters, name)? {
                self.attach(principled, property, tint);
            }
        }
        if let Some(eta) = parameters.float("eta")? {
            self.draft.set(principled, "eta", Value::Float(eta));
        }
        parameters.ignore_all();
        Ok(principled)
    }
}

/// The width of the distribution in pbrt-v3.
pub(super) fn old_alpha(roughness: f64) -> f64 {
    let x = libm::log(roughness.max(1e-3));
    1.621_42 + x * (0.819_955 + x * (0.173_4 + x * (0.017_120_1 + x * 0.000_640_711)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The values of the polynomial at 1 and 0.1, by hand.
    #[test]
    fn roughness_of_pbrt_v3() {
        assert!((old_alpha(1.0) - 1.621_42).abs() < 1e-12);
        assert!((old_alpha(0.1) - 0.461_76).abs() < 1e-4, "{}", old_alpha(0.1));
        assert_eq!(old_alpha(0.0), old_alpha(1e-3));
    }
}

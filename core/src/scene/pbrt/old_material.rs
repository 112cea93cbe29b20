//! Materials of pbrt-v3 that pbrt-v4 has no more.

use super::Reading;
use super::material::MATERIALS;
use super::parameter::Parameters;
use super::texture::Tint;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{SceneError, did_you_mean, list, shortened};
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
            "substrate" => {
                self.old = true;
                let substrate = self.add(Kind::Bsdf, "pbrtsubstrate", parameters);
                for (name, property) in [("Kd", "diffuse_reflectance"), ("Ks", "specular_reflectance")] {
                    let part = self.reflectance(parameters, name, 0.5)?;
                    self.attach(substrate, property, part);
                }
                let roughness = self.roughness(parameters, "", 0.1)?.never_smooth();
                self.set_roughness(substrate, roughness);
                Ok(self.two_sided(substrate, parameters))
            }
            "plastic" => {
                self.old = true;
                // pbrt-v3 takes the light as coming from within, from where steep directions are mirrored in all
                // (`PlasticMaterial::ComputeScatteringFunctions`).
                self.plastic(parameters, 1.0 / 1.5)
            }
            "uber" => {
                self.old = true;
                let opacity = self.tint(parameters, "opacity", Use::Reflectance)?;
                let index = if parameters.has("index") { "index" } else { "eta" };
                let eta = self.index(parameters, index)?;
                for name in ["Kr", "Kt"] {
                    let part = self.tint(parameters, name, Use::Reflectance)?;
                    if part.is_some_and(|part| part.constant() != Some([0.0; 3])) {
                        parameters.warn_of(name, "light that is mirrored or let through by this factor is left out");
                    }
                }
                let coated = self.plastic(parameters, eta)?;
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
                let known = MATERIALS.iter().filter(|known| !known.is_empty()).copied();
                let known = list(known);
                let hint = did_you_mean(kind, &known);
                let kind = shortened(kind);
                parameters.warn(&format!(
                    "there is no type `{kind}`: it is rendered as `diffuse` of reflectance 0.5;{hint} known: {known}"
                ));
                parameters.ignore_all();
                Ok(self.diffuse(parameters, Tint::Number(0.5)))
            }
        }
    }

    /// A diffuse part and a highlight of dielectric microfacets, of an index over that before them.
    fn plastic(&mut self, parameters: &Parameters, eta: f64) -> Result<ObjectId, SceneError> {
        let diffuse = self.reflectance(parameters, "Kd", 0.25)?;
        let specular = self.reflectance(parameters, "Ks", 0.25)?;
        let roughness = self.roughness(parameters, "", 0.1)?.never_smooth();
        if specular.constant() == Some([0.0; 3]) {
            return Ok(self.diffuse(parameters, diffuse));
        }
        let plastic = self.add(Kind::Bsdf, "pbrtplastic", parameters);
        self.attach(plastic, "diffuse_reflectance", diffuse);
        self.attach(plastic, "specular_reflectance", specular);
        self.draft.set(plastic, "eta", Value::Float(eta));
        self.set_roughness(plastic, roughness);
        Ok(self.two_sided(plastic, parameters))
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

//! Materials.
//!
//! Surfaces of pbrt look the same from both sides, so that what only reflects is wrapped in `twosided`. The roughness of pbrt is that of
//! the distribution of Trowbridge and Reitz, GGX.

use super::Reading;
use super::parameter::Parameters;
use super::texture::Tint;
use super::values::Values;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError};
use crate::scene::spectrum::Use;
use crate::texture::Curve;

pub(super) const MATERIALS: [&str; 14] = [
    "diffuse",
    "conductor",
    "dielectric",
    "thindielectric",
    "coateddiffuse",
    "coatedconductor",
    "diffusetransmission",
    "mix",
    "interface",
    "hair",
    "measured",
    "subsurface",
    "",
    "none",
];

/// Below this roughness pbrt takes a surface for smooth (`TrowbridgeReitzDistribution::EffectivelySmooth`).
const SMOOTH: f64 = 1e-3;

/// The roughness along both axes of a surface.
#[derive(Clone, Copy)]
pub(super) struct Roughness([Tint; 2]);

impl Roughness {
    /// As metals and plastics of pbrt-v3 have it, whose roughness 0 is not smooth.
    pub(super) fn never_smooth(self) -> Self {
        Self(self.0.map(|alpha| match alpha {
            Tint::Number(0.0) => Tint::Number(Curve::OldRoughness.of(0.0).into()),
            alpha => alpha,
        }))
    }

    fn is_smooth(self) -> bool {
        self.0
            .iter()
            .all(|alpha| matches!(alpha, Tint::Number(alpha) if *alpha < SMOOTH))
    }
}

impl Reading<'_, '_> {
    /// The material of shapes before the first `Material`.
    pub(super) fn default_material(&mut self) -> ObjectId {
        let place = self.draft.objects[0].place.clone();
        let written = Some("Material \"diffuse\"");
        let both = self.draft.add(Kind::Bsdf, "twosided", written, &place);
        let diffuse = self.draft.add(Kind::Bsdf, "diffuse", written, &place);
        self.draft.link(both, None, diffuse);
        self.state.material = Some(both);
        both
    }

    /// A material of a type, with what bends its normals.
    pub(super) fn material(&mut self, kind: &str, parameters: &Parameters) -> Result<ObjectId, SceneError> {
        parameters.ignore(&["type"]);
        let base = self.base(kind, parameters)?;
        let bumped = self.bumped(base, parameters)?;
        parameters.finish();
        Ok(bumped)
    }

    fn base(&mut self, kind: &str, parameters: &Parameters) -> Result<ObjectId, SceneError> {
        match kind {
            "diffuse" => {
                let reflectance = self.reflectance(parameters, "reflectance", 0.5)?;
                Ok(self.diffuse(parameters, reflectance))
            }
            "conductor" => self.conductor(parameters, 0.0),
            "dielectric" => self.dielectric(parameters, "eta"),
            "thindielectric" => {
                let pane = self.add(Kind::Bsdf, "thindielectric", parameters);
                self.indices(pane, parameters, "eta")?;
                Ok(pane)
            }
            "coateddiffuse" => {
                let reflectance = self.reflectance(parameters, "reflectance", 0.5)?;
                let roughness = self.roughness(parameters, "", 0.0)?;
                self.layers(parameters, "the layers' own scattering is that of `roughplastic`")?;
                self.coated(parameters, reflectance, roughness)
            }
            "coatedconductor" => self.coated_conductor(parameters),
            "diffusetransmission" => {
                let both = self.add(Kind::Bsdf, "difftrans", parameters);
                let scale = parameters.float_or("scale", 1.0)?;
                for name in ["reflectance", "transmittance"] {
                    let part = self.reflectance(parameters, name, 0.25)?;
                    let part = self.times(part, scale, parameters);
                    self.attach(both, name, part);
                }
                Ok(both)
            }
            "mix" => self.mix(parameters),
            "interface" | "" | "none" => Ok(self.add(Kind::Bsdf, "null", parameters)),
            "hair" => {
                parameters.warn("this type does not exist here: it is rendered as `diffuse`");
                parameters.ignore_all();
                let brown = Tint::Rgb([0.35, 0.2, 0.1]);
                let colour = self.tint(parameters, "color", Use::Reflectance)?;
                let reflectance = self.tint(parameters, "reflectance", Use::Reflectance)?;
                Ok(self.diffuse(parameters, reflectance.or(colour).unwrap_or(brown)))
            }
            "measured" | "fourier" => {
                parameters.warn("this type does not exist here: it is rendered as `diffuse` of reflectance 0.5");
                parameters.ignore_all();
                Ok(self.diffuse(parameters, Tint::Number(0.5)))
            }
            "subsurface" | "kdsubsurface" => {
                let without = "light leaves the surface where it arrives: it is rendered as `coateddiffuse`";
                parameters.warn(without);
                let name = if kind == "subsurface" { "reflectance" } else { "Kd" };
                let reflectance = self.reflectance(parameters, name, 0.8)?;
                let roughness = self.roughness(parameters, "", 0.0)?;
                parameters.ignore_all();
                self.coated(parameters, reflectance, roughness)
            }
            _ => self.old_material(kind, parameters),
        }
    }

    pub(super) fn reflectance(
        &mut self,
        parameters: &Parameters,
        name: &str,
        default: f64,
    ) -> Result<Tint, SceneError> {
        Ok(self
            .tint(parameters, name, Use::Reflectance)?
            .unwrap_or(Tint::Number(default)))
    }

    fn times(&mut self, tint: Tint, factor: f64, parameters: &Parameters) -> Tint {
        self.product(tint, Tint::Number(factor), parameters)
    }

    pub(super) fn two_sided(&mut self, side: ObjectId, parameters: &Parameters) -> ObjectId {
        let both = self.add(Kind::Bsdf, "twosided", parameters);
        self.draft.link(both, None, side);
        both
    }

    pub(super) fn diffuse(&mut self, parameters: &Parameters, reflectance: Tint) -> ObjectId {
        let diffuse = self.add(Kind::Bsdf, "diffuse", parameters);
        self.attach(diffuse, "reflectance", reflectance);
        self.two_sided(diffuse, parameters)
    }

    /// The roughness of a surface whose parameters begin with `prefix`. By default it is mapped, so that numbers from 0 to 1 look
    /// evenly spaced: by the root in pbrt-v4, by a polynomial of the logarithm in pbrt-v3 (`TrowbridgeReitzDistribution::RoughnessToAlpha`).
    pub(super) fn roughness(
        &mut self,
        parameters: &Parameters,
        prefix: &str,
        default: f64,
    ) -> Result<Roughness, SceneError> {
        let both = self
            .float_tint(parameters, &format!("{prefix}roughness"))?
            .unwrap_or(Tint::Number(default));
        let u = self
            .float_tint(parameters, &format!("{prefix}uroughness"))?
            .unwrap_or(both);
        let v = self
            .float_tint(parameters, &format!("{prefix}vroughness"))?
            .unwrap_or(both);
        let remap = parameters.boolean("remaproughness", true)?;
        if !remap {
            return Ok(Roughness([u, v]));
        }
        let curve = if self.old { Curve::OldRoughness } else { Curve::Root };
        let mut alpha = |tint: Tint| match tint {
            Tint::Texture(texture) => {
                let curved = self.add(Kind::Texture, "curve", parameters);
                self.draft.link(curved, Some("tex"), texture);
                let name = if self.old { "pbrt3_roughness" } else { "root" };
                self.draft.set(curved, "curve", Value::String(name.into()));
                Tint::Texture(curved)
            }
            // What is said to be smooth is.
            Tint::Number(0.0) => tint,
            Tint::Number(roughness) if curve == Curve::Root => Tint::Number(roughness.max(0.0).sqrt()),
            Tint::Number(roughness) => Tint::Number(curve.of(roughness as f32).into()),
            Tint::Rgb(_) => tint,
        };
        let first = alpha(u);
        Ok(Roughness([first, if u == v { first } else { alpha(v) }]))
    }

    /// Gives `object` its roughness.
    pub(super) fn set_roughness(&mut self, object: ObjectId, roughness: Roughness) {
        self.draft.set(object, "distribution", Value::String("ggx".into()));
        let bounded = |tint| match tint {
            Tint::Number(alpha) => Tint::Number(alpha.clamp(1e-4, 10.0)),
            other => other,
        };
        let [u, v] = roughness.0.map(bounded);
        if u == v {
            self.attach(object, "alpha", u);
        } else {
            self.attach(object, "alpha_u", u);
            self.attach(object, "alpha_v", v);
        }
    }

    /// The index of refraction `name` of what lies behind a surface in empty space.
    pub(super) fn index(&mut self, parameters: &Parameters, name: &str) -> Result<f64, SceneError> {
        let Some(eta) = self.colour(parameters, name, Use::Constant)? else {
            return Ok(1.5);
        };
        let is_named = matches!(parameters.find(name).map(|found| &found.values), Some(Values::Texts(_)));
        if is_named || eta[0] != eta[1] || eta[1] != eta[2] {
            parameters.warn_of(
                name,
                "dispersion is left out: all colours are refracted alike, by the index of the green or of a named glass at 588 nm",
            );
        }
        if eta[1] <= 0.0 {
            return Ok(parameters
                .fault(name, "an index of refraction is above 0")?
                .unwrap_or(1.5));
        }
        Ok(eta[1])
    }

    fn indices(&mut self, object: ObjectId, parameters: &Parameters, name: &str) -> Result<(), SceneError> {
        let index = self.index(parameters, name)?;
        self.draft.set(object, "int_ior", Value::Float(index));
        self.draft.set(object, "ext_ior", Value::Float(1.0));
        Ok(())
    }

    pub(super) fn dielectric(&mut self, parameters: &Parameters, index: &str) -> Result<ObjectId, SceneError> {
        let roughness = self.roughness(parameters, "", 0.0)?;
        let plugin = if roughness.is_smooth() {
            "dielectric"
        } else {
            "roughdielectric"
        };
        let glass = self.add(Kind::Bsdf, plugin, parameters);
        self.indices(glass, parameters, index)?;
        if !roughness.is_smooth() {
            self.set_roughness(glass, roughness);
        }
        Ok(glass)
    }

    pub(super) fn conductor(
        &mut self,
        parameters: &Parameters,
        default_roughness: f64,
    ) -> Result<ObjectId, SceneError> {
        let mut roughness = self.roughness(parameters, "", default_roughness)?;
        if self.old {
            roughness = roughness.never_smooth();
        }
        let metal = self.metal(parameters, "", roughness, 1.0)?;
        Ok(self.two_sided(metal, parameters))
    }

    /// A metal whose parameters begin with `prefix`, under something of the index `outside`.
    fn metal(
        &mut self,
        parameters: &Parameters,
        prefix: &str,
        roughness: Roughness,
        outside: f64,
    ) -> Result<ObjectId, SceneError> {
        let plugin = if roughness.is_smooth() {
            "conductor"
        } else {
            "roughconductor"
        };
        let metal = self.add(Kind::Bsdf, plugin, parameters);
        if !roughness.is_smooth() {
            self.set_roughness(metal, roughness);
        }
        let names = [format!("{prefix}eta"), format!("{prefix}k")];
        match self.tint(parameters, "reflectance", Use::Reflectance)? {
            // The index 1 and the extinction that reflect so much at a right angle (`ConductorMaterial::GetBxDF`).
            Some(Tint::Rgb(reflectance)) => {
                let extinction = |r: f64| {
                    let r = r.clamp(0.0, 0.9999);
                    2.0 * r.sqrt() / (1.0 - r).sqrt()
                };
                self.draft.set(metal, "eta", Value::Rgb([1.0 / outside; 3]));
                self.draft
                    .set(metal, "k", Value::Rgb(reflectance.map(|r| extinction(r) / outside)));
            }
            Some(tint) => {
                let without = "the metal reflects so much at every angle, where pbrt's reflects more at grazing ones";
                parameters.warn_of("reflectance", without);
                self.attach(metal, "specular_reflectance", tint);
            }
            None => {
                let copper = ["metal-Cu-eta", "metal-Cu-k"];
                for ((name, default), property) in names.iter().zip(copper).zip(["eta", "k"]) {
                    let given = match parameters.texture(name)? {
                        Some(_) => {
                            let without =
                                "textures of optical constants do not exist here: those of copper stand in for it";
                            parameters.warn_of(name, without);
                            parameters.ignore(&[name]);
                            None
                        }
                        None => self.colour(parameters, name, Use::Constant)?,
                    };
                    let value = given.or_else(|| super::colour::named(default)).unwrap_or([1.0; 3]);
                    self.draft
                        .set(metal, property, Value::Rgb(value.map(|value| value / outside)));
                }
            }
        }
        Ok(metal)
    }

    /// A diffuse base under a dielectric coat.
    pub(super) fn coated(
        &mut self,
        parameters: &Parameters,
        reflectance: Tint,
        roughness: Roughness,
    ) -> Result<ObjectId, SceneError> {
        let plugin = if roughness.is_smooth() {
            "plastic"
        } else {
            "roughplastic"
        };
        let plastic = self.add(Kind::Bsdf, plugin, parameters);
        self.attach(plastic, "diffuse_reflectance", reflectance);
        self.draft.set(plastic, "nonlinear", Value::Boolean(true));
        self.indices(plastic, parameters, "eta")?;
        if !roughness.is_smooth() {
            let [u, v] = roughness.0;
            if let (Tint::Number(u), Tint::Number(v)) = (u, v)
                && u != v
            {
                parameters.warn("the coat is as rough along both axes, by their mean");
                let mean = Tint::Number(0.5 * (u + v));
                self.set_roughness(plastic, Roughness([mean; 2]));
            } else {
                self.set_roughness(plastic, Roughness([u; 2]));
            }
        }
        Ok(self.two_sided(plastic, parameters))
    }

    /// Parameters of what lies between two layers.
    fn layers(&mut self, parameters: &Parameters, instead: &str) -> Result<(), SceneError> {
        let albedo = self.tint(parameters, "albedo", Use::Reflectance)?;
        if albedo.is_some_and(|albedo| albedo.constant() != Some([0.0; 3])) {
            parameters.warn_of("albedo", "nothing scatters light between the layers");
        }
        parameters.ignore(&["g", "thickness", "maxdepth", "nsamples"]);
        parameters.warn(instead);
        Ok(())
    }

    fn coated_conductor(&mut self, parameters: &Parameters) -> Result<ObjectId, SceneError> {
        self.layers(parameters, "it is rendered as a conductor under Mitsuba's `coating`")?;
        let coat = self.roughness(parameters, "interface.", 0.0)?;
        let inner = self.roughness(parameters, "conductor.", 0.0)?;
        let index = self.index(parameters, "interface.eta")?;
        let metal = self.metal(parameters, "conductor.", inner, index)?;
        let plugin = if coat.is_smooth() { "coating" } else { "roughcoating" };
        let coating = self.add(Kind::Bsdf, plugin, parameters);
        self.draft.set(coating, "int_ior", Value::Float(index));
        self.draft.set(coating, "ext_ior", Value::Float(1.0));
        if !coat.is_smooth() {
            let [u, _] = coat.0;
            self.set_roughness(coating, Roughness([u; 2]));
        }
        self.draft.link(coating, None, metal);
        Ok(self.two_sided(coating, parameters))
    }

    /// Two materials. The amount is the share of the second in pbrt-v4, and of the first in pbrt-v3, which names them apart.
    fn mix(&mut self, parameters: &Parameters) -> Result<ObjectId, SceneError> {
        let names: Vec<String> = match parameters.texts("materials")? {
            Some(names) => names.to_vec(),
            None => {
                let mut names = Vec::new();
                for name in ["namedmaterial2", "namedmaterial1"] {
                    names.extend(parameters.text(name)?.map(str::to_owned));
                }
                names
            }
        };
        let mut parts = Vec::new();
        for name in &names {
            match self.materials.get(name) {
                Some(material) => parts.push(*material),
                None => {
                    let known = self.materials.keys().map(String::as_str);
                    let (place, context) = (&parameters.place, parameters.context.clone());
                    self.faults
                        .note(SceneError::unknown(place, context, "material", name, known))?;
                }
            }
        }
        let mix = self.add(Kind::Bsdf, "blendbsdf", parameters);
        if names.len() != 2 {
            parameters.fault::<()>("materials", format!("expected two names, found {}", names.len()))?;
        }
        let weight = match self.float_tint(parameters, "amount")? {
            Some(tint) => tint,
            None => Tint::Number(0.5),
        };
        self.attach(mix, "weight", weight);
        for part in parts {
            self.draft.link(mix, None, part);
        }
        Ok(mix)
    }

    /// A material under a texture of heights or an image of normals.
    fn bumped(&mut self, base: ObjectId, parameters: &Parameters) -> Result<ObjectId, SceneError> {
        let mut bumped = base;
        let old = self.float_tint(parameters, "bumpmap")?;
        if let Some(Tint::Texture(heights)) = self.float_tint(parameters, "displacement")?.or(old) {
            let bump = self.add(Kind::Bsdf, "bumpmap", parameters);
            self.draft.link(bump, None, heights);
            self.draft.link(bump, None, bumped);
            self.draft.set(bump, "scale", Value::Float(1.0));
            bumped = bump;
        }
        if let Some(file) = parameters.text("normalmap")?.map(str::to_owned) {
            let image = self.add(Kind::Texture, "bitmap", parameters);
            self.draft.set(image, "filename", Value::String(file));
            self.draft.set(image, "raw", Value::Boolean(true));
            self.flip_v(image);
            let map = self.add(Kind::Bsdf, "normalmap", parameters);
            self.draft.link(map, Some("normalmap"), image);
            self.draft.link(map, None, bumped);
            bumped = map;
        }
        Ok(bumped)
    }

    /// A material that is cut out by an opacity.
    pub(super) fn masked(&mut self, material: ObjectId, opacity: Tint, written: &str, place: &Place) -> ObjectId {
        let mask = self.draft.add(Kind::Bsdf, "mask", Some(written), place);
        self.attach(mask, "opacity", opacity);
        self.draft.link(mask, None, material);
        mask
    }
}

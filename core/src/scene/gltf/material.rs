//! Materials as BSDFs and area lights.
//!
//! A material becomes `principled`, whose parameters are those of glTF's metallic-roughness model; clear glass and smooth metal become the
//! plugins that are made for them. What has no counterpart is told.

use super::document::{Document, Material, TextureInfo, Volume};
use super::solid::{extinction, single_scattering};
use super::texture::{Change, Sampling, Textures};
use super::warnings::Told;
use crate::scene::description::{Draft, Kind, ObjectId, Value};
use crate::scene::error::{SceneError, shortened};
use crate::scene::loader::Loader;
use std::collections::BTreeMap;

/// What a primitive looks like.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Look {
    /// `None` where the material lets everything through.
    pub(super) bsdf: Option<ObjectId>,
    pub(super) emitter: Option<ObjectId>,
    /// The medium that the surface encloses.
    pub(super) interior: Option<ObjectId>,
    /// Whether the surface encloses a body that light comes into.
    pub(super) is_solid: bool,
    /// The set of texture coordinates that its textures use.
    pub(super) uv_set: u32,
}

/// Roughness (`alpha` of the microfacets) below which a surface counts as smooth.
const SMOOTH: f64 = 1e-4;

/// Extensions of materials that are left out, with what the picture lacks.
const LEFT_OUT: [(&str, &str); 4] = [
    ("KHR_materials_iridescence", "no colours of thin films"),
    ("KHR_materials_dispersion", "all colours are refracted alike"),
    (
        "KHR_materials_diffuse_transmission",
        "no light comes through from behind",
    ),
    ("KHR_materials_variants", "the default variant is shown"),
];

/// Materials that were made, by their index and whether vertices have colours.
pub(super) struct Materials<'a> {
    document: &'a Document,
    told: &'a Told,
    made: BTreeMap<(Option<usize>, bool), Look>,
    /// Whether glass without a thickness is a solid, as in files of Blender.
    solid_glass: bool,
}

impl<'a> Materials<'a> {
    pub(super) fn new(document: &'a Document, told: &'a Told) -> Self {
        Self {
            document,
            told,
            made: BTreeMap::new(),
            solid_glass: document.asset.generator.contains("Blender"),
        }
    }

    /// What the material `index` looks like, on vertices that are coloured or not; a primitive without one has the default material.
    pub(super) fn look(
        &mut self,
        (index, coloured): (Option<usize>, bool),
        draft: &mut Draft,
        textures: &mut Textures,
        loader: &mut Loader,
        used: &str,
    ) -> Result<Look, SceneError> {
        if let Some(look) = self.made.get(&(index, coloured)) {
            return Ok(*look);
        }
        let default = Material::default();
        let (material, name) = match index {
            Some(index) => {
                let materials = &self.document.materials;
                let material = materials.get(index).ok_or_else(|| {
                    let reason = format!("there is no material {index}; the file has {}", materials.len());
                    SceneError::value(self.told.place(), used, reason)
                })?;
                (
                    material,
                    format!("materials[{index}] \"{}\"", shortened(&material.name)),
                )
            }
            None => (&default, "the default material".to_owned()),
        };
        let mut maker = Maker {
            material,
            name,
            told: self.told,
            draft,
            textures,
            loader,
            coloured,
            uv_set: None,
        };
        let look = maker.make(self.solid_glass)?;
        self.made.insert((index, coloured), look);
        Ok(look)
    }
}

/// Makes the objects of one material.
struct Maker<'m, 't, 'd, 'l, 'f> {
    material: &'m Material,
    name: String,
    told: &'m Told,
    draft: &'d mut Draft,
    textures: &'d mut Textures<'t>,
    loader: &'l mut Loader<'f>,
    /// Whether the base colour is multiplied by the colours of vertices.
    coloured: bool,
    /// The set of texture coordinates of the first texture.
    uv_set: Option<u32>,
}

impl Maker<'_, '_, '_, '_, '_> {
    fn warn(&self, message: &str) {
        self.told.warn(format!("{}: {message}", self.name));
    }

    fn make(&mut self, solid_glass: bool) -> Result<Look, SceneError> {
        self.tell_left_out();
        let material = self.material;
        let unlit = material.extensions.unlit.is_some();
        let surface = match unlit {
            true => self.black()?,
            false => self.surface(solid_glass)?,
        };
        let bumped = self.bumped(surface.bsdf)?;
        let both = match surface.transmits {
            true => bumped,
            false => self.around("twosided", bumped),
        };
        let bsdf = self.masked(both)?;
        if let Some(bsdf) = bsdf {
            self.draft.call(bsdf, &material.name);
        }
        let emitter = self.emitter(unlit)?;
        let interior = self.interior(surface.transmits);
        let is_solid = surface.transmits && (solid_glass || material.extensions.volume.is_some());
        Ok(Look {
            bsdf,
            emitter,
            interior,
            is_solid,
            uv_set: self.uv_set.unwrap_or(0),
        })
    }

    /// Warns about what has no counterpart.
    fn tell_left_out(&self) {
        for (extension, without) in LEFT_OUT {
            if self.material.extensions.others.contains_key(extension) {
                self.warn(&format!("{extension} is left out: {without}"));
            }
        }
        for extension in self.material.extensions.others.keys() {
            if !LEFT_OUT.iter().any(|(known, _)| known == extension) {
                self.warn(&format!("{} is not known here and left out", shortened(extension)));
            }
        }
    }

    fn add(&mut self, kind: Kind, plugin: &str) -> ObjectId {
        self.draft.add(kind, plugin, Some(&self.name), self.told.place())
    }

    /// A BSDF around another.
    fn around(&mut self, plugin: &str, inner: ObjectId) -> ObjectId {
        let outer = self.add(Kind::Bsdf, plugin);
        self.draft.link(outer, None, inner);
        outer
    }

    /// Takes the set of coordinates of a texture, where it is the material's first.
    fn choose_set(&mut self, info: &TextureInfo, field: &str) {
        let transform = info.extensions.transform.as_ref();
        let set = transform
            .and_then(|transform| transform.tex_coord)
            .unwrap_or(info.tex_coord);
        let taken = *self.uv_set.get_or_insert(set);
        if taken != set {
            self.warn(&format!(
                "`{field}` takes TEXCOORD_{set}: it is rendered with TEXCOORD_{taken}, as the other textures"
            ));
        }
    }

    /// The texture of `info`, as in `sampling`.
    fn texture(&mut self, info: &TextureInfo, field: &str, sampling: Sampling) -> Result<ObjectId, SceneError> {
        self.choose_set(info, field);
        let written = format!("{} {field}", self.name);
        self.textures.add(self.draft, self.loader, info, &written, sampling)
    }

    /// The texture of numbers that `change` makes of that of `info`.
    fn changed(&mut self, info: &TextureInfo, field: &str, change: Change) -> Result<ObjectId, SceneError> {
        self.choose_set(info, field);
        let written = format!("{} {field}", self.name);
        self.textures
            .add_changed(self.draft, self.loader, info, &written, change)
    }

    /// The property `name`, a colour: `factor`, times the texture where there is one.
    fn colour(
        &mut self,
        object: ObjectId,
        name: &str,
        factor: [f64; 3],
        (info, field): (Option<&TextureInfo>, &str),
    ) -> Result<(), SceneError> {
        match info {
            Some(info) if factor.iter().any(|c| *c > 0.0) => {
                let texture = self.texture(info, field, Sampling::colour(factor))?;
                self.draft.link(object, Some(name), texture);
            }
            _ => self.draft.set(object, name, Value::Rgb(factor)),
        }
        Ok(())
    }

    /// The base colour: `factor`, times the texture and the colours of vertices where there are such.
    fn base_colour(&mut self, object: ObjectId, name: &str, factor: [f64; 3]) -> Result<(), SceneError> {
        let material = self.material;
        let texture = material.pbr_metallic_roughness.base_color_texture.as_ref();
        if !self.coloured {
            return self.colour(object, name, factor, (texture, "baseColorTexture"));
        }
        let vertices = self.add(Kind::Texture, "mesh_attribute");
        if texture.is_none() && factor == [1.0; 3] {
            self.draft.link(object, Some(name), vertices);
            return Ok(());
        }
        let product = self.add(Kind::Texture, "scale");
        self.draft.link(product, None, vertices);
        self.colour(product, "scale", factor, (texture, "baseColorTexture"))?;
        self.draft.link(object, Some(name), product);
        Ok(())
    }

    /// The property `name`, a number: `factor`, times a channel of the texture where there is one.
    fn number(
        &mut self,
        object: ObjectId,
        name: &str,
        factor: f64,
        (info, field, channel): (Option<&TextureInfo>, &str, &'static str),
    ) -> Result<(), SceneError> {
        match info {
            Some(info) if factor > 0.0 => {
                let texture = self.texture(info, field, Sampling::channel(channel, factor))?;
                self.draft.link(object, Some(name), texture);
            }
            _ => self.draft.set(object, name, Value::Float(factor)),
        }
        Ok(())
    }

    /// A surface that only shines.
    fn black(&mut self) -> Result<Surface, SceneError> {
        let bsdf = self.add(Kind::Bsdf, "diffuse");
        self.draft.set(bsdf, "reflectance", Value::Rgb([0.0; 3]));
        Ok(Surface { bsdf, transmits: false })
    }

    fn surface(&mut self, solid_glass: bool) -> Result<Surface, SceneError> {
        let material = self.material;
        let extensions = &material.extensions;
        let plain = &material.pbr_metallic_roughness;
        let base = self.factors(&plain.base_color_factor, "baseColorFactor");
        if extensions.specular_glossiness.is_some() {
            return self.specular_glossiness();
        }
        let textured = plain.metallic_roughness_texture.is_some();
        let metallic = self.factor(plain.metallic_factor, "metallicFactor");
        let roughness = self.factor(plain.roughness_factor, "roughnessFactor");
        let transmission = extensions.transmission.as_ref();
        let transmitted = transmission.map_or(0.0, |glass| {
            self.factor(glass.transmission_factor, "transmissionFactor")
        });
        let eta = self.index_of_refraction(transmitted > 0.0);
        let even = !textured && plain.base_color_texture.is_none() && !self.coloured;
        let wholly = transmitted == 1.0 && transmission.is_some_and(|glass| glass.transmission_texture.is_none());
        let thin = transmitted > 0.0 && extensions.volume.is_none() && !solid_glass;
        let coated = extensions.clearcoat.is_some() || extensions.sheen.is_some();
        if even && wholly && !coated && metallic == 0.0 && !thin {
            return self.glass(eta, roughness, base);
        }
        if even && !coated && metallic == 1.0 && roughness * roughness < SMOOTH {
            return self.mirror(base);
        }
        let matt = eta == 1.0 && transmitted == 0.0;
        if matt && !coated && metallic == 0.0 && extensions.anisotropy.is_none() {
            // Without a reflecting surface the model is Lambert's.
            let bsdf = self.add(Kind::Bsdf, "diffuse");
            self.base_colour(bsdf, "reflectance", base)?;
            return Ok(Surface { bsdf, transmits: false });
        }
        let bsdf = self.add(Kind::Bsdf, if thin { "principledthin" } else { "principled" });
        let color = match transmitted > 0.0 {
            true => base,
            // The diffuse part of glTF gets what the surface above it lets through, 1 - F (appendix B.3.5), and that of `principled` all. Of F
            // the value at normal incidence is taken.
            false if metallic == 0.0 => base.map(|c| c * (1.0 - normal_reflectance(eta))),
            false => base,
        };
        self.base_colour(bsdf, "base_color", color)?;
        let texture = plain.metallic_roughness_texture.as_ref();
        self.number(bsdf, "roughness", roughness, (texture, "metallicRoughnessTexture", "g"))?;
        if !thin {
            self.number(bsdf, "metallic", metallic, (texture, "metallicRoughnessTexture", "b"))?;
        }
        self.draft.set(bsdf, "eta", Value::Float(eta));
        if transmitted > 0.0 {
            let texture = transmission.and_then(|glass| glass.transmission_texture.as_ref());
            self.number(bsdf, "spec_trans", transmitted, (texture, "transmissionTexture", "r"))?;
        }
        if !thin {
            self.coats(bsdf)?;
        }
        Ok(Surface {
            bsdf,
            transmits: transmitted > 0.0,
        })
    }

    /// Clear coat, sheen and anisotropy, by the parameters of Disney's model that are nearest.
    fn coats(&mut self, bsdf: ObjectId) -> Result<(), SceneError> {
        let extensions = &self.material.extensions;
        if let Some(coat) = extensions.clearcoat.as_ref().filter(|coat| coat.clearcoat_factor > 0.0) {
            let factor = self.factor(coat.clearcoat_factor, "clearcoatFactor");
            self.number(
                bsdf,
                "clearcoat",
                factor,
                (coat.clearcoat_texture.as_ref(), "clearcoatTexture", "r"),
            )?;
            let roughness = self.factor(coat.clearcoat_roughness_factor, "clearcoatRoughnessFactor");
            // The gloss goes from a roughness of 0.1 to one of 0.001 (Burley 2012).
            let gloss = ((0.1 - roughness * roughness) / 0.099).clamp(0.0, 1.0);
            self.draft.set(bsdf, "clearcoat_gloss", Value::Float(gloss));
            if coat.clearcoat_roughness_texture.is_some() || coat.clearcoat_normal_texture.is_some() {
                self.warn("the textures of the clear coat's roughness and normals are left out");
            }
        }
        if let Some(sheen) = extensions.sheen.as_ref() {
            let strongest = sheen.sheen_color_factor.iter().copied().fold(0.0, f64::max);
            if strongest > 0.0 {
                let strongest = self.factor(strongest, "sheenColorFactor");
                self.draft.set(bsdf, "sheen", Value::Float(strongest));
                self.warn("KHR_materials_sheen is approximated: the sheen of `principled`, without its colour");
            }
            if sheen.sheen_color_texture.is_some() {
                self.warn("`sheenColorTexture` is left out");
            }
        }
        if let Some(brushed) = extensions
            .anisotropy
            .as_ref()
            .filter(|brushed| brushed.anisotropy_strength > 0.0)
        {
            let strength = self.factor(brushed.anisotropy_strength, "anisotropyStrength");
            self.draft.set(bsdf, "anisotropic", Value::Float(strength));
            if brushed.anisotropy_rotation != 0.0 || brushed.anisotropy_texture.is_some() {
                self.warn("the anisotropy is rendered along the texture coordinates, without its rotation and texture");
            }
        }
        Ok(())
    }

    /// A solid of glass, of which each surface takes the square root of the colour, as in Cycles.
    fn glass(&mut self, eta: f64, roughness: f64, base: [f64; 3]) -> Result<Surface, SceneError> {
        let alpha = roughness * roughness;
        let rough = alpha >= SMOOTH;
        let bsdf = self.add(Kind::Bsdf, if rough { "roughdielectric" } else { "dielectric" });
        self.draft.set(bsdf, "int_ior", Value::Float(eta));
        self.draft.set(bsdf, "ext_ior", Value::Float(1.0));
        self.draft
            .set(bsdf, "specular_transmittance", Value::Rgb(base.map(f64::sqrt)));
        if rough {
            self.draft.set(bsdf, "distribution", Value::String("ggx".into()));
            self.draft.set(bsdf, "alpha", Value::Float(alpha));
        }
        Ok(Surface { bsdf, transmits: true })
    }

    /// A smooth metal whose colour at normal incidence is `base`: an index of 1 and the absorption that gives it.
    fn mirror(&mut self, base: [f64; 3]) -> Result<Surface, SceneError> {
        let bsdf = self.add(Kind::Bsdf, "conductor");
        self.draft.set(bsdf, "eta", Value::Rgb([1.0; 3]));
        let absorption = base.map(|r| {
            let r = r.min(0.9999);
            2.0 * (r / (1.0 - r)).sqrt()
        });
        self.draft.set(bsdf, "k", Value::Rgb(absorption));
        Ok(Surface { bsdf, transmits: false })
    }

    /// The old KHR_materials_pbrSpecularGlossiness, whose diffuse part is rendered.
    fn specular_glossiness(&mut self) -> Result<Surface, SceneError> {
        let material = self.material;
        let Some(old) = &material.extensions.specular_glossiness else {
            return self.black();
        };
        self.warn(
            "KHR_materials_pbrSpecularGlossiness is approximated: a dielectric of its diffuse colour and glossiness",
        );
        let diffuse = self.factors(&old.diffuse_factor, "diffuseFactor");
        let glossiness = self.factor(old.glossiness_factor, "glossinessFactor");
        let bsdf = self.add(Kind::Bsdf, "principled");
        self.colour(
            bsdf,
            "base_color",
            diffuse,
            (old.diffuse_texture.as_ref(), "diffuseTexture"),
        )?;
        self.draft.set(bsdf, "roughness", Value::Float(1.0 - glossiness));
        Ok(Surface { bsdf, transmits: false })
    }

    /// A factor, which lies between 0 and 1.
    fn factor(&self, factor: f64, field: &str) -> f64 {
        if !(0.0..=1.0).contains(&factor) {
            self.warn(&format!(
                "`{field}` is {factor}, which counts as {}: it lies between 0 and 1",
                factor.clamp(0.0, 1.0)
            ));
        }
        factor.clamp(0.0, 1.0)
    }

    fn factors(&self, factors: &[f64; 4], field: &str) -> [f64; 3] {
        [0, 1, 2].map(|i| self.factor(factors[i], field))
    }

    /// The index that gives the reflectance at normal incidence of KHR_materials_ior and KHR_materials_specular.
    fn index_of_refraction(&self, transmits: bool) -> f64 {
        let extensions = &self.material.extensions;
        // 0 stands for a mirror in both (KHR_materials_ior).
        let ior = match extensions.ior.as_ref().map_or(1.5, |ior| ior.ior) {
            ior if ior >= 1.0 => ior.min(MOST_IOR),
            0.0 => MOST_IOR,
            ior => {
                self.warn(&format!("`ior` is {ior}, which counts as 1: it is 1 or more"));
                1.0
            }
        };
        let Some(specular) = &extensions.specular else {
            return ior;
        };
        if specular.specular_texture.is_some() || specular.specular_color_texture.is_some() {
            self.warn("the textures of KHR_materials_specular are left out: its factors count");
        }
        let [r, g, b] = specular.specular_color_factor;
        if r != g || g != b {
            self.warn("the colour of KHR_materials_specular is left out: its mean counts");
        }
        let scale = self.factor(specular.specular_factor, "specularFactor") * (r + g + b) / 3.0;
        if transmits || scale == 1.0 {
            return ior;
        }
        let root = (normal_reflectance(ior) * scale).clamp(0.0, 0.9).sqrt();
        (1.0 + root) / (1.0 - root)
    }

    /// What fills a solid of a material that light comes through: KHR_materials_volume says how much is lost along a way, by absorption, and with
    /// KHR_materials_volume_scatter by scattering as well.
    fn interior(&mut self, transmits: bool) -> Option<ObjectId> {
        let extensions = &self.material.extensions;
        let scatter = extensions.volume_scatter.as_ref();
        let of_solid = |volume: &&Volume| transmits && volume.thickness_factor > 0.0;
        let sigma_t = extensions.volume.as_ref().filter(of_solid).and_then(extinction);
        let Some(sigma_t) = sigma_t else {
            if scatter.is_some() {
                self.warn(
                    "KHR_materials_volume_scatter is left out: it scatters within what KHR_materials_transmission lets light into, and \
                     KHR_materials_volume gives a thickness and an attenuation",
                );
            }
            return None;
        };
        let albedo = match scatter {
            None => [0.0; 3],
            Some(scatter) => {
                let [r, g, b] = scatter.multiscatter_color;
                let [r, g, b] = self.factors(&[r, g, b, 1.0], "multiscatterColor");
                [r, g, b].map(single_scattering)
            }
        };
        let medium = self.add(Kind::Medium, "homogeneous");
        self.draft.set(medium, "sigma_t", Value::Rgb(sigma_t));
        self.draft.set(medium, "albedo", Value::Rgb(albedo));
        let g = scatter.map_or(0.0, |scatter| scatter.scatter_anisotropy.clamp(-1.0, 1.0));
        if g != 0.0 {
            let phase = self.add(Kind::Phase, "hg");
            self.draft.set(phase, "g", Value::Float(g));
            self.draft.link(medium, None, phase);
        }
        Some(medium)
    }

    /// The normal texture around a BSDF.
    fn bumped(&mut self, inner: ObjectId) -> Result<ObjectId, SceneError> {
        let material = self.material;
        let Some(normals) = &material.normal_texture else {
            return Ok(inner);
        };
        let field = "normalTexture";
        let texture = match normals.scale == 1.0 {
            true => self.texture(normals, field, Sampling::numbers())?,
            false => self.changed(normals, field, Change::Steeper { scale: normals.scale })?,
        };
        let outer = self.around("normalmap", inner);
        self.draft.link(outer, Some("normalmap"), texture);
        Ok(outer)
    }

    /// The opacity around a BSDF; `None` where nothing is left of it.
    fn masked(&mut self, inner: ObjectId) -> Result<Option<ObjectId>, SceneError> {
        let material = self.material;
        let plain = &material.pbr_metallic_roughness;
        let alpha = self.factor(plain.base_color_factor[3], "baseColorFactor");
        let cutoff = match material.alpha_mode.as_deref() {
            None | Some("OPAQUE") => return Ok(Some(inner)),
            Some("MASK") => Some(material.alpha_cutoff.unwrap_or(0.5)),
            Some("BLEND") => None,
            Some(other) => {
                let reason = format!("there is no mode `{}`; allowed: OPAQUE, MASK, BLEND", shortened(other));
                return Err(SceneError::value(
                    self.told.place(),
                    format!("{} `alphaMode`", self.name),
                    reason,
                ));
            }
        };
        let Some(texture) = &plain.base_color_texture else {
            let opacity = match cutoff {
                Some(cutoff) => f64::from(u8::from(alpha >= cutoff)),
                None => alpha,
            };
            if opacity == 0.0 {
                return Ok(None);
            }
            if opacity == 1.0 {
                return Ok(Some(inner));
            }
            let outer = self.around("mask", inner);
            self.draft.set(outer, "opacity", Value::Float(opacity));
            return Ok(Some(outer));
        };
        if alpha == 0.0 {
            return Ok(cutoff.filter(|cutoff| *cutoff <= 0.0).map(|_| inner));
        }
        let field = "baseColorTexture";
        let opacity = match cutoff {
            None => self.texture(texture, field, Sampling::channel("a", alpha))?,
            Some(cutoff) => self.changed(texture, field, Change::Cut { factor: alpha, cutoff })?,
        };
        let outer = self.around("mask", inner);
        self.draft.link(outer, Some("opacity"), opacity);
        Ok(Some(outer))
    }

    /// The area light of a material that shines. What is unlit shines with its base colour.
    fn emitter(&mut self, unlit: bool) -> Result<Option<ObjectId>, SceneError> {
        let material = self.material;
        let plain = &material.pbr_metallic_roughness;
        let [r, g, b, _] = plain.base_color_factor;
        let strength = material.extensions.emissive_strength.as_ref();
        let strength = strength.map_or(1.0, |strength| strength.emissive_strength);
        let (factor, texture) = match unlit {
            true => ([r, g, b], (plain.base_color_texture.as_ref(), "baseColorTexture")),
            false => (
                material.emissive_factor.map(|c| c * strength),
                (material.emissive_texture.as_ref(), "emissiveTexture"),
            ),
        };
        let factor = factor.map(|c| c.max(0.0));
        if factor == [0.0; 3] {
            return Ok(None);
        }
        let emitter = self.add(Kind::Emitter, "area");
        self.colour(emitter, "radiance", factor, texture)?;
        Ok(Some(emitter))
    }
}

/// The reflectance of a dielectric at normal incidence.
fn normal_reflectance(eta: f64) -> f64 {
    let root = (eta - 1.0) / (eta + 1.0);
    root * root
}

/// The largest index that is rendered: it reflects nine tenths at normal incidence.
const MOST_IOR: f64 = 38.0;

/// A BSDF without what lies around it.
struct Surface {
    bsdf: ObjectId,
    /// Whether light comes through, so that its back looks otherwise than its front.
    transmits: bool,
}

//! BSDFs.

use super::texture::{Role, colour};
use super::{Builder, Plain};
use crate::material::{Coat, Material, MicrofacetKind, RoughCoat, Roughness, ior};
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{SceneError, shortened, within};
use crate::scene::reader::{POSITIVE, Reader};
use crate::scene::spectrum::Use;
use crate::spectrum::Spectrum;
use crate::texture::Texture;
use std::ops::RangeInclusive;
use std::sync::Arc;

const SUPPORTED: [&str; 27] = [
    "diffuse",
    "twosided",
    "dielectric",
    "roughdielectric",
    "thindielectric",
    "conductor",
    "roughconductor",
    "plastic",
    "roughplastic",
    "coating",
    "roughcoating",
    "mask",
    "blendbsdf",
    "mixturebsdf",
    "normalmap",
    "bumpmap",
    "bump",
    "null",
    "principled",
    "principledthin",
    "roughdiffuse",
    "phong",
    "ward",
    "pbrtplastic",
    "pbrtsubstrate",
    "difftrans",
    "diffusetransmission",
];
/// How deep BSDFs lie within each other at most.
const DEEPEST: u64 = 16;
/// How many BSDFs a material consists of at most: each of them is looked up at every hit.
const MOST_WITHIN: u64 = 256;
/// The range of roughness.
const ROUGHNESS: RangeInclusive<f64> = 0.0..=10.0;
/// Below it the microfacet distributions lose precision; as in Mitsuba it stands for all that is less.
const LEAST_ROUGHNESS: f64 = 1e-4;

impl Builder<'_, '_> {
    /// The index of the material that `object` describes.
    pub(super) fn material(&mut self, object: ObjectId) -> Result<u32, SceneError> {
        if self.attributes.is_empty()
            && let Some(index) = self.material_of.get(&object)
        {
            return Ok(*index);
        }
        let built = self.new_material(object);
        let index = match self.description.attempt(object, built)? {
            Some(material) => self.add_material(material, self.name_of_material(object)),
            None => self.default_material(),
        };
        // What shows attributes of a mesh is the material of this mesh alone.
        if self.attributes.is_empty() {
            self.material_of.insert(object, index);
        }
        Ok(index)
    }

    /// The material of shapes without one: Mitsuba's default, a grey diffuse surface.
    pub(super) fn default_material(&mut self) -> u32 {
        self.plain_material(Plain::Grey)
    }

    /// A material that no file describes.
    pub(super) fn plain_material(&mut self, plain: Plain) -> u32 {
        if let Some(index) = self.plain_materials[plain as usize] {
            return index;
        }
        let diffuse = |reflectance| Material::Diffuse {
            reflectance: Texture::Constant(Spectrum::splat(reflectance)),
        };
        let material = match plain {
            Plain::Grey => diffuse(0.5),
            Plain::Black => diffuse(0.0),
            Plain::Invisible => Material::Null,
        };
        let index = self.add_material(material, None);
        self.plain_materials[plain as usize] = Some(index);
        index
    }

    fn add_material(&mut self, material: Material, name: Option<Arc<str>>) -> u32 {
        self.materials.push(material);
        self.called.materials.push(name);
        self.materials.len() as u32 - 1
    }

    /// What a material is called: where it has no name itself and lies around one other, what that is called.
    fn name_of_material(&self, object: ObjectId) -> Option<Arc<str>> {
        let mut within = vec![object];
        while within.len() as u64 <= DEEPEST {
            let last = within.last().copied()?;
            let children = self.description.objects[last].children.iter();
            let bsdfs = children.filter(|child| self.description.objects[child.target].kind == Kind::Bsdf);
            match &bsdfs.map(|child| child.target).collect::<Vec<_>>()[..] {
                [only] => within.push(*only),
                _ => break,
            }
        }
        self.name_of(within)
    }

    pub(super) fn new_material(&mut self, object: ObjectId) -> Result<Material, SceneError> {
        let reader = self.reader(object);
        if self.building.contains(&object) {
            let place = reader.place().clone();
            let (id, reason) = (reader.object.plugin.clone(), "the BSDF contains itself".to_owned());
            return Err(SceneError::Reference { place, id, reason });
        }
        if self.building.is_empty() {
            self.bsdfs_within = 0;
        }
        self.bsdfs_within += 1;
        within(
            reader.place(),
            "depth of BSDFs",
            self.building.len() as u64 + 1,
            DEEPEST,
        )?;
        within(
            reader.place(),
            "number of BSDFs within one",
            self.bsdfs_within,
            MOST_WITHIN,
        )?;
        self.building.push(object);
        let material = match reader.object.plugin.as_str() {
            "diffuse" => self.diffuse(&reader),
            "twosided" => self.two_sided(&reader),
            "dielectric" | "roughdielectric" | "thindielectric" => self.dielectric(&reader),
            "conductor" | "roughconductor" => self.conductor(&reader),
            "plastic" => self.plastic(&reader),
            "roughplastic" => self.rough_plastic(&reader),
            "coating" | "roughcoating" => self.coating(&reader),
            "mask" => self.mask(&reader),
            "blendbsdf" => self.blend(&reader),
            "mixturebsdf" | "mixture" => self.mixture(&reader),
            "normalmap" => self.normal_map(&reader),
            "bumpmap" | "bump" => self.bump_map(&reader),
            "null" => Ok(Material::Null),
            "principled" => self.principled(&reader),
            "principledthin" => self.principled_thin(&reader),
            "roughdiffuse" => self.rough_diffuse(&reader),
            "phong" | "ward" | "pbrtplastic" | "pbrtsubstrate" => self.glossy(&reader),
            "difftrans" | "diffusetransmission" => self.transmitter(&reader),
            other => match StandIn::of(other) {
                Some(stand_in) => self.stand_in(&reader, stand_in),
                None => self.other_bsdf(&reader),
            },
        };
        self.building.pop();
        let material = material?;
        reader.finish();
        Ok(material)
    }

    /// What is rendered in the place of a BSDF that does not exist here.
    fn stand_in(&mut self, reader: &Reader, stand_in: StandIn) -> Result<Material, SceneError> {
        reader.warn(reader.place(), stand_in.without());
        let material = match stand_in {
            StandIn::SmoothPlastic => self.plastic(reader)?,
            StandIn::Diffuse => self.diffuse_stand_in(reader)?,
            StandIn::Nothing(_) => Material::Null,
        };
        reader.accept_rest();
        Ok(material)
    }

    /// A BSDF of another build of Mitsuba: diffuse, in the colour that it has.
    fn other_bsdf(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        reader.other_type(&SUPPORTED, "it is rendered as `diffuse`")?;
        self.diffuse_stand_in(reader)
    }

    /// A diffuse surface of the colour that a BSDF has under one of the usual names.
    fn diffuse_stand_in(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let given = DIFFUSE_COLOURS.iter().find(|name| reader.has(name));
        let name = given.copied().unwrap_or("reflectance");
        Ok(Material::Diffuse {
            reflectance: self.colour_or_texture(reader, name, Role::REFLECTANCE, 0.5)?,
        })
    }

    fn diffuse(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        Ok(Material::Diffuse {
            reflectance: self.diffuse_reflectance(reader)?,
        })
    }

    /// The albedo of a diffuse surface, of which Mitsuba 0.x has two names.
    pub(super) fn diffuse_reflectance(&mut self, reader: &Reader) -> Result<Texture, SceneError> {
        let old = "diffuse_reflectance";
        let name = match reader.has(old) && !reader.has("reflectance") {
            true => old,
            false => "reflectance",
        };
        self.colour_or_texture(reader, name, Role::REFLECTANCE, 0.5)
    }

    fn two_sided(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let sides = reader.children(Kind::Bsdf);
        let (front, back) = match sides[..] {
            [both] => (both, both),
            [front, back] => (front, back),
            _ => return Err(reader.missing(format!("one or two nested BSDFs (found {})", sides.len()))),
        };
        Ok(Material::TwoSided {
            front: self.side(reader, front.target)?,
            back: self.side(reader, back.target)?,
        })
    }

    /// A side of `twosided`.
    fn side(&mut self, reader: &Reader, object: ObjectId) -> Result<Box<Material>, SceneError> {
        let built = self.new_material(object);
        let side = self.description.attempt(object, built)?;
        match side {
            Some(material) if !material.transmits() => return Ok(Box::new(material)),
            Some(_) if !self.description.objects[object].faulty.get() => {
                let place = &self.description.objects[object].place;
                let reason = "a side must reflect only, and this BSDF lets light through";
                reader.fault(SceneError::value(place, reader.context(), reason))?;
            }
            _ => reader.object.faulty.set(true),
        }
        Ok(Box::new(Material::Null))
    }

    fn dielectric(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let eta = relative_index(reader, "bk7")?;
        let specular_reflectance = self.colour_or_texture(reader, "specular_reflectance", Role::REFLECTANCE, 1.0)?;
        let specular_transmittance =
            self.colour_or_texture(reader, "specular_transmittance", Role::REFLECTANCE, 1.0)?;
        Ok(match reader.object.plugin.as_str() {
            "dielectric" => Material::Dielectric {
                eta,
                specular_reflectance,
                specular_transmittance,
            },
            "thindielectric" => Material::ThinDielectric {
                eta,
                specular_reflectance,
                specular_transmittance,
            },
            _ => Material::RoughDielectric {
                eta,
                distribution: self.roughness(reader)?,
                specular_reflectance,
                specular_transmittance,
            },
        })
    }

    fn plastic(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let eta = relative_index(reader, "polypropylene")?;
        Ok(Material::Plastic {
            coat: Coat::new(eta, reader.boolean("nonlinear", false)?),
            diffuse_reflectance: self.colour_or_texture(reader, "diffuse_reflectance", Role::REFLECTANCE, 0.5)?,
            specular_reflectance: self.colour_or_texture(reader, "specular_reflectance", Role::REFLECTANCE, 1.0)?,
        })
    }

    fn rough_plastic(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let eta = relative_index(reader, "polypropylene")?;
        let distribution = self.roughness(reader)?;
        warn_of_mean_roughness(reader, &distribution);
        let coat = RoughCoat::new(eta, distribution, reader.boolean("nonlinear", false)?);
        Ok(Material::RoughPlastic {
            coat: Box::new(coat),
            diffuse_reflectance: self.colour_or_texture(reader, "diffuse_reflectance", Role::REFLECTANCE, 0.5)?,
            specular_reflectance: self.colour_or_texture(reader, "specular_reflectance", Role::REFLECTANCE, 1.0)?,
        })
    }

    fn conductor(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let (eta, k) = self.complex_index(reader)?;
        let specular_reflectance = self.colour_or_texture(reader, "specular_reflectance", Role::REFLECTANCE, 1.0)?;
        if reader.object.plugin == "conductor" {
            return Ok(Material::Conductor {
                eta,
                k,
                specular_reflectance,
            });
        }
        let distribution = self.roughness(reader)?;
        Ok(Material::RoughConductor {
            eta,
            k,
            distribution,
            specular_reflectance,
        })
    }
}

/// What those BSDFs call their colour that stand-ins are diffuse for.
const DIFFUSE_COLOURS: [&str; 3] = ["diffuse_reflectance", "reflectance", "base_color"];

/// What is rendered in the place of a BSDF of Mitsuba that does not exist here.
#[derive(Clone, Copy)]
enum StandIn {
    SmoothPlastic,
    Diffuse,
    /// Light passes; with what is lost.
    Nothing(&'static str),
}

impl StandIn {
    /// For a plugin's name.
    fn of(plugin: &str) -> Option<Self> {
        Some(match plugin {
            "pplastic" => Self::SmoothPlastic,
            "hair" | "hk" | "irawan" | "measured" | "measured_polarized" | "rmbrdf" => Self::Diffuse,
            "circular" | "polarizer" | "retarder" => Self::Nothing("light is not polarised"),
            _ => return None,
        })
    }

    /// How the picture differs.
    fn without(self) -> String {
        match self {
            Self::SmoothPlastic => "light is not polarised: it is rendered as `plastic`".into(),
            Self::Diffuse => "it is rendered as `diffuse`: this type does not exist here".into(),
            Self::Nothing(lost) => format!("it is rendered as `null`, which lets light through, and {lost}"),
        }
    }
}

/// The index of the interior, `default` unless it is given, over that of the exterior.
pub(super) fn relative_index(reader: &Reader, default: &str) -> Result<f32, SceneError> {
    let interior = refractive_index(reader, "int_ior", default)?;
    let exterior = refractive_index(reader, "ext_ior", "air")?;
    let eta = (interior / exterior) as f32;
    if !(1e-3..=1e3).contains(&eta) {
        let reason = format!("the ratio of indices is {eta}; allowed: 0.001 to 1000");
        reader.fault(reader.wrong("int_ior", reason))?;
    }
    Ok(eta)
}

/// An index of refraction as a number or the name of a material.
fn refractive_index(reader: &Reader, name: &str, default: &str) -> Result<f64, SceneError> {
    let material = match reader.property(name).map(|property| &property.value) {
        Some(Value::String(material)) => material.as_str(),
        Some(_) => return Ok(reader.float(name, POSITIVE)?.unwrap_or(1.0)),
        None => default,
    };
    if let Some(index) = ior::dielectric(material) {
        return Ok(f64::from(index));
    }
    let problem = format!("there is no dielectric `{}`; there are", shortened(material));
    reader.fault(reader.no_such(name, &problem, material, ior::dielectric_names()))?;
    Ok(1.0)
}

/// Whether the object has a texture of this name.
fn has_texture(reader: &Reader, name: &str) -> bool {
    let mut children = reader.object.children.iter();
    children.any(|child| child.name.as_deref() == Some(name))
}

/// Warns where a coat's roughness varies.
pub(super) fn warn_of_mean_roughness(reader: &Reader, roughness: &Roughness) {
    if roughness
        .alpha
        .iter()
        .any(|alpha| !matches!(alpha, Texture::Constant(_)))
    {
        let mean =
            "the light that its coat lets through is that of the mean roughness; what it reflects follows the texture";
        reader.warn_of("alpha", mean);
    }
}

impl Builder<'_, '_> {
    /// The complex index of a conductor: a named material, or `eta` and `k`; a perfect mirror by default.
    fn complex_index(&mut self, reader: &Reader) -> Result<(Texture, Texture), SceneError> {
        let exterior = refractive_index(reader, "ext_eta", "vacuum")? as f32;
        if has_texture(reader, "eta") || has_texture(reader, "k") {
            if exterior != 1.0 {
                reader.warn_of(
                    "ext_eta",
                    "textures of `eta` and `k` are taken as relative to the exterior",
                );
            }
            let eta = self.colour_or_texture(reader, "eta", Role::CONSTANT, 0.0)?;
            return Ok((eta, self.colour_or_texture(reader, "k", Role::CONSTANT, 1.0)?));
        }
        let (eta, k) = (
            colour(reader, "eta", Use::Constant)?,
            colour(reader, "k", Use::Constant)?,
        );
        let material = reader.string("material")?.filter(|name| *name != "none");
        let relative = |eta: Spectrum, k: Spectrum| {
            let relative = [eta, k].map(|index| Texture::Constant(index * (1.0 / exterior)));
            let [eta, k] = relative;
            (eta, k)
        };
        match (material, eta, k) {
            (None, eta, k) => {
                let (eta, k) = (eta.unwrap_or(Spectrum::ZERO), k.unwrap_or(Spectrum::ONE));
                if eta.zip(k, f32::max).to_rgb().contains(&0.0) {
                    return Err(reader.wrong("k", "`eta` and `k` are both 0 in a channel"));
                }
                Ok(relative(eta, k))
            }
            (Some(name), None, None) => match ior::conductor(name) {
                Some((eta, k)) => Ok(relative(eta, k)),
                None => {
                    let problem = format!("there is no conductor `{}`; there are", shortened(name));
                    Err(reader.no_such("material", &problem, name, ior::conductor_names()))
                }
            },
            _ => Err(reader.wrong("material", "give either `material` or `eta` and `k`, not both")),
        }
    }

    /// The distribution of microfacets, whose roughness may be a texture.
    pub(super) fn roughness(&mut self, reader: &Reader) -> Result<Roughness, SceneError> {
        // The last two are Mitsuba 0.x's, which takes their roughness as that of Beckmann's.
        let kinds = [
            ("beckmann", (MicrofacetKind::Beckmann, None)),
            ("ggx", (MicrofacetKind::Ggx, None)),
            ("phong", (MicrofacetKind::Beckmann, Some("phong"))),
            ("as", (MicrofacetKind::Beckmann, Some("as"))),
        ];
        let (kind, replaced) = reader.choice("distribution", &kinds, (MicrofacetKind::Beckmann, None))?;
        if let Some(written) = replaced {
            let instead = format!("`beckmann` of the same roughness stands in for `{written}`");
            reader.warn_of("distribution", &instead);
        }
        reader.boolean("sample_visible", true)?;
        let alpha = self.roughness_along(reader, "alpha")?;
        let along = [
            self.roughness_along(reader, "alpha_u")?,
            self.roughness_along(reader, "alpha_v")?,
        ];
        let alpha = match (alpha, along) {
            (alpha, [None, None]) => {
                let alpha = alpha.unwrap_or(Texture::Constant(Spectrum::splat(0.1)));
                [alpha.clone(), alpha]
            }
            (None, [Some(u), Some(v)]) => [u, v],
            _ => return Err(reader.wrong("alpha_u", "give either `alpha`, or `alpha_u` and `alpha_v` both")),
        };
        Ok(Roughness { kind, alpha })
    }

    fn roughness_along(&mut self, reader: &Reader, name: &str) -> Result<Option<Texture>, SceneError> {
        if has_texture(reader, name) {
            return self.colour_or_texture(reader, name, Role::CONSTANT, 0.1).map(Some);
        }
        let alpha = reader.float(name, ROUGHNESS)?;
        Ok(alpha.map(|alpha| Texture::Constant(Spectrum::splat(alpha.max(LEAST_ROUGHNESS) as f32))))
    }
}

//! Tests of the materials as a whole.

mod composed;
mod lobes;
mod mitsuba;
mod plastic;
mod principled;
mod robustness;
mod statistics;
mod symmetry;

use super::*;
use crate::random::{PathRandom, Stream};
use crate::spectrum::Spectrum;
use crate::texture::TexturePoint;

const UV: Vec2 = Vec2::new(0.5, 0.5);
const AT: TexturePoint = TexturePoint {
    uv: UV,
    position: Vec3::ZERO,
    normal: Vec3::Z,
    primitive: 0,
    barycentric: Vec2::ZERO,
};
const WHITE: Texture = Texture::Constant(Spectrum::ONE);
const MODES: [TransportMode; 2] = [TransportMode::Radiance, TransportMode::Flux];

/// Tangents that are neither of unit length nor perpendicular.
const TANGENTS: Tangents = Tangents {
    du: Vec3::new(2.0, 0.0, 0.0),
    dv: Vec3::new(0.5, 1.5, 0.0),
};

impl Material {
    /// The BSDF at a point of a surface with [`TANGENTS`].
    pub(crate) fn resolve(&self, at: &TexturePoint, wo: Vec3) -> Bsdf {
        self.resolve_on(at, wo, &|| TANGENTS)
    }
}

fn grey(v: f32) -> Texture {
    Texture::Constant(Spectrum::splat(v))
}

fn facets(kind: MicrofacetKind, x: f32, y: f32) -> Microfacets {
    Microfacets {
        kind,
        alpha: Vec2::new(x, y),
    }
}

fn roughness(facets: Microfacets) -> Roughness {
    Roughness {
        kind: facets.kind,
        alpha: [grey(facets.alpha.x), grey(facets.alpha.y)],
    }
}

fn rgb(rgb: [f32; 3]) -> Texture {
    Texture::Constant(Spectrum::from_rgb(rgb))
}

fn mirror() -> Material {
    Material::Conductor {
        eta: grey(0.0),
        k: WHITE,
        specular_reflectance: WHITE,
    }
}

/// A rough perfect mirror.
fn rough_mirror(distribution: Microfacets) -> Material {
    Material::RoughConductor {
        eta: grey(0.0),
        k: WHITE,
        distribution: roughness(distribution),
        specular_reflectance: WHITE,
    }
}

fn rough_gold(distribution: Microfacets, reflectance: Spectrum) -> Material {
    Material::RoughConductor {
        eta: rgb([0.143, 0.375, 1.442]),
        k: rgb([3.983, 2.3856, 1.6034]),
        distribution: roughness(distribution),
        specular_reflectance: Texture::Constant(reflectance),
    }
}

fn glass(eta: f32) -> Material {
    Material::Dielectric {
        eta,
        specular_reflectance: WHITE,
        specular_transmittance: WHITE,
    }
}

fn rough_glass(eta: f32, distribution: Microfacets, transmittance: Spectrum) -> Material {
    Material::RoughDielectric {
        eta,
        distribution: roughness(distribution),
        specular_reflectance: WHITE,
        specular_transmittance: Texture::Constant(transmittance),
    }
}

/// A coat of relative index `eta` over a grey base.
fn plastic(eta: f32, albedo: f32, nonlinear: bool) -> Material {
    Material::Plastic {
        coat: Coat::new(eta, nonlinear),
        diffuse_reflectance: grey(albedo),
        specular_reflectance: WHITE,
    }
}

/// A rough coat of relative index `eta` over a grey base.
fn rough_plastic(eta: f32, distribution: Microfacets, albedo: f32, nonlinear: bool) -> Material {
    Material::RoughPlastic {
        coat: Box::new(RoughCoat::new(eta, roughness(distribution), nonlinear)),
        diffuse_reflectance: grey(albedo),
        specular_reflectance: WHITE,
    }
}

fn pane(eta: f32) -> Material {
    Material::ThinDielectric {
        eta,
        specular_reflectance: WHITE,
        specular_transmittance: WHITE,
    }
}

fn mask(opacity: f32, nested: Material) -> Material {
    Material::Mask {
        opacity: grey(opacity),
        nested: Box::new(nested),
    }
}

fn blend(weight: f32, first: Material, second: Material) -> Material {
    Material::Blend {
        weight: grey(weight),
        nested: Box::new([first, second]),
    }
}

const TILT: Tilt = Tilt {
    flip_invalid_normals: true,
    shadowing: true,
};

/// A normal map of one colour.
fn normal_map(colour: [f32; 3], tilt: Tilt, nested: Material) -> Material {
    Material::NormalMap {
        normals: rgb(colour),
        tilt,
        nested: Box::new(nested),
    }
}

/// A clear coat; rough ones with the roughness `alpha` of GGX.
fn coating(eta: f32, alpha: Option<f32>, absorption: f32, nested: Material) -> Material {
    let rough = |alpha| {
        let table = TransmittanceTable::new(MicrofacetKind::Ggx, alpha, eta);
        (roughness(facets(MicrofacetKind::Ggx, alpha, alpha)), table)
    };
    Material::Coating(Box::new(Coating {
        eta,
        rough: alpha.map(rough),
        specular_reflectance: WHITE,
        absorption: grey(absorption),
        thickness: 1.0,
        nested,
    }))
}

fn two_sided(front: Material, back: Material) -> Material {
    Material::TwoSided {
        front: Box::new(front),
        back: Box::new(back),
    }
}

fn principled_of(base: [f32; 3], roughness: f32, change: impl FnOnce(&mut Principled)) -> Material {
    let zero = || grey(0.0);
    let mut body = Principled {
        base_color: Texture::Constant(Spectrum::from_rgb(base)),
        roughness: grey(roughness),
        anisotropic: zero(),
        metallic: zero(),
        spec_trans: zero(),
        spec_tint: zero(),
        sheen: zero(),
        sheen_tint: zero(),
        flatness: zero(),
        clearcoat: zero(),
        clearcoat_gloss: zero(),
        eta: 1.5,
        transmits: true,
    };
    change(&mut body);
    body.transmits = body.spec_trans.brightest() > 0.0;
    Material::Principled(Box::new(body))
}

fn thin_of(base: [f32; 3], roughness: f32, change: impl FnOnce(&mut PrincipledThin)) -> Material {
    let zero = || grey(0.0);
    let mut sheet = PrincipledThin {
        base_color: Texture::Constant(Spectrum::from_rgb(base)),
        roughness: grey(roughness),
        anisotropic: zero(),
        spec_trans: zero(),
        diff_trans: zero(),
        spec_tint: zero(),
        sheen: zero(),
        sheen_tint: zero(),
        flatness: zero(),
        eta: grey(1.5),
    };
    change(&mut sheet);
    Material::PrincipledThin(Box::new(sheet))
}

/// A body with a bit of everything.
fn principled_body() -> Material {
    principled_of([0.2, 0.5, 0.8], 0.3, |body| {
        body.metallic = grey(0.4);
        body.spec_tint = grey(0.6);
        body.anisotropic = grey(0.8);
        body.clearcoat = grey(0.6);
        body.clearcoat_gloss = grey(0.2);
        body.sheen = grey(0.4);
        body.sheen_tint = grey(0.2);
        body.flatness = grey(0.4);
        body.spec_trans = grey(0.6);
        body.eta = 1.4;
    })
}

/// A sheet with a bit of everything.
fn principled_sheet() -> Material {
    thin_of([0.2, 0.5, 0.8], 0.4, |sheet| {
        sheet.spec_tint = grey(0.6);
        sheet.anisotropic = grey(0.4);
        sheet.sheen = grey(0.4);
        sheet.sheen_tint = grey(0.8);
        sheet.flatness = grey(0.4);
        sheet.spec_trans = grey(0.6);
        sheet.diff_trans = grey(0.4);
        sheet.eta = grey(1.4);
    })
}

fn rough_diffuse(albedo: f32, alpha: f32, fast: bool) -> Material {
    Material::RoughDiffuse {
        reflectance: grey(albedo),
        alpha: grey(alpha),
        fast,
    }
}

fn glossy(diffuse: f32, specular: f32, highlight: Highlight) -> Material {
    Material::Glossy(Box::new(Glossy {
        diffuse_reflectance: grey(diffuse),
        specular_reflectance: grey(specular),
        highlight,
    }))
}

fn phong(diffuse: f32, specular: f32, exponent: f32) -> Material {
    let exponent = grey(exponent);
    glossy(diffuse, specular, Highlight::Phong { exponent })
}

fn ward(diffuse: f32, specular: f32, alpha: [f32; 2], model: WardModel) -> Material {
    let alpha = alpha.map(grey);
    glossy(diffuse, specular, Highlight::Ward { alpha, model })
}

fn pbrt_plastic(diffuse: f32, specular: f32, eta: f32, alpha: [f32; 2]) -> Material {
    let distribution = Roughness {
        kind: MicrofacetKind::Ggx,
        alpha: alpha.map(grey),
    };
    glossy(diffuse, specular, Highlight::Facets { eta, distribution })
}

fn substrate(diffuse: f32, specular: f32, alpha: [f32; 2]) -> Material {
    let distribution = Roughness {
        kind: MicrofacetKind::Ggx,
        alpha: alpha.map(grey),
    };
    glossy(diffuse, specular, Highlight::Blend { distribution })
}

fn transmitter(reflectance: f32, transmittance: f32) -> Material {
    Material::Transmitter {
        reflectance: grey(reflectance),
        transmittance: grey(transmittance),
    }
}

/// One of every material with a density, and several roughnesses.
fn scattering() -> Vec<(&'static str, Material)> {
    let mut all = lobes();
    all.extend(composed());
    all
}

fn diffuse() -> Material {
    Material::Diffuse { reflectance: grey(0.7) }
}

/// Materials of one or two lobes.
fn lobes() -> Vec<(&'static str, Material)> {
    use MicrofacetKind::{Beckmann, Ggx};
    vec![
        ("diffuse", diffuse()),
        ("rough mirror, GGX 0.05", rough_mirror(facets(Ggx, 0.05, 0.05))),
        ("rough mirror, GGX 0.1 x 0.4", rough_mirror(facets(Ggx, 0.1, 0.4))),
        (
            "rough gold, Beckmann 0.3",
            rough_gold(facets(Beckmann, 0.3, 0.3), Spectrum::splat(0.9)),
        ),
        (
            "rough gold, Beckmann 1.0 x 0.2",
            rough_gold(facets(Beckmann, 1.0, 0.2), Spectrum::ONE),
        ),
        (
            "rough glass, GGX 0.1",
            rough_glass(1.5, facets(Ggx, 0.1, 0.1), Spectrum::ONE),
        ),
        (
            "rough glass, GGX 0.6 x 0.3",
            rough_glass(1.5, facets(Ggx, 0.6, 0.3), Spectrum::ONE),
        ),
        (
            "rough water, Beckmann 0.25",
            rough_glass(1.33, facets(Beckmann, 0.25, 0.25), Spectrum::splat(0.8)),
        ),
        (
            "rough bubble, Beckmann 0.5",
            rough_glass(1.0 / 1.6, facets(Beckmann, 0.5, 0.5), Spectrum::ONE),
        ),
        (
            "two sides",
            two_sided(diffuse(), rough_gold(facets(Ggx, 0.2, 0.2), Spectrum::ONE)),
        ),
        ("plastic", plastic(1.49, 0.5, false)),
        ("nonlinear plastic of high index", plastic(2.4, 0.9, true)),
        ("plastic on the back", two_sided(diffuse(), plastic(1.49, 0.5, false))),
        ("rough diffuse", rough_diffuse(0.8, 0.5, false)),
        ("rough diffuse, short form", rough_diffuse(0.8, 0.3, true)),
        ("Phong, exponent 30", phong(0.5, 0.2, 30.0)),
        ("Phong, exponent 0.5", phong(0.0, 0.9, 0.5)),
        ("Ward", ward(0.5, 0.3, [0.1, 0.3], WardModel::Ward)),
        ("Ward and Duer", ward(0.2, 0.4, [0.2, 0.2], WardModel::Duer)),
        ("balanced Ward", ward(0.1, 0.7, [0.4, 0.15], WardModel::Balanced)),
        ("plastic of pbrt-v3", pbrt_plastic(0.4, 0.3, 1.0 / 1.5, [0.2, 0.2])),
        ("uber of pbrt-v3", pbrt_plastic(0.5, 0.4, 1.5, [0.1, 0.4])),
        ("substrate of pbrt-v3", substrate(0.6, 0.2, [0.3, 0.15])),
        ("sheet", transmitter(0.3, 0.6)),
        ("principled body", principled_body()),
        (
            "principled, diffuse under a coat",
            principled_of([0.8, 0.3, 0.1], 0.6, |body| {
                (body.clearcoat, body.clearcoat_gloss) = (WHITE, grey(0.5));
            }),
        ),
        (
            "principled bubble",
            principled_of([0.9, 0.9, 0.9], 0.5, |body| {
                (body.spec_trans, body.eta) = (grey(0.7), 1.0 / 1.4);
            }),
        ),
        ("principled sheet", principled_sheet()),
    ]
}

/// Materials that are made of others.
fn composed() -> Vec<(&'static str, Material)> {
    use MicrofacetKind::{Beckmann, Ggx};
    let gold = || rough_gold(facets(Ggx, 0.1, 0.3), Spectrum::ONE);
    let frosted = || rough_glass(1.5, facets(Ggx, 0.3, 0.3), Spectrum::ONE);
    vec![
        (
            "rough plastic, GGX 0.1",
            rough_plastic(1.49, facets(Ggx, 0.1, 0.1), 0.5, false),
        ),
        (
            "nonlinear rough plastic, Beckmann 0.4",
            rough_plastic(1.9, facets(Beckmann, 0.4, 0.4), 0.9, true),
        ),
        ("mask over frosted glass", mask(0.6, frosted())),
        ("blend of metal and glass", blend(0.3, gold(), frosted())),
        (
            "blends within blends",
            blend(
                0.5,
                blend(0.2, diffuse(), plastic(1.49, 0.5, true)),
                mask(0.5, two_sided(gold(), gold())),
            ),
        ),
        (
            "mixture that absorbs",
            Material::Mixture(vec![(0.2, diffuse()), (0.5, gold()), (0.1, mirror())]),
        ),
        ("tilted gold", normal_map([0.65, 0.4, 0.9], TILT, gold())),
        ("tilted frosted glass", normal_map([0.6, 0.6, 0.9], TILT, frosted())),
        ("steep diffuse", normal_map([0.9, 0.45, 0.7], TILT, diffuse())),
        (
            "tilted plastic, as it comes",
            normal_map(
                [0.7, 0.5, 0.9],
                Tilt {
                    flip_invalid_normals: false,
                    shadowing: false,
                },
                plastic(1.49, 0.5, false),
            ),
        ),
        ("clear coat on gold", coating(1.5, None, 0.0, gold())),
        ("tinted coat on diffuse", coating(1.7, None, 0.3, diffuse())),
        ("rough coat on gold", coating(1.5, Some(0.2), 0.1, gold())),
        (
            "coat over a tilted mirror and plastic",
            coating(
                1.4,
                None,
                0.0,
                blend(
                    0.5,
                    normal_map([0.6, 0.5, 0.95], TILT, mirror()),
                    plastic(1.8, 0.5, true),
                ),
            ),
        ),
        (
            "two sides of coats and plastic",
            two_sided(
                coating(1.5, None, 0.1, gold()),
                rough_plastic(1.49, facets(Ggx, 0.2, 0.2), 0.5, false),
            ),
        ),
    ]
}

/// Whether a material scatters in radiance as it does in flux, and the same there and back on one side.
fn is_symmetric(material: &Material) -> bool {
    match material {
        Material::NormalMap { .. } | Material::BumpMap { .. } => false,
        Material::Coating(coating) => is_symmetric(&coating.nested),
        Material::Blend { nested, .. } => nested.iter().all(is_symmetric),
        Material::Mixture(parts) => parts.iter().all(|(_, nested)| is_symmetric(nested)),
        Material::Mask { nested, .. } => is_symmetric(nested),
        _ => true,
    }
}

/// Along the normal, oblique, grazing, from below, and grazing from below.
fn outgoing() -> [Vec3; 5] {
    [
        [0.0, 0.0, 1.0],
        [0.3, -0.5, 0.6],
        [-0.9, 0.2, 0.06],
        [0.2, 0.6, -0.5],
        [0.6, -0.7, -0.03],
    ]
    .map(|w| Vec3::from(w).normalize())
}

fn random(path: u64) -> PathRandom {
    PathRandom::new(2_718_281, 1, Stream::Camera, path)
}

fn draw(material: &Material, wo: Vec3, random: &mut PathRandom, mode: TransportMode) -> Option<BsdfSample> {
    let lobe = random.next_1d();
    material.resolve(&AT, wo).sample(wo, lobe, random.next_2d(), mode)
}

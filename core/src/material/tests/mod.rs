//! Tests of the materials as a whole.

mod mitsuba;
mod plastic;
mod robustness;
mod statistics;
mod symmetry;

use super::*;
use crate::random::{PathRandom, Stream};

const UV: Vec2 = Vec2::new(0.5, 0.5);
const AT: TexturePoint = TexturePoint {
    uv: UV,
    position: Vec3::ZERO,
    primitive: 0,
    barycentric: Vec2::ZERO,
};
const WHITE: Texture = Texture::Constant(Spectrum::ONE);
const MODES: [TransportMode; 2] = [TransportMode::Radiance, TransportMode::Flux];

fn grey(v: f32) -> Texture {
    Texture::Constant(Spectrum::splat(v))
}

fn facets(kind: MicrofacetKind, x: f32, y: f32) -> Microfacets {
    Microfacets {
        kind,
        alpha: Vec2::new(x, y),
    }
}

fn mirror() -> Material {
    Material::Conductor {
        eta: Spectrum::ZERO,
        k: Spectrum::ONE,
        specular_reflectance: WHITE,
    }
}

/// A rough perfect mirror.
fn rough_mirror(distribution: Microfacets) -> Material {
    Material::RoughConductor {
        eta: Spectrum::ZERO,
        k: Spectrum::ONE,
        distribution,
        specular_reflectance: WHITE,
    }
}

fn rough_gold(distribution: Microfacets, reflectance: Spectrum) -> Material {
    Material::RoughConductor {
        eta: Spectrum::from_rgb([0.143, 0.375, 1.442]),
        k: Spectrum::from_rgb([3.983, 2.3856, 1.6034]),
        distribution,
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
        distribution,
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

fn two_sided(front: Material, back: Material) -> Material {
    Material::TwoSided {
        front: Box::new(front),
        back: Box::new(back),
    }
}

/// One of every material with a density, and several roughnesses.
fn scattering() -> Vec<(&'static str, Material)> {
    use MicrofacetKind::{Beckmann, Ggx};
    let diffuse = || Material::Diffuse { reflectance: grey(0.7) };
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
    ]
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

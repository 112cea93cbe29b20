//! Whatever the unit directions, roughness and index: finite, not negative, and never more energy than came in.

use super::*;
use crate::math::{ONE_MINUS_EPSILON, sin_cos};

/// A unit direction whose cosine with the normal is often tiny: powers of ten down to 1e-12, either side.
fn direction(random: &mut PathRandom) -> Vec3 {
    let exponent = 12.0 * random.next_1d();
    let size = if random.next_1d() < 0.5 {
        random.next_1d()
    } else {
        crate::math::pow(10.0, -exponent)
    };
    let z = if random.next_1d() < 0.5 { -size } else { size };
    let (sin_phi, cos_phi) = sin_cos(crate::math::TAU * random.next_1d());
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * cos_phi, r * sin_phi, z)
}

/// Mostly ordinary random numbers, now and then the ends of the unit interval.
fn unit(random: &mut PathRandom) -> f32 {
    let u = random.next_1d();
    match (u * 40.0) as u32 {
        0 => 0.0,
        1 => ONE_MINUS_EPSILON,
        _ => random.next_1d(),
    }
}

fn materials() -> Vec<Material> {
    let mut materials = vec![
        Material::Diffuse { reflectance: WHITE },
        mirror(),
        Material::Null,
        glass(1.5),
        glass(1.0),
        glass(1e-3),
        glass(1e3),
        two_sided(mirror(), Material::Diffuse { reflectance: WHITE }),
    ];
    for eta in [1.5, 1.0, 1.0003, 1e-3, 1e3] {
        materials.push(plastic(eta, 1.0, false));
        materials.push(plastic(eta, 1.0, true));
        materials.push(plastic(eta, 0.0, true));
    }
    for alpha in [0.0, 0.3, 10.0] {
        materials.push(rough_diffuse(1.0, alpha, false));
        materials.push(rough_diffuse(1.0, alpha, true));
    }
    for exponent in [0.0, 30.0, 1e6] {
        materials.push(phong(0.0, 1.0, exponent));
        materials.push(phong(0.5, 0.5, exponent));
    }
    for model in [WardModel::Ward, WardModel::Duer, WardModel::Balanced] {
        for alpha in [[1e-4, 1e-4], [10.0, 1e-4], [0.3, 0.3]] {
            materials.push(ward(0.0, 1.0, alpha, model));
        }
    }
    materials.extend([transmitter(1.0, 0.0), transmitter(0.5, 0.5), transmitter(0.0, 0.0)]);
    materials.extend([principled_body(), principled_sheet()]);
    for roughness in [0.0, 0.5, 1.0] {
        for eta in [1.5, 1.001, 1e-3, 1e3] {
            materials.push(principled_of([1.0; 3], roughness, |body| {
                (body.eta, body.spec_trans, body.anisotropic) = (eta, WHITE, WHITE);
            }));
            materials.push(principled_of([0.0, 0.0, 1.0], roughness, |body| {
                (body.eta, body.spec_tint, body.metallic) = (eta, WHITE, grey(0.5));
                (body.sheen, body.sheen_tint, body.flatness) = (WHITE, WHITE, WHITE);
                (body.clearcoat, body.clearcoat_gloss) = (WHITE, WHITE);
            }));
            materials.push(thin_of([1.0; 3], roughness, |sheet| {
                (sheet.eta, sheet.spec_trans, sheet.diff_trans) = (grey(eta), grey(0.5), WHITE);
            }));
        }
    }
    for kind in [MicrofacetKind::Beckmann, MicrofacetKind::Ggx] {
        for (x, y) in [
            (0.0, 0.0),
            (1e-4, 1e-4),
            (1e-3, 0.5),
            (0.1, 0.1),
            (1.0, 1.0),
            (30.0, 1e-4),
        ] {
            materials.push(rough_mirror(facets(kind, x, y)));
            materials.push(rough_gold(facets(kind, x, y), Spectrum::ONE));
            for eta in [1.5, 1.0003, 1.0 / 2.4, 1e-3] {
                materials.push(rough_glass(eta, facets(kind, x, y), Spectrum::ONE));
            }
        }
    }
    materials
}

#[test]
fn everything_is_finite_and_energy_is_not_made() {
    let mut drawn = 0;
    for material in materials() {
        for path in 0..20_000 {
            let mut random = random(path);
            let (wo, wi) = (direction(&mut random), direction(&mut random));
            let mode = MODES[(path % 2) as usize];
            let (f, pdf) = (
                material.resolve(&AT, wo).f(wo, wi, mode),
                material.resolve(&AT, wo).pdf(wo, wi),
            );
            assert!(
                f.is_valid() && pdf.is_finite() && pdf >= 0.0,
                "{material:?} {wo} {wi} {f:?} {pdf}"
            );
            let (lobe, u) = (unit(&mut random), Vec2::new(unit(&mut random), unit(&mut random)));
            let Some(sample) = material.resolve(&AT, wo).sample(wo, lobe, u, mode) else {
                continue;
            };
            let what = || format!("{material:?} {wo} {lobe} {u} {sample:?}");
            assert!(
                sample.f.is_valid() && sample.pdf.is_finite() && sample.pdf > 0.0,
                "{}",
                what()
            );
            assert!((sample.wi.length() - 1.0).abs() < 1e-4, "{}", what());
            let gain = if mode == TransportMode::Radiance {
                sample.eta * sample.eta
            } else {
                1.0
            };
            let weight = sample.f * (gain * sample.wi.z.abs() / sample.pdf);
            // Samples of a coated base do not follow what the coat lets out: their weights are below one in the mean only, which
            // the tests of `plastic` show. Those of the other materials here do not follow f either.
            let even = matches!(
                material,
                Material::Plastic { .. }
                    | Material::RoughDiffuse { .. }
                    | Material::Glossy(_)
                    | Material::Principled(_)
                    | Material::PrincipledThin(_)
            );
            assert!(
                (even && !sample.delta) || weight.max_component() <= 1.0 + 1e-4,
                "{} {weight:?}",
                what()
            );
            drawn += 1;
        }
    }
    assert!(drawn > 400_000, "{drawn}");
}

//! Materials that are made of others.

use super::*;
use crate::math::FRAC_1_PI;

/// A coat over a diffuse surface is nonlinear plastic without the light that the coat returns to the base, again and again: without the factor
/// `1 / (1 - d Fi)`.
#[test]
fn a_coat_on_diffuse_is_plastic_but_for_what_returns() {
    for (eta, albedo) in [(1.3, 0.9), (1.5, 0.5), (2.4, 0.2)] {
        let coated = coating(
            eta,
            None,
            0.0,
            Material::Diffuse {
                reflectance: grey(albedo),
            },
        );
        let plastic = plastic(eta, albedo, true);
        let returned = albedo * fresnel::mean_reflectance(1.0 / eta) as f32;
        let up = outgoing().into_iter().filter(|w| w.z > 0.0);
        for (wo, wi) in up.clone().flat_map(|wo| up.clone().map(move |wi| (wo, wi))) {
            let of = |material: &Material| material.resolve(&AT, wo).f(wo, wi, TransportMode::Radiance)[0];
            let (coated, plastic) = (of(&coated), of(&plastic));
            assert!(
                (coated - plastic * (1.0 - returned)).abs() < 1e-5 * plastic,
                "{eta} {wo} {wi}"
            );
        }
        // What the coats reflect is the same.
        let mirrored = |material: &Material| {
            let sample = material
                .resolve(&AT, Vec3::Z)
                .sample(Vec3::Z, 0.0, UV, TransportMode::Flux);
            sample.filter(|sample| sample.delta).map(|sample| sample.f)
        };
        assert_eq!(mirrored(&coated), mirrored(&plastic));
    }
}

/// The absorption counts for the way in and out, along the refracted directions (Beer's law).
#[test]
fn a_tinted_coat_absorbs_along_both_ways() {
    let eta = 1.5;
    let within = |w: Vec3| (1.0 - (1.0 - w.z * w.z) / (eta * eta)).sqrt();
    let of = |absorption: f32, wo: Vec3, wi: Vec3| {
        let material = coating(eta, None, absorption, diffuse());
        material.resolve(&AT, wo).f(wo, wi, TransportMode::Flux)[0]
    };
    let (wo, wi) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 0.8, 0.6));
    let expected = libm::expf(-0.7 * (1.0 / within(wo) + 1.0 / within(wi)));
    let ratio = of(0.7, wo, wi) / of(0.0, wo, wi);
    assert!((ratio - expected).abs() < 1e-5, "{ratio} {expected}");
}

/// A rough coat that is hardly rough lets through what a smooth one does.
#[test]
fn a_rough_coat_tends_to_a_smooth_one() {
    let rough = rough_plastic(1.5, facets(MicrofacetKind::Ggx, 1e-3, 1e-3), 0.5, false);
    let smooth = plastic(1.5, 0.5, false);
    for (wo, wi) in [
        (Vec3::Z, Vec3::new(0.6, 0.0, 0.8)),
        (Vec3::new(0.8, 0.0, 0.6), Vec3::new(0.0, 0.6, 0.8)),
    ] {
        let of = |material: &Material| material.resolve(&AT, wo).f(wo, wi, TransportMode::Flux)[0];
        let ratio = of(&rough) / of(&smooth);
        // Mitsuba's mean over cosines makes the base darker.
        assert!((0.97..=1.001).contains(&ratio), "{ratio}");
    }
}

/// Whole and empty masks cost nothing and change nothing.
#[test]
fn shares_of_all_and_nothing_are_the_materials_themselves() {
    let lobes = |material: &Material| {
        let mut lobes = Vec::new();
        let bsdf = material.resolve(&AT, Vec3::Z);
        bsdf.each_lobe(&mut |lobe| lobes.push(format!("{lobe:?}")));
        lobes
    };
    assert_eq!(lobes(&mask(1.0, diffuse())), lobes(&diffuse()));
    assert_eq!(lobes(&mask(2.0, diffuse())), lobes(&diffuse()));
    assert_eq!(lobes(&mask(0.0, diffuse())), lobes(&Material::Null));
    assert_eq!(lobes(&blend(0.0, diffuse(), mirror())), lobes(&diffuse()));
    assert_eq!(lobes(&blend(1.0, diffuse(), mirror())), lobes(&mirror()));
    assert_eq!(lobes(&blend(0.5, diffuse(), mirror())).len(), 2);
}

/// Several delta functions, of which two point the same way, next to diffuse scattering: together they carry what they carry one by one.
#[test]
fn delta_functions_in_the_same_direction_add_up() {
    let material = mask(0.5, blend(0.4, diffuse(), Material::Null));
    let bsdf = material.resolve(&AT, Vec3::Z);
    assert!(bsdf.has_delta() && bsdf.has_smooth() && bsdf.least_roughness() == Some(f32::INFINITY));
    const SAMPLES: u64 = 40_000;
    let mut through = 0.0;
    for path in 0..SAMPLES {
        let sample = draw(&material, Vec3::Z, &mut random(path), TransportMode::Radiance).unwrap();
        if sample.delta {
            assert_eq!(sample.wi, -Vec3::Z);
            through += f64::from(sample.f[0] / sample.pdf);
        }
    }
    let (mean, expected) = (through / SAMPLES as f64, 0.5 + 0.5 * 0.4);
    let error = (expected * (1.0 - expected) / SAMPLES as f64).sqrt();
    assert!((mean - expected).abs() < 4.0 * error, "{mean}");
    let f = bsdf.f(Vec3::Z, Vec3::Z, TransportMode::Radiance)[0];
    assert!((f - 0.5 * 0.6 * 0.7 * FRAC_1_PI).abs() < 1e-6);
}

fn extremes() -> Vec<Material> {
    let rough = |eta, alpha| rough_plastic(eta, facets(MicrofacetKind::Beckmann, alpha, alpha), 1.0, true);
    let tilted = |colour, nested| normal_map(colour, TILT, nested);
    let mut materials: Vec<Material> = composed().into_iter().map(|(_, material)| material).collect();
    materials.extend([
        pane(1.0),
        pane(1e3),
        mask(0.5, Material::Null),
        rough(1.5, 1e-4),
        rough(1e3, 1.0),
        rough(1e-3, 0.3),
        coating(1e3, None, 0.0, mirror()),
        coating(1e-3, None, 0.0, diffuse()),
        coating(1.5, Some(10.0), 1e4, diffuse()),
        tilted([0.5; 3], diffuse()),
        tilted([1.0, 0.5, 0.5], mirror()),
        tilted([0.0; 3], glass(1.5)),
        tilted([0.9, 0.9, 0.51], diffuse()),
        Material::Mixture(vec![(0.0, diffuse())]),
    ]);
    materials
}

/// Whatever the directions, values are finite, and in the mean no more radiance leaves than arrives.
#[test]
fn composed_materials_are_finite_and_make_no_energy() {
    for material in extremes() {
        for wo in outgoing()
            .into_iter()
            .chain([Vec3::new(1.0, 0.0, 1e-8), Vec3::new(0.6, 0.8, -1e-6)])
        {
            let bsdf = material.resolve(&AT, wo);
            let (mut sum, mut squares) = (0.0, 0.0);
            const SAMPLES: u64 = 4000;
            for path in 0..SAMPLES {
                let mut random = random(path);
                let mode = MODES[(path % 2) as usize];
                let wi = crate::math::warp::square_to_sphere(random.next_2d());
                let (f, pdf) = (bsdf.f(wo, wi, mode), bsdf.pdf(wo, wi));
                assert!(
                    f.is_valid() && pdf.is_finite() && pdf >= 0.0,
                    "{material:?} {wo} {wi} {f:?} {pdf}"
                );
                let lobe = random.next_1d();
                let Some(sample) = bsdf.sample(wo, lobe, random.next_2d(), mode) else {
                    continue;
                };
                let reverse = bsdf.pdf_rev(wo, &sample);
                assert!(
                    sample.f.is_valid() && sample.pdf.is_finite() && sample.pdf > 0.0 && reverse.is_finite(),
                    "{material:?} {wo} {sample:?} {reverse}"
                );
                if mode == TransportMode::Radiance {
                    let weight = f64::from(sample.f[0] * sample.wi.z.abs() / sample.pdf * sample.eta * sample.eta);
                    sum += weight;
                    squares += weight * weight;
                }
            }
            let n = SAMPLES as f64 / 2.0;
            let mean = sum / n;
            let error = ((squares / n - mean * mean).max(0.0) / n).sqrt();
            assert!(mean <= 1.0 + 1e-4 + 5.0 * error, "{material:?} {wo}: {mean} +- {error}");
        }
    }
}

//! Relations between eval, pdf and sample that hold exactly but for rounding.

use super::*;
use crate::math::warp;

/// Relative difference that rounding explains at the roughnesses tested.
const ROUNDING: f32 = 2e-3;

fn close(a: f32, b: f32) -> bool {
    (a - b).abs() <= ROUNDING * a.abs().max(b.abs()) + 1e-6
}

fn random_pair(path: u64) -> (Vec3, Vec3) {
    let mut random = random(path);
    (
        warp::square_to_sphere(random.next_2d()),
        warp::square_to_sphere(random.next_2d()),
    )
}

#[test]
fn reflection_is_reciprocal() {
    let mut compared = 0;
    for (name, material) in scattering() {
        for path in 0..20_000 {
            let (a, b) = random_pair(path);
            if a.z * b.z <= 0.0 || !is_symmetric(&material) {
                continue;
            }
            for mode in MODES {
                let (there, back) = (
                    material.resolve(&AT, a).f(a, b, mode),
                    material.resolve(&AT, b).f(b, a, mode),
                );
                assert!(
                    (0..3).all(|c| close(there[c], back[c])),
                    "{name}: {a} {b} {there:?} {back:?}"
                );
                compared += u32::from(!there.is_black());
            }
        }
    }
    assert!(compared > 100_000);
}

/// f(wo, wi, Radiance) = f(wi, wo, Flux): light paths and camera paths see the same surface.
#[test]
fn radiance_is_the_adjoint_of_flux() {
    let mut compared = 0;
    for (name, material) in scattering() {
        for path in 0..10_000 {
            let (a, b) = random_pair(path);
            let radiance = material.resolve(&AT, a).f(a, b, TransportMode::Radiance);
            let flux = material.resolve(&AT, b).f(b, a, TransportMode::Flux);
            assert!(
                (0..3).all(|c| close(radiance[c], flux[c])),
                "{name}: {a} {b} {radiance:?} {flux:?}"
            );
            compared += u32::from(!radiance.is_black());
        }
    }
    assert!(compared > 100_000, "{compared}");
}

/// f(wo, wi, Radiance) = f(wi, wo, Flux) = f(wo, wi, Flux) / eta^2 (Veach 1997, section 5.2).
#[test]
fn refraction_has_its_adjoint() {
    let mut compared = 0;
    for (name, material) in scattering() {
        let eta = match &material {
            Material::RoughDielectric { eta, .. } => *eta,
            Material::Principled(body) if body.transmits => body.eta,
            Material::PrincipledThin(_) | Material::Transmitter { .. } => 1.0,
            _ => continue,
        };
        for path in 0..40_000 {
            let (a, b) = random_pair(path);
            if a.z * b.z >= 0.0 {
                continue;
            }
            let relative = if a.z > 0.0 { eta } else { 1.0 / eta };
            let radiance = material.resolve(&AT, a).f(a, b, TransportMode::Radiance)[0];
            let flux = material.resolve(&AT, a).f(a, b, TransportMode::Flux)[0];
            let adjoint = material.resolve(&AT, b).f(b, a, TransportMode::Flux)[0];
            assert!(close(radiance, adjoint), "{name}: {a} {b} {radiance} {adjoint}");
            assert!(
                close(radiance, flux / (relative * relative)),
                "{name}: {a} {b} {radiance} {flux}"
            );
            compared += u32::from(radiance > 0.0);
        }
    }
    assert!(compared > 10_000, "{compared}");
}

#[test]
fn samples_carry_what_eval_and_pdf_say() {
    let mut compared = 0;
    for (name, material) in scattering() {
        for path in 0..5000 {
            let (wo, _) = random_pair(path);
            for mode in MODES {
                let Some(sample) = draw(&material, wo, &mut random(path + 1_000_000), mode) else {
                    continue;
                };
                if sample.delta {
                    continue;
                }
                let (f, pdf) = (
                    material.resolve(&AT, wo).f(wo, sample.wi, mode),
                    material.resolve(&AT, wo).pdf(wo, sample.wi),
                );
                assert!((sample.wi.length() - 1.0).abs() < 1e-5);
                assert!(close(sample.pdf, pdf), "{name}: {wo} {sample:?} {pdf}");
                assert!(
                    (0..3).all(|c| close(sample.f[c], f[c])),
                    "{name}: {wo} {sample:?} {f:?}"
                );
                compared += 1;
            }
        }
    }
    assert!(compared > 50_000);
}

#[test]
fn relative_index_follows_the_side_and_the_branch() {
    for material in [
        glass(1.5),
        rough_glass(1.5, facets(MicrofacetKind::Ggx, 0.2, 0.2), Spectrum::ONE),
    ] {
        for path in 0..2000 {
            let (wo, _) = random_pair(path);
            let Some(sample) = draw(&material, wo, &mut random(path), TransportMode::Flux) else {
                continue;
            };
            let crossing = if wo.z > 0.0 { 1.5 } else { 1.0 / 1.5 };
            let expected = if wo.z * sample.wi.z > 0.0 { 1.0 } else { crossing };
            assert_eq!(sample.eta, expected, "{material:?} {wo} {sample:?}");
        }
    }
}

#[test]
fn gloss_depends_on_the_side_that_is_seen() {
    let rough = rough_mirror(facets(MicrofacetKind::Ggx, 0.05, 0.3));
    let material = two_sided(mirror(), rough);
    assert!(!material.resolve(&AT, Vec3::Z).has_smooth() && material.resolve(&AT, -Vec3::Z).has_smooth());
    assert!(material.resolve(&AT, Vec3::Z).is_glossier_than(0.0));
    assert!(
        material.resolve(&AT, -Vec3::Z).is_glossier_than(0.1)
            && !material.resolve(&AT, -Vec3::Z).is_glossier_than(0.01)
    );
    let diffuse = Material::Diffuse { reflectance: WHITE };
    assert!(diffuse.resolve(&AT, Vec3::Z).has_smooth() && !diffuse.resolve(&AT, Vec3::Z).is_glossier_than(1e9));
    assert!(!Material::Null.resolve(&AT, Vec3::Z).has_smooth() && !glass(1.5).resolve(&AT, Vec3::Z).has_smooth());
}

#[test]
fn one_sided_materials_are_black_from_behind_and_do_not_transmit() {
    let (up, down) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.6, 0.0, -0.8));
    let rough = rough_mirror(facets(MicrofacetKind::Beckmann, 0.5, 0.5));
    for material in [
        Material::Diffuse { reflectance: WHITE },
        rough,
        mirror(),
        plastic(1.5, 0.5, true),
    ] {
        for (wo, wi) in [(up, down), (down, up), (down, down)] {
            assert!(
                material.resolve(&AT, wo).f(wo, wi, TransportMode::Radiance).is_black()
                    && material.resolve(&AT, wo).pdf(wo, wi) == 0.0
            );
        }
        assert!(draw(&material, down, &mut random(1), TransportMode::Radiance).is_none());
    }
}

/// The reverse density of a delta lobe is the limit of that of a rough one: at the directions that a smooth boundary connects, the
/// densities of a narrow rough boundary there and back have the quotient that [`Bsdf::pdf_rev`] gives.
#[test]
fn reverse_densities_of_delta_lobes_are_limits_of_rough_ones() {
    let mut crossed = 0;
    for eta in [1.5, 1.0 / 1.33] {
        let rough = rough_glass(eta, facets(MicrofacetKind::Ggx, 2e-3, 2e-3), Spectrum::ONE);
        for path in 0..200 {
            let (wo, _) = random_pair(path);
            if wo.z.abs() < 0.1 {
                continue;
            }
            let smooth = glass(eta).resolve(&AT, wo);
            let sample = draw(&glass(eta), wo, &mut random(path), TransportMode::Flux).unwrap();
            let rough = rough.resolve(&AT, wo);
            let [there, back] = [rough.pdf(wo, sample.wi), rough.pdf(sample.wi, wo)];
            let (limit, quotient) = (back / there, smooth.pdf_rev(wo, &sample) / sample.pdf);
            assert!(
                (limit - quotient).abs() < 5e-3 * limit,
                "{wo} {sample:?}: {limit} {quotient}"
            );
            crossed += u32::from(sample.eta != 1.0);
        }
    }
    assert!(crossed > 200, "{crossed}");
}

/// Walked the other way, a sample's direction has the density that sampling from there says.
#[test]
fn reverse_densities_are_those_of_sampling_the_reverse() {
    let mut compared = 0;
    let delta = [("mirror", mirror()), ("glass", glass(1.5)), ("null", Material::Null)];
    for (name, material) in lobes().into_iter().chain(delta) {
        for path in 0..500 {
            let (wo, _) = random_pair(path);
            let Some(sample) = draw(&material, wo, &mut random(path), TransportMode::Radiance) else {
                continue;
            };
            let reverse = material.resolve(&AT, wo).pdf_rev(wo, &sample);
            let from_there = material.resolve(&AT, sample.wi);
            let expected = if sample.delta {
                let lobe = if sample.eta == 1.0 {
                    0.0
                } else {
                    crate::math::ONE_MINUS_EPSILON
                };
                let back = from_there.sample(sample.wi, lobe, UV, TransportMode::Radiance).unwrap();
                assert!((back.wi - wo).length() < 1e-3, "{name}: {wo} {sample:?} {back:?}");
                back.pdf * (wo.z / sample.wi.z).abs() / (sample.eta * sample.eta)
            } else {
                from_there.pdf(sample.wi, wo)
            };
            assert!(close(reverse, expected), "{name}: {wo} {sample:?} {reverse} {expected}");
            compared += 1;
        }
    }
    assert!(compared > 3000, "{compared}");
}

/// The reverse density of a delta lobe among others is the probability with which the way back is sampled, times the quotient of the solid angles
/// that a narrow pencil of directions fills after it and before it, which differences tell.
#[test]
fn reverse_densities_of_delta_lobes_are_those_of_pencils() {
    let mirror_in_tilt = || normal_map([0.62, 0.45, 0.95], TILT, mirror());
    let materials = [
        pane(1.5),
        mask(0.4, glass(1.5)),
        mirror_in_tilt(),
        normal_map([0.6, 0.55, 0.95], TILT, glass(1.5)),
        coating(1.5, None, 0.1, mirror_in_tilt()),
        mask(0.8, coating(1.3, None, 0.0, blend(0.3, mirror_in_tilt(), diffuse()))),
    ];
    let mut compared = 0;
    for material in &materials {
        for path in 0..400 {
            let (wo, _) = random_pair(path);
            let u = random(path).next_1d();
            let find = |wo: Vec3, u: f32, mode| material.resolve(&AT, wo).sample(wo, u, UV, mode);
            let found = find(wo, u, TransportMode::Radiance).filter(|found| found.delta);
            let Some(sample) = found.filter(|sample| wo.z.abs().min(sample.wi.z.abs()) > 0.15) else {
                continue;
            };
            let back = (0..1000)
                .filter_map(|i| find(sample.wi, (i as f32 + 0.5) / 1000.0, TransportMode::Flux))
                .find(|back| (back.wi - wo).length() < 1e-3)
                .unwrap_or_else(|| panic!("no way back: {material:?} {wo} {sample:?}"));
            const STEP: f32 = 2e-3;
            let frame = crate::math::Frame::from_normal(wo);
            let [s, t] = [frame.s, frame.t].map(|axis| {
                [-STEP, STEP]
                    .map(|step| find((wo + axis * step).normalize(), u, TransportMode::Radiance).map(|found| found.wi))
            });
            let ([Some(s0), Some(s1)], [Some(t0), Some(t1)]) = (s, t) else {
                continue;
            };
            let (s, t) = ((s1 - s0) / (2.0 * STEP), (t1 - t0) / (2.0 * STEP));
            // Where a step changes the lobe, the directions jump.
            if s.length().max(t.length()) > 20.0 {
                continue;
            }
            let expected = back.pdf * s.cross(t).length();
            let reverse = material.resolve(&AT, wo).pdf_rev(wo, &sample);
            assert!(
                (reverse - expected).abs() < 0.02 * expected,
                "{material:?} {wo} {sample:?}: {reverse}, expected {expected}"
            );
            compared += 1;
        }
    }
    assert!(compared > 1000, "{compared}");
}

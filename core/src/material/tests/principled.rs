//! Limits of the principled BSDF that other materials are, and the size of lobes.

use super::*;
use crate::math::{FRAC_1_PI, warp};

/// Both have the same f and density between random directions.
fn assert_same(a: &Material, b: &Material) {
    let mut compared = 0;
    for path in 0..20_000 {
        let mut random = random(path);
        let (wo, wi) = (
            warp::square_to_sphere(random.next_2d()),
            warp::square_to_sphere(random.next_2d()),
        );
        let (a, b) = (a.resolve(&AT, wo), b.resolve(&AT, wo));
        for mode in MODES {
            let (fa, fb) = (a.f(wo, wi, mode), b.f(wo, wi, mode));
            let close = |a: f32, b: f32| (a - b).abs() <= 1e-4 * a.abs().max(b.abs()) + 1e-6;
            assert!((0..3).all(|c| close(fa[c], fb[c])), "{wo} {wi} {mode:?}: {fa:?} {fb:?}");
            assert!(close(a.pdf(wo, wi), b.pdf(wo, wi)), "{wo} {wi}");
            compared += u32::from(!fa.is_black());
        }
    }
    assert!(compared > 5000, "{compared}");
}

#[test]
fn a_white_metal_is_a_rough_mirror() {
    let metal = principled_of([1.0; 3], 0.6, |body| {
        (body.metallic, body.anisotropic) = (WHITE, WHITE);
    });
    let aspect = 0.1_f32.sqrt();
    assert_same(
        &metal,
        &rough_mirror(facets(MicrofacetKind::Ggx, 0.36 / aspect, 0.36 * aspect)),
    );
}

#[test]
fn a_white_body_that_transmits_is_rough_glass() {
    for eta in [1.5, 1.0 / 1.33] {
        let body = principled_of([1.0; 3], 0.5, |body| {
            (body.spec_trans, body.eta) = (WHITE, eta);
        });
        assert_same(
            &body,
            &rough_glass(eta, facets(MicrofacetKind::Ggx, 0.25, 0.25), Spectrum::ONE),
        );
    }
}

/// Along the normal all of Schlick's weights vanish, and the diffuse part is Lambert's.
#[test]
fn the_diffuse_part_is_lamberts_along_the_normal() {
    let sheet = thin_of([0.3, 0.6, 0.9], 1.0, |sheet| sheet.diff_trans = grey(0.2));
    let bsdf = sheet.resolve(&AT, Vec3::Z);
    for (wi, share) in [(Vec3::Z, 0.8), (-Vec3::Z, 0.2)] {
        let f = bsdf.f(Vec3::Z, wi, TransportMode::Radiance);
        for (c, base) in [0.3, 0.6, 0.9].into_iter().enumerate() {
            assert!((f[c] - share * base * FRAC_1_PI).abs() < 1e-5, "{wi} {f:?}");
        }
    }
}

#[test]
fn roughness_is_that_of_the_narrowest_part() {
    let roughness = |material: Material| material.resolve(&AT, Vec3::Z).least_roughness().unwrap();
    assert!((roughness(principled_of([0.5; 3], 0.5, |_| ())) - 0.25).abs() < 1e-6);
    let coated = principled_of([0.5; 3], 0.5, |body| body.clearcoat = grey(0.1));
    assert!((roughness(coated) - 0.1).abs() < 1e-6);
    assert_eq!(roughness(thin_of([0.5; 3], 0.5, |_| ())), f32::INFINITY);
    let glassy = thin_of([0.5; 3], 0.5, |sheet| sheet.spec_trans = grey(0.1));
    assert!((roughness(glassy) - (0.625_f32 * 0.5).powi(2)).abs() < 1e-6);
}

/// A `Bsdf` is copied at every hit.
#[test]
fn lobes_are_small() {
    assert!(size_of::<Lobe>() <= 48, "{}", size_of::<Lobe>());
}

//! Closed forms of the materials of Mitsuba 0.x and pbrt.

use super::statistics::{QUADRATURE, albedo};
use super::*;
use crate::math::FRAC_1_PI;
use std::f64::consts::PI;

/// A direction by its angles, in degrees.
fn direction(theta: f64, phi: f64) -> Vec3 {
    let (theta, phi) = (theta.to_radians(), phi.to_radians());
    let sine = libm::sin(theta);
    Vec3::new(
        (sine * libm::cos(phi)) as f32,
        (sine * libm::sin(phi)) as f32,
        libm::cos(theta) as f32,
    )
}

fn f(material: &Material, wo: Vec3, wi: Vec3) -> f64 {
    f64::from(material.resolve(&AT, wo).f(wo, wi, TransportMode::Radiance)[0])
}

#[test]
fn without_roughness_the_rough_diffuse_surface_is_lamberts() {
    for fast in [false, true] {
        let found = f(
            &rough_diffuse(0.7, 0.0, fast),
            direction(40.0, 0.0),
            direction(70.0, 130.0),
        );
        assert!((found - 0.7 / PI).abs() < 1e-6, "{found}");
    }
}

/// Equations of Oren and Nayar 1994 where the azimuths are the same, opposite and perpendicular, which leaves out some of their terms.
#[test]
fn the_rough_diffuse_surface_is_oren_and_nayars() {
    let (rho, roughness) = (0.8, 0.6);
    let variance = roughness * roughness / 2.0;
    let (c1, slope) = (1.0 - 0.5 * variance / (variance + 0.33), variance / (variance + 0.09));
    let (alpha, beta) = (65.0_f64, 35.0_f64);
    let (a, b) = (alpha.to_radians(), beta.to_radians());
    let tan_beta = libm::tan(b);
    let share = 2.0 * b / PI;
    let double = |cos_phi: f64| 0.17 * rho * rho * variance / (variance + 0.13) * (1.0 - cos_phi * share * share);
    let same = rho * (c1 + 0.45 * slope * libm::sin(a) * tan_beta) + double(1.0);
    let opposite = rho * (c1 - 0.45 * slope * (libm::sin(a) - share * share * share) * tan_beta) + double(-1.0);
    let c3 = 0.125 * slope * (4.0 * a * b / (PI * PI)) * (4.0 * a * b / (PI * PI));
    let perpendicular = rho * (c1 + c3 * libm::tan((a + b) / 2.0)) + double(0.0);
    let material = rough_diffuse(rho as f32, roughness as f32, false);
    for (phi, expected) in [(0.0, same), (180.0, opposite), (90.0, perpendicular)] {
        let (wo, wi) = (direction(alpha, 20.0), direction(beta, 20.0 + phi));
        let found = f(&material, wo, wi);
        assert!(
            (found - expected / PI).abs() < 1e-5,
            "{phi}: {found}, expected {}",
            expected / PI
        );
    }
    let short = rough_diffuse(rho as f32, roughness as f32, true);
    let expected = rho * (c1 + 0.45 * slope * libm::sin(a) * tan_beta) / PI;
    assert!((f(&short, direction(alpha, 0.0), direction(beta, 0.0)) - expected).abs() < 1e-5);
    let found = f(&short, direction(alpha, 0.0), direction(beta, 180.0));
    assert!((found - rho * c1 / PI).abs() < 1e-5);
}

/// `integral (n + 2) cos^(n + 1) / 2 pi = 1` over the hemisphere about the normal; elsewhere a part of the highlight is cut off.
#[test]
fn phongs_highlight_has_its_albedo() {
    for exponent in [0.0, 1.0, 30.0, 500.0] {
        let material = phong(0.3, 0.6, exponent);
        let upright = albedo(&material, Vec3::Z, TransportMode::Flux);
        assert!((upright - 0.9).abs() < QUADRATURE, "{exponent}: {upright}");
        for wo in outgoing().into_iter().filter(|wo| wo.z > 0.0) {
            let albedo = albedo(&material, wo, TransportMode::Flux);
            assert!(albedo < 0.9 + QUADRATURE, "{exponent} {wo}: {albedo}");
        }
    }
}

#[test]
fn phongs_highlight_is_a_power_of_the_cosine() {
    let (wo, wi) = (direction(40.0, 0.0), direction(60.0, 180.0));
    let expected = 0.2 / PI + 0.5 * 32.0 / (2.0 * PI) * libm::pow(libm::cos(20.0_f64.to_radians()), 30.0);
    assert!((f(&phong(0.2, 0.5, 30.0), wo, wi) - expected).abs() < 1e-5);
    let lambert = f(&phong(0.2, 0.5, 30.0), direction(60.0, 0.0), direction(60.0, 0.0));
    assert!((lambert - 0.2 / PI).abs() < 1e-6);
}

/// In the mirror direction the half vector is the normal: `1 / (4 pi alpha_u alpha_v cos^2)`, without the square in Ward's own form.
#[test]
fn wards_highlights_peak_in_the_mirror_direction() {
    let (wo, wi) = (direction(50.0, 30.0), direction(50.0, 210.0));
    let cos = libm::cos(50.0_f64.to_radians());
    let peak = 0.3 / (4.0 * PI * 0.1 * 0.3);
    for (model, expected) in [
        (WardModel::Ward, peak / cos),
        (WardModel::Duer, peak / (cos * cos)),
        (WardModel::Balanced, peak / (cos * cos)),
    ] {
        let found = f(&ward(0.5, 0.3, [0.1, 0.3], model), wo, wi);
        let expected = expected + 0.5 / PI;
        assert!(
            (found / expected - 1.0).abs() < 1e-5,
            "{model:?}: {found}, expected {expected}"
        );
    }
}

/// In the mirror direction the half vector is the normal, where GGX has density `1 / (pi alpha^2)`; by hand after Fresnel's equations at
/// 50 degrees from an index 1.5, heights that correlate, and Schlick's approximation.
#[test]
fn highlights_of_pbrt_in_the_mirror_direction() {
    let (wo, wi) = (direction(50.0, 30.0), direction(50.0, 210.0));
    let (sin, cos) = libm::sincos(50.0_f64.to_radians());
    let density = 1.0 / (PI * 0.2 * 0.2);
    let inside = (1.0 - sin * sin / 2.25).sqrt();
    let [s, p] = [(cos, inside), (inside, cos)].map(|(a, b)| ((a - 1.5 * b) / (a + 1.5 * b)).powi(2));
    // Smith's lambda is half of sqrt(1 + alpha^2 tan^2) - 1, and both directions' sum with 1.
    let shadowing = 1.0 / (1.0 + 0.04 * sin * sin / (cos * cos)).sqrt();
    let expected = 0.5 / PI + 0.3 * density * 0.5 * (s + p) * shadowing / (4.0 * cos * cos);
    let found = f(&pbrt_plastic(0.5, 0.3, 1.5, [0.2, 0.2]), wo, wi);
    assert!((found / expected - 1.0).abs() < 1e-5, "{found}, expected {expected}");
    // From within all is reflected beyond 41.8 degrees.
    let expected = 0.5 / PI + 0.3 * density * shadowing / (4.0 * cos * cos);
    let found = f(&pbrt_plastic(0.5, 0.3, 1.0 / 1.5, [0.2, 0.2]), wo, wi);
    assert!((found / expected - 1.0).abs() < 1e-5, "{found}, expected {expected}");
    let seen = 1.0 - (1.0 - 0.5 * cos).powi(5);
    let schlick = 0.2 + 0.8 * (1.0 - cos).powi(5);
    let expected = 28.0 / (23.0 * PI) * 0.6 * 0.8 * seen * seen + schlick * density / (4.0 * cos * cos);
    let found = f(&substrate(0.6, 0.2, [0.2, 0.2]), wo, wi);
    assert!((found / expected - 1.0).abs() < 1e-5, "{found}, expected {expected}");
}

/// The balanced form never makes energy, and loses little where it is narrow and seen from above.
#[test]
fn the_balanced_form_of_ward_keeps_energy() {
    for alpha in [[0.05, 0.05], [0.2, 0.5], [1.0, 1.0]] {
        let material = ward(0.0, 1.0, alpha, WardModel::Balanced);
        for wo in outgoing().into_iter().filter(|wo| wo.z > 0.0) {
            let albedo = albedo(&material, wo, TransportMode::Flux);
            assert!(albedo < 1.0 + QUADRATURE, "{alpha:?} {wo}: {albedo}");
            assert!(
                alpha[0] > 0.1 || wo.z < 0.5 || albedo > 0.98,
                "{alpha:?} {wo}: {albedo}"
            );
        }
    }
}

#[test]
fn a_sheet_has_its_albedos_on_both_sides() {
    let sheet = transmitter(0.2, 0.5);
    for wo in outgoing() {
        let both = albedo(&sheet, wo, TransportMode::Radiance);
        assert!((both - 0.7).abs() < QUADRATURE, "{wo} {both}");
        let bsdf = sheet.resolve(&AT, wo);
        assert_eq!(bsdf.f(wo, wo, TransportMode::Flux)[0], 0.2 * FRAC_1_PI);
        assert_eq!(bsdf.f(wo, -wo, TransportMode::Flux)[0], 0.5 * FRAC_1_PI);
    }
}

#[test]
fn highlights_have_a_roughness() {
    let roughness = |material: Material| material.resolve(&AT, Vec3::Z).least_roughness().unwrap();
    assert_eq!(roughness(phong(0.5, 0.2, 198.0)), 0.1);
    assert_eq!(roughness(ward(0.5, 0.2, [0.3, 0.1], WardModel::Duer)), 0.1);
    assert_eq!(roughness(phong(0.5, 0.0, 198.0)), f32::INFINITY);
    assert_eq!(roughness(rough_diffuse(0.5, 0.2, false)), f32::INFINITY);
    assert_eq!(roughness(transmitter(0.5, 0.2)), f32::INFINITY);
}

//! Samplers against densities, and their weights against the energy that quadrature finds. Seeds are fixed; all tests of
//! a function together raise a false alarm with probability 1 % (Sidak's correction).

use super::*;
use crate::chi_square::{assert_directions, integrate_sphere, sidak};

#[test]
fn every_sampler_matches_its_density() {
    let tests = scattering().len() * outgoing().len();
    for (name, material) in scattering() {
        for wo in outgoing().into_iter().filter(|wo| sees(&material, *wo)) {
            if (0..256).all(|path| draw(&material, wo, &mut random(path), TransportMode::Radiance).is_none()) {
                // A tilted frame that is not mirrored turns away from some directions: it scatters nothing there.
                let density = |wi: &Vec3| material.resolve(&AT, wo).pdf(wo, *wi);
                assert!(
                    outgoing().iter().all(|wi| density(wi) == 0.0 && density(&-*wi) == 0.0),
                    "{name}, {wo}"
                );
                continue;
            }
            let bsdf = material.resolve(&AT, wo);
            assert_directions(
                &format!("{name}, {wo}"),
                tests,
                |random| {
                    // Also samples that carry nothing: the density counts them.
                    let lobe = random.next_1d();
                    let sample = bsdf.draw(wo, lobe, random.next_2d(), TransportMode::Radiance)?;
                    (!sample.delta).then_some(sample.wi)
                },
                |wi| bsdf.pdf(wo, wi),
            );
        }
    }
}

/// Whether the side of `wo` scatters at all.
fn sees(material: &Material, wo: Vec3) -> bool {
    wo.z > 0.0 || !material.is_one_sided()
}

#[test]
fn sampling_is_the_same_in_both_modes() {
    for (name, material) in scattering() {
        for (wo, path) in outgoing().into_iter().zip(0..) {
            let [radiance, flux] = MODES.map(|mode| draw(&material, wo, &mut random(path), mode));
            let part = |sample: Option<BsdfSample>| sample.map(|s| (s.wi, s.pdf, s.delta, s.eta));
            // Where the tilted frame is another from both directions, one of the modes has nothing.
            if is_symmetric(&material) || (radiance.is_some() && flux.is_some()) {
                assert_eq!(part(radiance), part(flux), "{name}, {wo}");
            }
        }
    }
}

/// Mean and standard error of the weight `f |cos| / pdf` in the first channel, failures and what is not `counted` being zero.
pub(super) fn mean_weight(
    material: &Material,
    wo: Vec3,
    mode: TransportMode,
    samples: u64,
    counted: impl Fn(&BsdfSample) -> bool,
) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for path in 0..samples {
        let weight = draw(material, wo, &mut random(path), mode)
            .filter(&counted)
            .map_or(0.0, |sample| f64::from(sample.f[0] * sample.wi.z.abs() / sample.pdf));
        sum += weight;
        squares += weight * weight;
    }
    let n = samples as f64;
    let mean = sum / n;
    (mean, ((squares / n - mean * mean).max(0.0) / n).sqrt())
}

/// Share of the power arriving along `wo` that leaves again by lobes that are no delta functions, by quadrature.
pub(super) fn albedo(material: &Material, wo: Vec3, mode: TransportMode) -> f64 {
    integrate_sphere(|wi| f64::from(material.resolve(&AT, wo).f(wo, wi, mode)[0] * wi.z.abs()))
}

/// Error of [`albedo`] by quadrature in single precision, relative.
pub(super) const QUADRATURE: f64 = 2e-4;

#[test]
fn mean_weights_are_the_albedos() {
    let tests = scattering().len() * outgoing().len() * MODES.len();
    for (name, material) in scattering() {
        for wo in outgoing().into_iter().filter(|wo| sees(&material, *wo)) {
            // Only refraction and tilted normals depend on the mode.
            let depends = material.transmits() || !is_symmetric(&material);
            for mode in MODES.into_iter().take(if depends { 2 } else { 1 }) {
                let expected = albedo(&material, wo, mode);
                let (mean, error) = mean_weight(&material, wo, mode, 30_000, |sample| !sample.delta);
                let excess = ((mean - expected).abs() - QUADRATURE * expected).max(0.0);
                let p_value = if excess > 0.0 {
                    libm::erfc(excess / error / std::f64::consts::SQRT_2)
                } else {
                    1.0
                };
                assert!(
                    p_value >= sidak(tests),
                    "{name}, {wo}, {mode:?}: {mean} +- {error}, expected {expected}"
                );
            }
        }
    }
}

/// In a white furnace a surface that does not absorb returns what it gets: exactly if it is smooth, and less by what
/// facets shadow if it is rough, since scattering from facet to facet is left out. Flux is what is conserved.
#[test]
fn no_material_makes_energy_and_smooth_ones_lose_none() {
    for kind in [MicrofacetKind::Beckmann, MicrofacetKind::Ggx] {
        for (alpha, least, least_grazing) in [(0.05, 0.99, 0.7), (0.6, 0.55, 0.3)] {
            let mirror = rough_mirror(facets(kind, alpha, alpha));
            let glass = rough_glass(1.5, facets(kind, alpha, alpha), Spectrum::ONE);
            for wo in outgoing() {
                for material in [&mirror, &glass].into_iter().filter(|material| sees(material, wo)) {
                    let share = albedo(material, wo, TransportMode::Flux);
                    let least = if wo.z.abs() > 0.1 { least } else { least_grazing };
                    assert!((least..=1.0 + QUADRATURE).contains(&share), "{material:?} {wo} {share}");
                }
            }
        }
    }
    for (material, albedo) in [
        (glass(1.5), 1.0),
        (two_sided(mirror(), mirror()), 1.0),
        (Material::Null, 1.0),
        (pane(1.5), 1.0),
        (mask(0.3, two_sided(mirror(), mirror())), 1.0),
        (blend(0.4, glass(1.5), mask(0.5, pane(1.3))), 1.0),
        (Material::Mixture(vec![(0.5, Material::Null), (0.3, pane(1.5))]), 0.8),
    ] {
        for wo in outgoing() {
            let (mean, error) = mean_weight(&material, wo, TransportMode::Flux, 1000, |_| true);
            assert!((mean - albedo).abs() < 1e-6 && error < 1e-6, "{material:?} {wo} {mean}");
        }
    }
    let diffuse = Material::Diffuse { reflectance: grey(0.7) };
    let (mean, error) = mean_weight(&diffuse, Vec3::Z, TransportMode::Flux, 1000, |_| true);
    assert!((mean - 0.7).abs() < 1e-6 && error < 1e-6);
}

/// The single-scattering albedo of a rough mirror, integrated over facets instead of directions: visible normals times the
/// masking of the mirrored direction.
#[test]
fn albedo_of_a_rough_mirror_follows_from_its_facets() {
    for kind in [MicrofacetKind::Beckmann, MicrofacetKind::Ggx] {
        for alpha in [0.1, 0.5, 1.0] {
            let facets = facets(kind, alpha, alpha);
            for wo in outgoing().into_iter().filter(|wo| wo.z > 0.0) {
                let over_facets = integrate_sphere(|m| {
                    let wi = fresnel::reflect(wo, m, wo.dot(m));
                    if m.z <= 0.0 || wo.dot(m) <= 0.0 || wi.z <= 0.0 {
                        return 0.0;
                    }
                    let visible = facets.density(m) * wo.dot(m) * facets.masking_over_cos(wo);
                    f64::from(visible * facets.masking_over_cos(wi) * wi.z)
                });
                let over_directions = albedo(&rough_mirror(facets), wo, TransportMode::Flux);
                assert!(
                    (over_facets - over_directions).abs() < 2e-3,
                    "{facets:?} {wo} {over_facets} {over_directions}"
                );
            }
        }
    }
}

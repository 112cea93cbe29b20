//! Fresnel's equations for unpolarised light, and the directions of reflection and refraction.

use crate::math::{Vec3, safe_sqrt, sqr};
use crate::spectrum::Spectrum;

/// What a dielectric boundary does to light that arrives at it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Boundary {
    /// Share of the power that is reflected; the rest is transmitted.
    pub(super) reflectance: f32,
    /// Cosine of the refracted direction with the normal on its own side; zero under total reflection.
    pub(super) cos_transmitted: f32,
}

/// Fresnel's equations (Born and Wolf 1999, section 1.5.2) at a boundary whose far side has `eta` times the index of
/// the near side. `cos` > 0 is the cosine of the arriving direction with the normal on the near side.
pub(super) fn dielectric(cos: f32, eta: f32) -> Boundary {
    let cos_squared_transmitted = 1.0 - (1.0 - cos * cos) / (eta * eta);
    if cos_squared_transmitted <= 0.0 {
        return Boundary {
            reflectance: 1.0,
            cos_transmitted: 0.0,
        };
    }
    let cos_transmitted = cos_squared_transmitted.sqrt();
    Boundary {
        reflectance: reflectance(cos, cos_transmitted, eta),
        cos_transmitted,
    }
}

/// Share of the power that is reflected where both cosines are known, so that nothing cancels near the critical angle.
pub(super) fn reflectance(cos: f32, cos_transmitted: f32, eta: f32) -> f32 {
    let perpendicular = (cos - eta * cos_transmitted) / (cos + eta * cos_transmitted);
    let parallel = (eta * cos - cos_transmitted) / (eta * cos + cos_transmitted);
    0.5 * (sqr(perpendicular) + sqr(parallel))
}

/// Share that is reflected of light which arrives evenly from all directions of the near side, so that its power falls with the
/// cosine: `2 integral F(cos) cos d cos`. By the rule of midpoints; the error is below 1e-5.
///
/// A far side of less index reflects everything beyond the critical angle, and of the rest what it reflects from the other side
/// (both sides exchange the same power: `1 - F(eta) = (1 - F(1 / eta)) eta^2`).
pub(super) fn mean_reflectance(eta: f32) -> f64 {
    const STEPS: u32 = 1024;
    if eta < 1.0 {
        return 1.0 - (1.0 - mean_reflectance(1.0 / eta)) * f64::from(eta) * f64::from(eta);
    }
    let term = |step: u32| {
        let cos = (step as f32 + 0.5) / STEPS as f32;
        f64::from(dielectric(cos, eta).reflectance * cos)
    };
    2.0 / f64::from(STEPS) * (0..STEPS).map(term).sum::<f64>()
}

/// Reflectance of a conductor of index `eta + i k`, relative to the exterior, at cosine `cos` >= 0, channel by channel
/// (Born and Wolf 1999, section 14.2, with the refracted angle eliminated).
pub(super) fn conductor(cos: f32, eta: Spectrum, k: Spectrum) -> Spectrum {
    let cos_squared = cos * cos;
    let sin_squared = 1.0 - cos_squared;
    eta.zip(k, |eta, k| {
        // `real` and `modulus` of the squared normal component of the refracted wave vector.
        let real = eta * eta - k * k - sin_squared;
        let modulus = (sqr(real) + sqr(2.0 * eta * k)).sqrt();
        let twice_root = 2.0 * safe_sqrt(0.5 * (modulus + real)) * cos;
        let ratio = |sum: f32, cross: f32| {
            if sum + cross > 0.0 {
                (sum - cross) / (sum + cross)
            } else {
                1.0
            }
        };
        let perpendicular = ratio(modulus + cos_squared, twice_root);
        let parallel = ratio(modulus * cos_squared + sqr(sin_squared), twice_root * sin_squared);
        (0.5 * perpendicular * (1.0 + parallel)).clamp(0.0, 1.0)
    })
}

/// The mirror image of `w` about the unit vector `m`, `cos` being their cosine.
pub(super) fn reflect(w: Vec3, m: Vec3, cos: f32) -> Vec3 {
    2.0 * cos * m - w
}

/// The refracted direction of `w`, which makes the cosine `cos` > 0 with `m`; the far side has `eta` times the index.
pub(super) fn refract(w: Vec3, m: Vec3, cos: f32, cos_transmitted: f32, eta: f32) -> Vec3 {
    m * (cos / eta - cos_transmitted) - w / eta
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_incidence_has_the_closed_form() {
        let glass = dielectric(1.0, 1.5);
        assert!((glass.reflectance - 0.04).abs() < 1e-7 && glass.cos_transmitted == 1.0);
        let metal = conductor(1.0, Spectrum::splat(0.2), Spectrum::splat(3.9));
        let expected = (0.8 * 0.8 + 3.9 * 3.9) / (1.2 * 1.2 + 3.9 * 3.9);
        assert!((metal[0] - expected).abs() < 1e-6);
    }

    #[test]
    fn a_conductor_that_does_not_absorb_is_a_dielectric() {
        for cos in [0.0, 0.01, 0.3, 0.8, 1.0] {
            for eta in [0.5, 1.33, 2.4] {
                let metal = conductor(cos, Spectrum::splat(eta), Spectrum::ZERO)[0];
                assert!(
                    (metal - dielectric(cos, eta).reflectance).abs() < 2e-4,
                    "{cos} {eta} {metal}"
                );
            }
        }
    }

    #[test]
    fn no_light_passes_brewsters_angle_in_one_polarisation_and_none_beyond_the_critical_angle() {
        let brewster = 1.0 / (1.0_f32 + 1.5 * 1.5).sqrt();
        let at_brewster = dielectric(brewster, 1.5).reflectance;
        let perpendicular = (1.0 - 1.5 * 1.5) / (1.0 + 1.5 * 1.5);
        assert!((at_brewster - 0.5 * sqr(perpendicular)).abs() < 1e-6);
        let critical = (1.0_f32 - 1.0 / (1.5 * 1.5)).sqrt();
        assert_eq!(dielectric(critical - 1e-4, 1.0 / 1.5).reflectance, 1.0);
        assert!(dielectric(critical + 1e-4, 1.0 / 1.5).reflectance < 1.0);
    }

    #[test]
    fn reflectance_is_the_same_from_both_sides() {
        for cos in [0.1, 0.5, 0.9] {
            let outside = dielectric(cos, 1.5);
            let inside = dielectric(outside.cos_transmitted, 1.0 / 1.5);
            assert!((outside.reflectance - inside.reflectance).abs() < 1e-5);
            assert!((inside.cos_transmitted - cos).abs() < 1e-5);
        }
    }

    #[test]
    fn a_perfect_mirror_reflects_everything_at_any_angle() {
        for cos in [0.0, 1e-6, 0.2, 1.0] {
            assert_eq!(conductor(cos, Spectrum::ZERO, Spectrum::ONE), Spectrum::ONE);
        }
    }

    /// The closed form of Duntley 1942 (Ishimaru 1978, *Wave Propagation and Scattering in Random Media*, for diffuse light).
    #[test]
    fn mean_reflectance_has_the_closed_form() {
        for eta in [1.1_f32, 1.33, 1.5, 2.4, 10.0] {
            let n = f64::from(eta);
            let (n2, n4) = (n * n, n.powi(4));
            let closed = 0.5
                + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0).powi(2))
                + n2 * (n2 - 1.0).powi(2) / (n2 + 1.0).powi(3) * libm::log((n - 1.0) / (n + 1.0))
                - 2.0 * n.powi(3) * (n2 + 2.0 * n - 1.0) / ((n2 + 1.0) * (n4 - 1.0))
                + 8.0 * n4 * (n4 + 1.0) / ((n2 + 1.0) * (n4 - 1.0).powi(2)) * libm::log(n);
            let mean = mean_reflectance(eta);
            assert!((mean - closed).abs() < 1e-5, "{eta}: {mean} {closed}");
            // Light from within: 1 - F(1 / n) = (1 - F(n)) / n^2.
            let from_within = mean_reflectance(1.0 / eta);
            assert!(
                (1.0 - (1.0 - closed) / n2 - from_within).abs() < 1e-5,
                "{eta}: {from_within}"
            );
        }
        assert_eq!(mean_reflectance(1.0), 0.0);
    }

    #[test]
    fn refraction_obeys_snells_law() {
        let w = Vec3::new(0.6, 0.0, 0.8);
        let boundary = dielectric(0.8, 1.5);
        let wt = refract(w, Vec3::Z, 0.8, boundary.cos_transmitted, 1.5);
        assert!((wt.length() - 1.0).abs() < 1e-6 && (wt.x + 0.4).abs() < 1e-6 && wt.z < 0.0);
    }
}

//! Distributions of microfacet normals: density, masking and sampling of the normals that are visible.
//!
//! Sources: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces" (densities and Smith's
//! masking); Heitz and d'Eon 2014, "Importance Sampling Microfacet-Based BSDFs using the Distribution of Visible
//! Normals"; Jakob 2014, "An Improved Visible Normal Sampling Routine for the Beckmann Distribution"; Dupuy and
//! Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps".

use super::{MicrofacetKind, Microfacets};
use crate::math::{PI, TAU, Vec2, Vec3, erfc, exp, ln, safe_sqrt, sin_cos, sqr};

/// Smallest roughness: below it the distribution is not resolved in single precision.
const LEAST_ALPHA: f32 = 1e-4;
/// Square root of pi.
const SQRT_PI: f32 = 1.772_453_9;
/// Least random number that the Beckmann sampler uses: half a step of the generator.
const LEAST_RANDOM: f32 = 1.0 / (1u32 << 25) as f32;

impl Microfacets {
    /// Roughness along the tangent and the bitangent, kept away from zero.
    fn clamped_alpha(&self) -> Vec2 {
        self.alpha.max(Vec2::splat(LEAST_ALPHA))
    }

    /// D(m) [1/sr]: area of microfacets with unit normal `m`, per area of surface and solid angle.
    pub(super) fn density(&self, m: Vec3) -> f32 {
        let alpha = self.clamped_alpha();
        let slope_squared = sqr(m.x / alpha.x) + sqr(m.y / alpha.y);
        let z_squared = m.z * m.z;
        match self.kind {
            MicrofacetKind::Ggx => 1.0 / (PI * alpha.x * alpha.y * sqr(slope_squared + z_squared)),
            MicrofacetKind::Beckmann => {
                // exp(-80) times any finite factor is nothing; beyond it the quotient below is 0 / 0.
                if slope_squared >= 80.0 * z_squared {
                    return 0.0;
                }
                exp(-slope_squared / z_squared) / (PI * alpha.x * alpha.y * sqr(z_squared))
            }
        }
    }

    /// G1(v) / |cos v|: the share of microfacets seen from `v`, over the cosine. Finite at grazing directions, where
    /// both tend to zero. Smith's masking, in closed form for each distribution.
    pub(super) fn masking_over_cos(&self, v: Vec3) -> f32 {
        let alpha = self.clamped_alpha();
        let cos = v.z.abs();
        let stretched_sin = (sqr(alpha.x * v.x) + sqr(alpha.y * v.y)).sqrt();
        match self.kind {
            MicrofacetKind::Ggx => 2.0 / (cos + (sqr(cos) + sqr(stretched_sin)).sqrt()),
            MicrofacetKind::Beckmann => {
                if cos >= 4.0 * stretched_sin {
                    return 1.0 / cos;
                }
                let cot = cos / stretched_sin;
                2.0 / (cos * erfc(-cot) + stretched_sin * exp(-cot * cot) / SQRT_PI)
            }
        }
    }

    /// A unit normal with density `D(m) max(0, wo . m) G1(wo) / cos wo` [1/sr]. `wo.z` > 0.
    pub(super) fn sample_visible(&self, wo: Vec3, u: Vec2) -> Vec3 {
        let alpha = self.clamped_alpha();
        let stretched = Vec3::new(alpha.x * wo.x, alpha.y * wo.y, wo.z).normalize();
        let standard = match self.kind {
            MicrofacetKind::Ggx => visible_ggx(stretched, u),
            MicrofacetKind::Beckmann => visible_beckmann(stretched, u),
        };
        Vec3::new(alpha.x * standard.x, alpha.y * standard.y, standard.z).normalize()
    }
}

/// A normal of the GGX distribution with roughness 1 visible from `wo`, not normalised: the half vector of `wo` and a
/// point uniform on the cap of the sphere that mirrors `wo` into the upper hemisphere.
fn visible_ggx(wo: Vec3, u: Vec2) -> Vec3 {
    let height = (1.0 - u.y) * (1.0 + wo.z);
    let z = height - wo.z;
    let radius = safe_sqrt(1.0 - z * z);
    let (sin_phi, cos_phi) = sin_cos(TAU * u.x);
    Vec3::new(radius * cos_phi + wo.x, radius * sin_phi + wo.y, height)
}

/// A normal of the Beckmann distribution with roughness 1 visible from `wo`, not normalised.
fn visible_beckmann(wo: Vec3, u: Vec2) -> Vec3 {
    let sin = Vec2::new(wo.x, wo.y).length();
    let azimuth = if sin > 0.0 {
        Vec2::new(wo.x, wo.y) / sin
    } else {
        Vec2::X
    };
    let u = u.max(Vec2::splat(LEAST_RANDOM));
    let along = visible_beckmann_slope(sin / wo.z, u.x);
    let across = inverse_erf_of_excess(2.0 * u.y);
    let slope = along * azimuth + across * azimuth.perp();
    Vec3::new(-slope.x, -slope.y, 1.0)
}

/// The slope s < cot, in the plane of `wo`, at which the cumulative distribution of visible slopes,
/// `1 + erf(s) + tan exp(-s^2) / sqrt(pi)` up to its normalisation, is `u` (Jakob 2014, equation 10). `tan` is that of
/// `wo` with the normal. Newton's method on `y = 1 + erf(s)`, in which the distribution is concave, within a bracket.
fn visible_beckmann_slope(tan: f32, u: f32) -> f32 {
    let cot = 1.0 / tan;
    let upper = erfc(-cot);
    let total = upper + tan * exp(-cot * cot) / SQRT_PI;
    let (mut low, mut high) = (0.0, upper);
    let mut y = upper * erfc((-ln(u)).sqrt());
    let mut slope = inverse_erf_of_excess(y);
    for _ in 0..12 {
        let error = y + tan * exp(-slope * slope) / SQRT_PI - u * total;
        if error.abs() <= 1e-5 * u * total {
            break;
        }
        if error < 0.0 {
            low = y;
        } else {
            high = y;
        }
        let newton = y - error / (1.0 - slope * tan);
        y = if newton > low && newton < high {
            newton
        } else {
            0.5 * (low + high)
        };
        slope = inverse_erf_of_excess(y);
    }
    slope
}

/// The inverse of `y = 1 + erf(s)` for `y` in (0, 2); in terms of `y` the lower tail keeps its precision. Polynomials
/// of Giles 2010, "Approximating the erfinv function", table 5 (relative error about 4e-7).
fn inverse_erf_of_excess(y: f32) -> f32 {
    const CENTRAL: [f32; 9] = [
        2.810_226_4e-8,
        3.432_739_4e-7,
        -3.523_387_7e-6,
        -4.391_506_5e-6,
        2.185_808_7e-4,
        -1.253_725e-3,
        -4.177_681_6e-3,
        2.466_407_3e-1,
        1.501_409_4,
    ];
    const TAIL: [f32; 9] = [
        -2.002_142_6e-4,
        1.009_505_6e-4,
        1.349_343_2e-3,
        -3.673_428_4e-3,
        5.739_507_7e-3,
        -7.622_461_3e-3,
        9.438_870_5e-3,
        1.001_674,
        2.832_976_8,
    ];
    let w = -ln(y * (2.0 - y));
    let (coefficients, x) = if w < 5.0 {
        (&CENTRAL, w - 2.5)
    } else {
        (&TAIL, w.sqrt() - 3.0)
    };
    coefficients.iter().fold(0.0, |sum, c| sum * x + c) * (y - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chi_square::{assert_directions, integrate_sphere};

    fn distributions() -> Vec<Microfacets> {
        let kinds = [MicrofacetKind::Beckmann, MicrofacetKind::Ggx];
        let alphas = [
            Vec2::splat(0.05),
            Vec2::splat(0.5),
            Vec2::new(0.1, 0.4),
            Vec2::splat(1.0),
        ];
        kinds
            .into_iter()
            .flat_map(|kind| alphas.map(|alpha| Microfacets { kind, alpha }))
            .collect()
    }

    fn outgoing() -> [Vec3; 4] {
        [[0.0, 0.0, 1.0], [0.3, -0.5, 0.6], [-0.9, 0.2, 0.15], [0.6, 0.8, 0.002]].map(|w| Vec3::from(w).normalize())
    }

    #[test]
    fn inverse_error_function_inverts() {
        for i in 1..2000 {
            let y = i as f32 / 1000.0;
            let s = inverse_erf_of_excess(y);
            assert!((erfc(-s) - y).abs() < 1e-6, "{y} {s}");
        }
        for y in [1e-4, 1e-6, 1e-8] {
            let s = f64::from(inverse_erf_of_excess(y));
            assert!((libm::erfc(-s) / f64::from(y) - 1.0).abs() < 1e-3, "{y} {s}");
        }
    }

    #[test]
    fn projected_area_of_all_facets_is_one() {
        for facets in distributions() {
            let area = integrate_sphere(|m| {
                if m.z > 0.0 {
                    f64::from(facets.density(m) * m.z)
                } else {
                    0.0
                }
            });
            assert!((area - 1.0).abs() < 1e-4, "{facets:?} {area}");
        }
    }

    /// D(m) max(0, wo . m) G1(wo) / cos wo.
    fn visible_density(facets: &Microfacets, wo: Vec3, m: Vec3) -> f32 {
        if m.z > 0.0 && wo.dot(m) > 0.0 {
            facets.density(m) * wo.dot(m) * facets.masking_over_cos(wo)
        } else {
            0.0
        }
    }

    /// The visible area of facets seen from `wo` is the projected area of the surface (Heitz 2014, equation 15): proves
    /// that the masking function belongs to the density.
    #[test]
    fn visible_area_is_the_projected_area() {
        for facets in distributions() {
            for wo in outgoing() {
                let share = integrate_sphere(|m| f64::from(visible_density(&facets, wo, m)));
                assert!((share - 1.0).abs() < 1e-4, "{facets:?} {wo} {share}");
            }
        }
    }

    #[test]
    fn visible_normals_match_their_density() {
        let tests = distributions().len() * outgoing().len();
        for facets in distributions() {
            for wo in outgoing() {
                assert_directions(
                    &format!("{facets:?} {wo}"),
                    tests,
                    |random| Some(facets.sample_visible(wo, random.next_2d())),
                    |m| visible_density(&facets, wo, m),
                );
            }
        }
    }

    #[test]
    fn extreme_input_gives_unit_normals() {
        for kind in [MicrofacetKind::Beckmann, MicrofacetKind::Ggx] {
            for alpha in [0.0, 1e-4, 1.0, 10.0] {
                let facets = Microfacets {
                    kind,
                    alpha: Vec2::splat(alpha),
                };
                for z in [1e-7, 1e-4, 1.0_f32] {
                    for u in [0.0, 1e-7, 0.5, crate::math::ONE_MINUS_EPSILON] {
                        let wo = Vec3::new((1.0 - z * z).sqrt(), 0.0, z);
                        for u in [Vec2::new(u, 0.3), Vec2::new(0.3, u), Vec2::splat(u)] {
                            let m = facets.sample_visible(wo, u);
                            assert!((m.length() - 1.0).abs() < 1e-5 && m.z >= 0.0, "{facets:?} {wo} {u} {m}");
                        }
                    }
                }
            }
        }
    }
}

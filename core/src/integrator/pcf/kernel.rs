//! Kernels: how much a cone counts for a query.

use crate::integrator::Bandwidth;
use crate::map::{Candidate, Candidates, Reach};
use crate::math::{PI, TAU, Vec3, sqr, warp::one_minus_cos};
use crate::settings::{KernelShape, PcfSettings};
use crate::spectrum::Spectrum;

use super::query::{Query, Surface};

/// The kernel of an iteration (thesis, section 3.1): a function of the distance and of the angle that integrates to one over
/// a disc and a cone.
pub(super) struct Kernel<'a> {
    shape: KernelShape,
    /// Shares of the radius for light paths of 1, 2, ... edges.
    sigma_by_length: &'a [f32],
    surface_test: bool,
    /// On rough surfaces, and on delta and glossy ones.
    widths: [Width; 2],
}

/// The kernel's size on a kind of surface.
struct Width {
    bandwidth: Bandwidth,
    reach: Reach,
    /// `1 / (pi sigma^2 2 pi (1 - cos theta))` (thesis, equation 3.6) [1 / (unit^2 sr)].
    height: f32,
}

impl Width {
    fn new(bandwidth: Bandwidth) -> Self {
        Self {
            bandwidth,
            reach: Reach::new(bandwidth.sigma, bandwidth.theta),
            height: 1.0 / (PI * sqr(bandwidth.sigma) * TAU * one_minus_cos(bandwidth.theta)),
        }
    }
}

impl<'a> Kernel<'a> {
    pub(super) fn new(settings: &'a PcfSettings, bandwidth: Bandwidth) -> Self {
        let glossy = Bandwidth {
            theta: bandwidth.theta * settings.theta_glossy,
            ..bandwidth
        };
        Self {
            shape: settings.kernel,
            sigma_by_length: &settings.sigma_by_length,
            surface_test: settings.surface_test,
            widths: [Width::new(bandwidth), Width::new(glossy)],
        }
    }

    /// How far any query reaches.
    pub(super) fn reach(&self) -> &Reach {
        &self.widths[0].reach
    }

    pub(super) fn shape(&self) -> KernelShape {
        self.shape
    }

    /// Size of the kernel about a query.
    pub(super) fn bandwidth(&self, query: &Query) -> Bandwidth {
        self.width(query).bandwidth
    }

    fn width(&self, query: &Query) -> &Width {
        &self.widths[usize::from(query.surface != Surface::Rough)]
    }

    /// `sum_j K(psi_j - psi) weight_j` over the cones gathered for the query (thesis, equation 3.11) [W/(unit^2 sr)], and how many records
    /// were tested and counted.
    pub(super) fn sum(&self, cones: &Candidates, query: &Query) -> (Spectrum, u64, u64) {
        let width = self.width(query);
        let mut sum = Spectrum::ZERO;
        let mut counted = 0;
        let tested = cones.query(query.position, query.direction, &width.reach, |cone| {
            if cone.edges() > query.limit || (self.surface_test && !on_same_surface(&cone, query, &width.reach)) {
                return;
            }
            let value = self.value(&cone, query, &width.reach);
            if value > 0.0 {
                counted += 1;
                sum += cone.weight() * value;
            }
        });
        (sum * width.height, tested, counted)
    }

    /// The kernel over the height of the box.
    #[inline]
    fn value(&self, cone: &Candidate, query: &Query, reach: &Reach) -> f32 {
        if self.shape == KernelShape::Box && self.sigma_by_length.is_empty() {
            return 1.0;
        }
        let share = match self.sigma_by_length {
            [] => 1.0,
            shares => shares[(usize::from(cone.edges()) - 1).min(shares.len() - 1)],
        };
        let radius2 = sqr(share * reach.radius());
        let distance2 = (cone.position() - query.position).length_squared();
        if distance2 >= radius2 {
            return 0.0;
        }
        let shape = match self.shape {
            KernelShape::Box => 1.0,
            KernelShape::Epanechnikov => {
                let chord2 = (cone.direction() - query.direction).length_squared();
                2.0 * (1.0 - distance2 / radius2) * 2.0 * (1.0 - chord2 / reach.chord2()).max(0.0)
            }
        };
        shape / sqr(share)
    }
}

/// Part of the radius that a cone may lie off the query's tangent plane. On a surface of radius of curvature R a cone at the
/// distance sigma lies `sigma^2 / 2R` off it, so that the test refuses nothing on smooth surfaces once sigma is below R / 2.
pub(super) const OFF_PLANE: f32 = 0.25;

/// Cosine of the largest angle between the normals of the query and of the cone, which on a smooth surface is about sigma / R.
pub(super) const NORMALS_APART: f32 = 0.7;

/// Whether a cone may be taken for one of the surface that the query lies on: close to its tangent plane, with a similar
/// normal, and leaving on the same side. On a smooth surface all three hold as the kernel shrinks.
fn on_same_surface(cone: &Candidate, query: &Query, reach: &Reach) -> bool {
    let off_plane = (cone.position() - query.position).dot(query.normal).abs();
    let side = |direction: Vec3| direction.dot(query.normal) > 0.0;
    off_plane < OFF_PLANE * reach.radius()
        && cone.normal().dot(query.normal).abs() > NORMALS_APART
        && side(cone.direction()) == side(query.direction)
}

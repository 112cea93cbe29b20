//! How much a cone counts for a query.

use super::query::{Query, Surface};
use crate::density::{Candidate, Candidates, Extent, KernelShape, LEAST_ANGLE, Reach, cone_height};
use crate::integrator::Bandwidth;
use crate::math::{Vec3, sqr};
use crate::settings::PcfSettings;
use crate::spectrum::Spectrum;

/// The kernel of an iteration (thesis, section 3.1): a function of the distance and of the angle that integrates to one over
/// a disc and a cone, or in media over a ball and a cone (section 3.7.2).
pub(super) struct Kernel<'a> {
    extent: Extent,
    shape: KernelShape,
    /// Shares of the radius for light paths of 1, 2, ... edges.
    sigma_by_length: &'a [f32],
    surface_test: bool,
    /// On rough surfaces or in media, and on delta and glossy surfaces.
    widths: [Width; 2],
}

/// The kernel's size on a kind of surface.
struct Width {
    theta: f32,
    reach: Reach,
    /// Of the box ([`cone_height`]) [1 / (unit^2 sr), in media 1 / (unit^3 sr)].
    height: f32,
}

impl Width {
    fn new(extent: Extent, bandwidth: Bandwidth) -> Self {
        Self {
            theta: bandwidth.theta,
            reach: Reach::new(bandwidth.sigma, bandwidth.theta),
            height: cone_height(extent, bandwidth.sigma, bandwidth.theta),
        }
    }
}

impl<'a> Kernel<'a> {
    pub(super) fn new(settings: &'a PcfSettings, extent: Extent, bandwidth: Bandwidth) -> Self {
        let glossy = Bandwidth {
            theta: (bandwidth.theta * settings.theta_glossy).max(LEAST_ANGLE),
            ..bandwidth
        };
        Self {
            extent,
            shape: settings.kernel,
            sigma_by_length: &settings.sigma_by_length,
            surface_test: settings.surface_test && extent == Extent::Disc,
            widths: [bandwidth, glossy].map(|bandwidth| Width::new(extent, bandwidth)),
        }
    }

    /// How far any query reaches.
    pub(super) fn reach(&self) -> &Reach {
        &self.widths[0].reach
    }

    /// Whether only cones near the query's surface count, and the kernel is clipped to it.
    pub(super) fn tests_surfaces(&self) -> bool {
        self.surface_test
    }

    pub(super) fn shape(&self) -> KernelShape {
        self.shape
    }

    /// Size of the kernel about a query, for each length of light paths that has a share of the radius of its own.
    pub(super) fn bandwidths(&self, query: &Query) -> impl Iterator<Item = Bandwidth> {
        let width = self.width(query);
        let radius = width.reach.at(query.position).radius();
        (0..self.lengths()).map(move |length| Bandwidth {
            sigma: self.share_of_radius(length) * radius,
            theta: width.theta,
        })
    }

    /// How many lengths of light paths are told apart.
    pub(super) fn lengths(&self) -> usize {
        self.sigma_by_length.len().max(1)
    }

    /// The index of the length of light paths with `edges` edges.
    fn length(&self, edges: u8) -> usize {
        (usize::from(edges) - 1).min(self.lengths() - 1)
    }

    fn share_of_radius(&self, length: usize) -> f32 {
        self.sigma_by_length.get(length).copied().unwrap_or(1.0)
    }

    fn width(&self, query: &Query) -> &Width {
        &self.widths[usize::from(query.surface != Surface::Rough)]
    }

    /// `sum_j K(psi_j - psi) weight_j` over the cones gathered for the query (thesis, equation 3.11) [W/(unit^2 sr), in media W/(unit^3 sr)], and how many records
    /// were tested and counted. `on_surface`: for each length of light paths the share of the kernel on the query's surface, which
    /// the sum is divided by; empty without a surface test.
    pub(super) fn sum(&self, cones: &Candidates, query: &Query, on_surface: &[f32]) -> (Spectrum, u64, u64) {
        let width = self.width(query);
        let reach = width.reach.at(query.position);
        let mut sum = Spectrum::ZERO;
        let mut counted = 0;
        let tested = cones.query(query.position, query.direction, &reach, |cone| {
            if cone.edges() > query.limit || cone.states() & query.states == 0 || !on_same_side(&cone, query) {
                return;
            }
            let length = self.length(cone.edges());
            let radius = self.share_of_radius(length) * reach.radius();
            if self.surface_test && !on_same_surface(&cone, query, radius) {
                return;
            }
            let value = self.value(&cone, query, radius, &reach);
            if value > 0.0 {
                counted += 1;
                sum += cone.weight() * (value / on_surface.get(length).unwrap_or(&1.0));
            }
        });
        let height = width.height * self.extent.growth(width.reach.radius() / reach.radius());
        (sum * height, tested, counted)
    }

    /// The kernel in a disc of the given radius, over the height of a box of the reach.
    #[inline]
    fn value(&self, cone: &Candidate, query: &Query, radius: f32, reach: &Reach) -> f32 {
        if self.shape == KernelShape::Box && self.sigma_by_length.is_empty() {
            return 1.0;
        }
        let radius2 = sqr(radius);
        let distance2 = (cone.position() - query.position).length_squared();
        if distance2 >= radius2 {
            return 0.0;
        }
        let chord2 = (cone.direction() - query.direction).length_squared();
        // No two directions are further apart than opposite ones.
        let chord2 = chord2 / reach.chord2().min(4.0);
        let shape = self.shape.value(self.extent, distance2 / radius2, chord2);
        match self.extent {
            Extent::Disc => shape * (sqr(reach.radius()) / radius2),
            Extent::Ball => shape * self.extent.growth(reach.radius() / radius),
        }
    }
}

/// Part of the radius that a cone may lie off the query's tangent plane. On a surface of radius of curvature R a cone at the
/// distance sigma lies `sigma^2 / 2R` off it, so that the test refuses nothing on smooth surfaces once sigma is below R / 2.
pub(super) const OFF_PLANE: f32 = 0.25;

/// Cosine of the largest angle between the normals of the query and of the cone, which on a smooth surface is about sigma / R.
pub(super) const NORMALS_APART: f32 = 0.7;

/// Whether a cone leaves on the side of the query's surface from which it is seen. Light that leaves the back of a thin
/// wall would otherwise shine through it, for views along the wall.
fn on_same_side(cone: &Candidate, query: &Query) -> bool {
    let side = |direction: Vec3| direction.dot(query.normal) > 0.0;
    side(cone.direction()) == side(query.direction)
}

/// Whether a cone may be taken for one of the surface that the query lies on: close to its tangent plane, with a similar
/// normal. On a smooth surface both hold as the kernel's `radius` shrinks.
fn on_same_surface(cone: &Candidate, query: &Query, radius: f32) -> bool {
    let off_plane = (cone.position() - query.position).dot(query.normal).abs();
    off_plane < OFF_PLANE * radius && cone.normal().dot(query.normal).abs() > NORMALS_APART
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::{Cone, ConeMap};
    use crate::math::{PI, warp::square_to_sphere};
    use crate::random::{PathRandom, Stream};

    /// Records spread evenly over a square or a cube of side 2 and over all directions, of light paths of one and two edges in turn.
    fn evenly(extent: Extent, count: u64) -> Vec<Cone> {
        (0..count)
            .map(|i| {
                let mut random = PathRandom::new(5, 1, Stream::Light, i);
                let place = 2.0 * random.next_2d() - 1.0;
                let direction = square_to_sphere(random.next_2d());
                let height = match extent {
                    Extent::Disc => 0.0,
                    Extent::Ball => 2.0 * random.next_1d() - 1.0,
                };
                let edges = 1 + (i % 2) as u32;
                Cone::new(place.extend(height), Vec3::Z, direction, Spectrum::ONE, edges, u8::MAX)
            })
            .collect()
    }

    /// Every kernel integrates to one over positions and directions, up to the widest: all directions. The query has no
    /// normal, so that no direction lies on another side than its own.
    #[test]
    fn kernels_integrate_to_one() {
        const COUNT: u64 = 400_000;
        let query = Query::at(Vec3::new(0.05, -0.02, 0.0), Vec3::new(0.48, -0.6, 0.64), Vec3::ZERO);
        // The place's measure, and the spread of weights over their mean at most.
        for (extent, measure, spread) in [(Extent::Disc, 4.0, 1.5), (Extent::Ball, 8.0, 2.0)] {
            let records = evenly(extent, COUNT);
            for kernel in [KernelShape::Box, KernelShape::Epanechnikov] {
                for sigma_by_length in [vec![], vec![0.6, 1.0]] {
                    for theta in [0.4, 1.5, 2.5, PI] {
                        let settings = PcfSettings {
                            kernel,
                            sigma_by_length: sigma_by_length.clone(),
                            ..Default::default()
                        };
                        let bandwidth = Bandwidth { sigma: 0.7, theta };
                        let kernel = Kernel::new(&settings, extent, bandwidth);
                        let map = ConeMap::build(vec![records.clone()], kernel.reach(), false);
                        let mut cones = Candidates::new(&map);
                        let _ = cones.gather(std::iter::once((query.position, query.direction)), kernel.reach());
                        let (sum, _, counted) = kernel.sum(&cones, &query, &[]);
                        let integral = sum[0] * measure * 4.0 * PI / COUNT as f32;
                        // The noise of a sum of weights, at 4 deviations.
                        let allowed = 4.0 * spread / (counted as f32).sqrt();
                        assert!(
                            (integral - 1.0).abs() < allowed,
                            "{settings:?}, {extent:?}, {theta}: {integral}, {counted}"
                        );
                    }
                }
            }
        }
    }
}

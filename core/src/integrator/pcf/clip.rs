//! The part of a query's kernel that lies on its surface: the disc ends at borders, the cone of directions at the horizon.

use super::kernel::{NORMALS_APART, OFF_PLANE};
use super::query::Query;
use crate::geometry::Ray;
use crate::integrator::Bandwidth;
use crate::math::{FRAC_1_PI, Frame, PI, TAU, Vec3, acos, sin_cos};
use crate::path::Tracer;
use crate::random::PathRandom;
use crate::settings::KernelShape;

/// Points of the disc that are probed.
const PROBES: u32 = 8;

/// Share of a turn from one probe to the next, by which any number of them spread evenly (Vogel 1979).
const GOLDEN_TURN: f32 = 0.381_966;

/// Share of the kernel about a query that lies on its surface. Cones come from there only, so that their sum is short by the
/// same share. Once the kernel is small against the curvature and the distance from borders and the horizon the share is one:
/// dividing by it changes nothing in the limit.
pub(super) fn share_on_surface(
    tracer: &mut Tracer,
    query: &Query,
    bandwidth: Bandwidth,
    shape: KernelShape,
    random: &mut PathRandom,
) -> f32 {
    let sin_elevation = query.direction.dot(query.normal).abs();
    let elevation = 0.5 * PI - acos(sin_elevation);
    share_of_disc(tracer, query, bandwidth.sigma, shape, random) * share_above(elevation / bandwidth.theta, shape)
}

/// Share of the spatial kernel on a surface close to the query's tangent plane with a similar normal, by [`PROBES`] rays along
/// the normal, distributed as the kernel; at least one probe's share.
fn share_of_disc(tracer: &mut Tracer, query: &Query, radius: f32, shape: KernelShape, random: &mut PathRandom) -> f32 {
    let frame = Frame::from_normal(query.normal);
    let height = OFF_PLANE * radius;
    let turn = random.next_1d();
    let hits = (0..PROBES).filter(|probe| {
        let u = (*probe as f32 + random.next_1d()) / PROBES as f32;
        let distance2 = match shape {
            KernelShape::Box => u,
            KernelShape::Epanechnikov => 1.0 - (1.0 - u).sqrt(),
        };
        let distance = radius * distance2.sqrt();
        let (sin_phi, cos_phi) = sin_cos(TAU * (turn + GOLDEN_TURN * *probe as f32).fract());
        let above_plane = Vec3::new(distance * cos_phi, distance * sin_phi, height);
        let hit = tracer.intersect(&Ray {
            origin: query.position + frame.to_world(above_plane),
            direction: -query.normal,
            max_distance: 2.0 * height,
        });
        hit.is_some_and(|point| point.geometric_normal.dot(query.normal).abs() > NORMALS_APART)
    });
    hits.count().max(1) as f32 / PROBES as f32
}

/// Share of a kernel on a disc of radius one on the near side of a line at the distance `x` from its middle: what the horizon
/// leaves of a narrow cone of directions whose axis is `x` of its half angles above it.
fn share_above(x: f32, shape: KernelShape) -> f32 {
    if x >= 1.0 {
        return 1.0;
    }
    let chord = x * (1.0 - x * x).sqrt();
    let beyond = match shape {
        KernelShape::Box => chord,
        KernelShape::Epanechnikov => chord * (5.0 - 2.0 * x * x) / 3.0,
    };
    1.0 - FRAC_1_PI * (acos(x) - beyond)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sqr;

    #[test]
    fn shares_of_a_cut_disc_are_those_of_a_sum_over_it() {
        const STEPS: usize = 400;
        for shape in [KernelShape::Box, KernelShape::Epanechnikov] {
            for x in [0.0, 0.3, 0.8, 1.0] {
                let (mut near, mut whole) = (0.0, 0.0);
                for i in 0..STEPS * STEPS {
                    let at = |step: usize| 2.0 * (step as f32 + 0.5) / STEPS as f32 - 1.0;
                    let (a, b) = (at(i % STEPS), at(i / STEPS));
                    let inside = 1.0 - sqr(a) - sqr(b);
                    if inside > 0.0 {
                        let value = if shape == KernelShape::Box {
                            1.0
                        } else {
                            f64::from(inside)
                        };
                        whole += value;
                        near += if a < x { value } else { 0.0 };
                    }
                }
                let share = f64::from(share_above(x, shape));
                assert!(
                    (share - near / whole).abs() < 2e-3,
                    "{shape:?} {x}: {share} for {}",
                    near / whole
                );
            }
        }
    }
}

//! The part of a query's kernel that lies on its surface: the disc ends at borders, the cone of directions at the horizon.

use super::kernel::{NORMALS_APART, OFF_PLANE};
use super::query::Query;
use crate::density::KernelShape;
use crate::geometry::Ray;
use crate::integrator::Bandwidth;
use crate::math::{Frame, PI, TAU, Vec3, acos, sin_cos};
use crate::path::Tracer;
use crate::random::PathRandom;

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
    share_of_disc(tracer, query, bandwidth.sigma, shape, random) * shape.share_above(elevation / bandwidth.theta)
}

/// Share of the spatial kernel on a surface close to the query's tangent plane with a similar normal, by [`PROBES`] rays along
/// the normal, distributed as the kernel; at least one probe's share.
fn share_of_disc(tracer: &mut Tracer, query: &Query, radius: f32, shape: KernelShape, random: &mut PathRandom) -> f32 {
    let frame = Frame::from_normal(query.normal);
    let height = OFF_PLANE * radius;
    let turn = random.next_1d();
    let hits = (0..PROBES).filter(|probe| {
        let u = (*probe as f32 + random.next_1d()) / PROBES as f32;
        let distance = radius * shape.sample_distance2(u).sqrt();
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

//! Instances: groups of shapes that are kept once and stand in the scene at many places.

use super::hierarchy::{Hierarchy, ROUNDED_ORIGINS};
use super::surface::Interpolated;
use super::traversal::Hit;
use super::{Geometry, Line, Shape, ShapeId, SurfacePoint};
use crate::math::{DVec3, Transform, Vec3};
use glam::{DAffine3, DMat3};
use std::sync::Arc;

/// Shapes that are kept once, with a hierarchy of their own, and stand in the scene where [`Shape::Instance`]s place them.
///
/// Shapes of groups are numbered behind those of the scene itself, one group after the other.
#[derive(Clone, Debug)]
pub struct ShapeGroup {
    geometry: Geometry,
    /// Shapes of the groups before it.
    before: u32,
}

impl ShapeGroup {
    /// The group of `shapes`, numbered behind the group `before`.
    ///
    /// # Panics
    /// If one of the shapes is an instance, and as [`Geometry::build`].
    #[must_use]
    pub fn build(shapes: Vec<Shape>, before: Option<&Self>) -> Self {
        let nested = shapes.iter().any(|shape| matches!(shape, Shape::Instance { .. }));
        assert!(!nested, "a group of shapes holds no instances");
        Self {
            geometry: Geometry::build_for(shapes, ROUNDED_ORIGINS),
            before: before.map_or(0, Self::shapes),
        }
    }

    /// Shapes of all groups up to this one.
    fn shapes(&self) -> u32 {
        self.before + self.geometry.shapes.len() as u32
    }

    /// A shape of the group, numbered among those of all groups.
    pub(super) fn shape(&self, number: u32) -> &Shape {
        &self.geometry.shapes[(number - self.before) as usize]
    }

    /// Bounds of the group in its own space [scene units]: lower and upper corner.
    #[must_use]
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.geometry.bounds()
    }

    /// Whether nothing of the group can be hit.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.geometry.hierarchy.nodes.is_empty()
    }
}

/// A group of shapes where an instance places it, as rays meet it.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    group: Arc<ShapeGroup>,
    to_local: DAffine3,
}

/// Rays start this part of the group's largest coordinate before its bounds: more than what the bounds are rounded by.
const LEAD: f64 = 1.0 / (1u64 << 20) as f64;

impl Placed {
    pub(super) fn new(group: &Arc<ShapeGroup>, to_world: &Transform) -> Self {
        Self {
            group: Arc::clone(group),
            to_local: DAffine3::from_mat4(to_world.inverted().matrix()),
        }
    }

    /// The nearest hit before the distance `end`. Its primitive is of the group, and so is the place where the hierarchy keeps it.
    #[inline(never)]
    pub(super) fn nearest(&self, line: &Line, end: f64) -> Option<Hit> {
        let Local { line, start, stretch } = self.enter(line)?;
        let hit = self.group.geometry.hierarchy.nearest(&line, end * stretch - start)?;
        Some(Hit {
            t: (start + hit.t) / stretch,
            ..hit
        })
    }

    /// Whether there is any hit before the distance `end`.
    #[inline(never)]
    pub(super) fn any(&self, line: &Line, end: f64) -> bool {
        let hierarchy = &self.group.geometry.hierarchy;
        self.enter(line)
            .is_some_and(|local| hierarchy.any(&local.line, end * local.stretch - local.start))
    }

    /// The line in the group's space; `None` where it passes the group.
    ///
    /// It begins close to the group, where its coordinates are no larger than the group's: only so do they keep their precision in
    /// the hierarchy's tests of boxes.
    fn enter(&self, line: &Line) -> Option<Local> {
        let origin = self.to_local.transform_point3(line.origin);
        let direction = self.to_local.transform_vector3(line.direction);
        let stretch = direction.length();
        let direction = direction / stretch;
        let start = enter(&self.group.geometry.hierarchy, origin, direction)?.max(0.0);
        let line = Line {
            origin: origin + start * direction,
            direction,
        };
        Some(Local { line, start, stretch })
    }
}

/// A line in the space of a group.
struct Local {
    line: Line,
    /// The distance in the group's space from where the line begins in the world.
    start: f64,
    /// Lengths in the group's space over those in the world, along the line.
    stretch: f64,
}

/// The distance, before which nothing lies, at which a line comes close to the bounds of a hierarchy; `None` where it passes them.
fn enter(hierarchy: &Hierarchy, origin: DVec3, direction: DVec3) -> Option<f64> {
    let lead = DVec3::splat(LEAD * f64::from(hierarchy.reach));
    let lower = hierarchy.bounds.0.as_dvec3() - lead;
    let upper = hierarchy.bounds.1.as_dvec3() + lead;
    let (mut entry, mut exit) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        if direction[axis] == 0.0 {
            if origin[axis] < lower[axis] || origin[axis] > upper[axis] {
                return None;
            }
            continue;
        }
        let sides = [lower[axis], upper[axis]].map(|side| (side - origin[axis]) / direction[axis]);
        entry = entry.max(sides[0].min(sides[1]));
        exit = exit.min(sides[0].max(sides[1]));
    }
    (entry <= exit && exit >= 0.0).then_some(entry)
}

impl Geometry {
    /// The point of a hit on the instance `shape`, at `position` in the world.
    #[inline(never)]
    pub(super) fn instanced_point(
        &self,
        group: &ShapeGroup,
        to_world: &Transform,
        hit: &Hit,
        position: DVec3,
    ) -> SurfacePoint {
        let inner = Hit {
            primitive: group.geometry.hierarchy.primitive(hit.place),
            ..*hit
        };
        let shape = group.geometry.shape_of(inner.primitive);
        let local = || to_world.inverted().matrix().transform_point3(position);
        let interpolated = group.geometry.interpolate(shape, &inner, local).placed(to_world);
        let primitive = inner.primitive - group.geometry.first_primitive[shape as usize];
        let shape = ShapeId(self.shapes.len() as u32 + group.before + shape);
        interpolated.finish(shape, primitive, hit.barycentric, hit.t as f32)
    }
}

impl Interpolated {
    /// The point of an instance, mapped from its group's space to the world.
    ///
    /// A ray that leaves the point meets the surface where the inverse map has it. The product of the two maps differs from the
    /// identity by some roundings times the condition number (Higham 2002, Accuracy and Stability of Numerical Algorithms, section
    /// 14.1): what it makes of the coordinates is added to their extent, in units of what rounds an interpolated position.
    fn placed(self, to_world: &Transform) -> Self {
        let matrix = to_world.matrix();
        let linear = DMat3::from_mat4(matrix);
        let absolute = DMat3::from_cols(linear.x_axis.abs(), linear.y_axis.abs(), linear.z_axis.abs());
        let extent = absolute * self.extent.as_dvec3() + matrix.w_axis.truncate().abs();
        let norm =
            |m: DMat3| (m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()).sqrt();
        let condition = norm(linear) * norm(DMat3::from_mat4(to_world.inverted().matrix()));
        let shading_normal = to_world.normal(self.shading_normal);
        let geometric_normal = to_world.normal(self.geometric_normal);
        let disagree = geometric_normal.dot(shading_normal) < 0.0;
        Self {
            position: matrix.transform_point3(self.position),
            extent: (extent * (1.0 + CONDITION * condition)).as_vec3(),
            geometric_normal: if disagree { -geometric_normal } else { geometric_normal },
            shading_normal,
            uv: self.uv,
            tangent: to_world.vector(self.tangent),
        }
    }
}

/// What each unit of the condition number of an instance's map adds to a position's rounding: 16 roundings of 2^-53 in units of
/// the 2^-44 of an interpolated position.
const CONDITION: f64 = 1.0 / (1 << 5) as f64;

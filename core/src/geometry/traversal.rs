//! Walks through the hierarchy.
//!
//! A child is entered unless its box lies strictly beyond the nearest hit so far, with a margin for the rounding of
//! the box test (Ize 2013), and hits are compared in double precision, then by primitive index. So the nearest hit
//! does not depend on the shape of the hierarchy.

use super::Line;
use super::curved::Curved;
use super::hierarchy::{Child, Hierarchy, Lanes, Node, Target, WIDTH};
use super::triangle::{LANES, ShearedRay, TriangleHit};
use crate::math::Vec3;
use arrayvec::ArrayVec;

/// A hit of some primitive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Distance along the ray.
    pub(super) t: f64,
    /// Barycentric coordinates of the second and third vertex; zero for curved primitives.
    pub(super) barycentric: [f64; 2],
    /// Primitive index; that of the instance for a hit on one.
    pub(super) primitive: u32,
    /// Where the hierarchy keeps the primitive; for a hit on an instance, where that of its group does.
    pub(super) place: u32,
}

impl Hit {
    /// A hit before the end of a search for any, of which no more is known.
    const SOMEWHERE: Self = Self {
        t: 0.0,
        barycentric: [0.0; 2],
        primitive: 0,
        place: 0,
    };
}

/// What a walk looks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Search {
    /// The nearest hit.
    Nearest,
    /// Any hit.
    Any,
}

/// The bit of [`Hit::place`] that tells curved primitives from triangles.
const CURVED: u32 = 1 << 31;

/// A direction component no smaller than this keeps slab distances finite, or infinite but never NaN.
const SMALLEST_COMPONENT: f32 = 1e-30;
/// Covers the rounding of a slab distance at each end: of three operations and of the direction.
const SLAB_MARGIN: f32 = 1.0 + 6.0 * f32::EPSILON;
/// Entries of the stack before it moves to the heap.
const STACK: usize = 64;

/// What the box test needs of a ray.
pub(super) struct SlabRay {
    origin: [Lanes; 3],
    inverse: [Lanes; 3],
    /// 1 where the direction is negative: the upper side is met first.
    near: [usize; 3],
}

impl SlabRay {
    pub(super) fn new(line: &Line) -> Self {
        let direction = line.direction.as_vec3().to_array();
        let direction = direction.map(|d| d.abs().max(SMALLEST_COMPONENT).copysign(d));
        Self {
            origin: line.origin.as_vec3().to_array().map(Lanes::splat),
            inverse: direction.map(|d| Lanes::splat(1.0 / d)),
            near: direction.map(|d| usize::from(d < 0.0)),
        }
    }

    /// Distances at which the ray enters the children, and a bit for each child that it meets before `limit`.
    #[inline]
    pub(super) fn enter(&self, node: &Node, limit: f32) -> ([f32; WIDTH], u32) {
        let slab = |axis: usize| {
            let near = self.near[axis] & 1;
            let entry = (node.bounds[axis][near] - self.origin[axis]) * self.inverse[axis];
            let exit = (node.bounds[axis][1 - near] - self.origin[axis]) * self.inverse[axis];
            (entry, exit)
        };
        let ((x0, x1), (y0, y1), (z0, z1)) = (slab(0), slab(1), slab(2));
        let entry = x0.fast_max(y0).fast_max(z0.fast_max(Lanes::splat(0.0)));
        let exit = x1.fast_min(y1).fast_min(z1) * Lanes::splat(SLAB_MARGIN);
        let exit = exit.fast_min(Lanes::splat(limit));
        (entry.to_array(), entry.simd_le(exit).to_bitmask())
    }
}

/// Children still to be visited, nearest on top.
struct Stack {
    entries: ArrayVec<(f32, Child), STACK>,
    /// Entries above the first [`STACK`], for hierarchies of unusual depth.
    overflow: Vec<(f32, Child)>,
}

impl Stack {
    fn new() -> Self {
        Self {
            entries: ArrayVec::new(),
            overflow: Vec::new(),
        }
    }

    #[inline]
    fn push(&mut self, entry: (f32, Child)) {
        if let Err(full) = self.entries.try_push(entry) {
            self.overflow.push(full.element());
        }
    }

    /// The nearest entry that begins before `limit`.
    #[inline]
    fn pop(&mut self, limit: f32) -> Option<Child> {
        while let Some(entry) = self.overflow.pop() {
            if entry.0 <= limit {
                return Some(entry.1);
            }
        }
        while let Some(entry) = self.entries.pop() {
            if entry.0 <= limit {
                return Some(entry.1);
            }
        }
        None
    }

    /// Pushes all children of the non-empty `mask` but the nearest, farthest first, and returns the nearest.
    #[inline]
    fn push_farther(&mut self, node: &Node, entry: &[f32; WIDTH], mut mask: u32) -> Child {
        let mut next = || {
            let slot = mask.trailing_zeros() as usize % WIDTH;
            mask &= mask - 1;
            ((entry[slot], node.children[slot]), mask == 0)
        };
        let (mut first, mut last) = next();
        if last {
            return first.1;
        }
        let mut second;
        (second, last) = next();
        if second.0 < first.0 {
            (first, second) = (second, first);
        }
        if last {
            self.push(second);
            return first.1;
        }
        self.push_sorted(first, second, next)
    }

    /// The case of three children or more, of which two are given in order.
    fn push_sorted(
        &mut self,
        first: (f32, Child),
        second: (f32, Child),
        mut next: impl FnMut() -> ((f32, Child), bool),
    ) -> Child {
        let mut hits = [first; WIDTH];
        hits[1] = second;
        let (mut count, mut last) = (2, false);
        while !last {
            let hit;
            (hit, last) = next();
            let mut place = count;
            while place > 0 && hit.0 < hits[place - 1].0 {
                hits[place] = hits[place - 1];
                place -= 1;
            }
            hits[place] = hit;
            count += 1;
        }
        for hit in hits[1..count].iter().rev() {
            self.push(*hit);
        }
        hits[0].1
    }
}

/// An upper bound, in single precision, of the box distances that may hold a hit nearer than `t`.
fn box_limit(t: f64) -> f32 {
    (t as f32) * (1.0 + 8.0 * f32::EPSILON)
}

impl Hierarchy {
    /// The nearest hit before the distance `end`; of equally near ones that of the lowest primitive index.
    ///
    /// It is inlined, as is [`Hierarchy::any`]: for a ray of the scene no coordinate is then rounded to single precision again.
    #[inline(always)]
    pub(super) fn nearest(&self, line: &Line, end: f64) -> Option<Hit> {
        let mut best = Hit {
            t: end,
            barycentric: [0.0; 2],
            primitive: u32::MAX,
            place: 0,
        };
        self.walk(line, end, Search::Nearest, |hit| {
            if hit.t < best.t || (hit.t == best.t && hit.primitive < best.primitive && best.primitive != u32::MAX) {
                best = hit;
            }
            Some(best.t)
        });
        (best.primitive != u32::MAX).then_some(best)
    }

    /// Whether there is any hit before the distance `end`.
    #[inline(always)]
    pub(super) fn any(&self, line: &Line, end: f64) -> bool {
        let mut found = false;
        self.walk(line, end, Search::Any, |hit| {
            found = hit.t < end;
            (!found).then_some(end)
        });
        found
    }

    /// The vertices of the triangle of a hit.
    pub(super) fn corners(&self, hit: &Hit) -> [Vec3; 3] {
        self.blocks[hit.place as usize / LANES].corners(hit.place as usize % LANES)
    }

    /// The primitive at the place of a hit.
    pub(super) fn primitive(&self, place: u32) -> u32 {
        let index = (place & !CURVED) as usize;
        match place & CURVED {
            0 => self.blocks[index / LANES].primitive(index % LANES),
            _ => self.curved[index].primitive,
        }
    }

    /// Shows every hit at positive distance to `visit`, roughly in order, until it returns `None`; what it returns
    /// bounds the distances that still matter. Of an instance it shows the hit that `search` finds.
    #[inline(always)]
    fn walk(&self, line: &Line, end: f64, search: Search, mut visit: impl FnMut(Hit) -> Option<f64>) {
        if self.nodes.is_empty() {
            return;
        }
        let slabs = SlabRay::new(line);
        let sheared = ShearedRay::new(line, self.reach);
        let mut limit = box_limit(end);
        let mut stack = Stack::new();
        let mut next = Some(Child::ROOT);
        while let Some(child) = next {
            match child.target() {
                Target::Node(index) => {
                    let node = &self.nodes[index];
                    let (entry, mask) = slabs.enter(node, limit);
                    if mask != 0 {
                        next = Some(stack.push_farther(node, &entry, mask));
                        continue;
                    }
                }
                Target::Triangles(index) => {
                    let block = &self.blocks[index];
                    let mut mask = block.candidates(&sheared);
                    while mask != 0 {
                        let lane = mask.trailing_zeros() as usize % LANES;
                        mask &= mask - 1;
                        let Some(hit) = block.intersect(lane, &sheared).filter(|hit| hit.t > 0.0) else {
                            continue;
                        };
                        let place = (index * LANES + lane) as u32;
                        let TriangleHit { t, barycentric } = hit;
                        match visit(Hit {
                            t,
                            barycentric,
                            primitive: block.primitive(lane),
                            place,
                        }) {
                            Some(t) => limit = box_limit(t),
                            None => return,
                        }
                    }
                }
                Target::Curved(index) => {
                    let leaf = &self.curved[index];
                    let hit = match &leaf.curved {
                        Curved::Instance(placed) => match search {
                            Search::Nearest => placed.nearest(line, f64::from(limit)),
                            Search::Any => placed.any(line, end).then_some(Hit::SOMEWHERE),
                        },
                        curved => curved.intersect(line).map(|t| Hit {
                            t,
                            barycentric: [0.0; 2],
                            primitive: leaf.primitive,
                            place: index as u32 | CURVED,
                        }),
                    };
                    if let Some(hit) = hit {
                        let primitive = leaf.primitive;
                        match visit(Hit { primitive, ..hit }) {
                            Some(t) => limit = box_limit(t),
                            None => return,
                        }
                    }
                }
            }
            next = stack.pop(limit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stack_that_overflows_keeps_its_order() {
        let mut stack = Stack::new();
        let count = 3 * STACK;
        (0..count).for_each(|i| stack.push((i as f32, Child::node(i))));
        for i in (0..count).rev() {
            let limit = if i == count - 10 { (i - 1) as f32 } else { f32::INFINITY };
            if limit.is_finite() {
                assert_eq!(
                    stack.pop(limit),
                    Some(Child::node(i - 1)),
                    "the entry beyond the limit is dropped"
                );
                stack.push(((i - 1) as f32, Child::node(i - 1)));
                continue;
            }
            assert_eq!(stack.pop(limit), Some(Child::node(i)));
        }
        assert_eq!(stack.pop(f32::INFINITY), None);
    }
}

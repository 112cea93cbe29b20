//! Walks through the hierarchy.
//!
//! A child is entered unless its box lies strictly beyond the nearest hit so far, with a margin for the rounding of
//! the box test (Ize 2013), and hits are compared in double precision, then by primitive index. So the nearest hit
//! does not depend on the shape of the hierarchy.

use super::Ray;
use super::hierarchy::{Child, Hierarchy, Lanes, Node, Target, WIDTH};
use super::triangle::ShearedRay;

/// A hit of some primitive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Distance along the ray.
    pub(super) t: f64,
    /// Barycentric coordinates of the second and third vertex; zero for curved primitives.
    pub(super) barycentric: [f64; 2],
    /// Primitive index.
    pub(super) primitive: u32,
}

/// A direction component no smaller than this keeps slab distances finite, or infinite but never NaN.
const SMALLEST_COMPONENT: f32 = 1e-30;
/// Covers the rounding of a slab distance: three operations at each end.
const SLAB_MARGIN: f32 = 1.0 + 4.0 * f32::EPSILON;
/// Entries of the stack before it moves to the heap.
const STACK: usize = 96;

/// What the box test needs of a ray.
struct SlabRay {
    origin: [Lanes; 3],
    inverse: [Lanes; 3],
    /// 1 where the direction is negative: the upper side is met first.
    near: [usize; 3],
}

impl SlabRay {
    fn new(ray: &Ray) -> Self {
        let direction = ray
            .direction
            .to_array()
            .map(|d| d.abs().max(SMALLEST_COMPONENT).copysign(d));
        Self {
            origin: ray.origin.to_array().map(Lanes::splat),
            inverse: direction.map(|d| Lanes::splat(1.0 / d)),
            near: direction.map(|d| usize::from(d < 0.0)),
        }
    }

    /// Distances at which the ray enters the children, and a bit for each child that it meets before `limit`.
    #[inline]
    fn enter(&self, node: &Node, limit: f32) -> ([f32; WIDTH], u32) {
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
    entries: [(f32, Child); STACK],
    len: usize,
    overflow: Vec<(f32, Child)>,
}

impl Stack {
    fn new(root: Child) -> Self {
        Self {
            entries: [(0.0, root); STACK],
            len: 1,
            overflow: Vec::new(),
        }
    }

    #[inline]
    fn push(&mut self, entry: (f32, Child)) {
        if let Some(slot) = self.entries.get_mut(self.len) {
            *slot = entry;
            self.len += 1;
        } else {
            self.overflow.push(entry);
        }
    }

    #[inline]
    fn pop(&mut self) -> Option<(f32, Child)> {
        if !self.overflow.is_empty() {
            return self.overflow.pop();
        }
        self.len = self.len.checked_sub(1)?;
        Some(self.entries[self.len])
    }

    /// Pushes the children of `mask` so that the nearest is popped first.
    #[inline]
    fn push_sorted(&mut self, node: &Node, entry: &[f32; WIDTH], mut mask: u32) {
        let mut hits = [(0.0, Child::ROOT); WIDTH];
        let mut count = 0;
        while mask != 0 {
            let slot = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            let hit = (entry[slot], node.children[slot]);
            let mut place = count;
            while place > 0 && hits[place - 1].0 < hit.0 {
                hits[place] = hits[place - 1];
                place -= 1;
            }
            hits[place] = hit;
            count += 1;
        }
        for hit in &hits[..count] {
            self.push(*hit);
        }
    }
}

/// An upper bound, in single precision, of the box distances that may hold a hit nearer than `t`.
fn box_limit(t: f64) -> f32 {
    (t as f32) * (1.0 + 8.0 * f32::EPSILON)
}

impl Hierarchy {
    /// The nearest hit before the ray's end; of equally near ones that of the lowest primitive index.
    pub(super) fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let mut best = Hit {
            t: f64::from(ray.max_distance),
            barycentric: [0.0; 2],
            primitive: u32::MAX,
        };
        self.walk(ray, |hit| {
            if hit.t < best.t || (hit.t == best.t && hit.primitive < best.primitive && best.primitive != u32::MAX) {
                best = hit;
            }
            Some(best.t)
        });
        (best.primitive != u32::MAX).then_some(best)
    }

    /// Whether there is any hit before the ray's end.
    pub(super) fn any(&self, ray: &Ray) -> bool {
        let end = f64::from(ray.max_distance);
        let mut found = false;
        self.walk(ray, |hit| {
            found = hit.t < end;
            (!found).then_some(end)
        });
        found
    }

    /// Shows every hit at positive distance to `visit`, roughly in order, until it returns `None`; what it returns
    /// bounds the distances that still matter.
    #[inline(always)]
    fn walk(&self, ray: &Ray, mut visit: impl FnMut(Hit) -> Option<f64>) {
        if self.nodes.is_empty() {
            return;
        }
        let slabs = SlabRay::new(ray);
        let sheared = ShearedRay::new(ray, self.reach);
        let mut limit = box_limit(f64::from(ray.max_distance));
        let mut stack = Stack::new(Child::ROOT);
        while let Some((entry, child)) = stack.pop() {
            if entry > limit {
                continue;
            }
            match child.target() {
                Target::Node(index) => {
                    let node = &self.nodes[index];
                    let (entry, mask) = slabs.enter(node, limit);
                    stack.push_sorted(node, &entry, mask);
                }
                Target::Triangles(index) => {
                    let block = &self.blocks[index];
                    let mut mask = block.candidates(&sheared);
                    while mask != 0 {
                        let lane = mask.trailing_zeros() as usize;
                        mask &= mask - 1;
                        let Some(hit) = block.intersect(lane, &sheared).filter(|hit| hit.t > 0.0) else {
                            continue;
                        };
                        let primitive = block.primitive(lane);
                        match visit(Hit {
                            t: hit.t,
                            barycentric: hit.barycentric,
                            primitive,
                        }) {
                            Some(t) => limit = box_limit(t),
                            None => return,
                        }
                    }
                }
                Target::Curved(index) => {
                    let (primitive, curved) = &self.curved[index];
                    if let Some(t) = curved.intersect(ray) {
                        match visit(Hit {
                            t,
                            barycentric: [0.0; 2],
                            primitive: *primitive,
                        }) {
                            Some(t) => limit = box_limit(t),
                            None => return,
                        }
                    }
                }
            }
        }
    }
}

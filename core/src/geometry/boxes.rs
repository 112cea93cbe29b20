//! A hierarchy of boxes, all of which a ray visits: for what is found along a ray and hides nothing behind it.

use super::hierarchy::{Child, Node, Target, WIDTH, expand};
use super::traversal::SlabRay;
use super::{Line, Ray};
use crate::math::Vec3;
use obvhs::aabb::Aabb;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// Boxes that are numbered in an order in which those that lie close to each other follow each other.
#[derive(Clone, Debug, Default)]
pub(crate) struct BoxTree {
    /// The root is the first. Empty if there is no box.
    nodes: Vec<Node>,
}

impl BoxTree {
    /// Most boxes.
    pub(crate) const MOST: usize = 1 << 29;

    /// Builds the hierarchy of some boxes, lower and upper corners, and tells the places in `boxes` of those that are numbered 0, 1, ....
    /// The result depends on the boxes alone.
    ///
    /// # Panics
    /// If there are more than [`Self::MOST`].
    pub(crate) fn build(boxes: &[(Vec3, Vec3)]) -> (Self, Vec<u32>) {
        assert!(boxes.len() <= Self::MOST, "{} boxes: the limit is 2^29", boxes.len());
        let mut tree = Self::default();
        let mut order = Vec::with_capacity(boxes.len());
        if boxes.is_empty() {
            return (tree, order);
        }
        let aabbs: Vec<Aabb> = boxes
            .iter()
            .map(|(lower, upper)| Aabb {
                min: lower.to_array().into(),
                max: upper.to_array().into(),
            })
            .collect();
        let indices = (0..boxes.len() as u32).collect();
        let binary = PlocBuilder::new().build(PlocSearchDistance::Low, &aabbs, indices, SortPrecision::U64, 2);
        let mut stack = vec![(tree.reserve(), vec![0])];
        while let Some((index, members)) = stack.pop() {
            let members = expand(&binary, members, |member| binary.nodes[member].is_leaf());
            for (slot, member) in members.into_iter().enumerate() {
                let node = &binary.nodes[member];
                let first = node.first_index as usize;
                let child = if node.is_leaf() {
                    order.push(first as u32);
                    Child::curved(order.len() - 1)
                } else {
                    let child = tree.reserve();
                    stack.push((child, vec![first, first + 1]));
                    Child::node(child)
                };
                tree.nodes[index].set(slot, child, node.aabb());
            }
        }
        (tree, order)
    }

    fn reserve(&mut self) -> usize {
        self.nodes.push(Node::empty());
        self.nodes.len() - 1
    }

    /// Calls `visit` with the number of every box that the ray meets, and perhaps of others close to it, in an order that depends on the boxes and
    /// the ray alone. A ray of length 0 meets the boxes about its origin.
    pub(crate) fn visit(&self, ray: &Ray, mut visit: impl FnMut(usize)) {
        if self.nodes.is_empty() {
            return;
        }
        let slabs = SlabRay::new(&Line::of(ray));
        let mut stack = Vec::with_capacity(8 * WIDTH);
        stack.push(0);
        while let Some(index) = stack.pop() {
            let node: &Node = &self.nodes[index];
            let (_, mut mask) = slabs.enter(node, ray.max_distance);
            while mask != 0 {
                let slot = mask.trailing_zeros() as usize % WIDTH;
                mask &= mask - 1;
                match node.children[slot].target() {
                    Target::Node(child) => stack.push(child),
                    Target::Curved(number) | Target::Triangles(number) => visit(number),
                }
            }
        }
    }
}

impl Node {
    /// Sets a child and its box, which is made larger by what single precision rounds off a ray's origin.
    fn set(&mut self, slot: usize, child: Child, aabb: &Aabb) {
        self.children[slot] = child;
        for axis in 0..3 {
            let (lower, upper) = (aabb.min[axis], aabb.max[axis]);
            let margin = lower.abs().max(upper.abs()) * f32::EPSILON;
            self.bounds[axis][0].as_mut_array()[slot] = lower - margin;
            self.bounds[axis][1].as_mut_array()[slot] = upper + margin;
        }
    }
}

//! The bounding volume hierarchy: built as a binary tree by obvhs, then widened.

use super::Shape;
use super::curved::{self, Curved};
use super::triangle::{LANES, TriangleBlock};
use crate::math::Vec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use std::ops::Range;

/// Children of a node.
pub(super) const WIDTH: usize = 8;
/// One value per child.
pub(super) type Lanes = wide::f32x8;

/// What a node's slot refers to, in 32 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Child(u32);

/// [`Child`], unpacked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Target {
    /// Index of a node.
    Node(usize),
    /// Index of a triangle block.
    Triangles(usize),
    /// Index of a curved primitive.
    Curved(usize),
}

impl Child {
    /// The first node.
    pub(super) const ROOT: Self = Self(0);
    const EMPTY: Self = Self(u32::MAX);
    const LEAF: u32 = 1 << 31;
    const CURVED: u32 = 1 << 30;

    pub(super) fn node(index: usize) -> Self {
        Self(index as u32)
    }
    fn triangles(index: usize) -> Self {
        Self(index as u32 | Self::LEAF)
    }
    pub(super) fn curved(index: usize) -> Self {
        Self(index as u32 | Self::LEAF | Self::CURVED)
    }
    #[inline]
    pub(super) fn target(self) -> Target {
        let index = (self.0 & (Self::CURVED - 1)) as usize;
        if self.0 & Self::LEAF == 0 {
            Target::Node(index)
        } else if self.0 & Self::CURVED == 0 {
            Target::Triangles(index)
        } else {
            Target::Curved(index)
        }
    }
}

/// An inner node: the bounds of its children, by axis and by side (lower, upper). Bounds of empty slots are inside out.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Node {
    pub(super) bounds: [[Lanes; 2]; 3],
    pub(super) children: [Child; WIDTH],
}

impl Node {
    /// A node without children.
    pub(super) fn empty() -> Self {
        let inside_out = [Lanes::splat(f32::INFINITY), Lanes::splat(f32::NEG_INFINITY)];
        Self {
            bounds: [inside_out; 3],
            children: [Child::EMPTY; WIDTH],
        }
    }
}

/// The hierarchy over all primitives of a scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Hierarchy {
    /// Inner nodes; the root is the first, and children follow their parents. Empty if there is nothing to hit.
    pub(super) nodes: Vec<Node>,
    pub(super) blocks: Vec<TriangleBlock>,
    pub(super) curved: Vec<CurvedLeaf>,
    /// Bounds of everything.
    pub(super) bounds: (Vec3, Vec3),
    /// The largest absolute value of a coordinate of the bounds.
    pub(super) reach: f32,
    /// The part of `reach` by which boxes of nodes are larger than what they hold.
    margin: f32,
}

/// The margin for rays whose origins have single precision: a ray within the plane of a box's side must not miss the box.
pub(super) const EXACT_ORIGINS: f32 = f32::EPSILON;
/// The margin for lines whose origins are rounded to single precision for the tests of boxes.
pub(super) const ROUNDED_ORIGINS: f32 = 2.0 * f32::EPSILON;

/// A primitive that is not a triangle.
#[derive(Clone, Debug)]
pub(super) struct CurvedLeaf {
    pub(super) primitive: u32,
    pub(super) curved: Curved,
    bounds: (Vec3, Vec3),
}

/// A primitive that can be hit.
struct Leaf {
    primitive: u32,
    bounds: (Vec3, Vec3),
    kind: LeafKind,
}

enum LeafKind {
    Triangle([Vec3; 3]),
    Curved(Curved),
}

impl Hierarchy {
    /// Builds the hierarchy of `shapes`, whose primitives are numbered in order. Triangles without area are left out.
    ///
    /// `margin` is [`EXACT_ORIGINS`] or [`ROUNDED_ORIGINS`]. The smaller one is worth having: rays that leave a wall begin outside its box.
    pub(super) fn build(shapes: &[Shape], margin: f32) -> Self {
        let leaves = collect_leaves(shapes);
        if leaves.is_empty() {
            return Self::default();
        }
        let boxes: Vec<Aabb> = leaves
            .iter()
            .map(|leaf| Aabb {
                min: leaf.bounds.0.to_array().into(),
                max: leaf.bounds.1.to_array().into(),
            })
            .collect();
        let indices = (0..boxes.len() as u32).collect();
        let mut binary = PlocBuilder::new().build(PlocSearchDistance::Medium, &boxes, indices, SortPrecision::U64, 3);
        ReinsertionOptimizer::default().run(&mut binary, 0.1, None);
        let mut hierarchy = Self {
            margin,
            ..Self::default()
        };
        Widening {
            sizes: leaf_sizes(&binary, &leaves),
            binary,
            leaves,
            hierarchy: &mut hierarchy,
        }
        .run();
        hierarchy.fit();
        hierarchy
    }

    /// Takes up the new shapes of some ranges of primitives, in order, and fits the bounds. The structure stays.
    pub(super) fn refit(&mut self, renewed: &[(Range<u32>, &Shape)]) {
        let find = |primitive: u32| {
            let (range, shape) = renewed.get(renewed.partition_point(|(range, _)| range.end <= primitive))?;
            range.contains(&primitive).then(|| (primitive - range.start, *shape))
        };
        for block in &mut self.blocks {
            for lane in 0..LANES {
                if let Some((triangle, Shape::Mesh(mesh))) = find(block.primitive(lane)) {
                    let corners = mesh.triangles[triangle as usize].map(|i| mesh.positions[i as usize]);
                    block.set(lane, Some(corners).filter(|corners| has_area(*corners)));
                }
            }
        }
        for leaf in &mut self.curved {
            if let Some((_, shape)) = find(leaf.primitive)
                && let (Some(curved), Some(bounds)) = (Curved::new(shape), curved::bounds(shape))
            {
                (leaf.curved, leaf.bounds) = (curved, bounds);
            }
        }
        self.fit();
    }

    /// Computes all bounds from the primitives up.
    fn fit(&mut self) {
        const INSIDE_OUT: (Vec3, Vec3) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let mut of_nodes = vec![INSIDE_OUT; self.nodes.len()];
        for index in (0..self.nodes.len()).rev() {
            let node = &mut self.nodes[index];
            for slot in 0..WIDTH {
                if node.children[slot] == Child::EMPTY {
                    continue;
                }
                let (lower, upper) = match node.children[slot].target() {
                    Target::Node(child) => of_nodes[child],
                    Target::Triangles(block) => self.blocks[block].bounds(),
                    Target::Curved(leaf) => self.curved[leaf].bounds,
                };
                for axis in 0..3 {
                    node.bounds[axis][0].as_mut_array()[slot] = lower[axis];
                    node.bounds[axis][1].as_mut_array()[slot] = upper[axis];
                }
                let whole = &mut of_nodes[index];
                *whole = (whole.0.min(lower), whole.1.max(upper));
            }
        }
        self.bounds = match of_nodes.first() {
            Some(bounds) if *bounds != INSIDE_OUT => *bounds,
            _ => (Vec3::ZERO, Vec3::ZERO),
        };
        self.reach = self.bounds.0.abs().max(self.bounds.1.abs()).max_element();
        let margin = Lanes::splat(self.reach * self.margin);
        for [lower, upper] in self.nodes.iter_mut().flat_map(|node| &mut node.bounds) {
            *lower -= margin;
            *upper += margin;
        }
    }
}

fn collect_leaves(shapes: &[Shape]) -> Vec<Leaf> {
    let mut leaves = Vec::new();
    let mut primitive = 0;
    for shape in shapes {
        if let Shape::Mesh(mesh) = shape {
            for triangle in &mesh.triangles {
                let corners = triangle.map(|i| mesh.positions[i as usize]);
                if has_area(corners) {
                    let bounds = (
                        corners[0].min(corners[1]).min(corners[2]),
                        corners[0].max(corners[1]).max(corners[2]),
                    );
                    leaves.push(Leaf {
                        primitive,
                        bounds,
                        kind: LeafKind::Triangle(corners),
                    });
                }
                primitive += 1;
            }
        } else if let (Some(curved), Some(bounds)) = (Curved::new(shape), curved::bounds(shape)) {
            leaves.push(Leaf {
                primitive,
                bounds,
                kind: LeafKind::Curved(curved),
            });
            primitive += 1;
        }
    }
    leaves
}

fn has_area(corners: [Vec3; 3]) -> bool {
    let [a, b, c] = corners.map(|p| p.as_dvec3());
    let normal = (b - a).cross(c - a);
    normal.is_finite() && normal.length_squared() > 0.0
}

/// For each node of the binary tree, the triangles under it, or more than [`LANES`] where they cannot share a block.
fn leaf_sizes(binary: &Bvh2, leaves: &[Leaf]) -> Vec<usize> {
    let mut sizes = vec![0; binary.nodes.len()];
    let mut stack = vec![(0, false)];
    while let Some((index, children_done)) = stack.pop() {
        let node = &binary.nodes[index];
        let first = node.first_index as usize;
        if node.is_leaf() {
            let is_triangle = matches!(leaves[first].kind, LeafKind::Triangle(_));
            sizes[index] = if is_triangle { 1 } else { LANES + 1 };
        } else if children_done {
            sizes[index] = (sizes[first] + sizes[first + 1]).min(LANES + 1);
        } else {
            stack.extend([(index, true), (first, false), (first + 1, false)]);
        }
    }
    sizes
}

/// Puts the children of the largest member in its place until the members fill a node or all are leaves.
pub(super) fn expand(binary: &Bvh2, mut members: Vec<usize>, is_leaf: impl Fn(usize) -> bool) -> Vec<usize> {
    while members.len() < WIDTH {
        let area = |&slot: &usize| binary.nodes[members[slot]].aabb().half_area();
        let inner = (0..members.len()).filter(|&slot| !is_leaf(members[slot]));
        let Some(largest) = inner.max_by(|a, b| area(a).total_cmp(&area(b))) else {
            break;
        };
        let first = binary.nodes[members[largest]].first_index as usize;
        members.splice(largest..=largest, [first, first + 1]);
    }
    members
}

/// Turns the binary tree into wide nodes and blocks: a subtree that fits a block becomes one, and a node takes in the
/// descendants of largest area until it is full (Wald, Benthin and Boulos 2008).
struct Widening<'a> {
    binary: Bvh2,
    leaves: Vec<Leaf>,
    sizes: Vec<usize>,
    hierarchy: &'a mut Hierarchy,
}

impl Widening<'_> {
    fn run(mut self) {
        let root = self.reserve(vec![0]);
        let mut stack = vec![root];
        while let Some((index, members)) = stack.pop() {
            let members = expand(&self.binary, members, |member| self.is_leaf(member));
            for (slot, member) in members.into_iter().enumerate() {
                let child = match self.leaf(member) {
                    Some(leaf) => leaf,
                    None => {
                        let first = self.binary.nodes[member].first_index as usize;
                        let work = self.reserve(vec![first, first + 1]);
                        let child = Child::node(work.0);
                        stack.push(work);
                        child
                    }
                };
                self.hierarchy.nodes[index].children[slot] = child;
            }
        }
    }

    fn reserve(&mut self, members: Vec<usize>) -> (usize, Vec<usize>) {
        self.hierarchy.nodes.push(Node::empty());
        (self.hierarchy.nodes.len() - 1, members)
    }

    fn is_leaf(&self, member: usize) -> bool {
        self.sizes[member] <= LANES || self.binary.nodes[member].is_leaf()
    }

    fn leaf(&mut self, member: usize) -> Option<Child> {
        if !self.is_leaf(member) {
            return None;
        }
        let mut triangles = Vec::with_capacity(LANES);
        let mut stack = vec![member];
        while let Some(index) = stack.pop() {
            let node = &self.binary.nodes[index];
            let first = node.first_index as usize;
            if !node.is_leaf() {
                stack.extend([first + 1, first]);
                continue;
            }
            let leaf = &self.leaves[first];
            match &leaf.kind {
                LeafKind::Triangle(corners) => triangles.push((leaf.primitive, *corners)),
                LeafKind::Curved(curved) => {
                    self.hierarchy.curved.push(CurvedLeaf {
                        primitive: leaf.primitive,
                        curved: curved.clone(),
                        bounds: leaf.bounds,
                    });
                    return Some(Child::curved(self.hierarchy.curved.len() - 1));
                }
            }
        }
        self.hierarchy.blocks.push(TriangleBlock::new(&triangles));
        Some(Child::triangles(self.hierarchy.blocks.len() - 1))
    }
}

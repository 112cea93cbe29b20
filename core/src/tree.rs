//! The reduction tree: sums whose bits do not depend on who made them, or when.
//!
//! A node is always its left child plus its right child, so each node has one value, whichever of its descendants were
//! at hand. The sum of all nodes at hand adds the maximal ones, left to right.

use crate::film::{FilmError, Image, Node, Total};

/// Nodes from left to right, siblings merged as they come: only maximal nodes are held.
#[derive(Debug, Default)]
pub struct Forest {
    nodes: Vec<Node>,
}

impl Forest {
    /// Adds a node that lies to the right of every node before it.
    ///
    /// # Errors
    /// Another image size, or a node that is not to the right.
    pub fn push(&mut self, mut node: Node) -> Result<(), FilmError> {
        if let Some(last) = self.nodes.last()
            && first_leaf(&node) < end_leaf(last)
        {
            return Err(not_siblings(last, &node));
        }
        while let Some(left) = self.nodes.pop_if(|left| are_siblings(left, &node)) {
            node = left.merge(&node)?;
        }
        self.nodes.push(node);
        Ok(())
    }

    /// The maximal nodes from left to right.
    #[must_use]
    pub fn into_nodes(self) -> Vec<Node> {
        self.nodes
    }
}

/// The average over nodes, in memory for one sum and for the maximal nodes of a stretch without gaps.
#[derive(Debug, Default)]
pub struct Average {
    stretch: Forest,
    total: Option<Total>,
}

impl Average {
    /// Adds a node that lies to the right of every node before it.
    ///
    /// # Errors
    /// Another image size, or a node that is not to the right.
    pub fn push(&mut self, node: Node) -> Result<(), FilmError> {
        if let Some(last) = self.stretch.nodes.last()
            && end_leaf(last) < first_leaf(&node)
        {
            self.close_stretch()?;
        }
        self.stretch.push(node)
    }

    /// The average: that of [`Image::average`] over the maximal nodes.
    ///
    /// # Errors
    /// No nodes.
    pub fn finish(mut self) -> Result<Image, FilmError> {
        self.close_stretch()?;
        let total = self
            .total
            .ok_or_else(|| FilmError::Size("no nodes to average".into()))?;
        Ok(total.into_image())
    }

    fn close_stretch(&mut self) -> Result<(), FilmError> {
        for node in std::mem::take(&mut self.stretch).into_nodes() {
            match &mut self.total {
                Some(total) => total.add(&node)?,
                None => self.total = Some(Total::new(node)),
            }
        }
        Ok(())
    }
}

fn first_leaf(node: &Node) -> u64 {
    u64::from(node.index) << node.level
}

fn end_leaf(node: &Node) -> u64 {
    (u64::from(node.index) + 1) << node.level
}

fn are_siblings(left: &Node, right: &Node) -> bool {
    left.level == right.level && left.index.is_multiple_of(2) && right.index == left.index + 1
}

fn not_siblings(left: &Node, right: &Node) -> FilmError {
    FilmError::NotSiblings {
        left_level: left.level,
        left_index: left.index,
        right_level: right.level,
        right_index: right.index,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spectrum::Spectrum;

    /// Values whose sum depends on the order of additions.
    fn leaf(index: u32) -> Node {
        let value = |pixel: u32| ((index * 7919 + pixel * 104_729) % 1000) as f32 * 0.1 + 1e-4 / (index + 1) as f32;
        let pixels: Vec<Spectrum> = (0..6)
            .map(|pixel| Spectrum::from_rgb([value(pixel), value(pixel + 6), value(pixel + 12)]))
            .collect();
        Node::leaf(index, 3, 2, &pixels).unwrap()
    }

    /// The definition: left child plus right child, down to the leaves.
    fn node(level: u32, index: u32) -> Node {
        if level == 0 {
            return leaf(index);
        }
        node(level - 1, 2 * index)
            .merge(&node(level - 1, 2 * index + 1))
            .unwrap()
    }

    fn maximal_nodes(leaves: u32) -> Vec<Node> {
        let levels = (0..u32::BITS).rev().filter(|level| leaves >> level & 1 == 1);
        let mut first = 0;
        levels
            .map(|level| {
                let node = node(level, first >> level);
                first += 1 << level;
                node
            })
            .collect()
    }

    #[test]
    fn leaves_in_order_give_the_maximal_nodes() {
        for leaves in 1..=33 {
            let mut forest = Forest::default();
            (0..leaves).for_each(|index| forest.push(leaf(index)).unwrap());
            assert_eq!(forest.into_nodes(), maximal_nodes(leaves), "{leaves} leaves");
        }
    }

    #[test]
    fn the_average_does_not_depend_on_the_nodes_at_hand() {
        for leaves in 1..=33u32 {
            let expected = Image::average(&maximal_nodes(leaves)).unwrap();
            for level in 0..4 {
                let mut average = Average::default();
                let whole = leaves >> level;
                (0..whole).for_each(|index| average.push(node(level, index)).unwrap());
                (whole << level..leaves).for_each(|index| average.push(leaf(index)).unwrap());
                assert_eq!(average.finish().unwrap(), expected, "{leaves} leaves, level {level}");
            }
        }
    }

    #[test]
    fn gaps_are_left_out() {
        let mut average = Average::default();
        let nodes = [node(1, 0), leaf(3), node(2, 1), leaf(9)];
        nodes.iter().for_each(|node| average.push(node.clone()).unwrap());
        let image = average.finish().unwrap();
        assert_eq!(image, Image::average(&nodes).unwrap());
        assert_eq!(image.iterations, 8);
    }

    #[test]
    fn a_leaf_never_counts_twice() {
        for nodes in [[leaf(1), leaf(1)], [node(1, 0), leaf(1)], [leaf(5), leaf(4)]] {
            let mut average = Average::default();
            let [first, second] = nodes;
            average.push(first).unwrap();
            assert!(matches!(average.push(second), Err(FilmError::NotSiblings { .. })));
        }
    }

    #[test]
    fn nothing_has_no_average() {
        assert!(Average::default().finish().is_err());
    }
}

//! The nodes of the scene and where they stand, at a time and while the shutter is open.

use super::animation::{Animations, Property, quaternion};
use super::document::{Document, Node};
use crate::math::{AnimatedTransform, Transform};
use crate::scene::description::Value;
use crate::scene::error::{Place, SceneError, shortened};
use glam::{DMat4, DVec3};

/// Moments within the shutter interval at which moving nodes are placed; between them their parts are interpolated.
const MOMENTS: usize = 9;

/// When the scene is seen \[s\].
#[derive(Clone, Copy, Debug)]
pub(super) struct Timing {
    pub(super) time: f64,
    /// How long the shutter is open, around `time`.
    pub(super) shutter: f64,
}

impl Timing {
    /// When the shutter opens and closes.
    pub(super) fn interval(&self) -> [f64; 2] {
        [self.time - 0.5 * self.shutter, self.time + 0.5 * self.shutter]
    }
}

/// The nodes of a scene, each after its parent.
pub(super) struct Tree {
    /// Those that the scene shows.
    pub(super) shown: Vec<usize>,
    /// To the world by node, at the time; `None` where a node hangs in no tree.
    worlds: Vec<Option<DMat4>>,
    /// The same at moments while the shutter is open, where something moves.
    moments: Vec<(f64, Vec<Option<DMat4>>)>,
}

impl Tree {
    pub(super) fn new(
        document: &Document,
        animations: &Animations,
        timing: &Timing,
        place: &Place,
    ) -> Result<Self, SceneError> {
        let order = order(document, place)?;
        for (index, node) in document.nodes.iter().enumerate() {
            let affine = node
                .matrix
                .is_none_or(|m| [m[3], m[7], m[11], m[15]] == [0.0, 0.0, 0.0, 1.0]);
            if !affine {
                let reason = "the last row must be 0, 0, 0, 1";
                return Err(SceneError::value(place, format!("nodes[{index}].matrix"), reason));
            }
        }
        let worlds = |time: f64| {
            let mut worlds: Vec<Option<DMat4>> = vec![None; document.nodes.len()];
            for (node, parent, _) in &order {
                let own = local(&document.nodes[*node], *node, animations, time);
                worlds[*node] = match parent {
                    Some(parent) => worlds[*parent].map(|parent| parent * own),
                    None => Some(own),
                };
            }
            worlds
        };
        let mut moments = Vec::new();
        if timing.shutter > 0.0 && !animations.is_empty() {
            let [open, close] = timing.interval();
            for i in 0..MOMENTS {
                let time = open + (close - open) * i as f64 / (MOMENTS - 1) as f64;
                moments.push((time, worlds(time)));
            }
        }
        Ok(Self {
            shown: order
                .iter()
                .filter(|(_, _, shown)| *shown)
                .map(|(node, _, _)| *node)
                .collect(),
            worlds: worlds(timing.time),
            moments,
        })
    }

    /// From a node's space to the world, at the time.
    pub(super) fn world(&self, node: usize) -> Option<DMat4> {
        self.worlds.get(node).copied().flatten()
    }

    /// The `to_world` of something at a node, whose map `change` makes of the node's. `None` where the node has no inverse at some moment.
    pub(super) fn placement(&self, node: usize, change: impl Fn(DMat4) -> Option<DMat4>) -> Option<Value> {
        let at = |world: Option<DMat4>| world.and_then(&change).and_then(Transform::from_matrix);
        let still = at(self.world(node))?;
        let moments: Option<Vec<(f64, Transform)>> = self
            .moments
            .iter()
            .map(|(time, worlds)| Some((*time, at(worlds[node])?)))
            .collect();
        let moving = moments.filter(|moments| moments.iter().any(|(_, map)| map.matrix() != still.matrix()));
        match moving.and_then(AnimatedTransform::new) {
            Some(animation) => Some(Value::Animation(animation)),
            None => Some(Value::Transform(Box::new(still))),
        }
    }
}

/// Nodes after their parents, with these and with whether the scene shows them. Nodes outside the scene may be joints of skins.
fn order(document: &Document, place: &Place) -> Result<Vec<(usize, Option<usize>, bool)>, SceneError> {
    let nodes = &document.nodes;
    let wrong = |field: String, reason: String| Err(SceneError::value(place, field, reason));
    let mut has_parent = vec![false; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        for child in &node.children {
            match has_parent.get_mut(*child) {
                Some(known) => *known = true,
                None => {
                    let reason = format!("there is no node {child}; the file has {}", nodes.len());
                    return wrong(format!("nodes[{index}].children"), reason);
                }
            }
        }
    }
    let orphans = (0..nodes.len()).filter(|node| !has_parent[*node]);
    let chosen = document.scene.unwrap_or(0);
    let mut roots: Vec<(usize, bool)> = match (document.scenes.get(chosen), document.scene) {
        (Some(scene), _) => scene.nodes.iter().map(|node| (*node, true)).collect(),
        (None, Some(scene)) => {
            let reason = format!("there is no scene {scene}; the file has {}", document.scenes.len());
            return wrong("scene".into(), reason);
        }
        // A file without scenes shows all that it has.
        (None, None) => orphans.clone().map(|node| (node, true)).collect(),
    };
    roots.extend(orphans.map(|node| (node, false)));
    let mut seen = vec![false; nodes.len()];
    let mut order = Vec::with_capacity(nodes.len());
    for (root, shown) in roots {
        match seen.get(root) {
            None => {
                let reason = format!("there is no node {root}; the file has {}", nodes.len());
                return wrong(format!("scenes[{chosen}].nodes"), reason);
            }
            Some(true) if !shown => continue,
            Some(_) => {}
        }
        let mut stack = vec![(root, None)];
        while let Some((node, parent)) = stack.pop() {
            if std::mem::replace(&mut seen[node], true) {
                let reason = "the node has two parents or is its own ancestor; nodes form a tree";
                return wrong(format!("nodes[{node}]"), reason.into());
            }
            order.push((node, parent, shown));
            stack.extend(nodes[node].children.iter().rev().map(|child| (*child, Some(node))));
        }
    }
    Ok(order)
}

/// From a node's space to its parent's.
fn local(node: &Node, index: usize, animations: &Animations, time: f64) -> DMat4 {
    if let Some(matrix) = &node.matrix {
        return DMat4::from_cols_array(matrix);
    }
    let vector = |property, written: Option<[f64; 3]>, default: DVec3| {
        let animated = animations.at(index, property, time);
        let animated = animated.map(|value| DVec3::from_slice(&value));
        animated.or(written.map(DVec3::from_array)).unwrap_or(default)
    };
    let rotation = animations.at(index, Property::Rotation, time);
    let rotation = rotation.or(node.rotation.map(|xyzw| xyzw.to_vec()));
    DMat4::from_scale_rotation_translation(
        vector(Property::Scale, node.scale, DVec3::ONE),
        rotation.map_or(glam::DQuat::IDENTITY, |xyzw| quaternion(&xyzw)),
        vector(Property::Translation, node.translation, DVec3::ZERO),
    )
}

/// What messages call a node.
pub(super) fn node_name(document: &Document, node: usize) -> String {
    format!("nodes[{node}] \"{}\"", shortened(&document.nodes[node].name))
}

/// The rotation and the translation of a node, turned so that what looks along -z in glTF looks along +z: cameras and lights.
pub(super) fn looking(world: DMat4) -> Option<DMat4> {
    let z = world.z_axis.truncate().try_normalize()?;
    let y = world.y_axis.truncate();
    let y = (y - z * z.dot(y)).try_normalize()?;
    let x = y.cross(z);
    Some(DMat4::from_cols(
        (-x).extend(0.0),
        y.extend(0.0),
        (-z).extend(0.0),
        world.w_axis,
    ))
}

//! Groups of shapes and their instances.

use super::Builder;
use super::shape::{check_motion, own_space};
use crate::geometry::{Shape, ShapeGroup, ShapeId};
use crate::math::AnimatedTransform;
use crate::scene::description::{Kind, ObjectId};
use crate::scene::error::SceneError;
use std::ops::Range;
use std::rc::Rc;
use std::sync::Arc;

/// What a `<shape type="shapegroup">` holds.
#[derive(Debug, Default)]
pub(super) struct BuiltGroup {
    /// The shapes that are kept once; `None` where there are none.
    shapes: Option<Arc<ShapeGroup>>,
    /// Shapes that shine: each instance has its own, since every one of them is a light of its own.
    shining: Vec<ObjectId>,
    /// The bodies among the former.
    bodies: Range<usize>,
}

impl Builder<'_, '_> {
    /// A group of shapes, which is built where an instance first places it.
    pub(super) fn shape_group(&mut self, object: ObjectId) {
        self.groups.entry(object).or_default();
    }

    /// Places a group of shapes in the scene.
    pub(super) fn instance(&mut self, object: ObjectId) -> Result<(), SceneError> {
        let reader = self.reader(object);
        let to_world = reader.animation("to_world")?.unwrap_or_default();
        let Some(child) = reader.only_child(Kind::Shape)? else {
            return Err(reader.missing("the shapegroup that it places, as <ref id=\"...\"/>"));
        };
        let plugin = &self.description.objects[child.target].plugin;
        if plugin != "shapegroup" {
            let reason = format!("it places a shape of type `{plugin}`; allowed: shapegroup");
            return Err(SceneError::value(&child.place, reader.context(), reason));
        }
        reader.finish();
        let group = self.group(child.target)?;
        self.placing = Some([object, child.target]);
        if let Some(shapes) = &group.shapes {
            self.count_shape(&reader, true)?;
            let (moving, placed) = match to_world.moves_within(self.motion.shutter) {
                true => own_space(&to_world),
                false => None,
            }
            .map_or_else(
                || (None, to_world.at(self.motion.at_rest())),
                |(to_own, motion)| (Some(motion), to_own),
            );
            let moves = moving.is_some();
            self.stand_bodies(group.bodies.clone(), &to_world.at(self.motion.at_rest()), moves);
            let shape = Shape::Instance {
                group: Arc::clone(shapes),
                to_world: placed,
            };
            match moving {
                Some(motion) => {
                    self.add_moving_shape(&reader, shape, &motion, NO_MATERIAL)?;
                }
                None => {
                    let still = AnimatedTransform::default();
                    check_motion(&reader, ShapeId(0), &shape, &still)?;
                    self.add_shape(object, shape, NO_MATERIAL);
                }
            }
        }
        for shape in &group.shining {
            let built = self.placed_shape(*shape, Some(&to_world));
            self.description.attempt(*shape, built)?;
        }
        Ok(())
    }

    /// The group that `object` describes.
    fn group(&mut self, object: ObjectId) -> Result<Rc<BuiltGroup>, SceneError> {
        if let Some(Some(group)) = self.groups.get(&object) {
            return Ok(Rc::clone(group));
        }
        let reader = self.reader(object);
        let children = reader.children(Kind::Shape);
        reader.finish();
        let outer = (std::mem::take(&mut self.shapes), std::mem::take(&mut self.bindings));
        let first_body = self.bodies.len();
        let outer_names = self.called.objects.len();
        self.within_group = true;
        let mut shining = Vec::new();
        let mut result = Ok(());
        for child in children {
            if self.shines(child.target) {
                shining.push(child.target);
                continue;
            }
            let built = self.placed_shape(child.target, None);
            result = self.description.attempt(child.target, built).map(|_| ());
            if result.is_err() {
                break;
            }
        }
        self.within_group = false;
        let shapes = std::mem::replace(&mut self.shapes, outer.0);
        let bindings = std::mem::replace(&mut self.bindings, outer.1);
        self.called.objects.truncate(outer_names);
        result?;
        if shapes.is_empty() && shining.is_empty() {
            reader.warn(reader.place(), "the group holds no shapes: its instances are left out");
        }
        let shapes = (!shapes.is_empty()).then(|| Arc::new(ShapeGroup::build(shapes, self.last_group.as_deref())));
        if let Some(shapes) = &shapes {
            self.last_group = Some(Arc::clone(shapes));
            self.group_bindings.extend(bindings);
        }
        let group = Rc::new(BuiltGroup {
            shapes,
            shining,
            bodies: first_body..self.bodies.len(),
        });
        self.groups.insert(object, Some(Rc::clone(&group)));
        Ok(group)
    }

    /// Whether a shape, or one within it, is an area light.
    fn shines(&self, object: ObjectId) -> bool {
        let mut pending = vec![object];
        let mut seen = Vec::new();
        while let Some(object) = pending.pop() {
            if seen.contains(&object) {
                continue;
            }
            seen.push(object);
            for child in &self.description.objects[object].children {
                match self.description.objects[child.target].kind {
                    Kind::Emitter => return true,
                    Kind::Shape => pending.push(child.target),
                    _ => {}
                }
            }
        }
        false
    }

    /// Warns about groups that no instance places.
    pub(super) fn check_groups(&self) {
        for (object, group) in &self.groups {
            if group.is_none() {
                let reader = self.reader(*object);
                reader.warn(
                    reader.place(),
                    "no instance places this group: it is not in the picture",
                );
            }
        }
    }
}

/// The material of an instance: it is never asked for, since each hit names a shape within the group.
const NO_MATERIAL: u32 = 0;

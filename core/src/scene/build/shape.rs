//! Shapes.

use super::{Builder, uniform_scale};
use crate::geometry::{Shape, ShapeId, ShapeSampler};
use crate::light::Light;
use crate::math::{AnimatedTransform, Transform, Vec3};
use crate::motion::MovingShape;
use crate::scene::description::{Child, Kind, ObjectId};
use crate::scene::error::{Place, SceneError, within};
use crate::scene::mesh::{self, MeshFile, RawMesh, primitives};
use crate::scene::reader::{POSITIVE, Reader};
use crate::texture::Texture;
use glam::{DMat4, DVec3};

use super::texture::Role;

const SUPPORTED: [&str; 7] = ["rectangle", "cube", "sphere", "disk", "obj", "ply", "serialized"];
/// Shapes of Mitsuba that do not exist here.
const ELSEWHERE: [&str; 10] = [
    "cylinder",
    "instance",
    "shapegroup",
    "bsplinecurve",
    "linearcurve",
    "sdfgrid",
    "merge",
    "hair",
    "heightfield",
    "ellipsoids",
];

impl Builder<'_, '_> {
    pub(super) fn shape(&mut self, object: ObjectId) -> Result<(), SceneError> {
        let reader = self.reader(object);
        let animation = reader.animation("to_world")?.unwrap_or_default();
        let moving = match animation.moves_within(self.motion.shutter) {
            true => own_space(&animation),
            false => None,
        };
        let to_world = match &moving {
            Some((to_own, _)) => *to_own,
            None => animation.at(self.motion.at_rest()),
        };
        let flip = reader.boolean("flip_normals", false)?;
        let bsdf = reader.only_child(Kind::Bsdf)?;
        let emitter = reader.only_child(Kind::Emitter)?;
        let material = match bsdf {
            Some(bsdf) => self.material(bsdf.target)?,
            None => self.default_material(),
        };
        let radiance = match emitter {
            Some(emitter) => {
                self.used_area_lights.insert(emitter.target);
                let radiance = self.area_light(&reader, emitter);
                self.description.attempt(emitter.target, radiance)?
            }
            None => None,
        };
        let shape = match reader.object.plugin.as_str() {
            "rectangle" => self.flat_primitive(&reader, primitives::rectangle(), &to_world, flip)?,
            "cube" => self.flat_primitive(&reader, primitives::cube(), &to_world, flip)?,
            "sphere" => sphere(&reader, &to_world, flip)?,
            "disk" => disk(&reader, to_world, flip)?,
            "obj" | "ply" | "serialized" => self.mesh_file(&reader, &to_world, flip)?,
            "mesh" => self.mesh(&reader, &to_world, flip)?,
            other if ELSEWHERE.contains(&other) => {
                let instead = format!("there are: {}", SUPPORTED.join(", "));
                return Err(reader.unsupported(format!("type `{other}`"), instead));
            }
            _ => return Err(reader.unknown_type(&SUPPORTED)),
        };
        let moving = moving.map(|(_, to_world)| to_world);
        let shape = match &moving {
            Some(to_world) => self.add_moving_shape(&reader, shape, to_world, material)?,
            None => self.add_shape(shape, material),
        };
        if let (Some(radiance), Some(emitter)) = (radiance, emitter) {
            let light = self.add_light(Light::Area { shape, radiance }, moving, &emitter.place);
            self.bindings[shape.0 as usize].light = Some(light);
        }
        Ok(())
    }

    /// Adds a shape that stands in a space of its own and moves in the world by `to_world`.
    fn add_moving_shape(
        &mut self,
        reader: &Reader,
        shape: Shape,
        to_world: &AnimatedTransform,
        material: u32,
    ) -> Result<ShapeId, SceneError> {
        check_motion(reader, ShapeId(self.shapes.len() as u32), &shape, to_world)?;
        let id = self.add_shape(shape.moved(&to_world.at(self.motion.at_rest())), material);
        self.motion.shapes.push(MovingShape {
            id,
            shape,
            to_world: to_world.clone(),
        });
        Ok(id)
    }

    /// The radiance of a shape's area light.
    fn area_light(&mut self, shape: &Reader, emitter: &Child) -> Result<Texture, SceneError> {
        let light = self.reader(emitter.target);
        if light.object.plugin == "directionalarea" {
            light.warn(
                &emitter.place,
                "this type does not exist yet: it is rendered as `area`, which shines to all sides",
            );
        } else if light.object.plugin != "area" {
            let reason = "the emitter of a shape must have type `area`";
            return Err(SceneError::value(&emitter.place, shape.context(), reason));
        }
        let radiance = self.colour_or_texture(&light, "radiance", Role::EMISSION, 1.0)?;
        super::light::check_sampling_weight(&light)?;
        light.finish();
        Ok(radiance)
    }

    fn flat_primitive(
        &mut self,
        reader: &Reader,
        raw: RawMesh,
        to_world: &Transform,
        flip: bool,
    ) -> Result<Shape, SceneError> {
        reader.finish();
        let mut mesh = mesh::finish(raw, to_world, false, flip).map_err(|reason| reader.wrong("to_world", reason))?;
        // The corners' normals have told the outer side; within a face they are all the same.
        mesh.normals.clear();
        self.meshes.triangles += mesh.triangles.len() as u64;
        self.meshes.vertices += mesh.positions.len() as u64;
        Ok(Shape::Mesh(mesh.into()))
    }

    /// A mesh whose triangles stand in the scene itself.
    fn mesh(&mut self, reader: &Reader, to_world: &Transform, flip: bool) -> Result<Shape, SceneError> {
        let face_normals = reader.boolean("face_normals", false)?;
        let raw = reader.mesh("mesh")?.ok_or_else(|| reader.missing("property `mesh`"))?;
        reader.finish();
        self.count(reader.place(), raw)?;
        let mesh = mesh::finish(raw.clone(), to_world, face_normals, flip)
            .map_err(|reason| SceneError::value(reader.place(), reader.context(), reason))?;
        Ok(Shape::Mesh(mesh.into()))
    }

    /// Counts a mesh among those of the scene.
    fn count(&mut self, place: &Place, raw: &RawMesh) -> Result<(), SceneError> {
        self.meshes.triangles += raw.triangles.len() as u64;
        self.meshes.vertices += raw.positions.len() as u64;
        let limits = self.loader.limits;
        within(
            place,
            "number of triangles of the scene",
            self.meshes.triangles,
            limits.triangles,
        )?;
        within(
            place,
            "number of vertices of the scene",
            self.meshes.vertices,
            limits.vertices,
        )
        .map(|_| ())
    }

    fn mesh_file(&mut self, reader: &Reader, to_world: &Transform, flip: bool) -> Result<Shape, SceneError> {
        let plugin = reader.object.plugin.as_str();
        let mut face_normals = reader.boolean("face_normals", false)?;
        let flip_v = reader.boolean("flip_tex_coords", plugin == "obj")?;
        if reader.property("max_smooth_angle").is_some() {
            let without =
                "normals are those of the file, or smooth over all edges; set `face_normals` for a faceted look";
            reader.warn_of("max_smooth_angle", without);
        }
        let index = match plugin {
            "serialized" => reader.integer("shape_index", 0..=i64::from(u32::MAX - 1))?.unwrap_or(0),
            _ => 0,
        };
        reader.property("filename");
        reader.finish();
        let file = self.file(reader)?;
        let source = MeshFile::new(&file, self.loader.limits, self.meshes);
        let read = match plugin {
            "obj" => source.obj(flip_v),
            "ply" => source.ply(flip_v),
            _ => source.serialized(index as u32, flip_v).map(|(raw, flat)| {
                face_normals |= flat;
                raw
            }),
        };
        // Of a file with many meshes, those count that are read.
        if plugin != "serialized" || read.is_err() {
            self.meshes.bytes += file.bytes.len() as u64;
        }
        let raw = read.map_err(|found| self.description.faults.all_but_last(found))?;
        self.count(&source.place, &raw)?;
        let broken = |reason| SceneError::data(&source.place, format!("{reason} (used at {})", reader.place()));
        let mesh = mesh::finish(raw, to_world, face_normals, flip).map_err(broken)?;
        Ok(Shape::Mesh(mesh.into()))
    }
}

fn sphere(reader: &Reader, to_world: &Transform, flip: bool) -> Result<Shape, SceneError> {
    let center = reader.vector("center")?.unwrap_or(DVec3::ZERO);
    let radius = reader.float_or("radius", POSITIVE, 1.0)?;
    reader.finish();
    let unit_to_world = DMat4::from_translation(center) * DMat4::from_scale(DVec3::splat(radius));
    let unit_to_world = Transform::from_matrix(unit_to_world).map(|placed| to_world.after(&placed));
    let placed = unit_to_world.ok_or_else(|| reader.wrong("radius", "the sphere is too small or too large"))?;
    let scale = uniform_scale(&placed).ok_or_else(|| reader.wrong("to_world", UNEVEN_SPHERE))?;
    let (center, radius) = (placed.point(Vec3::ZERO), scale as f32);
    check_extent(reader, center, radius)?;
    let flip_normals = flip != placed.flips_handedness();
    Ok(Shape::Sphere {
        center,
        radius,
        to_local: placed.inverted(),
        flip_normals,
    })
}

fn disk(reader: &Reader, to_world: Transform, flip: bool) -> Result<Shape, SceneError> {
    reader.finish();
    let (u, v) = (to_world.vector(Vec3::X), to_world.vector(Vec3::Y));
    check_extent(reader, to_world.point(Vec3::ZERO), u.length().max(v.length()))?;
    if u.as_dvec3().cross(v.as_dvec3()).length() < 1e-18 {
        return Err(reader.wrong("to_world", "the disc has no area"));
    }
    Ok(Shape::Disk {
        to_world,
        flip_normals: flip,
    })
}

/// The space of its own in which a moving shape is built: a map to it from the space in which the shape is written, and the motion from it
/// to the world. The map mirrors where the motion would, so that the sides of triangles are told as for a shape that stands still.
fn own_space(animation: &AnimatedTransform) -> Option<(Transform, AnimatedTransform)> {
    let mirrors = animation.keyframes().any(Transform::flips_handedness);
    let sign = if mirrors { -1.0 } else { 1.0 };
    let to_own = Transform::from_matrix(DMat4::from_scale(DVec3::new(sign, 1.0, 1.0)))?;
    let motion = animation.map(|keyframe| Some(keyframe.after(&to_own.inverted())))?;
    Some((to_own, motion))
}

/// Checks that a moving shape keeps within the largest coordinate and has an area at each keyframe; between them it has one as well.
fn check_motion(reader: &Reader, id: ShapeId, shape: &Shape, to_world: &AnimatedTransform) -> Result<(), SceneError> {
    let radius = match shape {
        Shape::Mesh(mesh) => mesh.positions.iter().map(|p| p.length()).fold(0.0, f32::max),
        Shape::Sphere { center, radius, .. } => center.length() + radius,
        Shape::Disk { .. } => 1.0,
    };
    let reach = to_world.reach(f64::from(radius));
    let limit = f64::from(mesh::LARGEST_COORDINATE);
    if reach.is_nan() || reach > limit {
        let reason =
            format!("the shape may come {reach:.1e} from the origin as it moves; coordinates reach to {limit:e}");
        return Err(reader.wrong("to_world", reason));
    }
    for keyframe in to_world.keyframes() {
        let placed = shape.moved(keyframe);
        if let Shape::Sphere { center, radius, .. } = &placed {
            if uniform_scale(keyframe).is_none() {
                return Err(reader.wrong("to_world", UNEVEN_SPHERE));
            }
            check_extent(reader, *center, *radius)?;
        }
        if ShapeSampler::of(&placed, id).area() < f32::MIN_POSITIVE {
            return Err(reader.wrong("to_world", "the shape has no area at one of the keyframes"));
        }
    }
    Ok(())
}

const UNEVEN_SPHERE: &str = "a sphere can be scaled by the same factor in all directions only";

fn check_extent(reader: &Reader, center: Vec3, reach: f32) -> Result<(), SceneError> {
    let largest = center.abs().max_element() + reach;
    let smallest = 1e-12;
    if !(largest <= mesh::LARGEST_COORDINATE && reach >= smallest) {
        let limit = mesh::LARGEST_COORDINATE;
        let reason = format!("the shape of radius {reach} about {center} is too small or reaches beyond {limit:e}");
        return Err(reader.wrong("to_world", reason));
    }
    Ok(())
}

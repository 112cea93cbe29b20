//! Shapes.

use super::{Builder, Plain, uniform_scale};
use crate::geometry::{Shape, ShapeId, ShapeSampler, TriangleMesh};
use crate::light::Light;
use crate::math::{AnimatedTransform, Frame, PI, Transform, Vec3};
use crate::medium::Boundary;
use crate::motion::MovingShape;
use crate::scene::description::{Child, Kind, ObjectId};
use crate::scene::error::{Place, SceneError, within};
use crate::scene::mesh::{self, MeshFile, RawAttribute, RawMesh, primitives};
use crate::scene::reader::{POSITIVE, Reader};
use crate::scene::spectrum::BRIGHTEST;
use crate::texture::Texture;
use glam::{DMat4, DVec3};
use std::sync::Arc;

use super::attributes::MeshAttributes;
use super::texture::{Role, scaled};

const SUPPORTED: [&str; 16] = [
    "rectangle",
    "cube",
    "sphere",
    "ellipsoid",
    "disk",
    "cylinder",
    "obj",
    "ply",
    "serialized",
    "bsplinecurve",
    "linearcurve",
    "hair",
    "heightfield",
    "shapegroup",
    "instance",
    "merge",
];
/// Shapes of Mitsuba that are left out.
const LEFT_OUT: [&str; 3] = ["sdfgrid", "ellipsoids", "ellipsoidsmesh"];

impl Builder<'_, '_> {
    /// A shape; `placed` maps it further where it belongs to an instance.
    pub(super) fn placed_shape(
        &mut self,
        object: ObjectId,
        placed: Option<&AnimatedTransform>,
    ) -> Result<(), SceneError> {
        let reader = self.reader(object);
        match reader.object.plugin.as_str() {
            "shapegroup" | "instance" if self.within_group => {
                let without = "a group holds no groups and no instances: it is left out of the picture";
                reader.warn(reader.place(), without);
                Ok(())
            }
            "shapegroup" => {
                self.shape_group(object);
                Ok(())
            }
            "instance" => {
                let built = self.instance(object);
                self.placing = None;
                built
            }
            "merge" => self.merge(&reader, object, placed),
            other if LEFT_OUT.contains(&other) => {
                reader.warn(
                    reader.place(),
                    "this type does not exist here: the shape is left out of the picture",
                );
                Ok(())
            }
            _ => self.single_shape(&reader, placed),
        }
    }

    /// The shapes within a `merge`, each for itself.
    fn merge(
        &mut self,
        reader: &Reader,
        object: ObjectId,
        placed: Option<&AnimatedTransform>,
    ) -> Result<(), SceneError> {
        if self.building.contains(&object) {
            let (place, id) = (reader.place().clone(), reader.object.plugin.clone());
            let reason = "the shape contains itself".to_owned();
            return Err(SceneError::Reference { place, id, reason });
        }
        self.building.push(object);
        let children = reader.children(Kind::Shape);
        reader.finish();
        for child in children {
            let built = self.placed_shape(child.target, placed);
            self.description.attempt(child.target, built)?;
        }
        self.building.pop();
        Ok(())
    }

    /// Counts a shape or an instance against the limit.
    pub(super) fn count_shape(&mut self, reader: &Reader, instance: bool) -> Result<(), SceneError> {
        let limit = self.loader.limits.shapes;
        let (count, what) = match instance {
            true => (&mut self.counts.instances, "number of instances"),
            false => (&mut self.counts.shapes, "number of shapes"),
        };
        *count += 1;
        within(reader.place(), what, *count, limit).map(|_| ())
    }

    /// How a shape stands in the world.
    fn placement(&self, reader: &Reader, placed: Option<&AnimatedTransform>) -> Result<AnimatedTransform, SceneError> {
        let own = reader.animation("to_world")?.unwrap_or_default();
        if placed.is_none() && !self.within_group {
            return Ok(own);
        }
        if own.moves_within(self.motion.shutter) {
            let without = "a shape of a group does not move in it: it stands as in the middle of the exposure";
            reader.warn_of("to_world", without);
        }
        let own = own.at(self.motion.at_rest());
        let placed = placed.cloned().unwrap_or_default().map(|place| Some(place.after(&own)));
        placed.ok_or_else(|| reader.wrong("to_world", "the instance's map does not go with it"))
    }

    fn single_shape(&mut self, reader: &Reader, placed: Option<&AnimatedTransform>) -> Result<(), SceneError> {
        self.count_shape(reader, false)?;
        let animation = self.placement(reader, placed)?;
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
        let boundary = self.boundary(reader)?;
        let priority = self.priority(reader)?;
        // What measures the light that arrives here is read with the scene's sensors.
        reader.children(Kind::Sensor);
        let children = [bsdf, emitter].into_iter().flatten();
        self.attributes = MeshAttributes::asked_by(self.description, children.map(|child| child.target));
        // What shows a mesh's attributes is built when the mesh is there.
        let looks = match self.attributes.is_empty() {
            true => Some(self.looks(reader, bsdf, emitter, boundary)?),
            false => None,
        };
        let shape = match reader.object.plugin.as_str() {
            "rectangle" => self.flat_primitive(reader, primitives::rectangle(), &to_world, flip)?,
            "cube" => self.flat_primitive(reader, primitives::cube(), &to_world, flip)?,
            "sphere" | "ellipsoid" => sphere(reader, &to_world, moving.as_ref().map(|(_, motion)| motion), flip)?,
            "disk" => disk(reader, to_world, flip)?,
            "cylinder" => cylinder(reader, &to_world, flip)?,
            "obj" | "ply" | "serialized" => self.mesh_file(reader, &to_world, flip)?,
            "mesh" => {
                // The shapes of a group may be built for each of its instances.
                let again = placed.is_some() || self.within_group;
                self.mesh(reader, again, &to_world, flip)?
            }
            "bsplinecurve" | "linearcurve" | "hair" => self.curves(reader, &to_world, flip)?,
            "heightfield" => self.height_field(reader, &to_world, flip)?,
            _ => return reader.other_type(&SUPPORTED, "the shape is left out of the picture"),
        };
        let (material, lamp) = match looks {
            Some(looks) => looks,
            None => self.looks(reader, bsdf, emitter, boundary)?,
        };
        self.attributes = MeshAttributes::default();
        let metered = self.metered.is_some_and(|(object, _)| reader.id == object);
        let shape = match lamp.is_some() || metered {
            true => self.with_even_area(reader, shape, moving.as_ref().map(|(_, motion)| motion))?,
            false => shape,
        };
        let moving = moving.map(|(_, to_world)| to_world);
        let moving_body = moving.is_some();
        let area = lamp.as_ref().and_then(|lamp| lamp.power).map(|_| match &moving {
            Some(to_world) => area_of(&shape.moved(&to_world.at(self.motion.at_rest()))),
            None => area_of(&shape),
        });
        let shape = match &moving {
            Some(to_world) => self.add_moving_shape(reader, shape, to_world, material)?,
            None => self.add_shape(reader.id, shape, material),
        };
        self.bound(boundary);
        if let Some(priority) = priority {
            let medium = boundary.and_then(|boundary| boundary.interior);
            self.add_body(reader, priority, medium, moving_body)?;
        }
        if metered && let Some((_, found)) = &mut self.metered {
            *found = Some(shape);
        }
        if let (Some(lamp), Some(emitter)) = (lamp, emitter) {
            let light = lamp.on(shape, area.unwrap_or(0.0));
            let light = self.add_light(light, moving, &[emitter.target, reader.id], &emitter.place);
            self.bindings[shape.0 as usize].light = Some(light);
        }
        Ok(())
    }

    /// The material of a shape, and its light.
    fn looks(
        &mut self,
        reader: &Reader,
        bsdf: Option<&Child>,
        emitter: Option<&Child>,
        boundary: Option<Boundary>,
    ) -> Result<(u32, Option<Lamp>), SceneError> {
        let material = match bsdf {
            Some(bsdf) => self.material(bsdf.target)?,
            // Mitsuba 0.6 does so, and Mitsuba 3 does not (`Shape::configure` there, `Shape::initialize` here).
            None if reader.object.old_dialect && boundary.is_some() && emitter.is_none() => {
                self.plain_material(Plain::Invisible)
            }
            None if emitter.is_some() => self.plain_material(Plain::Black),
            None => self.default_material(),
        };
        let lamp = match emitter {
            Some(emitter) => {
                self.used_area_lights.insert(emitter.target);
                let lamp = self.area_light(reader, emitter);
                self.description.attempt(emitter.target, lamp)?
            }
            None => None,
        };
        Ok((material, lamp))
    }

    /// Adds a shape that stands in a space of its own and moves in the world by `to_world`.
    pub(super) fn add_moving_shape(
        &mut self,
        reader: &Reader,
        shape: Shape,
        to_world: &AnimatedTransform,
        material: u32,
    ) -> Result<ShapeId, SceneError> {
        check_motion(reader, ShapeId(self.shapes.len() as u32), &shape, to_world)?;
        let id = self.add_shape(reader.id, shape.moved(&to_world.at(self.motion.at_rest())), material);
        self.motion.shapes.push(MovingShape {
            id,
            shape,
            to_world: to_world.clone(),
        });
        Ok(id)
    }

    /// The shape, or a mesh in its place where no points can be chosen on it uniformly by area.
    fn with_even_area(
        &mut self,
        reader: &Reader,
        shape: Shape,
        motion: Option<&AnimatedTransform>,
    ) -> Result<Shape, SceneError> {
        let is_even = |to_world: &Transform| {
            let mut keyframes = motion.into_iter().flat_map(AnimatedTransform::keyframes);
            is_even_cylinder(to_world) && keyframes.all(|keyframe| is_even_cylinder(&keyframe.after(to_world)))
        };
        let (raw, to_world, flip) = match shape {
            Shape::Ellipsoid { to_world, flip_normals } => (primitives::sphere(), to_world, flip_normals),
            Shape::Cylinder { to_world, flip_normals } if !is_even(&to_world) => {
                (primitives::cylinder(), to_world, flip_normals)
            }
            shape => return Ok(shape),
        };
        let count = raw.triangles.len();
        let message =
            format!("its map scales it unevenly: with a light or a meter on it, it is a mesh of {count} triangles");
        reader.warn_of("to_world", &message);
        self.placed_mesh(reader, raw, &to_world, flip)
            .map(|mesh| Shape::Mesh(mesh.into()))
    }

    /// A shape's area light.
    fn area_light(&mut self, shape: &Reader, emitter: &Child) -> Result<Lamp, SceneError> {
        let light = self.reader(emitter.target);
        let along_normals = light.object.plugin == "directionalarea";
        if !along_normals && light.object.plugin != "area" {
            let reason = "the emitter of a shape must have type `area`";
            return Err(SceneError::value(&emitter.place, shape.context(), reason));
        }
        let radiance = self.colour_or_texture(&light, "radiance", Role::EMISSION, 1.0)?;
        let lamp = Lamp {
            radiance,
            along_normals,
            two_sided: !along_normals && light.boolean("two_sided", false)?,
            power: match along_normals {
                true => None,
                false => light.float("power", 0.0..=BRIGHTEST)?.map(|power| power as f32),
            },
        };
        super::light::check_sampling_weight(&light)?;
        light.finish();
        Ok(lamp)
    }

    fn flat_primitive(
        &mut self,
        reader: &Reader,
        raw: RawMesh,
        to_world: &Transform,
        flip: bool,
    ) -> Result<Shape, SceneError> {
        reader.finish();
        let mut mesh = self.placed_mesh(reader, raw, to_world, flip)?;
        // The corners' normals have told the outer side; within a face they are all the same.
        mesh.normals.clear();
        Ok(Shape::Mesh(mesh.into()))
    }

    /// A mesh that no file gives, in the world.
    pub(super) fn placed_mesh(
        &mut self,
        reader: &Reader,
        raw: RawMesh,
        to_world: &Transform,
        flip: bool,
    ) -> Result<TriangleMesh, SceneError> {
        self.count(reader.place(), &raw)?;
        mesh::finish(raw, to_world, false, flip)
            .map(|(mesh, _)| mesh)
            .map_err(|reason| reader.wrong("to_world", reason))
    }

    /// A mesh whose triangles stand in the scene itself; `again` tells that it may be built more than once.
    fn mesh(&mut self, reader: &Reader, again: bool, to_world: &Transform, flip: bool) -> Result<Shape, SceneError> {
        let face_normals = reader.boolean("face_normals", false)?;
        let raw = reader.mesh("mesh")?.ok_or_else(|| reader.missing("property `mesh`"))?;
        let raw = if again { raw.get() } else { raw.take() };
        reader.finish();
        self.count(reader.place(), &raw)?;
        let finished = mesh::finish(Arc::unwrap_or_clone(raw), to_world, face_normals, flip);
        let finished = finished.map_err(|reason| SceneError::value(reader.place(), reader.context(), reason))?;
        Ok(self.shape_of_mesh(finished))
    }

    /// The shape of a finished mesh, whose attributes are kept while what shows them is built.
    fn shape_of_mesh(&mut self, (mesh, attributes): (TriangleMesh, Vec<RawAttribute>)) -> Shape {
        let mesh = Arc::new(mesh);
        self.attributes.found(&mesh, attributes);
        Shape::Mesh(mesh)
    }

    /// Counts a mesh among those of the scene.
    fn count(&mut self, place: &Place, raw: &RawMesh) -> Result<(), SceneError> {
        self.count_mesh(place, raw.positions.len() as u64, raw.triangles.len() as u64)
    }

    pub(super) fn count_mesh(&mut self, place: &Place, vertices: u64, triangles: u64) -> Result<(), SceneError> {
        self.meshes.vertices += vertices;
        self.meshes.triangles += triangles;
        let (meshes, limits) = (self.meshes, self.loader.limits);
        let of_scene = "number of triangles of the scene";
        within(place, of_scene, meshes.triangles, limits.triangles)?;
        let of_scene = "number of vertices of the scene";
        within(place, of_scene, meshes.vertices, limits.vertices).map(|_| ())
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
        let mut source = MeshFile::new(&file, self.loader.limits, self.meshes);
        source.attributes = self.attributes.names();
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
        let finished = mesh::finish(raw, to_world, face_normals, flip).map_err(broken)?;
        Ok(self.shape_of_mesh(finished))
    }
}

/// A sphere, or an ellipsoid where `to_world`, or a keyframe of what moves the shape then, scales it unevenly.
fn sphere(
    reader: &Reader,
    to_world: &Transform,
    motion: Option<&AnimatedTransform>,
    flip: bool,
) -> Result<Shape, SceneError> {
    let center = reader.vector("center")?.unwrap_or(DVec3::ZERO);
    let radius = reader.float_or("radius", POSITIVE, 1.0)?;
    reader.finish();
    let unit_to_world = DMat4::from_translation(center) * DMat4::from_scale(DVec3::splat(radius));
    let unit_to_world = Transform::from_matrix(unit_to_world).map(|placed| to_world.after(&placed));
    let placed = unit_to_world.ok_or_else(|| reader.wrong("radius", "the sphere is too small or too large"))?;
    let flip_normals = flip != placed.flips_handedness();
    let moves_evenly = motion.is_none_or(|motion| motion.keyframes().all(|keyframe| uniform_scale(keyframe).is_some()));
    let Some(scale) = uniform_scale(&placed).filter(|_| moves_evenly) else {
        if reader.object.plugin == "sphere" {
            let message = "its map scales the sphere unevenly: it is rendered as the ellipsoid that this makes of it, in place of a sphere; \
                           the type `ellipsoid` is this shape";
            reader.warn_of("to_world", message);
        }
        check_axes(reader, &placed)?;
        return Ok(Shape::Ellipsoid {
            to_world: placed,
            flip_normals,
        });
    };
    let (center, radius) = (placed.point(Vec3::ZERO), scale as f32);
    check_extent(reader, center, radius)?;
    Ok(Shape::Sphere {
        center,
        radius,
        to_local: placed.inverted(),
        flip_normals,
    })
}

/// The mantle of the cylinder from `p0` to `p1`.
fn cylinder(reader: &Reader, to_world: &Transform, flip: bool) -> Result<Shape, SceneError> {
    let from = reader.vector("p0")?.unwrap_or(DVec3::ZERO);
    let to = reader.vector("p1")?.unwrap_or(DVec3::Z);
    let radius = reader.float_or("radius", POSITIVE, 1.0)?;
    reader.finish();
    let length = (to - from).length();
    let axis = ((to - from) / length).as_vec3();
    if !axis.is_finite() {
        return Err(reader.wrong("p1", "the cylinder has no length"));
    }
    let around = Frame::from_normal(axis);
    let column = |v: Vec3, scale: f64| (v.as_dvec3() * scale).extend(0.0);
    let unit_to_world = DMat4::from_cols(
        column(around.s, radius),
        column(around.t, radius),
        (to - from).extend(0.0),
        from.extend(1.0),
    );
    let unit_to_world = Transform::from_matrix(unit_to_world).map(|placed| to_world.after(&placed));
    let to_world = unit_to_world.ok_or_else(|| reader.wrong("radius", "the cylinder is too small or too large"))?;
    check_axes(reader, &to_world)?;
    Ok(Shape::Cylinder {
        to_world,
        flip_normals: flip,
    })
}

/// Whether a map keeps the unit cylinder one: points uniform on it are then uniform by area.
fn is_even_cylinder(to_world: &Transform) -> bool {
    let matrix = to_world.matrix();
    let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|axis| axis.truncate());
    let (radius, length) = (x.length(), z.length());
    (y.length() - radius).abs() <= 1e-3 * radius
        && x.dot(y).abs() <= 1e-3 * radius * radius
        && x.dot(z).abs().max(y.dot(z).abs()) <= 1e-3 * radius * length
}

/// The light of a shape whose area is not known yet.
struct Lamp {
    radiance: Texture,
    /// Whether it emits along its normals alone, and `radiance` is its exitance.
    along_normals: bool,
    two_sided: bool,
    /// What a radiance of luminance 1 shines in all.
    power: Option<f32>,
}

impl Lamp {
    /// The light on a shape of this area.
    fn on(self, shape: ShapeId, area: f32) -> Light {
        match (self.along_normals, self.two_sided) {
            (true, _) => Light::DirectionalArea {
                shape,
                exitance: self.radiance,
            },
            (false, two_sided) => Light::Area {
                shape,
                two_sided,
                radiance: self.radiance(area),
            },
        }
    }

    /// The radiance on a shape of this area: as it is written, or with `power` times that over pi times the area of the sides that
    /// shine; of a texture the mean luminance is 1 then (`DiffuseAreaLight::Create` of pbrt-v4).
    fn radiance(self, area: f32) -> Texture {
        let Some(power) = self.power else {
            return self.radiance;
        };
        let sides = if self.two_sided { 2.0 } else { 1.0 };
        let mean = match &self.radiance {
            Texture::Constant(_) => 1.0,
            texture => texture.mean().luminance(),
        };
        match PI * sides * area * mean {
            shone if shone > 0.0 => scaled(self.radiance, power / shone),
            _ => self.radiance,
        }
    }
}

fn area_of(shape: &Shape) -> f32 {
    ShapeSampler::of(shape, ShapeId(0)).area()
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
pub(super) fn own_space(animation: &AnimatedTransform) -> Option<(Transform, AnimatedTransform)> {
    let mirrors = animation.keyframes().any(Transform::flips_handedness);
    let sign = if mirrors { -1.0 } else { 1.0 };
    let to_own = Transform::from_matrix(DMat4::from_scale(DVec3::new(sign, 1.0, 1.0)))?;
    let motion = animation.map(|keyframe| Some(keyframe.after(&to_own.inverted())))?;
    Some((to_own, motion))
}

/// Checks that a moving shape keeps within the largest coordinate and has an area at each keyframe; between them it has one as well.
pub(super) fn check_motion(
    reader: &Reader,
    id: ShapeId,
    shape: &Shape,
    to_world: &AnimatedTransform,
) -> Result<(), SceneError> {
    let of_axes = |to_world: &Transform| {
        let matrix = to_world.matrix();
        let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis, matrix.w_axis];
        columns.iter().map(|column| column.truncate().length()).sum::<f64>()
    };
    let radius = match shape {
        Shape::Mesh(mesh) => f64::from(mesh.positions.iter().map(|p| p.length()).fold(0.0, f32::max)),
        Shape::Sphere { center, radius, .. } => f64::from(center.length() + radius),
        Shape::Disk { .. } => 1.0,
        Shape::Cylinder { to_world, .. } | Shape::Ellipsoid { to_world, .. } => of_axes(to_world),
        Shape::Instance { group, to_world } => {
            let (lower, upper) = group.bounds();
            let corner = f64::from(lower.abs().max(upper.abs()).length());
            of_axes(to_world) * corner.max(1.0)
        }
    };
    let reach = to_world.reach(radius);
    let limit = f64::from(mesh::LARGEST_COORDINATE);
    if reach.is_nan() || reach > limit {
        let reason =
            format!("the shape may come {reach:.1e} from the origin as it moves; coordinates reach to {limit:e}");
        return Err(reader.wrong("to_world", reason));
    }
    for keyframe in to_world.keyframes() {
        let placed = shape.moved(keyframe);
        if let Shape::Sphere { center, radius, .. } = &placed {
            check_extent(reader, *center, *radius)?;
        }
        if matches!(placed, Shape::Instance { .. } | Shape::Ellipsoid { .. }) {
            continue;
        }
        if ShapeSampler::of(&placed, id).area() < f32::MIN_POSITIVE {
            return Err(reader.wrong("to_world", "the shape has no area at one of the keyframes"));
        }
    }
    Ok(())
}

/// Checks that a shape of radius 1 about the origin, or from there to +z, keeps within the largest coordinate under a map, and is no
/// smaller than its rounding.
fn check_axes(reader: &Reader, to_world: &Transform) -> Result<(), SceneError> {
    let lengths = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| to_world.vector(axis).length());
    let center = to_world.point(Vec3::ZERO);
    check_extent(reader, center, lengths.iter().sum())?;
    check_extent(reader, center, lengths.into_iter().fold(f32::INFINITY, f32::min))
}

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

//! Bodies: closed shapes with a priority.

use super::Builder;
use crate::geometry::{Shape, TriangleMesh};
use crate::material::Material;
use crate::math::{Transform, Vec3};
use crate::medium::{Body, BodyId, Boundary, MOST_BODIES, MediumId};
use crate::scene::ShapeBinding;
use crate::scene::description::Kind;
use crate::scene::error::{Place, SceneError, within};
use crate::scene::reader::Reader;
use std::ops::Range;

/// Comparisons of boxes, and boxes, of which more are not looked through: everything counts as overlapping then.
const MOST_COMPARISONS: u64 = 1 << 26;
const MOST_BOXES: usize = 1 << 20;

/// A box in the world, by its lower and upper corner.
type Bounds = (Vec3, Vec3);

const ALL_SPACE: Bounds = (Vec3::NEG_INFINITY, Vec3::INFINITY);

/// The bodies of a scene that is built, in the order of their shapes.
#[derive(Default)]
pub(super) struct Bodies {
    found: Vec<Found>,
    /// Where they stand; a body of a group as often as the group does.
    boxes: Vec<(usize, Bounds)>,
    /// Whether there are more boxes than that.
    crowded: bool,
}

struct Found {
    body: Body,
    priority: i64,
    /// In its space: the world, or that of its group.
    bounds: Bounds,
    is_closed: bool,
    /// The volume of its largest box.
    volume: f64,
    place: Place,
}

impl Bodies {
    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.found.len()
    }

    /// Notes that a body stands in the world by a map, or moves.
    pub(super) fn stand(&mut self, index: usize, to_world: &Transform, moves: bool) {
        let found = &mut self.found[index];
        let bounds = mapped(found.bounds, to_world);
        let size = (bounds.1 - bounds.0).as_dvec3();
        found.volume = found.volume.max(size.x * size.y * size.z);
        if self.boxes.len() < MOST_BOXES {
            self.boxes.push((index, if moves { ALL_SPACE } else { bounds }));
        } else {
            self.crowded = true;
        }
    }

    /// Whether each body's box touches another.
    fn touching(&self) -> Vec<bool> {
        let mut boxes = self.boxes.clone();
        boxes.sort_by(|a, b| a.1.0.x.total_cmp(&b.1.0.x));
        let mut touching = vec![false; self.found.len()];
        let mut comparisons = 0;
        for (i, (body, (lower, upper))) in boxes.iter().enumerate() {
            for (other, (other_lower, other_upper)) in &boxes[i + 1..] {
                if other_lower.x > upper.x {
                    break;
                }
                comparisons += 1;
                if lower.cmple(*other_upper).all() && other_lower.cmple(*upper).all() {
                    (touching[*body], touching[*other]) = (true, true);
                }
            }
            if comparisons > MOST_COMPARISONS {
                return vec![true; self.found.len()];
            }
        }
        touching
    }

    /// The bodies that are rendered, those before others that hold where both lie: of a higher priority, of a smaller box, or described before. Bindings are told of
    /// them. What is no body stays a shape that bounds its medium: what is not closed and, where no other shape says where media lie (`alone`), what stands apart from all
    /// other bodies.
    pub(super) fn settle<'b>(
        self,
        bindings: impl Iterator<Item = &'b mut ShapeBinding>,
        alone: bool,
        warn: impl Fn(&Place, &str),
    ) -> Vec<Body> {
        let touching = match alone && !self.crowded {
            true => self.touching(),
            false => vec![true; self.found.len()],
        };
        let mut order = Vec::new();
        for (index, found) in self.found.iter().enumerate().filter(|(index, _)| touching[*index]) {
            if found.is_closed {
                order.push(index);
            } else {
                warn(
                    &found.place,
                    "it is not closed, and so has no priority where it overlaps others: paths that come in by a hole would never come out",
                );
            }
        }
        order.sort_by(|a, b| {
            let (a, b) = (&self.found[*a], &self.found[*b]);
            let by_priority = b.priority.cmp(&a.priority);
            by_priority.then(a.volume.total_cmp(&b.volume))
        });
        let mut ids = vec![None; self.found.len()];
        for (id, index) in order.iter().enumerate() {
            ids[*index] = Some(BodyId(id as u16));
        }
        for binding in bindings {
            let Some(BodyId(index)) = binding.body else { continue };
            let index = usize::from(index);
            binding.body = ids[index];
            if binding.body.is_none() {
                let interior = self.found[index].body.medium;
                binding.boundary = interior.is_some().then_some(Boundary {
                    interior,
                    exterior: None,
                });
            }
        }
        order.into_iter().map(|index| self.found[index].body).collect()
    }
}

impl Builder<'_, '_> {
    /// The priority of a shape that bounds a body.
    pub(super) fn priority(&self, reader: &Reader) -> Result<Option<i64>, SceneError> {
        let priority = reader.integer("priority", -1_000_000..=1_000_000)?;
        let without = |reason: &str| reader.fault(reader.wrong("priority", reason)).map(|()| None);
        if priority.is_none() {
            return Ok(None);
        }
        if reader.named_child("exterior", Kind::Medium)?.is_some() {
            return without("a shape with a priority has no `exterior`: outside of it is what is there without it");
        }
        if reader.only_child(Kind::Emitter)?.is_some() {
            return without("a shape that shines has no priority: its surface cannot be covered");
        }
        Ok(priority)
    }

    /// Makes a body of the shape that was added last.
    pub(super) fn add_body(
        &mut self,
        reader: &Reader,
        priority: i64,
        medium: Option<MediumId>,
        moves: bool,
    ) -> Result<(), SceneError> {
        let (Some(shape), Some(binding)) = (self.shapes.last(), self.bindings.last_mut()) else {
            return Ok(());
        };
        let index = self.bodies.len();
        within(
            reader.place(),
            "number of shapes with a priority",
            index as u64 + 1,
            MOST_BODIES,
        )?;
        binding.body = Some(BodyId(index as u16));
        binding.boundary = None;
        self.bodies.found.push(Found {
            body: Body {
                medium,
                index: Material::index(&self.materials[binding.material as usize]).unwrap_or(1.0),
            },
            priority,
            bounds: shape.bounds(),
            is_closed: is_closed(shape),
            volume: 0.0,
            place: reader.place().clone(),
        });
        if !self.within_group {
            self.bodies.stand(index, &Transform::default(), moves);
        }
        Ok(())
    }

    /// Notes that the bodies of a group stand where an instance places it.
    pub(super) fn stand_bodies(&mut self, bodies: Range<usize>, to_world: &Transform, moves: bool) {
        for index in bodies {
            self.bodies.stand(index, to_world, moves);
        }
    }
}

/// The box about a box that is mapped.
fn mapped((lower, upper): Bounds, by: &Transform) -> Bounds {
    let corners = (0..8).map(|corner| {
        let of = |axis: usize| match corner >> axis & 1 {
            0 => lower[axis],
            _ => upper[axis],
        };
        by.point(Vec3::new(of(0), of(1), of(2)))
    });
    let nothing = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    corners.fold(nothing, |(lower, upper), corner| (lower.min(corner), upper.max(corner)))
}

/// Whether a shape has an inside.
fn is_closed(shape: &Shape) -> bool {
    match shape {
        Shape::Mesh(mesh) => is_closed_mesh(mesh),
        Shape::Sphere { .. } | Shape::Ellipsoid { .. } => true,
        Shape::Disk { .. } | Shape::Cylinder { .. } | Shape::Instance { .. } => false,
    }
}

/// Whether triangles go along each edge as often one way as the other. Vertices at the same place are one.
fn is_closed_mesh(mesh: &TriangleMesh) -> bool {
    // Adding zero leaves one zero of both.
    let key = |vertex: u32| {
        (mesh.positions[vertex as usize] + Vec3::ZERO)
            .to_array()
            .map(f32::to_bits)
    };
    let mut order: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    order.sort_by_key(|vertex| key(*vertex));
    let mut first_at = vec![0; order.len()];
    let mut first = order.first().copied().unwrap_or_default();
    for vertex in order {
        if key(first) != key(vertex) {
            first = vertex;
        }
        first_at[vertex as usize] = first;
    }
    let mut edges = Vec::with_capacity(3 * mesh.triangles.len());
    for triangle in &mesh.triangles {
        let corners = triangle.map(|vertex| first_at[vertex as usize]);
        for i in 0..3 {
            let (from, to) = (corners[i], corners[(i + 1) % 3]);
            if from != to {
                edges.push((from.min(to), from.max(to), from < to));
            }
        }
    }
    edges.sort_unstable();
    edges
        .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
        .all(|edge| 2 * edge.iter().filter(|(.., up)| *up).count() == edge.len())
}

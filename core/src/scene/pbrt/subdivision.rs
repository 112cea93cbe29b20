//! Loop's subdivision surfaces (Loop 1987), with the weights of pbrt: those of Warren (1995) for vertices within, limit positions and
//! limit normals as in Hoppe et al. (1994).

use crate::math::Vec3;
use crate::scene::mesh::RawMesh;
use glam::DVec3;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// Refines triangles `levels` times and moves their vertices to the limit. The indices are in range; the error says what is wrong with
/// the mesh.
pub(super) fn subdivide(positions: &[Vec3], triangles: Vec<[u32; 3]>, levels: u32) -> Result<RawMesh, String> {
    let mut mesh = Mesh {
        positions: positions.iter().map(|p| p.as_dvec3()).collect(),
        triangles,
    };
    for _ in 0..levels {
        mesh = mesh.refined()?;
    }
    let rings = mesh.rings()?;
    let mut limit = RawMesh::default();
    for (vertex, ring) in rings.iter().enumerate() {
        limit.positions.push(mesh.limit_position(vertex, ring).as_vec3());
    }
    let at_limit = Mesh {
        positions: limit.positions.iter().map(|p| p.as_dvec3()).collect(),
        triangles: mesh.triangles,
    };
    for (vertex, ring) in rings.iter().enumerate() {
        limit
            .normals
            .push(at_limit.limit_normal(vertex, ring).normalize_or_zero().as_vec3());
    }
    limit.triangles = at_limit.triangles;
    Ok(limit)
}

struct Mesh {
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// The neighbours of a vertex, counter-clockwise; at a border from its one side to its other.
#[derive(Clone, Default)]
struct Ring {
    vertices: Vec<u32>,
    border: bool,
}

/// The weight of each neighbour of a vertex with `valence` of them.
fn beta(valence: usize) -> f64 {
    if valence == 3 {
        return 3.0 / 16.0;
    }
    3.0 / (8.0 * valence as f64)
}

impl Mesh {
    fn at(&self, vertex: u32) -> DVec3 {
        self.positions[vertex as usize]
    }

    /// The rings of all vertices. The error tells of edges with more than two triangles, and of triangles that are not turned alike.
    fn rings(&self) -> Result<Vec<Ring>, String> {
        // What follows each neighbour of a vertex about it.
        let mut next: Vec<Vec<(u32, u32)>> = vec![Vec::new(); self.positions.len()];
        for triangle in &self.triangles {
            for corner in 0..3 {
                let [a, b, c] = [0, 1, 2].map(|i| triangle[(corner + i) % 3]);
                next[a as usize].push((b, c));
            }
        }
        let mut rings = Vec::with_capacity(next.len());
        for (vertex, mut links) in next.into_iter().enumerate() {
            links.sort_unstable();
            let broken = || format!("about vertex {vertex} the triangles are not one fan of the same turn");
            if links.windows(2).any(|pair| pair[0].0 == pair[1].0) {
                return Err(broken());
            }
            let mut ends: Vec<u32> = links.iter().map(|link| link.1).collect();
            ends.sort_unstable();
            let start = links
                .iter()
                .find(|link| ends.binary_search(&link.0).is_err())
                .or(links.first());
            let mut ring = Ring::default();
            let Some((start, _)) = start.copied() else {
                rings.push(ring);
                continue;
            };
            let follow = |from: u32| {
                links
                    .binary_search_by_key(&from, |link| link.0)
                    .ok()
                    .map(|at| links[at].1)
            };
            ring.vertices.push(start);
            let mut at = start;
            for _ in 0..links.len() {
                let Some(after) = follow(at) else { break };
                if after == start {
                    break;
                }
                ring.vertices.push(after);
                at = after;
            }
            ring.border = follow(at) != Some(start);
            if ring.vertices.len() != links.len() + usize::from(ring.border) {
                return Err(broken());
            }
            rings.push(ring);
        }
        Ok(rings)
    }

    fn refined(&self) -> Result<Self, String> {
        let rings = self.rings()?;
        let mut positions: Vec<DVec3> = (0..self.positions.len())
            .map(|vertex| self.moved(vertex, &rings[vertex]))
            .collect();
        // The vertices across each edge, and later the vertex that halves it.
        let mut edges: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
        for triangle in &self.triangles {
            for corner in 0..3 {
                let [a, b, across] = [0, 1, 2].map(|i| triangle[(corner + i) % 3]);
                edges.entry((a.min(b), a.max(b))).or_default().push(across);
            }
        }
        let mut middles = BTreeMap::new();
        for ((a, b), across) in edges {
            let ends = self.at(a) + self.at(b);
            let middle = match across[..] {
                [one, other] => ends * 0.375 + (self.at(one) + self.at(other)) * 0.125,
                _ => ends * 0.5,
            };
            middles.insert((a, b), positions.len() as u32);
            positions.push(middle);
        }
        let mut triangles = Vec::with_capacity(self.triangles.len() * 4);
        for [a, b, c] in self.triangles.iter().copied() {
            let middle = |a: u32, b: u32| middles[&(a.min(b), a.max(b))];
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            triangles.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        Ok(Self { positions, triangles })
    }

    /// A vertex of the next level.
    fn moved(&self, vertex: usize, ring: &Ring) -> DVec3 {
        if ring.border {
            return self.between_borders(vertex, ring, 0.125);
        }
        self.between(vertex, ring, beta(ring.vertices.len()))
    }

    fn limit_position(&self, vertex: usize, ring: &Ring) -> DVec3 {
        if ring.border {
            return self.between_borders(vertex, ring, 0.2);
        }
        let valence = ring.vertices.len();
        self.between(vertex, ring, 1.0 / (valence as f64 + 3.0 / (8.0 * beta(valence))))
    }

    /// The vertex with a weight of `share` for each of its neighbours.
    fn between(&self, vertex: usize, ring: &Ring, share: f64) -> DVec3 {
        if ring.vertices.is_empty() {
            return self.positions[vertex];
        }
        let sum: DVec3 = ring.vertices.iter().map(|neighbour| self.at(*neighbour)).sum();
        self.positions[vertex] * (1.0 - ring.vertices.len() as f64 * share) + sum * share
    }

    /// The vertex with a weight of `share` for each of its two neighbours on the border.
    fn between_borders(&self, vertex: usize, ring: &Ring, share: f64) -> DVec3 {
        let (Some(first), Some(last)) = (ring.vertices.first(), ring.vertices.last()) else {
            return self.positions[vertex];
        };
        self.positions[vertex] * (1.0 - 2.0 * share) + (self.at(*first) + self.at(*last)) * share
    }

    /// The normal at a vertex of the limit surface, of any length: the product of two tangents.
    fn limit_normal(&self, vertex: usize, ring: &Ring) -> DVec3 {
        let points: Vec<DVec3> = ring.vertices.iter().map(|neighbour| self.at(*neighbour)).collect();
        let (count, here) = (points.len(), self.positions[vertex]);
        let (Some(first), Some(last)) = (points.first(), points.last()) else {
            return DVec3::ZERO;
        };
        if !ring.border {
            let (mut s, mut t) = (DVec3::ZERO, DVec3::ZERO);
            for (index, point) in points.iter().enumerate() {
                let (sin, cos) = libm::sincos(TAU * index as f64 / count as f64);
                s += *point * cos;
                t += *point * sin;
            }
            return s.cross(t);
        }
        let along = *first - *last;
        let inward = match count {
            2 => *first + *last - here * 2.0,
            3 => points[1] - here,
            4 => points[1] * 2.0 + points[2] * 2.0 - *first - *last - here * 2.0,
            _ => {
                let theta = PI / (count - 1) as f64;
                let mut sum = (*first + *last) * libm::sin(theta);
                for (index, point) in points.iter().enumerate().take(count - 1).skip(1) {
                    let weight = (2.0 * libm::cos(theta) - 2.0) * libm::sin(index as f64 * theta);
                    sum += *point * weight;
                }
                -sum
            }
        };
        along.cross(inward)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The corners of an octahedron, whose limit has its symmetry.
    #[test]
    fn an_octahedron_becomes_round() {
        let positions = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
        let mut triangles = Vec::new();
        for [a, b] in [[0, 1], [1, 3], [3, 4], [4, 0]] {
            triangles.push([a, b, 2]);
            triangles.push([b, a, 5]);
        }
        let mesh = subdivide(&positions, triangles.clone(), 3).unwrap();
        assert_eq!((mesh.triangles.len(), mesh.positions.len()), (8 * 64, 2 + 8 * 32));
        // The limit of a corner of valence 4: beta = 3/32, gamma = 1/8; its neighbours cancel.
        let corner = subdivide(&positions, triangles, 0).unwrap();
        assert!(
            (corner.positions[0] - Vec3::X * 0.5).length() < 1e-6,
            "{}",
            corner.positions[0]
        );
        assert!(
            (mesh.positions[0] - Vec3::X * 0.5).length() < 1e-6,
            "the limit does not depend on the level"
        );
        for (point, normal) in mesh.positions.iter().zip(&mesh.normals) {
            assert!(
                (normal.length() - 1.0).abs() < 1e-5 && normal.dot(point.normalize()) > 0.9,
                "{point} {normal}"
            );
        }
        assert!((mesh.normals[2] - Vec3::Z).length() < 1e-5);
    }

    #[test]
    fn a_flat_square_stays_flat_with_its_borders() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
        let mesh = subdivide(&positions, vec![[0, 1, 2], [0, 2, 3]], 2).unwrap();
        assert_eq!(mesh.triangles.len(), 32);
        assert!(mesh.positions.iter().all(|p| p.z == 0.0 && (0.0..=1.0).contains(&p.x)));
        assert!(mesh.normals.iter().all(|normal| normal.z > 0.999), "{:?}", mesh.normals);
    }

    #[test]
    fn what_is_no_surface_is_refused() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE];
        for triangles in [vec![[0, 1, 2], [0, 1, 3]], vec![[0, 1, 2], [0, 1, 3], [1, 0, 4]]] {
            assert!(subdivide(&positions, triangles, 1).is_err());
        }
    }
}

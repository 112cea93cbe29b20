//! Shares of techniques: of two that sample a direction, and of all that can make a path from both sides.
//!
//! The latter come from two sums that each vertex of a subpath keeps. A path counts for a technique with the share that the balance heuristic gives it: the technique's density times its number of
//! paths, over the sum of these products of all techniques that make the same path. Every other technique moves the
//! connection along the path, so that its product over this one's is a product of local terms. What the vertices before the end of a
//! subpath contribute to the sum is kept with the end, and two subpaths that meet only add what depends on both
//! (Georgiev 2012, "Implementing Vertex Connection and Merging": the quantities d^VCM and d^VC; his d^VM is d^VC over the
//! factor of merging, where both start alike, as here).
//!
//! Shares hold no Russian roulette and no shading normals, on either side: they only have to add up to one.

use crate::math::sqr;

/// Power heuristic with beta = 2 for one sample of each of two techniques (Veach 1997, equation 9.13), written so that large
/// densities do not overflow.
pub(crate) fn power_heuristic(pdf: f32, other: f32) -> f32 {
    if pdf == 0.0 {
        return 0.0;
    }
    1.0 / (1.0 + sqr(other / pdf))
}

/// The sums of a vertex, in terms of densities by area.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Partial {
    /// One over the density of the vertex: what connecting the edge before it would make of this technique. 0 where a delta function
    /// chose its direction.
    pub(crate) edge: f32,
    /// The same of all techniques that leave more of the subpath to the other side, without the density with which the other side
    /// chooses the direction of the edge before the vertex \[sr\].
    pub(crate) before: f32,
}

/// How often the connection of an edge is tried for each path: 0 where the technique is off.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Edges {
    /// Of the subpath's first edge.
    pub(crate) first: f32,
    /// Of the others.
    pub(crate) others: f32,
}

impl Edges {
    /// Of edge number `edge` of the subpath, from 1.
    pub(crate) fn of(self, edge: u32) -> f32 {
        if edge == 1 { self.first } else { self.others }
    }
}

impl Partial {
    /// After scattering with the solid-angle density `pdf` \[1/sr\] at an angle of cosine `cos`, until the next vertex is known. `pdf_rev` is the
    /// density of the way back, `edge` how often the edge before the vertex is connected, and `merges` the factor of merging at it.
    pub(crate) fn after(self, cos: f32, pdf: f32, pdf_rev: f32, edge: f32, merges: f32) -> Self {
        Self {
            edge: 1.0 / pdf,
            before: cos / pdf * (self.before * pdf_rev + edge * self.edge + merges),
        }
    }

    /// After a delta function chose the direction. Nothing can be connected or merged there; `ratio` is the density of choosing the way
    /// back over that of choosing the way.
    pub(crate) fn after_delta(self, cos: f32, ratio: f32) -> Self {
        Self {
            edge: 0.0,
            before: cos * ratio * self.before,
        }
    }

    /// At the next vertex, which faces the direction with cosine `cos`: densities by solid angle become densities by area at the squared
    /// distance `distance2`, which is 1 for parallel rays. The edge came through media with the probability `passed`, which a connection
    /// does without. (In a medium, densities are by volume, and the extinction that turns them into such is left out of all of them.)
    pub(crate) fn arrived(self, distance2: f32, cos: f32, passed: f32) -> Self {
        Self {
            edge: self.edge * distance2 / (cos * passed),
            before: self.before / cos,
        }
    }

    /// Products of the techniques that leave more of this subpath to the other side, over a connection with its end. `pdf_area` is the
    /// density by area with which the other side arrives at the end, and `pdf_rev` \[1/sr\] with which it goes on along the edge before it.
    pub(crate) fn over_connection(self, pdf_area: f32, pdf_rev: f32, edge: f32, merges: f32) -> f32 {
        pdf_area * (self.before * pdf_rev + edge * self.edge + merges)
    }

    /// The same over a merge at the end.
    pub(crate) fn over_merge(self, pdf_rev: f32, edge: f32, merges: f32) -> f32 {
        (self.before * pdf_rev + edge * self.edge) / merges
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{PathRandom, Stream};

    /// A path `x_0 ... x_k` by its densities, cosines, distances and what comes through alone.
    struct PathDensities {
        /// Of starting at `x_0`, of connecting with it, and of leaving it.
        start: f32,
        connected: f32,
        leave: f32,
        /// Of the lens point, and of the direction from it.
        lens: f32,
        direction: f32,
        /// For each vertex, of going on towards the camera, and towards the light.
        to_camera: Vec<f32>,
        to_light: Vec<f32>,
        /// Cosines at each vertex with the edge before and after it.
        before: Vec<f32>,
        after: Vec<f32>,
        /// Squared length of the edge after each vertex.
        distance2: Vec<f32>,
        /// Probability of coming through the edge after each vertex.
        passed: Vec<f32>,
        light_paths: f32,
        samples: f32,
        /// `pi r^2`.
        disc: f32,
    }

    impl PathDensities {
        fn random(edges: usize, number: u64) -> Self {
            let mut random = PathRandom::new(1, 1, Stream::Probe, number);
            let mut draw = move || 0.1 + 2.0 * random.next_1d();
            let mut list = || -> Vec<f32> { (0..=edges).map(|_| draw()).collect() };
            let (to_camera, to_light, before, after, distance2, passed, rest) =
                (list(), list(), list(), list(), list(), list(), list());
            let mut few = PathRandom::new(2, 1, Stream::Probe, number);
            let mut draw = move || 0.1 + 2.0 * few.next_1d();
            Self {
                start: rest[0],
                connected: rest[1],
                leave: draw(),
                lens: draw(),
                direction: draw(),
                to_camera,
                to_light,
                before,
                after,
                distance2,
                passed: passed.into_iter().map(|passed| passed / 2.1).collect(),
                light_paths: 10.0 * draw(),
                samples: draw(),
                disc: 0.1 * draw(),
            }
        }

        fn edges(&self) -> usize {
            self.distance2.len() - 1
        }

        /// Density by area of each vertex as light paths make them.
        fn of_light(&self) -> Vec<f32> {
            let next = |i: usize| match i {
                0 => self.start,
                1 => self.leave * self.before[1] * self.passed[0] / self.distance2[0],
                _ => self.to_camera[i - 1] * self.before[i] * self.passed[i - 1] / self.distance2[i - 1],
            };
            (0..=self.edges()).map(next).collect()
        }

        /// Density by area of each vertex as camera paths make them.
        fn of_camera(&self) -> Vec<f32> {
            let k = self.edges();
            let next = |i: usize| match k - i {
                0 => self.lens,
                1 => self.direction * self.after[i] * self.passed[i] / self.distance2[i],
                _ => self.to_light[i + 1] * self.after[i] * self.passed[i] / self.distance2[i],
            };
            (0..=k).map(next).collect()
        }

        /// Density times number of paths of technique `(s, t)`.
        fn connection(&self, s: usize) -> f32 {
            let (light, camera, k) = (self.of_light(), self.of_camera(), self.edges());
            let camera_part: f32 = camera[s..].iter().product();
            match (s, k + 1 - s) {
                (0, _) => self.samples * camera_part,
                (_, 0) => self.light_paths * light.iter().product::<f32>(),
                (_, 1) => self.light_paths * light[..s].iter().product::<f32>() * self.lens,
                (1, _) => self.samples * self.connected * camera_part,
                _ => self.samples * light[..s].iter().product::<f32>() * camera_part,
            }
        }

        /// The same of merging at vertex `i`.
        fn merge(&self, i: usize) -> f32 {
            let (light, camera) = (self.of_light(), self.of_camera());
            let density = light[..=i].iter().product::<f32>() * camera[i..].iter().product::<f32>();
            self.samples * self.light_paths * self.disc * density
        }

        fn merges(&self) -> f32 {
            self.light_paths * self.disc
        }

        fn camera_edges(&self) -> Edges {
            Edges {
                first: self.light_paths / self.samples,
                others: 1.0,
            }
        }

        /// What light paths keep at vertex `i` of 1 and more.
        fn light_partial(&self, i: usize) -> Partial {
            let start = Partial {
                edge: self.connected / (self.start * self.leave),
                before: self.after[0] / (self.start * self.leave),
            };
            (1..i).fold(
                start.arrived(self.distance2[0], self.before[1], self.passed[0]),
                |partial, j| {
                    let (to, from) = (self.to_camera[j], self.to_light[j]);
                    let after = partial.after(self.after[j], to, from, 1.0, self.merges());
                    after.arrived(self.distance2[j], self.before[j + 1], self.passed[j])
                },
            )
        }

        /// What camera paths keep at vertex `i` of `k - 1` and less.
        fn camera_partial(&self, i: usize) -> Partial {
            let k = self.edges();
            let edges = self.camera_edges();
            let start = Partial {
                edge: 1.0 / self.direction,
                before: edges.first * self.before[k] / (self.lens * self.direction),
            };
            let first = start.arrived(self.distance2[k - 1], self.after[k - 1], self.passed[k - 1]);
            (i + 1..k).rev().fold(first, |partial, j| {
                let (to, from, edge) = (self.to_light[j], self.to_camera[j], edges.of((k - j) as u32));
                let after = partial.after(self.before[j], to, from, edge, self.merges());
                after.arrived(self.distance2[j - 1], self.after[j - 1], self.passed[j - 1])
            })
        }

        /// What the products of all other techniques make of connection `(s, t)`, of 2 and more each, from what its ends keep.
        fn over_connection(&self, s: usize) -> f32 {
            let (k, merges) = (self.edges(), self.merges());
            let (x, y) = (s - 1, s);
            let to_y = self.to_camera[x] * self.before[y] * self.passed[x] / self.distance2[x];
            let to_x = self.to_light[y] * self.after[x] * self.passed[x] / self.distance2[x];
            let edge = self.camera_edges().of((k - y) as u32);
            self.light_partial(x)
                .over_connection(to_x, self.to_light[x], 1.0, merges)
                + self
                    .camera_partial(y)
                    .over_connection(to_y, self.to_camera[y], edge, merges)
        }

        /// The same of merging at vertex `i`.
        fn over_merge(&self, i: usize) -> f32 {
            let edge = self.camera_edges().of((self.edges() - i) as u32);
            self.light_partial(i).over_merge(self.to_light[i], 1.0, self.merges())
                + self
                    .camera_partial(i)
                    .over_merge(self.to_camera[i], edge, self.merges())
        }
    }

    /// Shares by what ends keep are those of the balance heuristic over all techniques, written out.
    #[test]
    fn shares_are_those_of_the_balance_heuristic() {
        for number in 0..200 {
            for edges in 3..8 {
                let path = PathDensities::random(edges, 10 * number + edges as u64);
                let connections: Vec<f32> = (0..=edges + 1).map(|s| path.connection(s)).collect();
                let merges: Vec<f32> = (1..edges).map(|i| path.merge(i)).collect();
                let all: f32 = connections.iter().chain(&merges).sum();
                let same = |share: f32, product: f32, label: &str| {
                    assert!(
                        (share * all / product - 1.0).abs() < 1e-4,
                        "{edges} edges, {label}: {share}"
                    );
                };
                for (s, product) in connections.iter().enumerate().take(edges).skip(2) {
                    let share = 1.0 / (1.0 + path.over_connection(s));
                    same(share, *product, &format!("connection {s}"));
                }
                for (i, product) in (1..edges).zip(&merges) {
                    same(1.0 / (1.0 + path.over_merge(i)), *product, &format!("merge {i}"));
                }
            }
        }
    }
}

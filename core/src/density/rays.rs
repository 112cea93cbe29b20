//! The map of what rays find on their way, such as photons about a point and beams.

use super::count_records;
use crate::geometry::{BoxTree, Ray};
use crate::math::Vec3;
use rayon::prelude::*;

/// Something with an extent in space that a ray can pass through.
pub(crate) trait Passable: Copy + Send + Sync {
    /// What is known where a ray passes through.
    type Found;

    /// A box that holds it: lower and upper corner.
    fn bounds(&self) -> (Vec3, Vec3);

    /// What a ray finds that passes through it; `None` where it does not.
    fn pass(&self, ray: &Ray) -> Option<Self::Found>;
}

/// Primitives in a hierarchy of their boxes, which lie in memory in its order.
#[derive(Debug)]
pub(crate) struct RayMap<P> {
    primitives: Vec<P>,
    tree: BoxTree,
}

impl<P: Passable> RayMap<P> {
    /// Builds the map. `chunks` are primitives in the order of paths; the result depends on them alone.
    ///
    /// # Panics
    /// If there are more than [`BoxTree::MOST`].
    pub(crate) fn build(chunks: Vec<Vec<P>>) -> Self {
        let mut unordered = Vec::with_capacity(count_records(&chunks));
        unordered.extend(chunks.into_iter().flatten());
        let boxes: Vec<_> = unordered.par_iter().map(P::bounds).collect();
        let (tree, order) = BoxTree::build(&boxes);
        Self {
            primitives: order.into_par_iter().map(|place| unordered[place as usize]).collect(),
            tree,
        }
    }

    /// Calls `visit` with every primitive that a ray passes through, in an order that depends on the primitives and the ray alone.
    /// Returns how many were tested.
    #[inline]
    pub(crate) fn along(&self, ray: &Ray, mut visit: impl FnMut(&P, P::Found)) -> u64 {
        let mut tested = 0;
        self.tree.visit(ray, |number| {
            tested += 1;
            let primitive = &self.primitives[number];
            if let Some(found) = primitive.pass(ray) {
                visit(primitive, found);
            }
        });
        tested
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{PathRandom, Stream};

    /// A ball with its number.
    #[derive(Clone, Copy)]
    struct Ball {
        number: usize,
        middle: Vec3,
        radius: f32,
    }

    impl Passable for Ball {
        type Found = ();

        fn bounds(&self) -> (Vec3, Vec3) {
            (self.middle - self.radius, self.middle + self.radius)
        }

        fn pass(&self, ray: &Ray) -> Option<()> {
            let along = (self.middle - ray.origin)
                .dot(ray.direction)
                .clamp(0.0, ray.max_distance);
            let nearest = ray.origin + ray.direction * along;
            (nearest.distance(self.middle) < self.radius).then_some(())
        }
    }

    /// Rays of every length, none and infinite among them, find what a look at all primitives finds.
    #[test]
    fn rays_find_what_they_pass_through() {
        let mut random = PathRandom::new(5, 1, Stream::Probe, 1);
        let place = |random: &mut PathRandom| Vec3::new(random.next_1d(), random.next_1d(), random.next_1d()) * 4.0;
        for count in [0, 1, 2, 9, 3_000] {
            let balls: Vec<Ball> = (0..count)
                .map(|number| Ball {
                    number,
                    // Many lie at the same place.
                    middle: if number % 60 == 0 {
                        Vec3::ONE
                    } else {
                        place(&mut random)
                    },
                    radius: 0.01 + 0.2 * random.next_1d(),
                })
                .collect();
            let map = RayMap::build(balls.chunks(100).map(<[_]>::to_vec).collect());
            assert_eq!(map.primitives.len(), count);
            let (mut found_in_all, mut tested_in_all) = (0, 0);
            for round in 0..400 {
                let direction = match round % 4 {
                    0 => Vec3::X,
                    _ => (place(&mut random) - 2.0).normalize_or(Vec3::Y),
                };
                let ray = Ray {
                    origin: place(&mut random),
                    direction,
                    max_distance: [0.0, 0.5, 3.0, f32::INFINITY][round / 4 % 4],
                };
                let mut found = Vec::new();
                tested_in_all += map.along(&ray, |ball, ()| found.push(ball.number));
                found.sort_unstable();
                let expected: Vec<usize> = balls
                    .iter()
                    .filter(|ball| ball.pass(&ray).is_some())
                    .map(|ball| ball.number)
                    .collect();
                assert_eq!(found, expected);
                found_in_all += found.len();
            }
            if count == 3_000 {
                assert!(
                    found_in_all > 500 && tested_in_all < 10 * found_in_all as u64,
                    "{tested_in_all} were tested, {found_in_all} found"
                );
            }
        }
    }
}

//! What the cone map is measured against: the same cones in a kd-tree and in a grid of positions.

use crate::{Found, Structure};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use photonfarm_core::density::{Cone, Reach};
use photonfarm_core::math::Vec3;
use photonfarm_core::spectrum::Spectrum;

/// A cone as the baselines keep it.
#[derive(Clone, Copy)]
struct StoredCone {
    position: Vec3,
    direction: Vec3,
    weight: Spectrum,
}

impl StoredCone {
    fn new(record: &Cone) -> Self {
        Self {
            position: record.position,
            direction: record.direction(),
            weight: record.weight,
        }
    }

    /// Counts the cone where it lies within `reach`.
    fn test(&self, (center, direction): (Vec3, Vec3), reach: &Reach, found: &mut Found) {
        found.read += 1;
        if (self.position - center).length_squared() < reach.radius() * reach.radius()
            && (self.direction - direction).length_squared() < reach.chord2()
        {
            found.counted += 1;
            found.sum += self.weight;
        }
    }
}

/// The thesis's structure: a kd-tree of positions, directions tested one by one.
pub(crate) struct KdTree {
    /// Distances of the tree are rounded differently: it is asked for a little more, and every cone is tested.
    tree: ImmutableKdTree<f32, 3>,
    cones: Vec<StoredCone>,
}

impl Structure for KdTree {
    const NAME: &'static str = "kd-tree";

    fn build(records: Vec<Vec<Cone>>, _: &Reach) -> Self {
        let cones: Vec<StoredCone> = records.iter().flatten().map(StoredCone::new).collect();
        let positions: Vec<[f32; 3]> = cones.iter().map(|cone| cone.position.to_array()).collect();
        Self {
            tree: ImmutableKdTree::new_from_slice(&positions).expect("finite positions"),
            cones,
        }
    }

    /// Inner nodes, some hundredths of this, are left out.
    fn bytes(&self) -> usize {
        self.cones.len() * (size_of::<StoredCone>() + size_of::<[f32; 3]>() + size_of::<u32>())
    }

    fn run(&self, queries: &[(Vec3, Vec3)], reach: &Reach, found: &mut Vec<Found>) {
        let mut scratch = self.tree.create_scratch::<SquaredEuclidean<f32>>();
        let radius2 = reach.radius() * reach.radius() * (1.0 + 1e-5);
        for query in queries {
            let mut sum = Found::default();
            self.tree
                .query(&query.0.to_array())
                .within::<SquaredEuclidean<f32>>(radius2)
                .unsorted()
                .with_scratch(&mut scratch)
                .visit(|hit| self.cones[hit.item as usize].test(*query, reach, &mut sum));
            found.push(sum);
        }
    }
}

/// StoredCones sorted by hashed cell; cells are two radii wide, so that a query looks at eight.
pub(crate) struct Grid {
    cells_per_unit: f32,
    /// `starts[b]..starts[b + 1]` are the cones of bucket `b`.
    starts: Vec<u32>,
    cones: Vec<StoredCone>,
}

impl Grid {
    fn cell(&self, position: Vec3) -> [i32; 3] {
        (position * self.cells_per_unit).floor().to_array().map(|c| c as i32)
    }

    fn bucket(&self, cell: [i32; 3]) -> usize {
        let [x, y, z] = cell.map(|c| c as u32);
        let hash = x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791);
        hash as usize & (self.starts.len() - 2)
    }
}

impl Structure for Grid {
    const NAME: &'static str = "grid";

    fn build(records: Vec<Vec<Cone>>, reach: &Reach) -> Self {
        let total: usize = records.iter().map(Vec::len).sum();
        let mut grid = Self {
            cells_per_unit: 0.5 / reach.radius(),
            starts: vec![0; total.next_power_of_two() + 1],
            cones: Vec::new(),
        };
        let buckets: Vec<usize> = records
            .iter()
            .flatten()
            .map(|record| grid.bucket(grid.cell(record.position)))
            .collect();
        for &bucket in &buckets {
            grid.starts[bucket + 1] += 1;
        }
        for bucket in 1..grid.starts.len() {
            grid.starts[bucket] += grid.starts[bucket - 1];
        }
        let mut next = grid.starts.clone();
        let mut order = vec![0; total];
        for (index, &bucket) in buckets.iter().enumerate() {
            order[next[bucket] as usize] = index;
            next[bucket] += 1;
        }
        let cones: Vec<StoredCone> = records.iter().flatten().map(StoredCone::new).collect();
        grid.cones = order.into_iter().map(|index| cones[index]).collect();
        grid
    }

    fn bytes(&self) -> usize {
        size_of_val(&*self.starts) + size_of_val(&*self.cones)
    }

    fn run(&self, queries: &[(Vec3, Vec3)], reach: &Reach, found: &mut Vec<Found>) {
        for query in queries {
            let mut sum = Found::default();
            let low = self.cell(query.0 - Vec3::splat(reach.radius()));
            let high = self.cell(query.0 + Vec3::splat(reach.radius()));
            for z in low[2]..=high[2] {
                for y in low[1]..=high[1] {
                    for x in low[0]..=high[0] {
                        let bucket = self.bucket([x, y, z]);
                        for cone in &self.cones[self.starts[bucket] as usize..self.starts[bucket + 1] as usize] {
                            if self.cell(cone.position) == [x, y, z] {
                                cone.test(*query, reach, &mut sum);
                            } else {
                                sum.read += 1;
                            }
                        }
                    }
                }
            }
            found.push(sum);
        }
    }
}

use super::direction::{ROW_BITS, row_of, row_shift, sort_key};
use super::{CELL_OVER_RADIUS, LANES, MAX_RECORDS, Reach, Record, RecordMap, bucket_of, cell, presence};
use crate::spectrum::Spectrum;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Parts that the buckets are split into by their high bits, so that each can be sorted on its own.
const PARTS: usize = 256;

/// Records a bucket holds on average, about, where directions tell the records of a bucket apart.
const RECORDS_PER_BUCKET: usize = 8;

/// Bits of presence for each bucket.
const BITS_PER_BUCKET: usize = 64;

/// The records of one chunk of light paths, by part.
struct ChunkOrder {
    /// Bucket and index in the chunk; in order within a part.
    entries: Vec<(u32, u32)>,
    /// `starts[p]..starts[p + 1]` are the entries of part `p`.
    starts: Vec<u32>,
}

/// How records are put in order.
#[derive(Clone, Copy)]
struct Layout {
    cells_per_unit: f32,
    /// Number of buckets less one.
    mask: u32,
    buckets_per_part: usize,
    /// `None`: by path alone.
    row_shift: Option<u32>,
}

impl RecordMap {
    /// Builds the map for queries that reach as far as `reach`. `chunks` are records in the order of light paths. `normals`: whether
    /// their normals will be asked for.
    ///
    /// A stable sort by bucket, direction and path on the current rayon pool: every chunk is split by the high bits of the
    /// bucket, then every part is sorted. The result depends on the records and on nothing else.
    ///
    /// # Panics
    /// If there are more than [`MAX_RECORDS`] records.
    #[must_use]
    pub fn build(chunks: &[Vec<Record>], reach: &Reach, normals: bool) -> Self {
        let total: usize = chunks.iter().map(Vec::len).sum();
        assert!(
            total <= MAX_RECORDS,
            "{total} records in one map: at most {MAX_RECORDS}"
        );
        let everywhere = reach.is_omnidirectional();
        let share = if everywhere { 1 } else { RECORDS_PER_BUCKET };
        let buckets = (total / share).next_power_of_two().max(PARTS);
        let cell_size = CELL_OVER_RADIUS * reach.radius;
        let shift = row_shift(reach.sin_theta);
        let layout = Layout {
            cells_per_unit: 1.0 / cell_size,
            mask: (buckets - 1) as u32,
            buckets_per_part: buckets / PARTS,
            row_shift: (!everywhere).then_some(shift),
        };
        let words = buckets * BITS_PER_BUCKET / 64;
        let present: Vec<AtomicU64> = std::iter::repeat_with(AtomicU64::default).take(words).collect();
        let orders: Vec<ChunkOrder> = chunks.par_iter().map(|chunk| layout.split(chunk, &present)).collect();
        let mut map = Self {
            reach: *reach,
            cell_size,
            cells_per_unit: layout.cells_per_unit,
            row_shift: shift.min(ROW_BITS),
            starts: vec![0; buckets + 1],
            present,
            positions: [(); 3].map(|()| vec![0.0; total + LANES]),
            directions: vec![0; total + LANES],
            weights: vec![Spectrum::ZERO; total],
            normals: vec![0; if normals { total } else { 0 }],
            edges: vec![0; total],
        };
        let tasks = map.tasks(&orders, &layout);
        tasks
            .into_par_iter()
            .for_each(|task| task.fill(&layout, chunks, &orders));
        map.starts[buckets] = total as u32;
        map
    }

    /// Cuts the arrays into parts.
    fn tasks(&mut self, orders: &[ChunkOrder], layout: &Layout) -> Vec<PartTask<'_>> {
        let mut rest = Arrays {
            positions: self.positions.each_mut().map(|axis| &mut axis[..]),
            directions: &mut self.directions,
            weights: &mut self.weights,
            normals: &mut self.normals,
            edges: &mut self.edges,
        };
        let buckets = self.starts.len() - 1;
        let mut first = 0;
        let mut tasks = Vec::with_capacity(PARTS);
        for (part, starts) in self.starts[..buckets]
            .chunks_exact_mut(layout.buckets_per_part)
            .enumerate()
        {
            let size = orders
                .iter()
                .map(|c| (c.starts[part + 1] - c.starts[part]) as usize)
                .sum();
            let (arrays, after) = rest.split_at(size);
            rest = after;
            tasks.push(PartTask {
                part,
                first,
                starts,
                arrays,
            });
            first += size as u32;
        }
        tasks
    }
}

impl Layout {
    /// Orders a chunk by part, and marks what is `present`.
    fn split(&self, chunk: &[Record], present: &[AtomicU64]) -> ChunkOrder {
        let mark = |record: &Record| {
            let hash = self.hash(record);
            let (word, bit) = presence(hash, present.len());
            present[word].fetch_or(bit, Ordering::Relaxed);
            hash & self.mask
        };
        let buckets: Vec<u32> = chunk.iter().map(mark).collect();
        let part_of = |bucket: u32| bucket as usize / self.buckets_per_part;
        let mut starts = vec![0_u32; PARTS + 1];
        for &bucket in &buckets {
            starts[part_of(bucket) + 1] += 1;
        }
        for part in 0..PARTS {
            starts[part + 1] += starts[part];
        }
        let mut entries = vec![(0, 0); chunk.len()];
        let mut next = starts.clone();
        for (index, &bucket) in buckets.iter().enumerate() {
            let slot = &mut next[part_of(bucket)];
            entries[*slot as usize] = (bucket, index as u32);
            *slot += 1;
        }
        ChunkOrder { entries, starts }
    }

    /// Hash of the record's cell and row; its low bits are the bucket.
    fn hash(&self, record: &Record) -> u32 {
        let first = bucket_of(cell(record.position, self.cells_per_unit));
        first.wrapping_add(row_of(self.direction_key(record)))
    }

    fn direction_key(&self, record: &Record) -> u32 {
        self.row_shift.map_or(0, |shift| sort_key(record.direction, shift))
    }
}

/// The parts of records, each in an array.
struct Arrays<'a> {
    positions: [&'a mut [f32]; 3],
    directions: &'a mut [u32],
    weights: &'a mut [Spectrum],
    normals: &'a mut [u16],
    edges: &'a mut [u8],
}

impl<'a> Arrays<'a> {
    fn split_at(self, size: usize) -> (Self, Self) {
        let [(x, x_after), (y, y_after), (z, z_after)] = self.positions.map(|axis| axis.split_at_mut(size));
        let (directions, directions_after) = self.directions.split_at_mut(size);
        let (weights, weights_after) = self.weights.split_at_mut(size);
        let (normals, normals_after) = self.normals.split_at_mut(size.min(self.normals.len()));
        let (edges, edges_after) = self.edges.split_at_mut(size);
        let before = Self {
            positions: [x, y, z],
            directions,
            weights,
            normals,
            edges,
        };
        let after = Self {
            positions: [x_after, y_after, z_after],
            directions: directions_after,
            weights: weights_after,
            normals: normals_after,
            edges: edges_after,
        };
        (before, after)
    }

    fn set(&mut self, index: usize, record: &Record) {
        for (axis, coordinate) in self.positions.iter_mut().zip(record.position.to_array()) {
            axis[index] = coordinate;
        }
        self.directions[index] = record.direction;
        self.weights[index] = record.weight;
        if let Some(normal) = self.normals.get_mut(index) {
            *normal = record.normal;
        }
        self.edges[index] = record.edges;
    }
}

/// One part of the map, to be filled.
struct PartTask<'a> {
    part: usize,
    /// Records in the parts before.
    first: u32,
    starts: &'a mut [u32],
    arrays: Arrays<'a>,
}

impl PartTask<'_> {
    fn fill(mut self, layout: &Layout, chunks: &[Vec<Record>], orders: &[ChunkOrder]) {
        let mut keys: Vec<(u64, u64)> = Vec::with_capacity(self.arrays.weights.len());
        for (chunk, order) in orders.iter().enumerate() {
            for &(bucket, index) in
                &order.entries[order.starts[self.part] as usize..order.starts[self.part + 1] as usize]
            {
                let key = layout.direction_key(&chunks[chunk][index as usize]);
                keys.push((
                    u64::from(bucket) << 32 | u64::from(key),
                    (chunk as u64) << 32 | u64::from(index),
                ));
            }
        }
        keys.sort_unstable();
        let first_bucket = self.part * layout.buckets_per_part;
        let mut sorted = keys.iter().enumerate().peekable();
        for (offset, start) in self.starts.iter_mut().enumerate() {
            while sorted
                .next_if(|(_, (key, _))| ((key >> 32) as usize) < first_bucket + offset)
                .is_some()
            {}
            *start = self.first + sorted.peek().map_or(keys.len(), |(index, _)| *index) as u32;
        }
        for (slot, &(_, place)) in keys.iter().enumerate() {
            self.arrays
                .set(slot, &chunks[(place >> 32) as usize][place as u32 as usize]);
        }
    }
}

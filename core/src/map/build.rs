use super::{MAX_RECORDS, Payload, Place, Record, RecordMap, bucket_of, cell, encode_direction};
use rayon::prelude::*;

/// Parts that the buckets are split into by their high bits, so that each can be sorted on its own.
const PARTS: usize = 256;

/// Records of one chunk of light paths, ordered by part.
struct SortedChunk {
    /// Bucket and record; stable within a part.
    records: Vec<(u32, Record)>,
    /// `starts[p]..starts[p + 1]` are the records of part `p`.
    starts: Vec<u32>,
}

impl RecordMap {
    /// Builds the map for queries of `radius` [scene units]. `chunks` are records in the order of light paths.
    ///
    /// A stable two-pass radix sort on the current rayon pool: every chunk is sorted by the high bits of the bucket, then
    /// every part by the low bits. The result depends on the records and on nothing else.
    ///
    /// # Panics
    /// If there are more than [`MAX_RECORDS`] records.
    #[must_use]
    pub fn build(chunks: Vec<Vec<Record>>, radius: f32) -> Self {
        let total: usize = chunks.iter().map(Vec::len).sum();
        assert!(
            total <= MAX_RECORDS,
            "{total} records in one map: at most {MAX_RECORDS}"
        );
        let buckets = total.next_power_of_two().max(PARTS);
        let buckets_per_part = buckets / PARTS;
        let cells_per_unit = 0.5 / radius;
        let mask = (buckets - 1) as u32;
        let sorted: Vec<SortedChunk> = chunks
            .into_par_iter()
            .map(|chunk| sort_by_part(&chunk, cells_per_unit, mask, buckets_per_part))
            .collect();

        let mut places = vec![Place::default(); total];
        let mut payloads = vec![Payload::default(); total];
        let mut starts = vec![0; buckets + 1];
        let mut tasks = Vec::with_capacity(PARTS);
        let (mut places_left, mut payloads_left) = (places.as_mut_slice(), payloads.as_mut_slice());
        let mut first = 0;
        for (part, starts) in starts[..buckets].chunks_exact_mut(buckets_per_part).enumerate() {
            let size = sorted
                .iter()
                .map(|c| (c.starts[part + 1] - c.starts[part]) as usize)
                .sum();
            let (places, places_rest) = places_left.split_at_mut(size);
            let (payloads, payloads_rest) = payloads_left.split_at_mut(size);
            (places_left, payloads_left) = (places_rest, payloads_rest);
            tasks.push(PartTask {
                part,
                first,
                starts,
                places,
                payloads,
            });
            first += size as u32;
        }
        tasks.into_par_iter().for_each(|task| task.sort(&sorted));
        starts[buckets] = total as u32;
        Self {
            radius,
            cells_per_unit,
            starts,
            places,
            payloads,
        }
    }
}

fn sort_by_part(chunk: &[Record], cells_per_unit: f32, mask: u32, buckets_per_part: usize) -> SortedChunk {
    let buckets: Vec<u32> = chunk
        .iter()
        .map(|r| bucket_of(cell(r.position, cells_per_unit), mask))
        .collect();
    let part_of = |bucket: u32| bucket as usize / buckets_per_part;
    let mut starts = vec![0_u32; PARTS + 1];
    for &bucket in &buckets {
        starts[part_of(bucket) + 1] += 1;
    }
    for part in 0..PARTS {
        starts[part + 1] += starts[part];
    }
    let mut order = vec![0_u32; chunk.len()];
    let mut next = starts.clone();
    for (index, &bucket) in buckets.iter().enumerate() {
        let slot = &mut next[part_of(bucket)];
        order[*slot as usize] = index as u32;
        *slot += 1;
    }
    let records = order
        .into_iter()
        .map(|i| (buckets[i as usize], chunk[i as usize]))
        .collect();
    SortedChunk { records, starts }
}

/// One part of the map, to be filled.
struct PartTask<'a> {
    part: usize,
    /// Records in the parts before.
    first: u32,
    starts: &'a mut [u32],
    places: &'a mut [Place],
    payloads: &'a mut [Payload],
}

impl PartTask<'_> {
    fn sort(self, sorted: &[SortedChunk]) {
        let low = |bucket: u32| bucket as usize & (self.starts.len() - 1);
        let mut next = vec![0_u32; self.starts.len()];
        for (bucket, _) in self.records(sorted) {
            next[low(*bucket)] += 1;
        }
        let mut sum = 0;
        for slot in &mut next {
            sum += std::mem::replace(slot, sum);
        }
        for (bucket, record) in self.records(sorted) {
            let slot = &mut next[low(*bucket)];
            self.places[*slot as usize] = Place {
                position: record.position.to_array(),
                direction: encode_direction(record.direction),
            };
            self.payloads[*slot as usize] = Payload {
                weight: record.weight,
                edges: record.edges,
            };
            *slot += 1;
        }
        let mut start = self.first;
        for (slot, end) in self.starts.iter_mut().zip(next) {
            *slot = start;
            start = self.first + end;
        }
    }

    fn records<'b>(&self, sorted: &'b [SortedChunk]) -> impl Iterator<Item = &'b (u32, Record)> + use<'b> {
        let part = self.part;
        sorted
            .iter()
            .flat_map(move |c| &c.records[c.starts[part] as usize..c.starts[part + 1] as usize])
    }
}

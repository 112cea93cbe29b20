use super::*;
use crate::math::warp::square_to_sphere;
use crate::random::{PathRandom, Stream};
use crate::spectrum::Spectrum;

fn records(count: u64, extent: f32) -> Vec<Cone> {
    (0..count)
        .map(|i| {
            let mut random = PathRandom::new(7, 1, Stream::Light, i);
            let position = Vec3::new(random.next_1d(), random.next_1d(), 0.1 * random.next_1d()) * extent
                - Vec3::splat(extent / 2.0);
            let direction = square_to_sphere(random.next_2d());
            Cone::new(
                position,
                Vec3::Z,
                direction,
                Spectrum::splat(i as f32),
                i as u32,
                u8::MAX,
            )
        })
        .collect()
}

/// Indices of the records found, and how many were read.
fn found(map: &ConeMap, center: Vec3, direction: Vec3, reach: &Reach) -> (Vec<u32>, u64) {
    let mut indices = Vec::new();
    let mut candidates = Candidates::new(map);
    let read = candidates.gather(std::iter::once((center, direction)), reach);
    candidates.query(center, direction, reach, |n| indices.push(n.weight().mean() as u32));
    assert!(read >= indices.len() as u64);
    (indices, read)
}

fn chunked<R: Copy>(all: &[R], size: usize) -> Vec<Vec<R>> {
    all.chunks(size).map(<[_]>::to_vec).collect()
}

#[test]
fn a_query_finds_each_record_in_reach_once_and_no_other() {
    let all = records(20_000, 10.0);
    for (radius, theta, least) in [(0.21, PI, 500), (0.5, 0.3, 80), (1.0, 0.05, 8), (0.6, 1.4, 500)] {
        let reach = Reach::new(radius, theta);
        let narrower = Reach::new(0.7 * radius, (0.6 * theta).min(1.0));
        let map = ConeMap::build(chunked(&all, 777), &reach, false);
        let mut hits = 0;
        for i in 0..500 {
            let mut random = PathRandom::new(8, 1, Stream::Camera, i);
            let center =
                Vec3::new(random.next_1d(), random.next_1d(), 0.1 * random.next_1d()) * 10.0 - Vec3::splat(5.0);
            let direction = square_to_sphere(random.next_2d());
            for reach in [reach, narrower] {
                let (mut got, _) = found(&map, center, direction, &reach);
                got.sort_unstable();
                let inside = |r: &&Cone| {
                    (r.position - center).length_squared() < reach.radius * reach.radius
                        && (r.direction() - direction).length_squared() < reach.chord2
                };
                let expected: Vec<u32> = all.iter().filter(inside).map(|r| r.weight.mean() as u32).collect();
                assert_eq!(got, expected);
                hits += got.len();
            }
        }
        assert!(hits > least, "the test looks at something: {hits}");
    }
}

#[test]
fn a_group_finds_for_each_query_what_it_finds_alone() {
    let all = records(40_000, 4.0);
    for (radius, theta, least) in [(0.3, PI, 10_000), (0.4, 0.3, 1_000), (0.1, 0.02, 0), (0.3, 1.5, 5_000)] {
        let reach = Reach::new(radius, theta);
        let map = ConeMap::build(chunked(&all, 999), &reach, false);
        let mut queries: Vec<(QueryCell, Vec3, Vec3)> = all
            .iter()
            .step_by(20)
            .map(|r| {
                (
                    QueryCell::new(r.position, r.direction(), &reach),
                    r.position,
                    r.direction(),
                )
            })
            .collect();
        queries.sort_by_key(|(cell, ..)| *cell);
        let mut candidates = Candidates::new(&map);
        let (mut hits, mut largest) = (0, 0);
        for group in queries.chunk_by(|a, b| a.0 == b.0) {
            largest = largest.max(group.len());
            candidates.gather(group.iter().map(|(_, center, direction)| (*center, *direction)), &reach);
            for &(_, center, direction) in group {
                let mut indices = Vec::new();
                candidates.query(center, direction, &reach, |n| indices.push(n.weight().mean() as u32));
                assert_eq!(indices, found(&map, center, direction, &reach).0);
                hits += indices.len();
            }
        }
        assert!(hits > least, "the test looks at something: {hits}");
        assert!(theta < 1.0 || largest > 5, "there are groups: {largest}");
    }
}

/// Points, each with its index.
fn points(count: u64, extent: f32) -> Vec<Point<u32>> {
    let records = records(count, extent);
    let point = |(record, payload): (&Cone, u32)| Point {
        position: record.position,
        payload,
    };
    records.iter().zip(0..).map(point).collect()
}

/// Indices of the points found by one query.
fn found_points(map: &PointMap<u32>, center: Vec3, radius: f32) -> Vec<u32> {
    let mut indices = Vec::new();
    let tested = map.query(center, radius, |index| indices.push(*index));
    assert!(tested >= indices.len() as u64);
    indices
}

#[test]
fn a_query_for_points_finds_each_in_reach_once_alone_and_in_a_group() {
    let all = points(20_000, 10.0);
    let map = PointMap::build(chunked(&all, 777), 0.21);
    // The centre, the radius and the number of queries, in lists as tasks leave them.
    let queries: Vec<(Vec3, f32, usize)> = (0..2_000)
        .map(|i| {
            let radius = [0.21, 0.05, 0.3][i % 3];
            (all[7 * i].position + Vec3::splat(0.05), radius, i)
        })
        .collect();
    let answers = map.answer(
        &chunked(&queries, 99),
        |query| (query.0, query.1),
        || false,
        |query, near| {
            let mut indices = Vec::new();
            near.query(query.0, query.1, |index| indices.push(*index));
            (query.2, indices)
        },
    );
    let mut answers: Vec<(usize, Vec<u32>)> = answers.unwrap().concat();
    answers.sort_by_key(|(number, _)| *number);
    assert_eq!(answers.len(), queries.len());
    let mut hits = 0;
    for ((center, radius, number), (answered, mut indices)) in queries.into_iter().zip(answers) {
        assert_eq!(number, answered);
        assert_eq!(
            indices,
            found_points(&map, center, radius),
            "the same, in the same order"
        );
        indices.sort_unstable();
        let inside = |p: &&Point<u32>| (p.position - center).length_squared() < radius * radius;
        let expected: Vec<u32> = all.iter().filter(inside).map(|p| p.payload).collect();
        assert_eq!(indices, expected);
        hits += indices.len();
    }
    assert!(hits > 2_000, "the test looks at something: {hits}");
}

#[test]
fn order_of_points_does_not_depend_on_chunks_or_threads() {
    let all = points(5_000, 2.0);
    let build = |size: usize, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| PointMap::build(chunked(&all, size), 0.3))
    };
    let (one, seven) = (build(5_000, 1), build(97, 7));
    for center in all.iter().step_by(91).map(|point| point.position) {
        let found = found_points(&one, center, 0.3);
        assert!(!found.is_empty());
        assert_eq!(found, found_points(&seven, center, 0.3));
    }
}

#[test]
fn an_answer_can_be_cancelled() {
    let all = points(100, 1.0);
    let map = PointMap::build(vec![all.clone()], 0.2);
    let answers = map.answer(&[all], |point| (point.position, 0.2), || true, |_, _| ());
    assert!(answers.is_none());
}

#[test]
fn order_does_not_depend_on_chunks_or_threads() {
    let all = records(5_000, 2.0);
    let reach = Reach::new(0.3, 0.5);
    let build = |size: usize, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| ConeMap::build(chunked(&all, size), &reach, true))
    };
    let (one, seven) = (build(5_000, 1), build(97, 7));
    for i in 0..50 {
        let (center, direction) = (all[i * 91].position, all[i * 91].direction());
        assert_eq!(
            found(&one, center, direction, &reach),
            found(&seven, center, direction, &reach)
        );
    }
}

#[test]
fn what_occupancy_drops_changes_neither_what_is_found_nor_its_order() {
    let all = records(20_000, 4.0);
    let reach = Reach::new(0.3, 0.4);
    let queries: Vec<(Vec3, Vec3)> = records(12, 3.9)
        .iter()
        .map(|r| (r.position + Vec3::splat(0.01), r.direction()))
        .collect();
    let occupancy = Occupancy::new(&reach, queries.len());
    let mut last = Default::default();
    for (center, direction) in &queries {
        occupancy.mark(*center, *direction, &mut last);
    }
    let kept: Vec<Cone> = all
        .iter()
        .copied()
        .filter(|r| occupancy.may_count_at(r.position) && occupancy.may_count(r.position, r.direction()))
        .collect();
    assert!(kept.len() < all.len() / 4, "most are dropped: {} are left", kept.len());
    let (whole, culled) = (
        ConeMap::build(chunked(&all, 999), &reach, false),
        ConeMap::build(chunked(&kept, 999), &reach, false),
    );
    let mut hits = 0;
    for (center, direction) in queries {
        let (expected, _) = found(&whole, center, direction, &reach);
        assert_eq!(found(&culled, center, direction, &reach).0, expected);
        hits += expected.len();
    }
    assert!(hits > 20, "the test looks at something: {hits}");
}

#[test]
fn a_query_reads_few_records_that_do_not_count() {
    let flat: Vec<Cone> = (0..400_000)
        .map(|i| {
            let mut random = PathRandom::new(7, 1, Stream::Light, i);
            let position = Vec3::new(random.next_1d(), random.next_1d(), 0.0);
            let direction = square_to_sphere(random.next_2d());
            Cone::new(position, Vec3::Z, direction, Spectrum::ONE, 1, u8::MAX)
        })
        .collect();
    for (radius, theta) in [(0.05, 0.3), (0.02, 0.1)] {
        let reach = Reach::new(radius, theta);
        let map = ConeMap::build(chunked(&flat, 4096), &reach, false);
        let (mut counted, mut read) = (0, 0);
        for query in flat.iter().step_by(400) {
            let (indices, r) = found(&map, query.position, query.direction(), &reach);
            (counted, read) = (counted + indices.len(), read + r as usize);
        }
        let ratio = read as f64 / counted as f64;
        println!("radius {radius}, theta {theta}: {ratio:.2} read for each counted, {counted} counted");
        assert!(ratio < 8.0, "{ratio}");
        assert!(map.bytes() <= 32 * flat.len(), "{} bytes", map.bytes());
    }
}

/// Far from the origin positions lie on a lattice that is coarse against the radius. Queries reach further there, so that what they
/// find stands for the area of their disc: neither nothing nor a multiple. Cells beyond the last are one.
#[test]
fn far_from_the_origin_queries_find_what_their_disc_holds() {
    const COUNT: u64 = 40_000;
    for doublings in [10, 21, 22, 23, 26, 40] {
        let radius = 0.02_f32;
        let distance = radius * (2.0_f32).powi(doublings);
        let reach = Reach::new(radius, PI);
        let disc = reach.at(Vec3::new(distance, 0.0, -distance)).radius();
        assert_eq!(disc > radius, doublings > 19);
        // A square of eight discs' widths in the plane y = 0.
        let half = 8.0 * disc;
        let all: Vec<Cone> = (0..COUNT)
            .map(|i| {
                let offset = (2.0 * PathRandom::new(7, 1, Stream::Light, i).next_2d() - 1.0) * half;
                let position = Vec3::new(distance + offset.x, 0.0, offset.y - distance);
                Cone::new(position, Vec3::Y, Vec3::Y, Spectrum::ONE, 1, u8::MAX)
            })
            .collect();
        let map = ConeMap::build(chunked(&all, 999), &reach, false);
        let point = |record: &Cone| Point {
            position: record.position,
            payload: (),
        };
        let points = PointMap::build(vec![all.iter().map(point).collect()], radius);
        let occupancy = Occupancy::new(&reach, 100);
        let (mut counted, mut queries) = (0, 0.0);
        for i in 0..200 {
            let offset = (2.0 * PathRandom::new(8, 1, Stream::Camera, i).next_2d() - 1.0) * 0.8 * half;
            let center = Vec3::new(distance + offset.x, 0.0, offset.y - distance);
            let wide = reach.at(center);
            let mut mine = Vec::new();
            points.query(center, wide.radius, |()| mine.push(()));
            let inside = |r: &&Cone| (r.position - center).length_squared() < wide.radius * wide.radius;
            assert_eq!(
                mine.len(),
                all.iter().filter(inside).count(),
                "2^{doublings} radii away"
            );
            occupancy.mark(center, Vec3::Y, &mut Default::default());
            assert!(
                all.iter()
                    .filter(inside)
                    .all(|r| occupancy.may_count(r.position, r.direction()))
            );
            let mut candidates = Candidates::new(&map);
            let _ = candidates.gather(std::iter::once((center, Vec3::Y)), &reach);
            let mut together = 0;
            candidates.query(center, Vec3::Y, &wide, |_| together += 1);
            assert_eq!(together, mine.len());
            counted += mine.len();
            queries += 1.0;
        }
        let expected = queries * COUNT as f32 * PI * disc * disc / (4.0 * half * half);
        let ratio = counted as f32 / expected;
        assert!((ratio - 1.0).abs() < 0.03, "2^{doublings} radii away: {ratio}");
    }
}

#[test]
fn an_empty_map_finds_nothing() {
    let reach = Reach::new(1.0, 0.5);
    let map = ConeMap::build(Vec::new(), &reach, false);
    assert!(map.is_empty());
    assert!(found(&map, Vec3::ZERO, Vec3::Z, &reach).0.is_empty());
}

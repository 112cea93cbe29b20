use super::*;
use crate::math::warp::square_to_sphere;
use crate::random::{PathRandom, Stream};

fn records(count: u64, extent: f32) -> Vec<Record> {
    (0..count)
        .map(|i| {
            let mut random = PathRandom::new(7, 1, Stream::Light, i);
            let position = Vec3::new(random.next_1d(), random.next_1d(), 0.1 * random.next_1d()) * extent
                - Vec3::splat(extent / 2.0);
            let direction = square_to_sphere(random.next_2d());
            Record {
                position,
                direction,
                weight: Spectrum::splat(i as f32),
                edges: i as u32,
            }
        })
        .collect()
}

fn found(map: &RecordMap, center: Vec3) -> Vec<u32> {
    let mut edges = Vec::new();
    let read = map.query(center, |n| edges.push(n.edges()));
    assert!(read >= edges.len() as u64);
    edges
}

#[test]
fn a_query_finds_each_record_within_the_radius_once_and_no_other() {
    let all = records(20_000, 10.0);
    let radius = 0.21;
    let map = RecordMap::build(all.chunks(777).map(<[_]>::to_vec).collect(), radius);
    let mut hits = 0;
    for i in 0..500 {
        let mut random = PathRandom::new(8, 1, Stream::Camera, i);
        let center = Vec3::new(random.next_1d(), random.next_1d(), 0.1 * random.next_1d()) * 10.0 - Vec3::splat(5.0);
        let mut got = found(&map, center);
        got.sort_unstable();
        let expected: Vec<u32> = all
            .iter()
            .filter(|r| (r.position - center).length_squared() < radius * radius)
            .map(|r| r.edges)
            .collect();
        assert_eq!(got, expected);
        hits += got.len();
    }
    assert!(hits > 500, "the test looks at something: {hits}");
}

#[test]
fn order_does_not_depend_on_chunks_or_threads() {
    let all = records(5_000, 2.0);
    let build = |size: usize, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| RecordMap::build(all.chunks(size).map(<[_]>::to_vec).collect(), 0.3))
    };
    let (one, seven) = (build(5_000, 1), build(97, 7));
    for i in 0..50 {
        let center = all[i * 91].position;
        assert_eq!(found(&one, center), found(&seven, center));
    }
}

#[test]
fn an_empty_map_finds_nothing() {
    let map = RecordMap::build(Vec::new(), 1.0);
    assert!(map.is_empty());
    assert!(found(&map, Vec3::ZERO).is_empty());
}

#[test]
fn directions_survive_coding() {
    let axes = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
    let random = (0..10_000).map(|i| square_to_sphere(PathRandom::new(9, 1, Stream::Light, i).next_2d()));
    for direction in axes.into_iter().chain(random) {
        let error = (decode_direction(encode_direction(direction)) - direction).length();
        assert!(error < 7e-5, "{direction}: off by {error}");
    }
}

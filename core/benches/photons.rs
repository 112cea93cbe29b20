//! Light paths, map build, map queries and whole iterations.
//!
//!     cargo bench -p photonfarm-core --bench photons
//!
//! `divan` prints items per second: light paths, records, queries or pixels, as the benchmark's name says.

#[path = "../tests/scenes/mod.rs"]
mod scenes;

use divan::Bencher;
use divan::counter::ItemsCount;
use photonfarm_core::integrator::{Unobserved, render_iteration};
use photonfarm_core::map::{Reach, Record, RecordMap};
use photonfarm_core::math::{PI, Vec2, Vec3};
use photonfarm_core::random::{PathRandom, Sampling, Stream};
use photonfarm_core::settings::{IntegratorSettings, PathSettings, PcfSettings, PppmSettings};
use photonfarm_core::spectrum::Spectrum;

fn main() {
    divan::main();
}

const THREADS: [usize; 2] = [1, 2];

/// Runs `work` on a pool of `threads`.
fn on_pool<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("a pool")
        .install(work)
}

/// Drawing the first 24 numbers of a path, in singles and pairs, on one thread; items are numbers.
#[divan::bench(args = [Sampling::Independent, Sampling::Sobol], sample_count = 20)]
fn random_numbers(bencher: Bencher, sampling: Sampling) {
    const PATHS: u32 = 50_000;
    let sequence = sampling.sequence(1, 2, Stream::Light, 0, PATHS);
    bencher.counter(ItemsCount::new(24 * PATHS)).bench(|| {
        let mut sum = Vec2::ZERO;
        for path in 0..PATHS {
            let mut random = sequence.path(path);
            for _ in 0..8 {
                sum += random.next_1d() * random.next_2d();
            }
        }
        sum
    });
}

/// Tracing and storing photons in a closed box with a mirror and a glass ball; items are light paths.
#[divan::bench(args = THREADS, sample_count = 5)]
fn trace_light_paths(bencher: Bencher, threads: usize) {
    const PATHS: u32 = 400_000;
    let scene = scenes::named("mirror-glass", 1);
    let settings = PppmSettings {
        photons: PATHS,
        sigma1: Some(0.02),
        ..Default::default()
    };
    let settings = IntegratorSettings::Pppm(settings);
    bencher.counter(ItemsCount::new(PATHS)).bench(|| {
        on_pool(threads, || {
            render_iteration(&scene, &settings, 1, 1, &Unobserved)
                .expect("it renders")
                .counts
        })
    });
}

/// Records spread over the walls of a box of side 2.
fn wall_records(count: u64) -> Vec<Vec<Record>> {
    let record = |i: u64| {
        let mut random = PathRandom::new(3, 1, Stream::Light, i);
        let (axis, side) = (
            (random.next_1d() * 3.0) as usize,
            if random.next_1d() < 0.5 { 0.0 } else { 2.0 },
        );
        let mut position = [2.0 * random.next_1d(), 2.0 * random.next_1d(), 2.0 * random.next_1d()];
        position[axis] = side;
        let mut direction = Vec3::ZERO;
        direction[axis] = 1.0 - side;
        Record::new(Vec3::from_array(position), direction, direction, Spectrum::ONE, 1)
    };
    (0..count)
        .map(record)
        .collect::<Vec<_>>()
        .chunks(8192)
        .map(<[_]>::to_vec)
        .collect()
}

/// A radius at which a query among a million wall records finds about two.
const RADIUS: f32 = 0.004;

/// Building the map; items are records.
#[divan::bench(args = THREADS, sample_count = 10)]
fn build_map(bencher: Bencher, threads: usize) {
    const RECORDS: u64 = 1_000_000;
    let records = wall_records(RECORDS);
    bencher
        .counter(ItemsCount::new(RECORDS))
        .with_inputs(|| records.clone())
        .bench_values(|records| on_pool(threads, || RecordMap::build(records, &Reach::new(RADIUS, PI), false)));
}

/// Queries in random order that find about two records each, on one thread; items are queries.
#[divan::bench(sample_count = 10)]
fn query_map(bencher: Bencher) {
    const QUERIES: u64 = 200_000;
    let reach = Reach::new(RADIUS, PI);
    let map = RecordMap::build(wall_records(1_000_000), &reach, false);
    let centers: Vec<Vec3> = wall_records(QUERIES)
        .into_iter()
        .flatten()
        .map(|r| r.position)
        .collect();
    bencher.counter(ItemsCount::new(QUERIES)).bench(|| {
        let mut sum = Spectrum::ZERO;
        for center in &centers {
            map.query(*center, &reach, |n| sum += n.weight());
        }
        sum
    });
}

/// Whole iterations of the box with a mirror and a glass ball at 256 x 256 pixels on two threads; items are pixels.
#[divan::bench(args = ["path", "pppm", "pcf"], sample_count = 5)]
fn iteration(bencher: Bencher, integrator: &str) {
    const RESOLUTION: u32 = 256;
    let scene = scenes::named("mirror-glass", RESOLUTION);
    let settings = match integrator {
        "path" => IntegratorSettings::Path(PathSettings {
            samples: 1,
            ..Default::default()
        }),
        "pppm" => IntegratorSettings::Pppm(PppmSettings::default()),
        _ => IntegratorSettings::Pcf(PcfSettings {
            samples: 1,
            ..Default::default()
        }),
    };
    bencher.counter(ItemsCount::new(RESOLUTION * RESOLUTION)).bench(|| {
        on_pool(2, || {
            render_iteration(&scene, &settings, 1, 1, &Unobserved)
                .expect("it renders")
                .counts
        })
    });
}

//! Light paths, map build, map queries and whole iterations.
//!
//!     cargo bench -p photonfarm-core --bench photons
//!
//! `divan` prints items per second: light paths, records, queries or pixels, as the benchmark's name says.

#[path = "../tests/scenes/mod.rs"]
mod scenes;

use divan::Bencher;
use divan::counter::ItemsCount;
use photonfarm_core::density::{Point, PointMap};
use photonfarm_core::integrator::{Unobserved, render_iteration};
use photonfarm_core::math::{Vec2, Vec3};
use photonfarm_core::random::{PathRandom, Sampling, Stream};
use photonfarm_core::settings::{IntegratorSettings, PathSettings, PcfSettings, PppmSettings, VcmSettings};
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

/// Points spread over the walls of a box of side 2, each with flux.
fn wall_points(count: u64) -> Vec<Vec<Point<Spectrum>>> {
    let point = |i: u64| {
        let mut random = PathRandom::new(3, 1, Stream::Light, i);
        let (axis, side) = (
            (random.next_1d() * 3.0) as usize,
            if random.next_1d() < 0.5 { 0.0 } else { 2.0 },
        );
        let mut position = [2.0 * random.next_1d(), 2.0 * random.next_1d(), 2.0 * random.next_1d()];
        position[axis] = side;
        Point {
            position: Vec3::from_array(position),
            payload: Spectrum::ONE,
        }
    };
    (0..count)
        .map(point)
        .collect::<Vec<_>>()
        .chunks(8192)
        .map(<[_]>::to_vec)
        .collect()
}

/// A radius at which a query among a million wall points finds about two.
const RADIUS: f32 = 0.004;

/// Building the map; items are points.
#[divan::bench(args = THREADS, sample_count = 10)]
fn build_map(bencher: Bencher, threads: usize) {
    const POINTS: u64 = 1_000_000;
    let points = wall_points(POINTS);
    bencher
        .counter(ItemsCount::new(POINTS))
        .with_inputs(|| points.clone())
        .bench_values(|points| on_pool(threads, || PointMap::build(points, RADIUS)));
}

/// Queries in random order that find about two points each, on one thread; items are queries.
#[divan::bench(sample_count = 10)]
fn query_map(bencher: Bencher) {
    const QUERIES: u64 = 200_000;
    let map = PointMap::build(wall_points(1_000_000), RADIUS);
    let centers: Vec<Vec3> = wall_points(QUERIES)
        .into_iter()
        .flatten()
        .map(|point| point.position)
        .collect();
    bencher.counter(ItemsCount::new(QUERIES)).bench(|| {
        let mut sum = Spectrum::ZERO;
        for center in &centers {
            map.query(*center, RADIUS, |flux| sum += *flux);
        }
        sum
    });
}

/// The same queries answered together, on one thread; items are queries.
#[divan::bench(sample_count = 10)]
fn query_map_together(bencher: Bencher) {
    const QUERIES: u64 = 200_000;
    let map = PointMap::build(wall_points(1_000_000), RADIUS);
    let centers = wall_points(QUERIES);
    bencher.counter(ItemsCount::new(QUERIES)).bench(|| {
        on_pool(1, || {
            map.answer(
                &centers,
                |point| (point.position, RADIUS),
                || false,
                |point, near| {
                    let mut sum = Spectrum::ZERO;
                    near.query(point.position, RADIUS, |flux| sum += *flux);
                    sum
                },
            )
        })
    });
}

/// Whole iterations of the box with a mirror and a glass ball at 256 x 256 pixels on two threads; items are pixels.
#[divan::bench(args = ["path", "pppm", "pcf", "vcm"], sample_count = 5)]
fn iteration(bencher: Bencher, integrator: &str) {
    const RESOLUTION: u32 = 256;
    let scene = scenes::named("mirror-glass", RESOLUTION);
    let settings = match integrator {
        "path" => IntegratorSettings::Path(PathSettings {
            samples: 1,
            ..Default::default()
        }),
        "pppm" => IntegratorSettings::Pppm(PppmSettings::default()),
        "vcm" => IntegratorSettings::Vcm(VcmSettings::default()),
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

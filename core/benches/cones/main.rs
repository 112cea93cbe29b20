//! The cone map against the thesis's kd-tree and a grid of positions, on the cones and queries of real iterations; and how
//! an iteration's phases scale on two threads.
//!
//!     cargo bench -p photonfarm-core --bench cones
//!     cargo bench -p photonfarm-core --bench cones -- phases
//!
//! Queries are those of a quarter of the picture, at four samples per pixel, the default: every structure is asked all of them. An
//! argument after `--` is the number of light paths, a million by default, or `phases` for the phases of iterations alone. Every structure must find the same cones, with sums
//! equal to rounding. Times of queries and builds are processor time of one thread, so that a busy machine changes them little;
//! the phases of an iteration are wall-clock time and mean something on an idle machine alone. It runs on Linux.

mod baselines;
#[path = "../../tests/scenes/mod.rs"]
mod scenes;

use baselines::{Grid, KdTree};
use photonfarm_core::density::{Candidates, Cone, ConeMap, QueryCell, Reach};
use photonfarm_core::integrator::pcf::workload::Workload;
use photonfarm_core::integrator::{Observer, Phase, render_iteration};
use photonfarm_core::math::Vec3;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{DirectionSampler, IntegratorSettings, LookupVertex, PcfSettings};
use photonfarm_core::spectrum::Spectrum;
use std::sync::Mutex;
use std::time::Instant;

/// Light paths per iteration: that of the thesis is 2 million.
const LIGHT_PATHS: u32 = 1_000_000;

/// Pixels across and down.
const RESOLUTION: u32 = 256;

/// Least processor time of a measurement [s].
const LEAST_SECONDS: f64 = 0.1;

/// Iterations whose phases are measured.
const RUNS: u32 = 3;

/// How cones choose their directions: as in most of the thesis, and with camera connections.
const BSDF: &[DirectionSampler] = &[DirectionSampler::Bsdf];
const CAMERA: &[DirectionSampler] = &[DirectionSampler::Bsdf, DirectionSampler::Camera];

/// What a query found.
#[derive(Clone, Copy, Debug, Default)]
struct Found {
    sum: Spectrum,
    counted: u64,
    read: u64,
}

/// Something that finds the cones within reach of a query.
trait Structure: Sized {
    /// Its name in the table.
    const NAME: &'static str;
    /// Builds it on the current rayon pool, for queries that reach as far as `reach`.
    fn build(records: Vec<Vec<Cone>>, reach: &Reach) -> Self;
    /// Memory that it keeps [bytes].
    fn bytes(&self) -> usize;
    /// Answers `queries`, in their order.
    fn run(&self, queries: &[(Vec3, Vec3)], reach: &Reach, found: &mut Vec<Found>);
}

impl Structure for ConeMap {
    const NAME: &'static str = "ours";

    fn build(records: Vec<Vec<Cone>>, reach: &Reach) -> Self {
        Self::build(records, reach, false)
    }

    fn bytes(&self) -> usize {
        self.bytes()
    }

    fn run(&self, queries: &[(Vec3, Vec3)], reach: &Reach, found: &mut Vec<Found>) {
        let cell = |&(center, direction): &(Vec3, Vec3)| QueryCell::new(center, direction, reach);
        let mut order: Vec<(QueryCell, usize)> = queries.iter().map(cell).zip(0..).collect();
        order.sort_unstable();
        found.resize(queries.len(), Found::default());
        let mut candidates = Candidates::new(self);
        for group in order.chunk_by(|a, b| a.0 == b.0) {
            let mut read = candidates.gather(group.iter().map(|(_, index)| queries[*index]), reach);
            for &(_, index) in group {
                let (center, direction) = queries[index];
                let mut sum = Found::default();
                read += candidates.query(center, direction, reach, |cone| {
                    sum.counted += 1;
                    sum.sum += cone.weight();
                });
                sum.read = std::mem::take(&mut read);
                found[index] = sum;
            }
        }
    }
}

/// Processor time of the calling thread [s].
fn thread_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux tells a thread's time");
    let nanoseconds: f64 = text.split(' ').next().and_then(|t| t.parse().ok()).expect("a number");
    nanoseconds * 1e-9
}

/// A structure's row of the table.
struct Row {
    name: String,
    records: usize,
    queries_per_second: f64,
    read_per_counted: f64,
    bytes_per_record: f64,
    build_seconds: f64,
    found: Vec<Found>,
}

/// Measures a structure on the calling thread and a pool of one.
fn measure<S: Structure>(cones: &str, records: &[Vec<Cone>], queries: &[(Vec3, Vec3)], reach: &Reach) -> Row {
    let count: usize = records.iter().map(Vec::len).sum();
    let input = records.to_vec();
    let start = thread_seconds();
    let structure = S::build(input, reach);
    let build_seconds = thread_seconds() - start;
    let mut found = Vec::with_capacity(queries.len());
    let (start, mut rounds) = (thread_seconds(), 0);
    while rounds < 1 || thread_seconds() - start < LEAST_SECONDS {
        found.clear();
        structure.run(queries, reach, &mut found);
        rounds += 1;
    }
    let seconds = (thread_seconds() - start) / f64::from(rounds);
    let total = |part: fn(&Found) -> u64| found.iter().map(part).sum::<u64>() as f64;
    Row {
        name: format!("{}, {cones}", S::NAME),
        records: count,
        queries_per_second: queries.len() as f64 / seconds,
        read_per_counted: total(|f| f.read) / total(|f| f.counted),
        bytes_per_record: structure.bytes() as f64 / count as f64,
        build_seconds,
        found,
    }
}

/// Stops where two structures disagree: other cones, or sums further apart than rounding explains.
fn assert_same(a: &Row, b: &Row) {
    for (query, (x, y)) in a.found.iter().zip(&b.found).enumerate() {
        let tolerance = 1e-5 * (1.0 + (x.counted as f32).sqrt()) * x.sum.max_component();
        let difference = (0..3).map(|c| (x.sum.to_rgb()[c] - y.sum.to_rgb()[c]).abs());
        assert!(
            x.counted == y.counted && difference.fold(0.0, f32::max) <= tolerance,
            "query {query}: {} found {x:?}, {} found {y:?}",
            a.name,
            b.name
        );
    }
}

/// The thesis's bandwidth: sigma_1 is 0.1 in a room of size 2, theta_1 18 degrees.
fn settings(scene: &Scene, light_paths: u32, k: u32, samplers: &[DirectionSampler]) -> PcfSettings {
    PcfSettings {
        photons: light_paths,
        sigma1: Some(0.1),
        theta1: 18.0,
        lookup_vertex: LookupVertex::Fixed(k),
        samplers: samplers.to_vec(),
        max_depth: scene.wishes.max_depth,
        ..Default::default()
    }
}

/// Compares the structures on one iteration.
fn compare(name: &str, scene: &Scene, settings: &PcfSettings, iteration: u32) {
    let work = Workload::new(scene, settings, 1, iteration).expect("the settings are in range");
    let reach = Reach::new(work.bandwidth.sigma, work.bandwidth.theta);
    let quarter = work.queries.len() / 4;
    let queries = &work.queries[quarter..2 * quarter];
    println!(
        "\n{name}, {:?}, samplers {:?}, iteration {iteration}: sigma {:.4}, theta {:.2} degrees, {} queries",
        settings.lookup_vertex,
        settings.samplers,
        work.bandwidth.sigma,
        work.bandwidth.theta.to_degrees(),
        queries.len(),
    );
    let rows = [
        measure::<KdTree>("all cones", &work.cones, queries, &reach),
        measure::<KdTree>("culled", &work.stored, queries, &reach),
        measure::<Grid>("culled", &work.stored, queries, &reach),
        measure::<ConeMap>("all cones", &work.cones, queries, &reach),
        measure::<ConeMap>("culled", &work.stored, queries, &reach),
    ];
    println!(
        "| structure | cones | queries [1/s] | over the kd-tree of all | read per counted | bytes per cone | build [s] |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for row in &rows {
        assert_same(&rows[0], row);
        println!(
            "| {} | {} | {:.0} | {:.1} | {:.1} | {:.0} | {:.2} |",
            row.name,
            row.records,
            row.queries_per_second,
            row.queries_per_second / rows[0].queries_per_second,
            row.read_per_counted,
            row.bytes_per_record,
            row.build_seconds,
        );
    }
}

/// Wall-clock seconds of an iteration's phases.
struct Clock(Mutex<PhaseTimes>);

/// When the phase that is going on began, which it is, and the seconds of each so far.
type PhaseTimes = (Instant, Option<Phase>, Vec<(Phase, f64)>);

impl Observer for Clock {
    fn phase(&self, phase: Phase) {
        let mut state = self.0.lock().expect("no panic meanwhile");
        let (since, before, seconds) = &mut *state;
        if let Some(before) = *before {
            let spent = since.elapsed().as_secs_f64();
            match seconds.iter_mut().find(|(known, _)| *known == before) {
                Some((_, sum)) => *sum += spent,
                None => seconds.push((before, spent)),
            }
        }
        (*since, *before) = (Instant::now(), Some(phase));
    }
}

/// Seconds of each phase of an iteration on a pool of `threads`: the least of some runs, since other work only adds to them.
fn phases(scene: &Scene, settings: &PcfSettings, threads: usize) -> Vec<(Phase, f64)> {
    let integrator = IntegratorSettings::Pcf(settings.clone());
    let run = || {
        let clock = Clock(Mutex::new((Instant::now(), None, Vec::new())));
        pool(threads).install(|| render_iteration(scene, &integrator, 1, 1, &clock).expect("it renders"));
        clock.0.into_inner().expect("no panic meanwhile").2
    };
    let mut least = run();
    for _ in 1..RUNS {
        for ((_, least), (_, seconds)) in least.iter_mut().zip(run()) {
            *least = least.min(seconds);
        }
    }
    least
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("a pool")
}

/// How an iteration scales from one thread to two.
fn scaling(name: &str, scene: &Scene, settings: &PcfSettings) {
    let (one, two) = (phases(scene, settings, 1), phases(scene, settings, 2));
    let whole = one.iter().map(|(_, seconds)| seconds).sum::<f64>();
    println!("\n{name}, a whole iteration, wall-clock");
    println!("| phase | 1 thread [s] | share | 2 threads [s] | efficiency |");
    println!("| --- | --- | --- | --- | --- |");
    for ((phase, a), (_, b)) in one.iter().zip(&two) {
        println!(
            "| {phase:?} | {a:.2} | {:.0} % | {b:.2} | {:.0} % |",
            100.0 * a / whole,
            100.0 * a / (2.0 * b)
        );
    }
}

fn main() {
    let light_paths = std::env::args().find_map(|a| a.parse().ok()).unwrap_or(LIGHT_PATHS);
    println!("{light_paths} light paths per iteration, {RESOLUTION} x {RESOLUTION} pixels");
    let scenes = ["diffuse-box", "mirror-glass"].map(|name| (name, scenes::named(name, RESOLUTION)));
    let structures = !std::env::args().any(|argument| argument == "phases");
    for (name, scene) in scenes.iter().filter(|_| structures) {
        for (k, samplers) in [(1, BSDF), (1, CAMERA), (2, BSDF)] {
            let settings = settings(scene, light_paths, k, samplers);
            for iteration in [1, 1000] {
                pool(1).install(|| compare(name, scene, &settings, iteration));
            }
        }
    }
    for (name, scene) in &scenes {
        scaling(name, scene, &settings(scene, light_paths, 1, CAMERA));
    }
}

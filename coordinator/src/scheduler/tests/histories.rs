//! Random histories: messages lost, repeated and reordered, workers lost, clumsy, lying and several on one machine, commits failed, restarts at
//! any moment with the clock set forth or back, jobs paused, extended, retried,
//! cancelled, stopped.
//!
//! Whatever happens: every leaf counts once or is reported, tokens rise, what is remembered is what is kept, what two
//! principals agree about is right, nobody honest is refuted, and once the faults stop every job ends. Seeds are fixed;
//! `PHOTONFARM_HISTORIES` sets their number.

use super::world::{Mode, Seen, World};

/// Histories of an ordinary run of the tests.
const HISTORIES: u64 = 5_000;
/// Steps of a history.
const STEPS: u32 = 150;

/// Tells which history failed.
struct Seed(u64);

impl Drop for Seed {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("history {} failed", self.0);
        }
    }
}

fn run(seed: u64) {
    let _seed = Seed(seed);
    let mode = match seed % 4 {
        0 => Mode::Honest,
        1 => Mode::Guarded,
        _ => Mode::Free,
    };
    let mut world = World::new(seed, mode);
    for _ in 0..STEPS {
        world.step();
    }
    world.check();
    world.bring_to_end();
    world.check_end();
}

#[test]
fn random_histories_count_every_leaf_once_or_report_it() {
    let asked = std::env::var("PHOTONFARM_HISTORIES").ok();
    let count = asked.map_or(HISTORIES, |text| {
        text.parse().expect("PHOTONFARM_HISTORIES is a number")
    });
    let threads = std::thread::available_parallelism().map_or(1, usize::from) as u64;
    std::thread::scope(|scope| {
        for thread in 0..threads {
            scope.spawn(move || (thread..count).step_by(threads as usize).for_each(run));
        }
    });
}

/// The histories are worth something only if what they are about does happen in them.
#[test]
fn histories_contain_what_they_are_about() {
    let mut seen = Seen::default();
    for seed in 0..200 {
        let mut world = World::new(seed, Mode::Free);
        (0..STEPS).for_each(|_| world.step());
        world.bring_to_end();
        world.check_end();
        seen.add(&world.seen);
    }
    let Seen {
        verdicts,
        disputes,
        quarantines,
        stops,
        reopened,
        lies_that_counted,
        poisoned,
        links,
        called_broken,
        repeated,
        overtaken,
        retried,
        drained,
    } = seen;
    let counts = [
        verdicts,
        disputes,
        quarantines,
        stops,
        reopened,
        lies_that_counted,
        poisoned,
        links,
        called_broken,
        repeated,
        overtaken,
        retried,
        drained,
    ];
    assert!(counts.iter().all(|count| *count > 0), "{counts:?}");
}

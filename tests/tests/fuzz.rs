//! Every fuzz target on mutations of its seeds, the same ones each time. `fuzz/README.md` tells how to go on for longer.

use photonfarm_core::random::{PathRandom, Stream};
use photonfarm_tests::fuzz::{TARGETS, target};
use rustix::time::{ClockId, clock_gettime};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::Duration;

/// Mutations of each target.
const ROUNDS: u64 = 4000;
/// Most processor time for one input of a few hundred bytes.
const SLOWEST: Duration = Duration::from_secs(10);

/// Processor time of this thread: whatever else the machine does counts nothing.
fn processor_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.try_into().unwrap()
}

fn below(random: &mut PathRandom, limit: usize) -> usize {
    ((random.next_1d() * limit as f32) as usize).min(limit - 1)
}

/// Changes bits and bytes, cuts, doubles, splices with another seed, and puts in numbers at the edges of their types.
fn mutate(seeds: &[Vec<u8>], random: &mut PathRandom) -> Vec<u8> {
    let mut bytes = seeds[below(random, seeds.len())].clone();
    for _ in 0..[1, 1, 2, 8][below(random, 4)] {
        if bytes.is_empty() {
            return bytes;
        }
        let at = below(random, bytes.len());
        let end = (at + [1, 2, 4, 8][below(random, 4)]).min(bytes.len());
        match below(random, 8) {
            0 => bytes.truncate(at),
            1 => bytes[at] = below(random, 256) as u8,
            2 => bytes[at] ^= 1 << below(random, 8),
            3 => bytes[at..end].fill([0, 0x7f, 0x80, 0xff][below(random, 4)]),
            4 => bytes[at] = b"-+.eE09\"'<>{}[],:$/\\\n "[below(random, 22)],
            5 => drop(bytes.splice(at..at, bytes[at..end].to_vec())),
            6 => drop(bytes.drain(at..end)),
            _ => {
                let other = &seeds[below(random, seeds.len())];
                let from = below(random, other.len().max(1)).min(other.len());
                bytes.truncate(at);
                bytes.extend_from_slice(&other[from..]);
            }
        }
    }
    bytes
}

#[test]
fn no_mutation_makes_a_reader_panic_or_hang() {
    for (index, target) in TARGETS.iter().enumerate() {
        let seeds = (target.seeds)();
        for round in 0..ROUNDS {
            let mut random = PathRandom::new(11, index as u32, Stream::Camera, round);
            let bytes = mutate(&seeds, &mut random);
            let start = processor_time();
            let result = catch_unwind(AssertUnwindSafe(|| (target.run)(&bytes)));
            assert!(result.is_ok(), "{}, round {round}: {bytes:?}", target.name);
            let taken = processor_time() - start;
            assert!(taken < SLOWEST, "{}, round {round} took {taken:?}", target.name);
        }
    }
}

#[test]
fn seeds_are_read() {
    for target in TARGETS {
        let seeds = (target.seeds)();
        assert!(!seeds.is_empty(), "{}", target.name);
        seeds.iter().for_each(|seed| (target.run)(seed));
    }
    let (request, reply) = (target("request"), target("reply"));
    assert!(
        (request.seeds)()
            .iter()
            .chain(&(reply.seeds)())
            .all(|seed| seed.first() == Some(&b'{'))
    );
}

#[test]
fn every_target_has_its_program() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz");
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap();
    for target in TARGETS {
        let program = format!("fuzz_targets/{}.rs", target.name);
        assert!(manifest.contains(&program), "{program} is not in fuzz/Cargo.toml");
        let source = std::fs::read_to_string(folder.join(&program)).unwrap();
        assert!(source.contains(&format!("target(\"{}\")", target.name)), "{program}");
    }
    assert_eq!(manifest.matches("fuzz_targets/").count(), TARGETS.len());
}

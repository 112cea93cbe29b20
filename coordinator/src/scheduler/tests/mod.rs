//! Tests of the scheduler: random histories, and its rules one by one.

mod histories;
mod rules;

use super::record::LeaseRecord;
use super::*;
use photonfarm_core::settings::{IntegratorSettings, PathSettings};
use photonfarm_proto::job::{PhaseSeconds, Totals};

fn spec(iterations: u32) -> JobSpec {
    JobSpec {
        scene: BlobHash::of(b""),
        main: "scene.xml".into(),
        defines: Default::default(),
        integrator: IntegratorSettings::Path(PathSettings::default()),
        iterations,
        seed: 0,
        schedule: Default::default(),
    }
}

fn introduction() -> Register {
    Register {
        name: "w".into(),
        threads: 1,
        renderer: "1+a".into(),
        tags: Default::default(),
    }
}

fn digest(job: JobId, node: NodeKey) -> BlobHash {
    BlobHash::of(format!("{job} {node}").as_bytes())
}

fn delivery(lease: &LeaseRecord, node: NodeKey) -> Delivery {
    let seconds = PhaseSeconds {
        other: 3.0 * node.leaves() as f64,
        ..PhaseSeconds::default()
    };
    Delivery {
        token: lease.token,
        worker: lease.worker,
        job: lease.job,
        node,
        resolution: [4, 4],
        digest: digest(lease.job, node),
        unread: false,
        totals: Totals {
            seconds,
            ..Totals::default()
        },
    }
}

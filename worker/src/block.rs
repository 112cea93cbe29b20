//! Renders the leaves of a lease and sums them in the tree's shape.

use crate::drain::Stop;
use crate::held::LeaseState;
use crate::render::LoadedScene;
use photonfarm_core::film::{FilmError, Node};
use photonfarm_core::integrator::{Observer, Phase, RenderError};
use photonfarm_core::tree::Forest;
use photonfarm_proto::job::{FailureKind, JobSpec, PhaseSeconds, Totals};
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::trace::Tracer;
use photonfarm_proto::worker::Lease;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// What is to be rendered.
pub(crate) struct Task<'a> {
    pub(crate) scene: &'a dyn LoadedScene,
    pub(crate) spec: &'a JobSpec,
    pub(crate) lease: &'a Lease,
    /// Where spans of the iterations go.
    pub(crate) tracer: &'a Tracer,
}

/// A node with what it took.
pub(crate) struct Sum {
    pub(crate) node: Node,
    pub(crate) totals: Totals,
}

/// How the rendering of a block ended.
pub(crate) enum Ending {
    /// All leaves are rendered.
    Complete,
    /// The worker is to stop: the rest goes back, the leaf at hand included if time is up.
    Drained,
    /// The lease is lost: nothing of it counts.
    Lost,
    /// A leaf failed.
    Failed {
        /// The leaf.
        leaf: u32,
        /// How.
        kind: FailureKind,
        /// In words.
        message: String,
    },
}

/// Time that is left for sending a node before the deadline of its job: that of 33 MB, an image of 1920 x 1080, at 1 Gbit/s, and as
/// much again.
const SENDING: Duration = Duration::from_millis(500);

/// The deadline of a job, for one lease: leaves that would come too late are not begun, so that those before them count.
pub(crate) struct Deadline {
    at: Option<Instant>,
    last: Instant,
    longest: Duration,
}

impl Deadline {
    /// The deadline, if there is one; the first leaf is begun at `now`.
    pub(crate) fn new(at: Option<Instant>, now: Instant) -> Self {
        Self {
            at,
            last: now,
            longest: Duration::ZERO,
        }
    }

    /// Whether another leaf would be in time, if it takes as long as the longest so far. A leaf ends at `now`.
    fn allows_another(&mut self, now: Instant) -> bool {
        self.longest = self.longest.max(now.saturating_duration_since(self.last));
        self.last = now;
        self.at.is_none_or(|at| now + self.longest + SENDING <= at)
    }
}

/// Renders the leaves of a lease in order, the first one going on from the statistics `before` if the integrator is sequential.
/// What was summed until the ending is the maximal nodes of the leaves done. Leaves that would miss the deadline are given back.
pub(crate) fn render_block(
    task: &Task,
    mut before: Vec<f32>,
    state: &LeaseState,
    stop: &Stop,
    mut deadline: Deadline,
) -> (Vec<Sum>, Ending) {
    let block = task.lease.node;
    let mut forest = Forest::default();
    let mut leaf_totals = Vec::new();
    let mut ending = Ending::Complete;
    for leaf in block.first()..block.end() {
        if stop.drain.is_cancelled() {
            ending = Ending::Drained;
            break;
        }
        let leaf = leaf as u32;
        let mut span = task.tracer.begin(task.lease.trace, "iteration");
        span.fact("iteration", || u64::from(leaf) + 1);
        let rendered = render_leaf(task, leaf, &before, state, &stop.abandon).and_then(|(node, totals)| {
            before.clone_from(&node.statistics);
            forest
                .push(node)
                .map_err(|error| LeafError::Failed(FailureKind::Render, error.to_string()))?;
            Ok(totals)
        });
        match &rendered {
            Ok(totals) => span.fact("rays", || totals.counts.rays),
            Err(LeafError::Cancelled) => span.failed("given up"),
            Err(LeafError::Failed(_, why)) => span.failed(why),
        }
        drop(span);
        match rendered {
            Ok(totals) => leaf_totals.push(totals),
            Err(LeafError::Cancelled) if state.is_lost() => return (Vec::new(), Ending::Lost),
            Err(LeafError::Cancelled) => {
                ending = Ending::Drained;
                break;
            }
            Err(LeafError::Failed(kind, message)) => {
                ending = Ending::Failed { leaf, kind, message };
                break;
            }
        }
        state.leaf_done();
        if u64::from(leaf) + 1 < block.end() && !deadline.allows_another(Instant::now()) {
            ending = Ending::Drained;
            break;
        }
    }
    let totals_of = |node: &Node| {
        let key = NodeKey {
            level: node.level,
            index: node.index,
        };
        let first = (key.first() - block.first()) as usize;
        let mut totals = Totals::default();
        leaf_totals[first..first + key.leaves() as usize]
            .iter()
            .for_each(|leaf| totals.add(leaf));
        totals
    };
    let sums = forest
        .into_nodes()
        .into_iter()
        .map(|node| Sum {
            totals: totals_of(&node),
            node,
        })
        .collect();
    (sums, ending)
}

enum LeafError {
    /// The lease is lost, or the leaf is given up.
    Cancelled,
    Failed(FailureKind, String),
}

impl From<RenderError> for LeafError {
    fn from(error: RenderError) -> Self {
        match error {
            RenderError::Cancelled => Self::Cancelled,
            RenderError::Setting(_) | RenderError::Layer(_) | RenderError::Window(_) => {
                Self::Failed(FailureKind::Scene, error.to_string())
            }
            RenderError::BadPixel { .. } | RenderError::Statistics { .. } | RenderError::Textures { .. } => {
                Self::Failed(FailureKind::Render, error.to_string())
            }
        }
    }
}

impl From<FilmError> for LeafError {
    fn from(error: FilmError) -> Self {
        Self::Failed(FailureKind::Render, error.to_string())
    }
}

fn render_leaf(
    task: &Task,
    leaf: u32,
    before: &[f32],
    state: &LeaseState,
    abandon: &CancellationToken,
) -> Result<(Node, Totals), LeafError> {
    let Task { scene, spec, .. } = *task;
    let clock = PhaseClock::new(state, abandon);
    let iteration = leaf + 1;
    let render = || scene.render(spec.integrator.with_defaults(), spec.seed, iteration, before, &clock);
    let result = catch_unwind(AssertUnwindSafe(render)).map_err(|panic| {
        LeafError::Failed(
            FailureKind::Panic,
            format!("the renderer panicked: {}", panic_message(&*panic)),
        )
    })?;
    let rendered = result?;
    let seconds = clock.finish();
    let [width, height] = scene.resolution();
    let node = Node::leaf(leaf, width, height, &rendered.pixels)?.with_statistics(rendered.statistics)?;
    let bandwidth = scene.bandwidth(spec.integrator.with_defaults(), iteration, before);
    Ok((
        node,
        Totals {
            counts: rendered.counts,
            seconds,
            bandwidth,
        },
    ))
}

/// What a panic said.
pub(crate) fn panic_message(panic: &(dyn std::any::Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("without a message")
}

/// Takes the times of an iteration's phases, and passes on that a lease is lost or its leaf given up.
struct PhaseClock<'a> {
    state: &'a LeaseState,
    abandon: &'a CancellationToken,
    current: Mutex<(Option<Phase>, Instant, PhaseSeconds)>,
}

impl<'a> PhaseClock<'a> {
    fn new(state: &'a LeaseState, abandon: &'a CancellationToken) -> Self {
        Self {
            state,
            abandon,
            current: Mutex::new((None, Instant::now(), PhaseSeconds::default())),
        }
    }

    fn enter(&self, next: Option<Phase>) -> PhaseSeconds {
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        let (phase, since, seconds) = &mut *current;
        let now = Instant::now();
        let spent = now.duration_since(*since).as_secs_f64();
        match phase {
            Some(Phase::TraceLight) => seconds.trace_light += spent,
            Some(Phase::BuildMap) => seconds.build_map += spent,
            Some(Phase::TraceCamera | Phase::ReadMap) => seconds.trace_camera += spent,
            Some(Phase::Done) | None => seconds.other += spent,
        }
        (*phase, *since) = (next, now);
        *seconds
    }

    fn finish(&self) -> PhaseSeconds {
        self.enter(None)
    }
}

impl Observer for PhaseClock<'_> {
    fn phase(&self, phase: Phase) {
        self.enter(Some(phase));
    }

    fn cancelled(&self) -> bool {
        self.state.is_lost() || self.abandon.is_cancelled()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leaf_is_begun_if_it_would_be_in_time() {
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        let mut deadline = Deadline::new(Some(at(8_000)), start);
        assert!(deadline.allows_another(at(2_000)));
        assert!(deadline.allows_another(at(4_000)));
        assert!(
            deadline.allows_another(at(5_500)),
            "two seconds, as the longest took, and sending are left"
        );
        assert!(!deadline.allows_another(at(5_501)));
        assert!(Deadline::new(None, start).allows_another(at(1 << 40)));
    }
}

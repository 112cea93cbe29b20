//! What rendering took.

use photonfarm_core::integrator::Counts;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The largest and the smallest bandwidth over some iterations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BandwidthRange {
    /// Spatial bandwidth (scene units), largest and smallest.
    pub sigma: [f32; 2],
    /// Angular bandwidth (radians), largest and smallest.
    pub theta: Option<[f32; 2]>,
}

impl BandwidthRange {
    /// The bandwidth of one iteration.
    #[must_use]
    pub fn one(sigma: f32, theta: Option<f32>) -> Self {
        Self {
            sigma: [sigma; 2],
            theta: theta.map(|t| [t; 2]),
        }
    }

    /// The range over both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        let join = |a: [f32; 2], b: [f32; 2]| [a[0].max(b[0]), a[1].min(b[1])];
        let theta = match (self.theta, other.theta) {
            (Some(a), Some(b)) => Some(join(a, b)),
            (a, b) => a.or(b),
        };
        Self {
            sigma: join(self.sigma, other.sigma),
            theta,
        }
    }

    /// Whether every number is finite and not negative.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let valid = |range: &[f32; 2]| range.iter().all(|v| v.is_finite() && *v >= 0.0);
        valid(&self.sigma) && self.theta.as_ref().is_none_or(valid)
    }
}

/// Seconds of wall-clock time by phase, summed over iterations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PhaseSeconds {
    /// Tracing paths from the lights.
    pub trace_light: f64,
    /// Building the map.
    pub build_map: f64,
    /// Tracing paths from the camera and reading the map.
    pub trace_camera: f64,
    /// Everything else within an iteration.
    pub other: f64,
}

impl PhaseSeconds {
    /// The sum of all phases.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.trace_light + self.build_map + self.trace_camera + self.other
    }

    /// Shortens all phases in proportion, so that they do not exceed `most` seconds together.
    pub fn bound(&mut self, most: f64) {
        let total = self.total();
        if total <= most {
            return;
        }
        // Finite seconds may have an infinite sum.
        let share = (most / total).max(0.0);
        let phases = [
            &mut self.trace_light,
            &mut self.build_map,
            &mut self.trace_camera,
            &mut self.other,
        ];
        for phase in phases {
            *phase *= share;
        }
    }

    fn is_valid(&self) -> bool {
        let phases = [self.trace_light, self.build_map, self.trace_camera, self.other];
        phases.iter().all(|seconds| seconds.is_finite() && *seconds >= 0.0)
    }
}

/// The highest that a worker may count in an iteration: far beyond what any iteration does, and so low that the sum over all
/// iterations of a job (at most 2^20) stays a number of 64 bits.
pub const MOST_COUNTED: u64 = 1 << 43;

/// What rendering some iterations took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Totals {
    /// Counts of the renderer.
    #[schema(value_type = Object)]
    pub counts: Counts,
    /// Time by phase.
    pub seconds: PhaseSeconds,
    /// Range of the bandwidth; absent for `path`.
    pub bandwidth: Option<BandwidthRange>,
}

impl Totals {
    /// Adds what other iterations took. Counts saturate.
    pub fn add(&mut self, other: &Self) {
        let (to, from) = (&mut self.counts, &other.counts);
        to.light_paths = to.light_paths.saturating_add(from.light_paths);
        to.records_stored = to.records_stored.saturating_add(from.records_stored);
        to.records_read = to.records_read.saturating_add(from.records_read);
        to.records_counted = to.records_counted.saturating_add(from.records_counted);
        to.rays = to.rays.saturating_add(from.rays);
        let (to, from) = (&mut self.seconds, &other.seconds);
        to.trace_light += from.trace_light;
        to.build_map += from.build_map;
        to.trace_camera += from.trace_camera;
        to.other += from.other;
        self.bandwidth = match (self.bandwidth, other.bandwidth) {
            (Some(a), Some(b)) => Some(a.union(b)),
            (a, b) => a.or(b),
        };
    }

    /// Whether every number may be said of so many iterations: finite, not negative, and no count beyond
    /// [`MOST_COUNTED`] of each iteration.
    #[must_use]
    pub fn is_valid(&self, iterations: u64) -> bool {
        let most = iterations.saturating_mul(MOST_COUNTED);
        let counts = &self.counts;
        let counts = [
            counts.light_paths,
            counts.records_stored,
            counts.records_read,
            counts.records_counted,
            counts.rays,
        ];
        counts.iter().all(|count| *count <= most)
            && self.seconds.is_valid()
            && self.bandwidth.is_none_or(|range| range.is_valid())
    }
}

//! How far a job has come: a bar on a terminal, a few lines elsewhere.

use crate::say::tell;
use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use photonfarm_proto::job::JobStatus;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Least time between two lines where there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);
const TEMPLATE: &str = "{bar:32} {pos}/{len} iterations{msg}, {eta} left";

/// Shows progress on standard error.
pub(crate) struct Progress {
    bar: Option<ProgressBar>,
    started: Instant,
    last_line: Option<Instant>,
    /// Iterations and totals when watching began.
    base: Option<Base>,
}

#[derive(Clone, Copy)]
struct Base {
    iterations: u64,
    light_paths: u64,
    rays: u64,
}

impl Progress {
    /// Begins.
    pub(crate) fn start(iterations: u32) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let style = ProgressStyle::with_template(TEMPLATE).unwrap_or_else(|_| ProgressStyle::default_bar());
            let bar = ProgressBar::new(iterations.into()).with_style(style);
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        });
        Self {
            bar,
            started: Instant::now(),
            last_line: None,
            base: None,
        }
    }

    /// Shows a status.
    pub(crate) fn update(&mut self, status: &JobStatus) {
        let counts = &status.totals.counts;
        let now = Base {
            iterations: status.iterations_rendered,
            light_paths: counts.light_paths,
            rays: counts.rays,
        };
        let base = *self.base.get_or_insert(now);
        let details = details(status, base, self.started.elapsed());
        if let Some(bar) = &self.bar {
            bar.set_position(status.iterations_rendered);
            bar.set_message(details);
            return;
        }
        let due = self.last_line.is_none_or(|last| last.elapsed() >= LINE_INTERVAL);
        if due || status.state.ended() {
            self.last_line = Some(Instant::now());
            let left = time_left(status, base, self.started.elapsed());
            let (done, all) = (status.iterations_rendered, status.spec.iterations);
            tell(format_args!("{done}/{all} iterations{details}{left}"));
        }
    }

    /// Removes the bar.
    pub(crate) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn details(status: &JobStatus, base: Base, elapsed: Duration) -> String {
    let sigma = status
        .totals
        .bandwidth
        .map(|b| format!(", sigma {:.3e}", b.sigma[1]))
        .unwrap_or_default();
    let counts = &status.totals.counts;
    let rate = |count: u64| count as f64 / elapsed.as_secs_f64().max(1e-3) / 1e6;
    let photons = counts.light_paths.saturating_sub(base.light_paths);
    let rays = counts.rays.saturating_sub(base.rays);
    match (photons, rays) {
        (0, 0) => sigma,
        (0, rays) => format!("{sigma}, {:.2} M rays/s", rate(rays)),
        (photons, _) => format!("{sigma}, {:.2} M photons/s", rate(photons)),
    }
}

fn time_left(status: &JobStatus, base: Base, elapsed: Duration) -> String {
    let done = status.iterations_rendered.saturating_sub(base.iterations);
    let left = u64::from(status.spec.iterations).saturating_sub(status.iterations_rendered);
    if done == 0 || left == 0 {
        return String::new();
    }
    let seconds = elapsed.as_secs_f64() / done as f64 * left as f64;
    format!(", {} left", HumanDuration(Duration::from_secs_f64(seconds)))
}

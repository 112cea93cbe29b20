//! How far a job has come: a bar on a terminal, a few lines elsewhere.

use crate::say::tell;
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use photonfarm_proto::job::JobStatus;
use std::io::IsTerminal;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Least time between two lines where there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);
/// How long bytes are sent and fetched without a bar.
const MOMENT: Duration = Duration::from_secs(1);
const TEMPLATE: &str = "{bar:24} {pos}/{len} iterations{msg}";

/// Shows progress on standard error.
pub(crate) struct Progress {
    bar: Option<ProgressBar>,
    started: Instant,
    last_line: Option<Instant>,
    /// Iterations and totals when watching began.
    base: Option<Base>,
    /// The noise of the picture, where it was looked at.
    noise: Option<f64>,
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
        let bar = is_shown_live().then(|| {
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
            noise: None,
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
        let elapsed = self.started.elapsed();
        let details = details(status, base, elapsed, self.noise) + &time_left(status, base, elapsed);
        if let Some(bar) = &self.bar {
            bar.set_length(status.spec.iterations.into());
            bar.set_position(status.iterations_rendered);
            bar.set_message(details);
            return;
        }
        let due = self.last_line.is_none_or(|last| last.elapsed() >= LINE_INTERVAL);
        if due || status.state.ended() {
            self.last_line = Some(Instant::now());
            let (done, all) = (status.iterations_rendered, status.spec.iterations);
            tell(format_args!("{done}/{all} iterations{details}"));
        }
    }

    /// Notes the noise of the picture as it stands, which shows from the next update on.
    pub(crate) fn note_noise(&mut self, noise: f64) {
        self.noise = Some(noise);
    }

    /// Removes the bar.
    pub(crate) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Bytes on their way: a bar, where somebody looks and it takes longer than a moment.
pub(crate) struct Transfer {
    bar: ProgressBar,
    started: Instant,
    shown: bool,
}

impl Transfer {
    /// So many bytes are to be moved in all, of which some were before.
    pub(crate) fn start(what: &'static str, bytes: u64, before: u64) -> Self {
        let template = match bytes {
            0 => "{msg} {bytes}, {bytes_per_sec}",
            _ => "{msg} {bar:24} {bytes} of {total_bytes}, {bytes_per_sec}, {eta} left",
        };
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::hidden().with_style(style).with_message(what);
        bar.set_length(bytes);
        bar.set_position(before);
        bar.reset_eta();
        Self {
            bar,
            started: Instant::now(),
            shown: false,
        }
    }

    /// So many were moved by now.
    pub(crate) fn at(&mut self, bytes: u64) {
        if !self.shown && self.started.elapsed() > MOMENT && is_shown_live() {
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
            self.shown = true;
        }
        self.bar.set_position(bytes);
    }
}

impl Drop for Transfer {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Whether somebody looks at a terminal.
pub(crate) fn is_shown_live() -> bool {
    std::io::stderr().is_terminal()
}

/// Bandwidths as they are now, noise, speed.
fn details(status: &JobStatus, base: Base, elapsed: Duration, noise: Option<f64>) -> String {
    let mut text = String::new();
    if let Some(bandwidth) = status.totals.bandwidth {
        text += &format!(", sigma {:.3e}", bandwidth.sigma[1]);
        if let Some([_, theta]) = bandwidth.theta {
            text += &format!(", theta {:.2}°", theta.to_degrees());
        }
    }
    let checked = status.checkpoint.and_then(|checkpoint| checkpoint.noise);
    if let Some(noise) = noise.or(checked) {
        text += &format!(", noise {noise:.4}");
        if let Some(target) = status.spec.schedule.noise_target {
            text += &format!(" (to {target})");
        }
    }
    let counts = &status.totals.counts;
    let rate = |count: u64| count as f64 / elapsed.as_secs_f64().max(1e-3) / 1e6;
    let photons = counts.light_paths.saturating_sub(base.light_paths);
    let rays = counts.rays.saturating_sub(base.rays);
    match (photons, rays) {
        (0, 0) => {}
        (0, rays) => text += &format!(", {:.2} M rays/s", rate(rays)),
        (photons, _) => text += &format!(", {:.2} M photons/s", rate(photons)),
    }
    if let Some(reason) = status.waiting.as_ref().filter(|_| !status.state.ended()) {
        text += &format!(", waits: {reason}");
    }
    text
}

/// Time until the last iteration at the pace so far, or until the deadline where that comes first.
fn time_left(status: &JobStatus, base: Base, elapsed: Duration) -> String {
    let done = status.iterations_rendered.saturating_sub(base.iterations);
    let left = u64::from(status.spec.iterations).saturating_sub(status.iterations_rendered);
    if left == 0 || status.state.ended() {
        return String::new();
    }
    let at_pace = (done > 0).then(|| elapsed.as_secs_f64() / done as f64 * left as f64);
    let until = status.spec.schedule.deadline_ms.and_then(|end| {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
        Some(Duration::from_millis(end).saturating_sub(now).as_secs_f64())
    });
    let seconds = match (at_pace, until) {
        (Some(pace), Some(until)) => Some(pace.min(until)),
        (pace, until) => pace.or(until),
    };
    let time = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    time.map_or(String::new(), |time| format!(", {} left", HumanDuration(time)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOTHING: Base = Base {
        iterations: 0,
        light_paths: 0,
        rays: 0,
    };

    fn status(more: serde_json::Value) -> JobStatus {
        let mut json = serde_json::json!({
            "id": 1, "state": "running", "created_ms": 0, "iterations_done": 4, "iterations_rendered": 4,
            "poisoned": [], "workers": 1, "totals": photonfarm_proto::job::Totals::default(),
            "spec": {"scene": "0".repeat(64), "main": "a.xml", "iterations": 8, "integrator": {"type": "pcf"}}});
        for (name, value) in more.as_object().unwrap() {
            json[name] = value.clone();
        }
        serde_json::from_value(json).unwrap()
    }

    #[test]
    fn what_is_known_is_said_and_nothing_else() {
        let ten = Duration::from_secs(10);
        let bare = status(serde_json::json!({}));
        assert_eq!(details(&bare, NOTHING, ten, None), "");
        assert_eq!(time_left(&bare, NOTHING, ten), ", 10 seconds left");
        let mut full = bare.clone();
        full.totals.counts.light_paths = 30_000_000;
        full.totals.bandwidth = Some(photonfarm_proto::job::BandwidthRange {
            sigma: [0.5, 0.25],
            theta: Some([0.2, 0.1]),
        });
        full.spec.schedule.noise_target = Some(0.01);
        assert_eq!(
            details(&full, NOTHING, ten, Some(0.125)),
            ", sigma 2.500e-1, theta 5.73°, noise 0.1250 (to 0.01), 3.00 M photons/s"
        );
    }

    #[test]
    fn a_deadline_that_comes_first_bounds_the_time_left() {
        let mut soon = status(serde_json::json!({}));
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
        soon.spec.schedule.deadline_ms = Some((now + Duration::from_secs(5)).as_millis() as u64);
        let text = time_left(&soon, NOTHING, Duration::from_secs(60));
        assert!(text == ", 5 seconds left" || text == ", 4 seconds left", "{text}");
    }
}

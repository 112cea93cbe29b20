//! What a study found, as pictures, plots, values and words.

use super::super::page::{Page, Picture};
use super::super::picture;
use super::{ALPHA, Findings, P, REFERENCE_SEEDS, Reference, Study};
use crate::plot::{self, Chart, Scale, Series, Stroke};
use crate::{Options, csv};
use anyhow::Result;
use photonfarm_core::picture::ToneCurve;
use std::path::Path;

impl Study {
    /// Writes the findings to the page and to files beside it.
    pub(super) fn report(&self, options: &Options, page: &mut Page, findings: &Findings) -> Result<()> {
        let picture = format!("figure-{}-{}.png", &self.figures[..3], self.name);
        let plot = format!("figure-{}-{}.png", &self.figures[self.figures.len() - 3..], self.name);
        let curve = ToneCurve::fit(&findings.picture.values);
        picture::write(&options.out.join(&picture), &findings.picture, &curve, &findings.blocks)?;
        self.draw(&options.out.join(&plot), findings)?;
        self.write_values(options, findings)?;

        page.heading(3, &format!("The {} ({})", self.name, self.figures));
        page.paragraph(&format!(
            "{} runs of {} iterations of {} light paths, {}x{} pixels. The true values are those of {}.",
            self.runs,
            self.iterations,
            self.photons,
            self.size[0],
            self.size[1],
            self.reference.in_words()
        ));
        page.pictures(&[
            Picture {
                caption: "probes A (blue), B (orange), C (green)".into(),
                file: picture,
            },
            Picture {
                caption: "bandwidths and errors against iterations".into(),
                file: plot,
            },
        ]);
        let (first, last) = (&findings.errors[0], &findings.errors[findings.errors.len() - 1]);
        let rows: Vec<Vec<String>> = (0..self.probes.len())
            .map(|i| {
                let truth = findings.truth[i];
                let percent = |error: f64| format!("{:.1} %", 100.0 * error / truth.mean);
                vec![
                    format!("{}: {}", self.probes[i].name, self.probes[i].what),
                    format!("{:.4} ± {:.4}", truth.mean, truth.standard_error),
                    percent(first[i]),
                    percent(last[i]),
                    findings
                        .path_errors
                        .last()
                        .map_or("unknown".into(), |path| percent(path[i])),
                    format!("{:.2}", findings.slope(i)),
                ]
            })
            .collect();
        page.table(
            &[
                "probe",
                "true luminance",
                "error of 1 iteration",
                &format!("of {} iterations", self.iterations),
                "of path with as many camera samples",
                "slope of the error (log-log)",
            ],
            &rows,
        );
        page.paragraph(&format!(
            "Theory: bias falls as N^{:.2}, the standard deviation as N^{:.2}. A slope near the first says that bias \
             rules at a probe, one near the second that noise does.",
            (ALPHA - 1.0) / (P + 1.0),
            -0.5 * ALPHA
        ));
        Ok(())
    }

    fn draw(&self, path: &Path, findings: &Findings) -> Result<()> {
        let over = |y: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
            findings
                .counts
                .iter()
                .enumerate()
                .map(|(i, &n)| (f64::from(n), y(i)))
                .collect()
        };
        let chart = |title: &str, y: &str, series| Chart {
            title: format!("{}, {title}", self.name),
            x: "iterations N".into(),
            y: y.into(),
            scales: (Scale::Log, Scale::Log),
            series,
        };
        let sigma = over(&|i| f64::from(findings.bandwidths[i].sigma));
        let theta = over(&|i| f64::from(findings.bandwidths[i].theta).to_degrees());
        let mut errors: Vec<Series> = (0..self.probes.len())
            .map(|p| Series::new(self.probes[p].name, Stroke::Dots, p, over(&|i| findings.errors[i][p])))
            .collect();
        let slope = (ALPHA - 1.0) / (P + 1.0);
        let start = findings.errors[0].iter().copied().fold(0.0, f64::max);
        let guide = over(&|i| start * f64::from(findings.counts[i]).powf(slope));
        errors.push(Series::new(format!("N^{slope:.2}"), Stroke::Dashes, 6, guide));
        let mut charts = vec![
            chart(
                "spatial bandwidth",
                "sigma",
                vec![Series::new("sigma", Stroke::Dots, 6, sigma)],
            ),
            chart(
                "angular bandwidth",
                "theta [degrees]",
                vec![Series::new("theta", Stroke::Dots, 6, theta)],
            ),
            chart("error", "absolute error", errors),
        ];
        if !findings.path_errors.is_empty() {
            let series = |p: usize| {
                Series::new(
                    self.probes[p].name,
                    Stroke::Dots,
                    p,
                    over(&|i| findings.path_errors[i][p]),
                )
            };
            let series = (0..self.probes.len()).map(series).collect();
            charts.push(chart(
                "error of path with as many camera samples",
                "absolute error",
                series,
            ));
        }
        plot::write(path, &charts, 2)
    }

    fn write_values(&self, options: &Options, findings: &Findings) -> Result<()> {
        let header = [
            "iterations",
            "sigma",
            "theta_degrees",
            "error_a",
            "error_b",
            "error_c",
            "path_error_a",
            "path_error_b",
            "path_error_c",
        ];
        let unknown = vec![vec![f64::NAN; self.probes.len()]; findings.counts.len()];
        let path_errors = if findings.path_errors.is_empty() {
            &unknown
        } else {
            &findings.path_errors
        };
        let rows: Vec<Vec<String>> = findings
            .counts
            .iter()
            .zip(&findings.bandwidths)
            .zip(&findings.errors)
            .zip(path_errors)
            .map(|(((n, bandwidth), errors), path_errors)| {
                let kernel = [f64::from(bandwidth.sigma), f64::from(bandwidth.theta).to_degrees()];
                let values = kernel.into_iter().chain(errors.iter().chain(path_errors).copied());
                std::iter::once(n.to_string()).chain(values.map(csv::number)).collect()
            })
            .collect();
        csv::write(
            &options.out.join(format!("figures-5-{}.csv", self.name)),
            &header,
            &rows,
        )
    }
}

impl Reference {
    /// What the true values are, in words.
    fn in_words(&self) -> String {
        let seeds = REFERENCE_SEEDS.count() as u32;
        match self {
            Self::Path { iterations, samples } => {
                format!(
                    "`path` through these pixels alone, {} samples each",
                    iterations * samples
                )
            }
            Self::Pppm {
                iterations,
                photons,
                sigma1,
            } => format!(
                "`pppm` under {seeds} other seeds, {iterations} iterations of {photons} light paths, sigma_1 = {sigma1}: paths cannot find \
                 the sun through the glass"
            ),
        }
    }
}

impl Findings {
    /// Fitted slope of the logarithm of a probe's error over the logarithm of the number of iterations.
    fn slope(&self, probe: usize) -> f64 {
        let points: Vec<(f64, f64)> = self
            .counts
            .iter()
            .zip(&self.errors)
            .map(|(&n, e)| (f64::from(n).ln(), e[probe].ln()))
            .collect();
        let n = points.len() as f64;
        let (x, y) = points.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
        let (xy, xx) = points.iter().fold((0.0, 0.0), |(xy, xx), p| {
            (xy + (p.0 - x) * (p.1 - y), xx + (p.0 - x).powi(2))
        });
        xy / xx
    }
}

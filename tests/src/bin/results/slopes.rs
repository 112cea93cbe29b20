//! Fitted slopes of the bias and the variance of averages, against the theory.

mod case;
mod fit;
mod report;

use crate::Options;
use crate::plot::{self, Chart, Scale, Series, Stroke};
use crate::render::{each, progress};
use anyhow::{Result, ensure};
use case::{Case, Exponents, Method, Varies};
use fit::{Curves, RUNS_OF_GROUP, Slope, curves_of_group, log_log_slope, mean_with_error, slope};
use photonfarm_tests::render::mean_luminance;

/// Confidence of the intervals that are written.
const CONFIDENCE: f64 = 0.95;

/// How much is measured.
struct Effort {
    cases: Vec<Case>,
    /// Groups of [`RUNS_OF_GROUP`] runs.
    groups: usize,
    /// Numbers of iterations through which slopes are fitted.
    counts: Vec<u32>,
}

impl Effort {
    fn full() -> Self {
        let position = |alpha, p, aimed, photons| pcf(Varies::WithPosition, alpha, p, aimed, photons);
        let direction = |alpha, p, photons| pcf(Varies::WithDirection, alpha, p, true, photons);
        Self {
            cases: vec![
                position(0.2, 1.0, true, 1500),
                position(0.2, 2.0, true, 1000),
                position(0.5, 1.0, true, 500),
                position(0.5, 2.0, true, 500),
                position(2.0 / 3.0, 1.0, true, 500),
                position(0.2, 1.0, false, 500),
                position(0.5, 1.0, false, 500),
                position(0.5, 2.0, false, 500),
                direction(0.2, 1.0, 500),
                direction(0.2, 2.0, 500),
                direction(0.5, 2.0, 500),
                pppm(0.5, 500),
                pppm(2.0 / 3.0, 500),
                pppm(0.8, 500),
            ],
            groups: 10,
            counts: vec![64, 128, 256, 512, 1024],
        }
    }

    fn small() -> Self {
        Self {
            cases: vec![
                pcf(Varies::WithPosition, 0.5, 1.0, true, 800),
                pcf(Varies::WithPosition, 0.5, 2.0, false, 400),
                pcf(Varies::WithDirection, 0.2, 2.0, true, 800),
                pppm(2.0 / 3.0, 500),
            ],
            groups: 10,
            counts: vec![8, 16, 32, 64, 128],
        }
    }
}

fn pcf(varies: Varies, alpha: f32, p: f32, aimed: bool, photons: u32) -> Case {
    Case {
        varies,
        method: Method::Pcf { p, aimed },
        alpha,
        photons,
    }
}

fn pppm(alpha: f32, photons: u32) -> Case {
    Case {
        varies: Varies::WithPosition,
        method: Method::Pppm,
        alpha,
        photons,
    }
}

/// A case as measured.
struct Outcome {
    case: Case,
    counts: Vec<u32>,
    groups: Vec<Curves>,
    predicted: (Vec<f64>, Vec<f64>),
    bias: Slope,
    variance: Slope,
    /// Slopes of what is predicted, fitted as the measured ones.
    expected: Exponents,
}

fn measure(effort: &Effort) -> Result<Vec<Outcome>> {
    let iterations = *effort.counts.last().expect("a number of iterations");
    let runs = (effort.groups * RUNS_OF_GROUP) as u64;
    let bar = progress("slopes", effort.cases.len() as u64 * runs * u64::from(iterations));
    let jobs: Vec<(u64, u32)> = (1..=runs).flat_map(|r| (1..=iterations).map(move |i| (r, i))).collect();
    let mut outcomes = Vec::new();
    for case in &effort.cases {
        let scene = case.varies.scene()?;
        let estimates = each(&scene, &case.settings(), &jobs, &bar, |image| {
            mean_luminance(&image.pixels)
        })?;
        let rows: Vec<&[f64]> = estimates.chunks(iterations as usize).collect();
        let truth = case.varies.truth(&scene);
        let groups: Vec<Curves> = rows
            .chunks(RUNS_OF_GROUP)
            .map(|runs| curves_of_group(runs, truth, &effort.counts))
            .collect();
        let predicted = case.predicted(&scene, &effort.counts);
        let (bias, _) = mean_with_error(&curves(&groups, |c| &c.bias));
        let visible = bias
            .iter()
            .zip(&predicted.0)
            .all(|(measured, expected)| measured * expected > 0.0);
        ensure!(
            visible || !case.shows_bias(),
            "{}: noise hides the bias: {bias:?} where {:?} is expected",
            case.name(),
            predicted.0
        );
        outcomes.push(Outcome {
            case: *case,
            counts: effort.counts.clone(),
            bias: slope(&effort.counts, &curves(&groups, |c| &c.bias)),
            variance: slope(&effort.counts, &curves(&groups, |c| &c.variance)),
            expected: Exponents {
                bias: log_log_slope(&effort.counts, &predicted.0),
                variance: log_log_slope(&effort.counts, &predicted.1),
            },
            groups,
            predicted,
        });
    }
    bar.finish_and_clear();
    Ok(outcomes)
}

fn curves(groups: &[Curves], pick: fn(&Curves) -> &Vec<f64>) -> Vec<&[f64]> {
    groups.iter().map(|g| pick(g).as_slice()).collect()
}

/// Writes `slopes.csv`, `slopes.md` and the plots to the folder `options.out`.
pub(crate) fn run(options: &Options) -> Result<()> {
    let effort = if options.small { Effort::small() } else { Effort::full() };
    let outcomes = measure(&effort)?;
    report::write(&options.out, &effort, &outcomes)?;
    for (name, title, belongs) in PLOTS {
        let shown: Vec<&Outcome> = outcomes.iter().filter(|o| belongs(&o.case)).collect();
        if !shown.is_empty() {
            let path = options.out.join(format!("slopes-{name}.png"));
            plot::write(&path, &charts(title, &shown), 2)?;
        }
    }
    Ok(())
}

/// A plot's file, its heading, and which cases it shows.
type Plot = (&'static str, &'static str, fn(&Case) -> bool);

const PLOTS: [Plot; 3] = [
    ("pcf-position", "pcf, radiance varies with position", |case| {
        case.varies == Varies::WithPosition && case.method != Method::Pppm
    }),
    ("pcf-direction", "pcf, radiance varies with direction", |case| {
        case.varies == Varies::WithDirection
    }),
    ("pppm", "pppm", |case| case.method == Method::Pppm),
];

/// Bias and variance over the number of iterations: measured with 95 % bands, and predicted, dashed.
fn charts(title: &str, outcomes: &[&Outcome]) -> [Chart; 2] {
    let chart = |what: &str, pick: fn(&Curves) -> &Vec<f64>, predict: fn(&Outcome) -> &Vec<f64>, variance: bool| {
        let mut series = Vec::new();
        let shown = outcomes
            .iter()
            .enumerate()
            .filter(|(_, o)| variance || o.case.shows_bias());
        for (colour, outcome) in shown {
            let (centre, errors) = mean_with_error(&curves(&outcome.groups, pick));
            let reach = photonfarm_tests::statistics::student_quantile(1.0 - CONFIDENCE, outcome.groups.len() - 1);
            let at = |values: Vec<f64>| -> Vec<(f64, f64)> {
                outcome.counts.iter().map(|n| f64::from(*n)).zip(values).collect()
            };
            let predicted = predict(outcome);
            // The prediction of variance has no scale of its own: it is put through the middle of what was measured.
            let logs = centre.iter().zip(predicted).map(|(m, p)| (m.abs() / p.abs()).ln());
            let scale = if variance {
                (logs.sum::<f64>() / centre.len() as f64).exp()
            } else {
                1.0
            };
            let expected = predicted.iter().map(|p| p.abs() * scale).collect();
            series.push(Series::new("", Stroke::Dashes, colour, at(expected)));
            series.push(Series {
                band: centre
                    .iter()
                    .zip(&errors)
                    .map(|(c, e)| (c.abs() - reach * e, c.abs() + reach * e))
                    .collect(),
                ..Series::new(
                    outcome.case.name(),
                    Stroke::Dots,
                    colour,
                    at(centre.iter().map(|c| c.abs()).collect()),
                )
            });
        }
        Chart {
            title: title.to_owned(),
            x: "iterations N".into(),
            y: format!("{what} of the average"),
            scales: (Scale::Log, Scale::Log),
            series,
        }
    };
    [
        chart("relative bias", |c| &c.bias, |o| &o.predicted.0, false),
        chart("relative variance", |c| &c.variance, |o| &o.predicted.1, true),
    ]
}

#[cfg(test)]
mod tests;

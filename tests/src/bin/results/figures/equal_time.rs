//! Figures 5.8 to 5.13: a room of shiny pyramids, integrators at equal time.

use super::page::{Page, Picture};
use super::picture::{self, Pixels};
use super::runs::{Sum, processor_seconds};
use super::stage::{self, CAMERA, IMPORTON};
use crate::render::progress;
use crate::{Options, csv};
use anyhow::Result;
use photonfarm_core::integrator::{Unobserved, render_iteration};
use photonfarm_core::picture::ToneCurve;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{IntegratorSettings, LookupVertex};

/// Share of the pixels, those with the largest errors, that the robust error leaves out.
const CUT: f64 = 0.001;

/// An integrator with its settings.
struct Method {
    name: &'static str,
    file: &'static str,
    settings: IntegratorSettings,
}

/// What a method gave in its time.
struct Outcome {
    sum: Sum,
    seconds: f64,
    error: f64,
    /// Without the worst pixels.
    robust_error: f64,
}

/// Samples of a pixel in each iteration of the truth.
const TRUTH_SAMPLES: u32 = 4;

/// Two independent pictures, and their average.
pub(super) struct Truth {
    halves: [Pixels; 2],
    mean: Pixels,
    /// Of both together.
    iterations: u32,
}

fn methods(scene: &Scene, photons: u32) -> Vec<Method> {
    let pcf = |lookup, samplers| stage::aimed(&stage::pcf(scene, photons, 2, 0.1), lookup, samplers);
    vec![
        Method {
            name: "pcf, read at a rough vertex",
            file: "pcf",
            settings: pcf(LookupVertex::Auto, CAMERA),
        },
        Method {
            name: "pcf, read at the first vertex",
            file: "pcf-1",
            settings: pcf(LookupVertex::Fixed(1), CAMERA),
        },
        Method {
            name: "pcf, importons, read at the second vertex",
            file: "pcf-2",
            settings: pcf(LookupVertex::Fixed(2), IMPORTON),
        },
        Method {
            name: "pppm",
            file: "pppm",
            settings: stage::pppm(scene, photons, 2, 0.05),
        },
        Method {
            name: "path",
            file: "path",
            settings: stage::path(scene, 1),
        },
    ]
}

/// Renders all methods and writes them to the page and to `figures-5-pyramids.csv`.
pub(super) fn run(options: &Options, page: &mut Page) -> Result<()> {
    let scaled = |full: f64, small: f64| if options.small { small } else { full };
    let size = [scaled(112.0, 48.0) as u32; 2];
    let (budget, reference_budget) = (scaled(12.0, 1.0), scaled(90.0, 6.0));
    let scene = stage::load(&options.scenes.join("pyramids"), size)?;
    let bar = progress("figures 5.8 to 5.13", 0);
    let truth = Truth::of(&scene, &stage::path(&scene, TRUTH_SAMPLES), reference_budget)?;
    bar.finish_and_clear();
    let methods = methods(&scene, scaled(50_000.0, 20_000.0) as u32);
    let outcomes = methods
        .iter()
        .map(|m| Outcome::measure(&scene, m, budget, &truth))
        .collect::<Result<Vec<_>>>()?;
    report(options, page, &truth, &methods, &outcomes, budget)
}

/// Iterations from the first on, as many as start within `budget` seconds of processor time.
fn spend(scene: &Scene, settings: &IntegratorSettings, seed: u64, budget: f64) -> Result<(Sum, f64)> {
    let start = processor_seconds();
    let mut sum = Sum::new(scene);
    loop {
        sum.add(&render_iteration(
            scene,
            settings,
            seed,
            sum.iterations + 1,
            &Unobserved,
        )?);
        let seconds = processor_seconds() - start;
        // The next one is expected to take as long as those before.
        if seconds * (1.0 + 0.5 / f64::from(sum.iterations)) >= budget {
            return Ok((sum, seconds));
        }
    }
}

impl Truth {
    /// In `budget` seconds of processor time together.
    pub(super) fn of(scene: &Scene, settings: &IntegratorSettings, budget: f64) -> Result<Self> {
        const SEEDS: [u64; 2] = [1_001, 1_002];
        let (a, _) = spend(scene, settings, SEEDS[0], 0.5 * budget)?;
        let mut b = Sum::new(scene);
        for i in 1..=a.iterations {
            b.add(&render_iteration(scene, settings, SEEDS[1], i, &Unobserved)?);
        }
        let halves = [a.mean(), b.mean()];
        let values = halves[0]
            .values
            .iter()
            .zip(&halves[1].values)
            .map(|(a, b)| (*a + *b) * 0.5)
            .collect();
        let mean = Pixels {
            size: halves[0].size,
            values,
        };
        Ok(Self {
            halves,
            mean,
            iterations: 2 * a.iterations,
        })
    }

    /// The average.
    pub(super) fn mean(&self) -> &Pixels {
        &self.mean
    }

    /// Relative mean squared errors of a picture: of all pixels, and without the worst [`CUT`] of them.
    ///
    /// At each pixel `(x - a)(x - b) / (r^2 + (0.1 mean r)^2)` in luminance, where `a` and `b` are the two halves and `r` is their
    /// average: as `a` and `b` are independent, and where they are without bias, the product's expectation is the squared error against the
    /// truth, free of their noise.
    pub(super) fn squared_errors(&self, picture: &Pixels) -> [f64; 2] {
        let luminance = |p: &Pixels, i: usize| f64::from(p.values[i].luminance());
        let n = picture.values.len();
        let mean = (0..n).map(|i| luminance(&self.mean, i)).sum::<f64>() / n as f64;
        let mut squares: Vec<f64> = (0..n)
            .map(|i| {
                let [a, b] = [0, 1].map(|half| luminance(picture, i) - luminance(&self.halves[half], i));
                a * b / (luminance(&self.mean, i).powi(2) + (0.1 * mean).powi(2))
            })
            .collect();
        squares.sort_unstable_by(|a, b| a.abs().total_cmp(&b.abs()));
        let kept = n - (CUT * n as f64).ceil() as usize;
        [n, kept].map(|kept| (squares[..kept].iter().sum::<f64>() / kept as f64).max(0.0))
    }
}

impl Outcome {
    fn measure(scene: &Scene, method: &Method, budget: f64, truth: &Truth) -> Result<Self> {
        let (sum, seconds) = spend(scene, &method.settings, 1, budget)?;
        let [error, robust_error] = truth.squared_errors(&sum.mean()).map(f64::sqrt);
        Ok(Self {
            sum,
            seconds,
            error,
            robust_error,
        })
    }
}

fn report(
    options: &Options,
    page: &mut Page,
    truth: &Truth,
    methods: &[Method],
    outcomes: &[Outcome],
    budget: f64,
) -> Result<()> {
    page.heading(2, "A room of shiny pyramids at equal time (figures 5.8 to 5.13)");
    let [width, height] = truth.mean.size;
    page.paragraph(&format!(
        "Each method has {budget} s of processor time for {width}x{height} pixels. The ground truth is `path` with {} samples a \
         pixel, in two independent halves a and b; the error of a picture x is the root of the mean over pixels of \
         (x - a)(x - b) / (r^2 + (0.1 mean r)^2) in luminance, with r the average of the halves, which is free of their noise. \
         The robust error leaves out the worst {} % of the pixels. How many iterations fit depends on the machine. `bdpt`, \
         `vcm` and `sppm` stand in [equal-time.md](equal-time.md); PSSMLT and ERPT, which the thesis compares with as well, do not exist here.",
        TRUTH_SAMPLES * truth.iterations,
        100.0 * CUT
    ));
    let curve = ToneCurve::fit(&truth.mean.values);
    let mut pictures = vec![("ground truth".to_owned(), "truth", truth.mean.clone())];
    pictures.extend(
        methods
            .iter()
            .zip(outcomes)
            .map(|(m, o)| (m.name.to_owned(), m.file, o.sum.mean())),
    );
    let written = pictures
        .iter()
        .map(|(caption, file, pixels)| {
            let file = format!("figure-5.8-{file}.png");
            picture::write(&options.out.join(&file), pixels, &curve, &[])?;
            Ok(Picture {
                caption: caption.clone(),
                file,
            })
        })
        .collect::<Result<Vec<_>>>()?;
    for row in written.chunks(3) {
        page.pictures(row);
    }
    let cells = |m: &Method, o: &Outcome| {
        vec![
            m.name.to_owned(),
            o.sum.iterations.to_string(),
            format!("{:.1}", o.seconds),
            format!("{:.4}", o.robust_error),
            format!("{:.4}", o.error),
        ]
    };
    let rows: Vec<_> = methods.iter().zip(outcomes).map(|(m, o)| cells(m, o)).collect();
    page.table(
        &[
            "method",
            "iterations",
            "processor seconds",
            "robust relative error",
            "relative error",
        ],
        &rows,
    );
    let mut order: Vec<usize> = (0..methods.len()).collect();
    order.sort_by(|&a, &b| outcomes[a].robust_error.total_cmp(&outcomes[b].robust_error));
    let names: Vec<_> = order
        .iter()
        .map(|&i| format!("{} ({:.3})", methods[i].name, outcomes[i].robust_error))
        .collect();
    page.paragraph(&format!(
        "From the smallest robust error to the largest: {}.",
        names.join("; ")
    ));
    page.paragraph(
        "Read at the first vertex, cones show every polished surface through the kernel: its reflections are smeared over sigma and \
         theta, and this bias is far from gone after so few iterations. The other photon methods walk on through the polished metals \
         and estimate at a rough vertex, where photons need a kernel over positions only: `pppm` has less to blur there than `pcf`. What \
         `path` has left is noise, mostly fireflies of light that the metals throw on the floor.",
    );
    let rows: Vec<_> = methods
        .iter()
        .zip(outcomes)
        .map(|(m, o)| {
            let values = [o.seconds, o.robust_error, o.error].map(csv::number);
            let name = m.name.replace(", ", " ");
            [name, o.sum.iterations.to_string()].into_iter().chain(values).collect()
        })
        .collect();
    let header = [
        "method",
        "iterations",
        "processor_seconds",
        "robust_relative_error",
        "relative_error",
    ];
    csv::write(&options.out.join("figures-5-pyramids.csv"), &header, &rows)
}

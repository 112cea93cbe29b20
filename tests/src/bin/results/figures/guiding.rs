//! Figures 4.2, 4.3, 4.5 and 4.8: what aiming cones gains at equal numbers of cones.

use super::page::{Page, Picture};
use super::picture::{self, Pixels};
use super::runs::{Estimate, average, estimate, processor_seconds};
use super::stage::{self, BSDF, CAMERA, IMPORTON};
use crate::render::progress;
use crate::{Options, csv};
use anyhow::Result;
use photonfarm_core::integrator::Counts;
use photonfarm_core::picture::ToneCurve;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{DirectionSampler, LookupVertex};
use std::path::PathBuf;

/// A set of direction samplers, its name in the table, and the end of its picture's file name.
type Technique = (&'static str, &'static [DirectionSampler], &'static str);

/// Two sets of direction samplers, side by side.
struct Comparison {
    /// The thesis's figures.
    figures: &'static str,
    title: &'static str,
    /// Folder of the scene.
    scene: PathBuf,
    size: [u32; 2],
    /// Directions sampled at each vertex of a light path times light paths of an iteration.
    cones: u32,
    sigma1: f32,
    lookup: u32,
    iterations: u32,
    /// Pairs of runs that variances come from.
    pairs: u64,
    techniques: [Technique; 2],
}

/// What one set of samplers gave.
struct Outcome {
    picture: Pixels,
    /// Relative variance of the average, once from each pair of runs.
    variances: Vec<f64>,
    /// Of one run.
    counts: Counts,
    /// Processor time of one run \[seconds\].
    seconds: f64,
}

const BSDF_ONLY: Technique = ("BSDF", BSDF, "bsdf");
const WITH_CAMERA: Technique = ("BSDF and camera", CAMERA, "camera");
const WITH_IMPORTONS: Technique = ("BSDF, camera and importons", IMPORTON, "importon");

fn comparisons(options: &Options) -> Vec<Comparison> {
    let bunny = options.scenes.join("cornell-bunny");
    let scaled = |full: u32, small: u32| if options.small { small } else { full };
    let size = [scaled(128, 48); 2];
    let common = |figures, title, lookup, techniques| Comparison {
        figures,
        title,
        scene: bunny.clone(),
        size,
        cones: scaled(48_000, 24_000),
        sigma1: 0.1,
        lookup,
        iterations: scaled(40, 4),
        pairs: if options.small { 8 } else { 2 },
        techniques,
    };
    let torus = stage::torus(options).map(|scene| Comparison {
        scene,
        size: [scaled(160, 48), scaled(120, 36)],
        // A tenth of half the side of the glass cube.
        sigma1: 1.0,
        ..common(
            "4.2",
            "The torus without and with aimed cones",
            1,
            [BSDF_ONLY, WITH_CAMERA],
        )
    });
    let mut all: Vec<Comparison> = torus.into_iter().collect();
    all.push(common("4.3 and 4.5", "Camera connections", 1, [BSDF_ONLY, WITH_CAMERA]));
    all.push(common("4.8", "Importons", 2, [WITH_CAMERA, WITH_IMPORTONS]));
    all
}

/// Renders all comparisons and writes them to the page and to `figures-4.csv`.
pub(super) fn run(options: &Options, page: &mut Page) -> Result<()> {
    page.heading(2, "Aiming cones (figures 4.2, 4.3, 4.5 and 4.8)");
    page.paragraph(
        "Each pair shows the same number of sampled cones: two techniques share them half and half, three by thirds, with as \
         many fewer light paths. Both averages have the same expectation, bandwidth for bandwidth, so that the better one \
         is the one with less variance. It comes from pairs of independent runs: the mean over pixels of half the squared difference \
         of luminance over m^2 + (0.1 mean)^2, where m is the pixel's average of both; its standard error comes from the pairs.",
    );
    let mut rows = Vec::new();
    for comparison in comparisons(options) {
        let scene = stage::load(&comparison.scene, comparison.size)?;
        let bar = progress(&format!("figures {}", comparison.figures), 4 * comparison.pairs);
        let outcomes = comparison
            .techniques
            .iter()
            .map(|technique| comparison.measure(&scene, technique, &|| bar.inc(1)))
            .collect::<Result<Vec<_>>>()?;
        bar.finish_and_clear();
        comparison.report(options, page, &outcomes, &mut rows)?;
    }
    page.paragraph(
        "Camera connections pay where a surface is rough and the map is read at the first vertex. At a delta surface, such as the \
         torus's glass, only the BSDF can aim a cone; there the light paths that the other technique has cost are missing. Read at \
         the second vertex, cones must point at the first one, not at the camera: that is what importons know.",
    );
    let header = [
        "figures",
        "samplers",
        "lookup_vertex",
        "light_paths",
        "iterations",
        "cones_stored",
        "relative_variance",
        "standard_error",
        "log_gain",
        "log_gain_standard_error",
        "processor_seconds",
    ];
    csv::write(&options.out.join("figures-4.csv"), &header, &rows)
}

impl Comparison {
    fn measure(&self, scene: &Scene, technique: &Technique, done: &dyn Fn()) -> Result<Outcome> {
        let samplers = technique.1;
        let settings = stage::pcf(scene, self.cones / samplers.len() as u32, 2, self.sigma1);
        let settings = stage::aimed(&settings, LookupVertex::Fixed(self.lookup), samplers);
        let start = processor_seconds();
        let mut variances = Vec::new();
        let mut first = None;
        for pair in 0..self.pairs {
            let a = average(scene, &settings, 2 * pair + 1, self.iterations, |_| ())?;
            done();
            let b = average(scene, &settings, 2 * pair + 2, self.iterations, |_| ())?;
            done();
            variances.push(relative_variance(&a.mean(), &b.mean()));
            first.get_or_insert(a);
        }
        let seconds = (processor_seconds() - start) / (2 * self.pairs) as f64;
        let first = first.expect("there is at least one pair");
        Ok(Outcome {
            picture: first.mean(),
            variances,
            counts: first.counts,
            seconds,
        })
    }

    fn report(
        &self,
        options: &Options,
        page: &mut Page,
        outcomes: &[Outcome],
        rows: &mut Vec<Vec<String>>,
    ) -> Result<()> {
        page.heading(3, &format!("{} ({})", self.title, self.figures));
        let [width, height] = self.size;
        page.paragraph(&format!(
            "{width}x{height} pixels, {} iterations of {} cones at each bounce, sigma_1 = {}, theta_1 = 18 degrees, alpha = 0.2, \
             p = 1, S = 2, cones read at camera vertex {}.",
            self.iterations, self.cones, self.sigma1, self.lookup
        ));
        let curve = ToneCurve::fit(&outcomes[1].picture.values);
        let gain = gain(&outcomes[0], &outcomes[1]);
        let (mut pictures, mut table) = (Vec::new(), Vec::new());
        for ((name, samplers, suffix), outcome) in self.techniques.iter().zip(outcomes) {
            let figure = self.figures.rsplit(' ').next().expect("a figure has a number");
            let file = format!("figure-{figure}-{suffix}.png");
            picture::write(&options.out.join(&file), &outcome.picture, &curve, &[])?;
            pictures.push(Picture {
                caption: (*name).into(),
                file,
            });
            let variance = estimate(&outcome.variances);
            let light_paths = self.cones / samplers.len() as u32;
            let stored = outcome.counts.records_stored / u64::from(self.iterations);
            table.push(vec![
                (*name).into(),
                light_paths.to_string(),
                stored.to_string(),
                format!("{:.5} ± {:.5}", variance.mean, variance.standard_error),
                format!("{:.1}", outcome.seconds),
            ]);
            rows.push(vec![
                self.figures.into(),
                name.replace(", ", "+").replace(" and ", "+"),
                self.lookup.to_string(),
                light_paths.to_string(),
                self.iterations.to_string(),
                stored.to_string(),
                csv::number(variance.mean),
                csv::number(variance.standard_error),
                csv::number(gain.mean),
                csv::number(gain.standard_error),
                csv::number(outcome.seconds),
            ]);
        }
        page.pictures(&pictures);
        page.table(
            &[
                "cones by",
                "light paths",
                "cones stored an iteration",
                "relative variance",
                "processor seconds",
            ],
            &table,
        );
        page.paragraph(&self.verdict(outcomes, gain));
        Ok(())
    }

    /// The outcome in words.
    fn verdict(&self, outcomes: &[Outcome], gain: Estimate) -> String {
        let ratio = gain.mean.exp();
        let spread = ratio * gain.standard_error;
        let time = outcomes[1].seconds / outcomes[0].seconds;
        let [(before, ..), (after, ..)] = self.techniques;
        let outcome = if gain.mean.abs() < 3.0 * gain.standard_error {
            "as much variance as".to_owned()
        } else if ratio > 1.0 {
            format!("{ratio:.2} ± {spread:.2} times less variance than")
        } else {
            format!(
                "{:.2} ± {:.2} times more variance than",
                1.0 / ratio,
                spread / ratio / ratio
            )
        };
        format!(
            "At equal numbers of cones \"{after}\" has {outcome} \"{before}\" (one standard error). It \
             takes {time:.2} times the processor time; with light paths to match, its variance at equal time is {:.2} times as large.",
            time / ratio
        )
    }
}

/// Mean over pixels of half the squared difference of luminance over `m^2 + (0.1 mean)^2`, where `m` is the pixel's average over
/// both runs: a picture's variance, no pixel weighing more than its brightness deserves.
fn relative_variance(a: &Pixels, b: &Pixels) -> f64 {
    let luminances = |p: &Pixels| -> Vec<f64> { p.values.iter().map(|v| f64::from(v.luminance())).collect() };
    let (a, b) = (luminances(a), luminances(b));
    let n = a.len() as f64;
    let mean = a.iter().chain(&b).sum::<f64>() / (2.0 * n);
    let of_pixel = |(a, b): (&f64, &f64)| 0.5 * (a - b).powi(2) / ((0.5 * (a + b)).powi(2) + (0.1 * mean).powi(2));
    a.iter().zip(&b).map(of_pixel).sum::<f64>() / n
}

/// Logarithm of how many times less variance `after` has than `before`, from pair to pair.
fn gain(before: &Outcome, after: &Outcome) -> Estimate {
    let logarithms: Vec<f64> = before
        .variances
        .iter()
        .zip(&after.variances)
        .map(|(b, a)| (b / a).ln())
        .collect();
    estimate(&logarithms)
}

//! Integrators against the clock: the error of each as its time grows.

use super::equal_time::Truth;
use super::page::{Page, Picture};
use super::picture::{self, Pixels, montage};
use super::runs::{Sum, processor_seconds};
use crate::plot::{self, Chart, Scale, Series, Stroke};
use crate::render::progress;
use crate::{Options, csv};
use anyhow::{Context, Result};
use photonfarm_core::integrator::{Integrator, bandwidth};
use photonfarm_core::picture::ToneCurve;
use photonfarm_core::scene::{Scene, SceneFolder};
use photonfarm_core::settings::{IntegratorSettings, VcmSettings};
use photonfarm_tests::{render, scenes};
use serde_json::{Map, json};
use std::path::PathBuf;

/// Who takes part, with default settings.
const METHODS: [&str; 6] = ["path", "bdpt", "vcm", "pppm", "sppm", "pcf"];

/// Times at which errors are taken: each half of the next.
const CHECKPOINTS: i32 = 6;

/// First radius of the truth over the automatic one: its bias is a sixteenth of that of a `vcm` with default settings after as many
/// iterations.
const TRUTH_RADIUS: f32 = 0.25;

/// A scene that they render.
struct Course {
    name: &'static str,
    folder: PathBuf,
    size: [u32; 2],
    /// What the scene calls width and height.
    size_names: [&'static str; 2],
}

/// A picture on its way.
struct Checkpoint {
    seconds: f64,
    iterations: u32,
    /// Relative mean squared error, and the same without the worst pixels.
    errors: [f64; 2],
}

/// What an integrator gave.
struct Outcome {
    method: &'static str,
    checkpoints: Vec<Checkpoint>,
    picture: Pixels,
}

fn courses(options: &Options) -> Vec<Course> {
    let scaled = |size: [u32; 2]| if options.small { size.map(|side| side / 4) } else { size };
    let of = |name, folder, size, size_names| Course {
        name,
        folder,
        size: scaled(size),
        size_names,
    };
    let own = of(
        "still-life",
        options.scenes.join("still-life"),
        [192, 128],
        ["width", "height"],
    );
    let others = options.others.iter().flat_map(|others| {
        let folder = |name: &str| others.join(name).join("mitsuba");
        [
            of("water-caustic", folder("water-caustic"), [160; 2], ["width", "height"]),
            of("veach-bidir", folder("veach-bidir"), [160; 2], ["resx", "resy"]),
        ]
    });
    std::iter::once(own).chain(others).collect()
}

impl Course {
    fn load(&self) -> Result<Scene> {
        let [width, height] = self.size_names;
        let files = SceneFolder::new(&self.folder)?;
        scenes::load(&files, "scene.xml", &[(width, self.size[0]), (height, self.size[1])])
            .with_context(|| format!("cannot load the scene in {}", self.folder.display()))
    }
}

/// The integrator's default settings, with the scene's longest paths.
fn settings(method: &str, scene: &Scene) -> Result<IntegratorSettings> {
    let integrator = Integrator::find(method).with_context(|| format!("there is no integrator {method}"))?;
    let max_depth = Map::from_iter([("max_depth".to_owned(), json!(scene.wishes.max_depth))]);
    Ok(integrator.read(max_depth)?)
}

/// Independent pictures by merging and connections, within a small radius.
fn truth(scene: &Scene, budget: f64) -> Result<Truth> {
    let of = |sigma1| {
        IntegratorSettings::Vcm(VcmSettings {
            sigma1,
            max_depth: scene.wishes.max_depth,
            ..Default::default()
        })
    };
    let automatic = bandwidth(scene, &of(None), 1).context("`vcm` merges")?;
    Truth::of(scene, &of(Some(TRUTH_RADIUS * automatic.sigma)), budget)
}

/// Renders iterations until the processor has worked for `budget` seconds on them, and takes errors on the way.
fn run_method(scene: &Scene, method: &'static str, budget: f64, truth: &Truth) -> Result<Outcome> {
    const SEED: u64 = 1;
    let settings = settings(method, scene)?;
    let mut sum = Sum::new(scene);
    let mut iterations = render::iterations(scene, &settings, SEED, u32::MAX);
    let (mut seconds, mut checkpoints) = (0.0, Vec::new());
    for halvings in (0..CHECKPOINTS).rev() {
        let until = budget * 0.5_f64.powi(halvings);
        let before = sum.iterations;
        while seconds < until {
            let start = processor_seconds();
            let iteration = iterations.next().context("iterations go on")??;
            seconds += processor_seconds() - start;
            sum.add(&iteration);
        }
        if sum.iterations > before {
            checkpoints.push(Checkpoint {
                seconds,
                iterations: sum.iterations,
                errors: truth.squared_errors(&sum.mean()),
            });
        }
    }
    Ok(Outcome {
        method,
        checkpoints,
        picture: sum.mean(),
    })
}

/// Writes `equal-time.md`, `equal-time.csv` and pictures to the folder `options.out`.
pub(crate) fn run(options: &Options) -> Result<()> {
    let (budget, truth_budget) = if options.small { (0.4, 2.0) } else { (12.0, 72.0) };
    let mut page = Page::default();
    introduce(options, &mut page, budget, truth_budget);
    let (mut rows, mut charts) = (Vec::new(), Vec::new());
    let courses = courses(options);
    let bar = progress("equal time", (courses.len() * (METHODS.len() + 1)) as u64);
    for course in courses {
        let scene = course.load()?;
        let truth = truth(&scene, truth_budget)?;
        bar.inc(1);
        let mut outcomes = Vec::new();
        for method in METHODS {
            outcomes.push(run_method(&scene, method, budget, &truth)?);
            bar.inc(1);
        }
        report(options, &mut page, &course, &truth, &outcomes)?;
        charts.push(chart(&course, &outcomes));
        rows.extend(outcomes.iter().flat_map(|outcome| csv_rows(&course, outcome)));
    }
    bar.finish_and_clear();
    plot::write(&options.out.join("equal-time.png"), &charts, charts.len())?;
    let header = [
        "scene",
        "integrator",
        "processor_seconds",
        "iterations",
        "relmse",
        "robust_relmse",
    ];
    csv::write(&options.out.join("equal-time.csv"), &header, &rows)?;
    page.write(&options.out.join("equal-time.md"))
}

fn introduce(options: &Options, page: &mut Page, budget: f64, truth_budget: f64) {
    page.heading(1, "Integrators at equal time");
    page.paragraph(&format!(
        "Written by `cargo run --release -p photonfarm-tests --bin results -- equal-time --others FOLDER`, where the folder holds \
         `water-caustic` and `veach-bidir`. Every integrator has its default settings, the scene's longest paths and {budget} s of \
         processor time, in which only iterations count. How many iterations fit depends on the machine."
    ));
    page.paragraph(&format!(
        "The error of a picture x (relMSE) is the mean over pixels of (x - a)(x - b) / (r^2 + (0.1 mean r)^2) in luminance. The \
         truth r is the average of two independent pictures a and b by `vcm` in {truth_budget} s together, with {TRUTH_RADIUS} of the \
         automatic first radius; the product is free of their noise, but not of what bias that radius leaves. The robust error leaves \
         out the worst 0.1 % of the pixels."
    ));
    if options.others.is_none() {
        page.paragraph("The scenes of others are not given (`--others FOLDER`) and left out.");
    }
    page.pictures(&[Picture {
        caption: "relMSE against processor time".into(),
        file: "equal-time.png".into(),
    }]);
}

fn chart(course: &Course, outcomes: &[Outcome]) -> Chart {
    let points = |outcome: &Outcome| outcome.checkpoints.iter().map(|c| (c.seconds, c.errors[0])).collect();
    Chart {
        title: course.name.into(),
        x: "processor time [s]".into(),
        y: "relMSE".into(),
        scales: (Scale::Log, Scale::Log),
        series: outcomes
            .iter()
            .enumerate()
            .map(|(index, outcome)| Series::new(outcome.method, Stroke::Dots, index, points(outcome)))
            .collect(),
    }
}

fn report(options: &Options, page: &mut Page, course: &Course, truth: &Truth, outcomes: &[Outcome]) -> Result<()> {
    page.heading(2, course.name);
    let last = |outcome: &Outcome| outcome.checkpoints.last().map(|c| (c.iterations, c.seconds, c.errors));
    let rows: Vec<_> = outcomes
        .iter()
        .filter_map(|outcome| {
            let (iterations, seconds, [error, robust]) = last(outcome)?;
            Some(vec![
                format!("`{}`", outcome.method),
                iterations.to_string(),
                format!("{seconds:.1}"),
                csv::number(error),
                csv::number(robust),
            ])
        })
        .collect();
    page.table(
        &[
            "integrator",
            "iterations",
            "processor seconds",
            "relMSE",
            "robust relMSE",
        ],
        &rows,
    );
    let file = format!("equal-time-{}.png", course.name);
    let pictures: Vec<&Pixels> = outcomes.iter().map(|outcome| &outcome.picture).collect();
    let curve = ToneCurve::fit(&truth.mean().values);
    picture::write(&options.out.join(&file), &montage(&pictures, 3), &curve, &[])?;
    page.pictures(&[Picture {
        caption: format!("row by row from the top left: {}", METHODS.join(", ")),
        file,
    }]);
    Ok(())
}

fn csv_rows(course: &Course, outcome: &Outcome) -> Vec<Vec<String>> {
    let row = |c: &Checkpoint| {
        vec![
            course.name.into(),
            outcome.method.into(),
            csv::number(c.seconds),
            c.iterations.to_string(),
            csv::number(c.errors[0]),
            csv::number(c.errors[1]),
        ]
    };
    outcome.checkpoints.iter().map(row).collect()
}

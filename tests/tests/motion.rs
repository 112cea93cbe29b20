//! Scenes in motion: their average over iterations is the average over time.
//!
//! Means are compared by t-tests over seeds, each of which has its own times and random numbers. A comparison of equal means fails
//! by chance with probability `FALSE_ALARMS`; seeds are fixed, so a test that passes once passes always.

use photonfarm_core::integrator::{INTEGRATORS, Unobserved, render_next};
use photonfarm_core::random::{PathRandom, Stream};
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{IntegratorSettings, PathSettings};
use photonfarm_tests::scenes;
use photonfarm_tests::statistics::{Moments, student_quantile};
use std::borrow::Borrow;
use std::collections::BTreeMap;

/// Probability with which a comparison of equal means fails.
const FALSE_ALARMS: f64 = 1e-4;

/// Seeds over which means are taken.
const SEEDS: u64 = 24;

/// Iterations of each seed, where moving and still scenes are compared.
const ITERATIONS: u32 = 8;

/// Pixels across and down; the means compared are those of the four quarters of the image.
const SIZE: usize = 8;

/// The largest difference of two vectors of means in standard errors, over what it may be.
fn excess(a: &Moments, b: &Moments) -> f64 {
    let components = a.mean().len();
    let allowed = student_quantile(FALSE_ALARMS / components as f64, SEEDS as usize - 1);
    let errors = a.squared_error().into_iter().zip(b.squared_error());
    let z = a.mean().iter().zip(b.mean()).zip(errors);
    z.map(|((a, b), (ea, eb))| (a - b).abs() / (ea + eb).sqrt() / allowed)
        .fold(0.0, f64::max)
}

/// Means over the first `iterations` of each seed; `scene` is the scene that an iteration of a seed is given.
fn measure<S: Borrow<Scene>>(settings: &IntegratorSettings, iterations: u32, scene: impl Fn(u64, u32) -> S) -> Moments {
    let mut moments = Moments::default();
    for seed in 1..=SEEDS {
        let (mut quarters, mut statistics) = ([0.0; 4], Vec::new());
        for i in 1..=iterations {
            let image = render_next(scene(seed, i).borrow(), settings, seed, i, &statistics, &Unobserved)
                .expect("the iteration renders");
            statistics = image.statistics;
            for (index, pixel) in image.pixels.iter().enumerate() {
                let quarter = index % SIZE / (SIZE / 2) + 2 * (index / SIZE / (SIZE / 2));
                quarters[quarter] += f64::from(pixel.luminance());
            }
        }
        moments.push(&quarters);
    }
    moments
}

/// Under the middle of a disc of radius `R` at height `h` a diffuse floor shows `rho Le R^2 / (R^2 + h^2)`. Averaged over heights
/// from `a` to `b` that is `rho Le R (atan(b / R) - atan(a / R)) / (b - a)`. The floor in view lies within 0.02 of the middle, where this
/// changes by less than 0.1 %.
#[test]
fn a_lamp_that_rises_lights_the_floor_by_its_mean() {
    let xml = format!(
        r#"<scene version="3.0.0">
            <sensor type="perspective">
                <float name="fov" value="0.2"/><float name="shutter_close" value="2"/>
                <transform name="to_world"><lookat origin="0, 0.9, 3" target="0, 0, 0" up="0, 1, 0"/></transform>
                <film type="hdrfilm"><integer name="width" value="{SIZE}"/><integer name="height" value="{SIZE}"/>
                    <rfilter type="box"/></film>
            </sensor>
            <shape type="rectangle">
                <transform name="to_world"><rotate x="1" angle="-90"/></transform>
                <bsdf type="diffuse"><rgb name="reflectance" value="0.6"/></bsdf>
            </shape>
            <shape type="disk">
                <animation name="to_world">
                    <transform time="0"><scale value="0.5"/><rotate x="1" angle="90"/><translate y="0.5"/></transform>
                    <transform time="2"><scale value="0.5"/><rotate x="1" angle="90"/><translate y="1.5"/></transform>
                </animation>
                <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
                <emitter type="area"><rgb name="radiance" value="3"/></emitter>
            </shape>
        </scene>"#
    );
    let expected = 0.6 * 3.0 * 0.5 * (f64::atan(1.5 / 0.5) - f64::atan(0.5 / 0.5));
    let pixels = (32 * SIZE * SIZE / 4) as f64;
    let scene = scenes::of_text(&xml).expect("the scene loads");
    let settings = IntegratorSettings::Path(PathSettings {
        samples: 2,
        ..Default::default()
    });
    let found = measure(&settings, 32, |_, _| &scene);
    let error = found.squared_error().into_iter().fold(0.0, f64::max).sqrt() / (expected * pixels);
    let exact = Moments::exact(&[expected * pixels; 4]);
    println!(
        "{:?} for {expected}, noise {error}",
        found.mean().iter().map(|m| m / pixels).collect::<Vec<_>>()
    );
    assert!(error < 0.01, "the test has power: {error}");
    assert!(excess(&found, &exact) < 1.0, "{found:?} for {exact:?}");
}

/// The scene tests/scenes/motion.xml as it stands at `time`, written without an animation: what moves is put where the closed forms of
/// its motions say.
fn still(text: &str, time: f64) -> Scene {
    let mut rest = text;
    let mut xml = String::new();
    let mut places = [
        format!(
            r#"<lookat origin="{0}, 1.1, 3.6" target="{0}, 0.6, 0" up="0, 1, 0"/>"#,
            0.4 * time
        ),
        format!(
            r#"<scale value="0.3"/><rotate y="1" angle="{}"/><translate x="-0.8" y="0.5"/>"#,
            80.0 * time
        ),
        format!(r#"<translate x="{}" y="{}"/>"#, 0.2 + 0.7 * time, 0.4 + 0.4 * time),
        format!(
            r#"<scale value="0.4"/><rotate x="1" angle="90"/><translate x="{}" y="2" z="0.4"/>"#,
            1.2 * time - 0.6
        ),
    ]
    .into_iter();
    while let Some((before, animation)) = rest.split_once("<animation") {
        let place = places.next().expect("four things move");
        xml += &format!(r#"{before}<transform name="to_world">{place}</transform>"#);
        rest = animation.split_once("</animation>").expect("it ends").1;
    }
    assert!(places.next().is_none());
    scenes::of_text(&(xml + rest)).expect("the scene loads")
}

/// For every integrator the image of the moving scene, through a moving thin lens, is the mean of still images at times that are spread over
/// the interval at random, one in each eighth. Kernels have the same width at the same iteration, so that their bias is the same too.
/// Integrators without bias have the same mean as each other.
#[test]
fn motion_blur_is_the_mean_of_still_images_for_every_integrator() {
    let file = std::fs::read_to_string(scenes::folder().join("motion.xml")).expect("the scene is there");
    let text = file.replace(r#"name="res" value="32""#, &format!(r#"name="res" value="{SIZE}""#));
    let moving = scenes::of_text(&text).expect("the scene loads");
    let start = still(&text, 0.0);
    let mut unbiased = Vec::new();
    let time = |seed: u64, iteration: u32| {
        let u = PathRandom::new(seed + 1000, iteration, Stream::Probe, 0).next_1d();
        (f64::from(iteration - 1) + f64::from(u)) / f64::from(ITERATIONS)
    };
    for integrator in INTEGRATORS {
        let given = [("photons", 1_000.into()), ("sigma1", 0.2.into()), ("samples", 4.into())];
        let given: BTreeMap<String, serde_json::Value> = given
            .into_iter()
            .filter(|(name, _)| integrator.setting(name).is_some())
            .map(|(name, value)| (name.to_owned(), value))
            .collect();
        let settings = integrator.read(given.into_iter().collect()).expect("valid settings");
        let blurred = measure(&settings, ITERATIONS, |_, _| &moving);
        let stills = measure(&settings, ITERATIONS, |seed, iteration| {
            still(&text, time(seed + 100, iteration))
        });
        let still = measure(&settings, ITERATIONS, |_, _| &start);
        let (same, other) = (excess(&blurred, &stills), excess(&blurred, &still));
        println!("{}: {same:.2}, at the start {other:.2}", settings.name());
        assert!(same < 1.0, "{}: {blurred:?} and {stills:?}", settings.name());
        assert!(
            other > 1.0,
            "{}: a scene that does not move is told apart",
            settings.name()
        );
        if ["path", "light", "bdpt"].contains(&settings.name()) {
            unbiased.push(blurred);
        }
    }
    assert!(
        unbiased[1..].iter().all(|other| excess(&unbiased[0], other) < 1.0),
        "{unbiased:?}"
    );
}

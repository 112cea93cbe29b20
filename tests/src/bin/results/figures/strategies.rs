//! The pyramid of bidirectional techniques (Veach 1997, figure 10.2): what technique (s, t) of `bdpt` finds alone, with its share
//! and in full.

use super::page::{Page, Picture};
use super::picture::{self, Pixels, montage};
use super::runs::average;
use super::stage;
use crate::Options;
use crate::render::progress;
use anyhow::Result;
use photonfarm_core::picture::ToneCurve;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{BdptSettings, IntegratorSettings};
use photonfarm_core::spectrum::Spectrum;

/// Lengths of paths that are shown, in edges: a row each.
const EDGES: std::ops::RangeInclusive<u32> = 2..=5;

/// Writes `strategies.md` and its pictures to the folder `options.out`.
pub(crate) fn run(options: &Options) -> Result<()> {
    let (size, iterations) = if options.small { ([32, 24], 2) } else { ([128, 96], 32) };
    let scene = stage::load(&options.scenes.join("box"), size)?;
    let rows = EDGES.count() as u64;
    let bar = progress("strategies", 2 * rows * u64::from(*EDGES.end() + 1));
    let mut page = Page::default();
    page.heading(1, "What each bidirectional technique finds");
    page.paragraph(
        "Written by `cargo run --release -p photonfarm-tests --bin results -- strategies`: `scenes/box` by `bdpt` with `light_vertices=s` and \
         `camera_vertices=t`. Each row has paths of one more edge, from 2; in a row s grows from 0, and t = edges + 1 - s falls. \
         The camera is a pinhole, which no light path hits (t = 0). With its share (`weighted=true`) a technique shows the part of the \
         picture that it is best at, and all pictures of a row add up to the light of that length; in full (`weighted=false`) it \
         shows all that it can find, with its noise, and black is what it cannot find.",
    );
    let pyramid = |weighted: bool| -> Result<Pixels> {
        let mut pictures = Vec::new();
        for edges in EDGES {
            for s in 0..=*EDGES.end() {
                let t = (edges + 1).checked_sub(s).filter(|t| *t > 0);
                pictures.push(match t {
                    Some(t) => average(&scene, &technique(&scene, s, t, weighted), 1, iterations, |_| {})?.mean(),
                    None => Pixels {
                        size,
                        values: vec![Spectrum::ZERO; (size[0] * size[1]) as usize],
                    },
                });
                bar.inc(1);
            }
        }
        Ok(montage(&pictures.iter().collect::<Vec<_>>(), *EDGES.end() as usize + 1))
    };
    let pyramids = [("with its share", pyramid(true)?), ("in full", pyramid(false)?)];
    bar.finish_and_clear();
    let curve = ToneCurve::fit(&pyramids[1].1.values);
    for (caption, pixels) in &pyramids {
        let file = format!("strategies-{}.png", caption.replace(' ', "-"));
        picture::write(&options.out.join(&file), pixels, &curve, &[])?;
        page.pictures(&[Picture {
            caption: format!("each technique {caption}"),
            file,
        }]);
    }
    page.write(&options.out.join("strategies.md"))
}

fn technique(scene: &Scene, s: u32, t: u32, weighted: bool) -> IntegratorSettings {
    let [width, height] = scene.film.resolution;
    IntegratorSettings::Bdpt(BdptSettings {
        photons: width * height,
        light_vertices: Some(s),
        camera_vertices: Some(t),
        weighted,
        max_depth: Some(*EDGES.end()),
        ..Default::default()
    })
}

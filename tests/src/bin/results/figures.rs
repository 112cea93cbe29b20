//! Pictures and plots of example scenes: the figures of chapters 4 and 5 of Chang's thesis (2019), repeated on scenes of this
//! project and, where it is given, on Hachisuka's torus.

mod equal_time;
mod guiding;
mod page;
mod picture;
mod probes;
pub(crate) mod race;
mod runs;
mod stage;
pub(crate) mod strategies;

use crate::Options;
use anyhow::Result;
use page::Page;
use std::time::Instant;

/// Writes pictures, plots, tables of values and the page `figures.md` to the folder `options.out`.
pub(crate) fn run(options: &Options) -> Result<()> {
    let start = Instant::now();
    let mut page = Page::default();
    page.heading(1, "Figures of the thesis, repeated");
    let small = if options.small { " --small" } else { "" };
    page.paragraph(&format!(
        "Written by `cargo run --release -p photonfarm-tests --bin results -- figures{small}`. Figures are those of C.-Y. Chang, \
         \"Photon Cone Focusing\" (2019), by their numbers there. Rooms have a side of about 2, as in the thesis; the scenes are \
         `scenes/box`, `scenes/cornell-bunny` and `scenes/pyramids`, and Hachisuka's torus where `--others FOLDER` names a folder \
         with it. Seeds are fixed: the numbers repeat, but for times and what depends on them."
    ));
    if stage::torus(options).is_none() {
        let left_out = "The torus scene is not given (`--others FOLDER`): figures 4.2, 5.4 and 5.5 are left out.";
        eprintln!("{left_out}");
        page.paragraph(left_out);
    }
    guiding::run(options, &mut page)?;
    probes::run(options, &mut page)?;
    equal_time::run(options, &mut page)?;
    page.paragraph(&format!(
        "All of this took {:.0} s on {} threads.",
        start.elapsed().as_secs_f64(),
        rayon::current_num_threads()
    ));
    page.write(&options.out.join("figures.md"))
}

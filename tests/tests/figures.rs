//! The figures of docs/results in their small version: they are written, and show what they are to show.

use photonfarm_tests::processes::printed;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// A table of values: each row by the names of its columns.
fn read(path: &Path) -> Vec<BTreeMap<String, String>> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut lines = text
        .lines()
        .map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let header = lines.next().expect("a header");
    lines.map(|row| header.iter().cloned().zip(row).collect()).collect()
}

fn number(row: &BTreeMap<String, String>, column: &str) -> f64 {
    row[column]
        .parse()
        .unwrap_or_else(|e| panic!("{column} of {row:?}: {e}"))
}

/// What 8 observations of mean zero exceed, as their mean over its standard error, with probability 0.001 (Student's t, 7 degrees
/// of freedom).
const T_OF_8: f64 = 4.785;

#[test]
fn small_figures_show_what_they_are_to_show() {
    let folder = small("figures");
    let in_folder = |name: &str| folder.path().join(name);

    // Aimed cones have less variance at equal numbers of cones; techniques that are alike would pass with probability 0.001 each.
    let pairs = read(&in_folder("figures-4.csv"));
    assert_eq!(pairs.len(), 4, "two comparisons of two");
    for row in &pairs {
        let gain = number(row, "log_gain") / number(row, "log_gain_standard_error");
        assert!(gain > T_OF_8, "{row:?}: {gain}");
    }

    // On the caustic the kernel's bias rules: it falls with the bandwidth. Its reflection is nearer to the truth than by paths with as
    // many camera samples, which seldom find the lamp through glass.
    let errors = read(&in_folder("figures-5-box.csv"));
    let (first, last) = (&errors[0], &errors[errors.len() - 1]);
    assert!(
        number(last, "error_a") < 0.8 * number(first, "error_a"),
        "{first:?} {last:?}"
    );
    for row in &errors {
        assert!(number(row, "error_b") < number(row, "path_error_b"), "{row:?}");
    }
    for bandwidth in ["sigma", "theta_degrees"] {
        assert!(number(last, bandwidth) < number(first, bandwidth), "{first:?} {last:?}");
    }

    assert!(pictures_of(&in_folder("figures.md")) > 8);
}

/// Every integrator gets further with more time; what each reaches in it depends on the machine.
#[test]
fn small_equal_times_are_written_for_every_integrator() {
    let folder = small("equal-time");
    let rows = read(&folder.path().join("equal-time.csv"));
    for method in ["path", "bdpt", "vcm", "pppm", "sppm", "pcf"] {
        let of_method: Vec<_> = rows.iter().filter(|row| row["integrator"] == method).collect();
        assert!(!of_method.is_empty(), "{method}");
        for pair in of_method.windows(2) {
            for column in ["processor_seconds", "iterations"] {
                assert!(number(pair[0], column) < number(pair[1], column), "{pair:?}");
            }
        }
        for row in of_method {
            assert!(number(row, "relmse") >= number(row, "robust_relmse"), "{row:?}");
        }
    }
    assert_eq!(
        pictures_of(&folder.path().join("equal-time.md")),
        2,
        "the chart and the scene"
    );
}

/// Technique (1, 2) finds light of two edges in both pyramids, and (2, 1) the same light: in full they are as bright as each other.
#[test]
fn small_strategies_are_drawn_as_pyramids() {
    let folder = small("strategies");
    assert_eq!(pictures_of(&folder.path().join("strategies.md")), 2);
    let open = |name: &str| image::open(folder.path().join(name)).expect("a picture").to_rgb32f();
    let (share, full) = (open("strategies-with-its-share.png"), open("strategies-in-full.png"));
    assert_eq!(share.dimensions(), full.dimensions());
    let (width, height) = (full.width() / 6, full.height() / 4);
    let mean = |picture: &image::Rgb32FImage, s: u32| {
        let cell = image::imageops::crop_imm(picture, s * width, 0, width, height).to_image();
        cell.pixels().map(|pixel| pixel.0.iter().sum::<f32>()).sum::<f32>() / (3 * width * height) as f32
    };
    for s in [1, 2] {
        assert!(mean(&full, s) > 0.05, "technique ({s}, {}) sees the room", 3 - s);
        assert!(mean(&share, s) < mean(&full, s), "and does not count alone");
    }
    assert_eq!(mean(&full, 4), 0.0, "no light path of four vertices has two edges");
}

/// Writes the small version of a part of the results.
fn small(part: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let run = Command::new(env!("CARGO_BIN_EXE_results"))
        .args([part, "--small", "--out"])
        .arg(folder.path())
        .env_remove("PHOTONFARM_SCENES")
        .output()
        .expect("the program starts");
    printed(&run);
    folder
}

/// How many pictures a page shows; all of them were written, and are large enough to be looked at.
fn pictures_of(page: &Path) -> usize {
    let text = std::fs::read_to_string(page).expect("the page");
    let pictures: Vec<&str> = text
        .split("](")
        .skip(1)
        .filter_map(|rest| rest.split(')').next())
        .filter(|link| link.ends_with(".png"))
        .collect();
    for picture in &pictures {
        let size = image::image_dimensions(page.with_file_name(picture)).unwrap_or_else(|e| panic!("{picture}: {e}"));
        assert!(size.0.max(size.1) >= 128, "{picture}: {size:?}");
    }
    pictures.len()
}

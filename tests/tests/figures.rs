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
    let folder = tempfile::tempdir().expect("a temporary folder");
    let run = Command::new(env!("CARGO_BIN_EXE_results"))
        .args(["figures", "--small", "--out"])
        .arg(folder.path())
        .env_remove("PHOTONFARM_SCENES")
        .output()
        .expect("the program starts");
    printed(&run);
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

    // The page shows only what was written.
    let page = std::fs::read_to_string(in_folder("figures.md")).expect("the page");
    let pictures: Vec<&str> = page
        .split("](")
        .skip(1)
        .filter_map(|rest| rest.split(')').next())
        .collect();
    assert!(pictures.len() > 8, "{pictures:?}");
    for picture in pictures {
        let size = image::image_dimensions(in_folder(picture)).unwrap_or_else(|e| panic!("{picture}: {e}"));
        assert!(size.0.max(size.1) >= 256, "{picture}: {size:?}");
    }
}

use super::*;
use photonfarm_tests::statistics::student_quantile;

/// Probability with which each check of a mean fails by chance; there are seven, of fixed seeds. With the errors that six iterations
/// reach, an error of 3 % (`path`) to 7 % (`pcf k=1`) of a column is noticed.
const FALSE_ALARMS: f64 = 1e-3;

/// Bound on the bias of the kernels; `path` and `bdpt` have none.
const BIAS: f64 = 0.02;

/// Six iterations tell little about the noise of one cell, so ratios are held against 1 by column: the mean of a column's
/// ratios, with the error of the cells that are not black together (five degrees of freedom each).
#[test]
fn cells_are_black_where_they_must_be_and_one_elsewhere() {
    let effort = Effort::small();
    let rows = measure(&effort, &ProgressBar::hidden()).unwrap();
    assert_eq!(rows.len(), 5 * 5, "every emitter and chain, for the pinhole");
    for (index, column) in Column::ALL.into_iter().enumerate() {
        let (mut sum, mut squared_error, mut cells) = (0.0, 0.0, 0);
        for Row { layout, ratios, .. } in &rows {
            let (named, ratio) = ratios[index];
            assert_eq!(named, column);
            let expected = must_be_black(column, layout);
            assert_eq!(ratio.is_black(), expected, "{layout:?}, {column:?}: {ratio:?}");
            if !expected {
                sum += ratio.value;
                squared_error += ratio.error * ratio.error;
                cells += 1;
            }
        }
        let (mean, error) = (sum / f64::from(cells), squared_error.sqrt() / f64::from(cells));
        // The cells' errors differ: as few degrees of freedom as four cells have.
        let unbiased = matches!(column, Column::Path | Column::Bdpt);
        let bias = if unbiased { 0.0 } else { BIAS };
        let reach = bias + error * student_quantile(FALSE_ALARMS, 20);
        println!(
            "{}: mean ratio {mean:.4} +- {error:.4} over {cells} cells",
            column.name()
        );
        assert!((mean - 1.0).abs() < reach, "{column:?}: {mean} +- {error}");
        assert!(error < 0.015, "the test has power: {column:?}: {error}");
    }
}

/// The lower mirror's back takes 4.19 % of the parallel rays that would see the environment's cap in both mirrors. The area light lies on the
/// camera's axis, 0.9 behind what is in focus at the distance 1: from every point of the lens it covers the share
/// `pi (0.08 / 1.9)^2 / 0.68^2` of the image.
#[test]
fn true_values_are_those_of_finer_sums() {
    for (eye, emitter, chain, expected) in [
        (Eye::Orthographic, Emitter::Environment, Chain::Ss, 0.9581),
        (Eye::Orthographic, Emitter::Environment, Chain::S, 1.0),
        (Eye::ThinLens, Emitter::Area, Chain::S, 0.012046),
        (Eye::Pinhole, Emitter::Area, Chain::S, 0.012046),
    ] {
        let layout = Layout { emitter, eye, chain };
        let truth = truth::mean_radiance(&layout).unwrap().unwrap();
        assert!(
            (truth / expected - 1.0).abs() < 2e-3,
            "{layout:?}: {truth} for {expected}"
        );
    }
    assert!((truth::blurred_cap(5.0_f64.to_radians()) - 0.3733).abs() < 1e-3);
}

/// The images of a point light, by the formulas and by counting rays that come within a small disc of it.
#[test]
fn the_image_of_a_delta_light_is_the_limit_of_a_small_one() {
    for eye in Eye::ALL {
        let layout = |emitter| Layout {
            emitter,
            eye,
            chain: Chain::Ss,
        };
        let truth = |emitter| truth::mean_radiance(&layout(emitter)).unwrap().unwrap();
        // The disc's intensity is its area, for radiance 1; it faces the camera.
        let disc = std::f64::consts::PI * f64::from(layout::LIGHT_RADIUS).powi(2);
        let ratio = truth(Emitter::Area) / (disc * truth(Emitter::Point));
        assert!((ratio - 1.0).abs() < 0.03, "{eye:?}: {ratio}");
    }
}

#[test]
fn parallel_light_along_parallel_rays_has_no_finite_image() {
    let layout = Layout {
        emitter: Emitter::Directional,
        eye: Eye::Orthographic,
        chain: Chain::S,
    };
    assert!(truth::mean_radiance(&layout).unwrap().is_none());
}

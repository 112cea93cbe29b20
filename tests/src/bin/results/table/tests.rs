use super::*;

/// Standard errors that a ratio may miss 1 by, beside the kernel's bias. Of some hundred ratios one misses more by chance with
/// probability 1e-3; the seeds are fixed.
const ERRORS: f64 = 4.5;

/// Bound on the bias of the kernels.
const BIAS: f64 = 0.06;

/// Whether the integrator has no way to sample light along the chain.
fn must_be_black(column: Column, layout: &Layout) -> bool {
    let singular = layout.emitter.is_delta();
    match column {
        Column::Path => singular && (layout.chain.shows_the_light() || layout.chain == Chain::Sds),
        Column::Pppm | Column::Pcf => singular && layout.chain.shows_the_light(),
        Column::NestedPcf | Column::FirstVertexPcf => false,
    }
}

#[test]
fn cells_are_black_where_they_must_be_and_one_elsewhere() {
    let rows = measure(&Effort::small(), &ProgressBar::hidden()).unwrap();
    let mut cells = 0;
    for Row { layout, ratios, .. } in &rows {
        for (column, ratio) in ratios {
            cells += 1;
            if must_be_black(*column, layout) {
                assert!(ratio.is_black(), "{layout:?}, {column:?}: {ratio:?}");
            } else {
                let reach = BIAS + ERRORS * ratio.error;
                assert!((ratio.value - 1.0).abs() < reach, "{layout:?}, {column:?}: {ratio:?}");
                assert!(
                    ratio.error < 0.3,
                    "the test has power: {layout:?}, {column:?}: {ratio:?}"
                );
            }
        }
    }
    assert_eq!(cells, 5 * 5 * 5, "every emitter, chain and integrator, for the pinhole");
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

use super::*;

/// Of seven intervals at confidence 1 - 1e-3 one misses by chance with a probability below 7e-3; the seeds are fixed.
#[test]
fn measured_slopes_hold_the_expected_ones() {
    for outcome in measure(&Effort::small()).unwrap() {
        let name = outcome.case.name();
        for (what, slope, expected) in [
            ("bias", outcome.bias, outcome.expected.bias),
            ("variance", outcome.variance, outcome.expected.variance),
        ] {
            if what == "bias" && !outcome.case.shows_bias() {
                continue;
            }
            println!(
                "{name}: {what} {:.3} +- {:.3} for {expected:.3}",
                slope.value,
                slope.half_width(CONFIDENCE)
            );
            assert!(
                slope.holds(expected, 1.0 - 1e-3),
                "{name}: {what} {slope:?} for {expected}"
            );
            assert!(
                slope.half_width(CONFIDENCE) < 0.12,
                "the test has power: {name}: {what} {slope:?}"
            );
        }
    }
}

/// With more iterations the prediction comes closer to the exponents of the limit.
#[test]
fn expected_slopes_tend_to_the_exponents() {
    for case in Effort::full().cases {
        let scene = case.varies.scene().unwrap();
        let refined = case.refined();
        let gaps = |counts: [u32; 3]| {
            let (bias, variance) = case.predicted(&scene, &counts);
            [
                (log_log_slope(&counts, &bias) - refined.bias).abs(),
                (log_log_slope(&counts, &variance) - refined.variance).abs(),
            ]
        };
        let (early, late) = (gaps([64, 256, 1024]), gaps([1024, 4096, 8192]));
        for (early, late) in early.into_iter().zip(late) {
            assert!(
                late < 0.06 && late < early.max(0.02),
                "{}: {early}, then {late}",
                case.name()
            );
        }
    }
}

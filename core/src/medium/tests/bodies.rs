//! Bodies that overlap, against closed forms and against scenes in which nothing does.

use super::{agrees, estimate, integrators, narrow_camera, path, scene};
use crate::integrator::IntegratorSettings;
use crate::random::Sampling;
use crate::settings::{MediaEstimator, PppmSettings, SurfacesSettings};
use crate::spectrum::CHANNELS;

/// A box from one z to another, of the same half size in x and y.
fn slab([from, to, half]: [f64; 3], priority: Option<i64>, inner: &str) -> String {
    let priority = priority.map_or(String::new(), |priority| {
        format!("<integer name='priority' value='{priority}'/>")
    });
    format!(
        "<shape type='cube'>{priority}<transform name='to_world'><scale x='{half}' y='{half}' z='{}'/><translate z='{}'/></transform>{inner}</shape>",
        0.5 * (to - from),
        0.5 * (from + to)
    )
}

/// What bounds nothing but a medium that absorbs.
fn absorbing(sigma: [f64; 3]) -> String {
    let [r, g, b] = sigma;
    format!(
        "<bsdf type='null'/><medium name='interior' type='homogeneous'><rgb name='sigma_t' value='{r} {g} {b}'/>\
         <float name='albedo' value='0'/></medium>"
    )
}

const FIRST: [f64; 3] = [0.5, 1.0, 2.0];
const SECOND: [f64; 3] = [0.3, 0.2, 0.1];

/// Beer's law along a line through two boxes, by the lengths of the line in either.
#[test]
fn the_highest_priority_holds() {
    let (outer, shifted, within) = ([-1.0, 1.0, 1.0], [0.0, 2.0, 0.9], [-0.5, 0.5, 0.5]);
    for (start, first, second, lengths) in [
        (-5.0, (outer, Some(1)), (shifted, Some(2)), [1.0, 2.0]),
        (-5.0, (outer, Some(2)), (shifted, Some(1)), [2.0, 1.0]),
        (-5.0, (outer, Some(1)), (within, Some(2)), [1.0, 1.0]),
        (-5.0, (outer, Some(2)), (within, Some(1)), [2.0, 0.0]),
        // Of equal ones the smaller.
        (-5.0, (outer, Some(0)), (shifted, Some(0)), [1.0, 2.0]),
        (-5.0, (outer, Some(0)), ([0.0, 2.0, 1.1], Some(0)), [2.0, 1.0]),
        (-5.0, (outer, Some(0)), (within, Some(0)), [1.0, 1.0]),
        // What says none comes last.
        (-5.0, (outer, None), (shifted, Some(-3)), [1.0, 2.0]),
        (-5.0, (outer, None), (within, Some(-3)), [1.0, 1.0]),
        (-5.0, (shifted, None), (outer, Some(-3)), [1.0, 2.0]),
        // The camera within one or both.
        (0.5, (outer, Some(1)), (shifted, Some(2)), [0.0, 1.5]),
        (0.5, (outer, Some(2)), (shifted, Some(1)), [0.5, 1.0]),
        (-0.5, (outer, Some(1)), (shifted, Some(2)), [0.5, 2.0]),
        (0.5, (outer, None), (shifted, Some(2)), [0.0, 1.5]),
    ] {
        let (a, b) = (absorbing(FIRST), absorbing(SECOND));
        let (first, second) = (slab(first.0, first.1, &a), slab(second.0, second.1, &b));
        let camera = narrow_camera(&format!("0 0 {start}"));
        for shapes in [format!("{first}{second}"), format!("{second}{first}")] {
            let scene = scene(&format!("{camera}<emitter type='constant'/>{shapes}"));
            let found = estimate(&scene, &path(1 << 9, None), 8);
            for channel in 0..CHANNELS {
                let depth = FIRST[channel] * lengths[0] + SECOND[channel] * lengths[1];
                agrees(
                    &format!("channel {channel}, {shapes}"),
                    found[channel],
                    (-depth).exp(),
                    1e-4,
                );
            }
        }
    }
}

/// Light straight through boxes of glass and a liquid that overlap: each surface that is there reflects what Fresnel's equations say of the two
/// indices on its sides, and those within what holds are not there.
#[test]
fn surfaces_stand_between_what_holds() {
    let clear = |plugin: &str, index: f64| {
        format!(
            "<bsdf type='{plugin}'><float name='int_ior' value='{index}'/><float name='ext_ior' value='1'/></bsdf>\
             <medium name='interior' type='homogeneous'><rgb name='sigma_t' value='0.1 0.2 0.4'/><float name='albedo' value='0'/></medium>"
        )
    };
    let through = |a: f64, b: f64| 1.0 - ((a - b) / (a + b)).powi(2);
    let (glass, liquid) = ([-1.0, 1.0, 1.0], [0.5, 3.0, 0.9]);
    let (smooth, water) = (clear("dielectric", 1.5), clear("dielectric", 1.33));
    let rough = clear("roughdielectric", 1.5);
    let through_all = through(1.0, 1.5) * through(1.5, 1.33) * through(1.33, 1.0);
    let glass_alone = through(1.0, 1.5).powi(2);
    for (shapes, expected, length) in [
        (
            slab(glass, Some(2), &smooth) + &slab(liquid, Some(1), &water),
            through_all,
            4.0,
        ),
        (
            slab(glass, Some(1), &smooth) + &slab(liquid, Some(2), &water),
            through_all,
            4.0,
        ),
        (
            slab(glass, Some(1), &smooth) + &slab(glass.map(|x| 0.5 * x), Some(0), &water),
            glass_alone,
            2.0,
        ),
        // Between glass and glass is no surface, rough or not.
        (
            slab(glass, Some(1), &smooth) + &slab(glass.map(|x| 0.5 * x), Some(2), &smooth),
            glass_alone,
            2.0,
        ),
        (
            slab(glass, Some(1), &smooth) + &slab(glass.map(|x| 0.5 * x), Some(2), &rough),
            glass_alone,
            2.0,
        ),
    ] {
        let scene = scene(&format!(
            "{}{shapes}<shape type='rectangle'><transform name='to_world'><rotate x='1' angle='180'/><translate z='5'/></transform>\
             <emitter type='area'><rgb name='radiance' value='1'/></emitter></shape>",
            narrow_camera("0 0 -5")
        ));
        // Longer paths are reflected within.
        let found = estimate(&scene, &path(1 << 12, Some(4)), 16);
        for (channel, sigma) in [0.1, 0.2, 0.4_f64].into_iter().enumerate() {
            let label = format!("channel {channel}, {shapes}");
            agrees(&label, found[channel], expected * (-length * sigma).exp(), 1e-3);
        }
    }
}

/// A side of a box: that of an axis, upper or lower.
fn face(center: [f64; 3], half: [f64; 3], axis: usize, upper: bool, inner: &str) -> String {
    let (turned, angle, [width, height]) = match axis {
        0 => ("y", 90.0, [half[2], half[1]]),
        1 => ("x", -90.0, [half[0], half[2]]),
        _ => ("y", 0.0, [half[0], half[1]]),
    };
    let angle = match (upper, axis) {
        (true, _) => angle,
        (false, 2) => 180.0,
        (false, _) => -angle,
    };
    let mut at = center;
    at[axis] += if upper { half[axis] } else { -half[axis] };
    let [x, y, z] = at;
    format!(
        "<shape type='rectangle'><transform name='to_world'><scale x='{width}' y='{height}'/><rotate {turned}='1' angle='{angle}'/>\
         <translate x='{x}' y='{y}' z='{z}'/></transform>{inner}</shape>"
    )
}

/// Two boxes, of which the first reaches from x = -1 to 0 and the second, which is less high and deep, from there to 1.2: by bodies that overlap, and by
/// surfaces that are there. Each is `bsdf(index, index outside)` with what fills it.
fn boxes(bsdf: impl Fn(f64, f64) -> String, fills: [&str; 2]) -> [String; 2] {
    let fill = |name: &str, id: &str| match id.is_empty() {
        true => String::new(),
        false => format!("<ref name='{name}' id='{id}'/>"),
    };
    let first = bsdf(1.5, 1.0) + &fill("interior", fills[0]);
    let second = bsdf(1.3, 1.0) + &fill("interior", fills[1]);
    let between = bsdf(1.5, 1.3) + &fill("interior", fills[0]) + &fill("exterior", fills[1]);
    let cube = |[from, to]: [f64; 2], half: f64, priority: i64, inner: &str| {
        format!(
            "<shape type='cube'><integer name='priority' value='{priority}'/><transform name='to_world'>\
             <scale x='{}' y='{half}' z='{half}'/><translate x='{}'/></transform>{inner}</shape>",
            0.5 * (to - from),
            0.5 * (from + to)
        )
    };
    let overlapping = cube([-1.0, 0.0], 1.0, 2, &first) + &cube([-0.6, 1.2], 0.8, 1, &second);
    let sides = |left_out: (usize, bool)| {
        let all = (0..3).flat_map(|axis| [(axis, false), (axis, true)]);
        all.filter(move |side| *side != left_out)
    };
    let mut apart = String::new();
    for (axis, upper) in sides((0, true)) {
        apart += &face([-0.5, 0.0, 0.0], [0.5, 1.0, 1.0], axis, upper, &first);
    }
    for (axis, upper) in sides((0, false)) {
        apart += &face([0.6, 0.0, 0.0], [0.6, 0.8, 0.8], axis, upper, &second);
    }
    apart += &face([0.0; 3], [0.0, 0.8, 0.8], 0, true, &between);
    for sign in [-0.9, 0.9] {
        apart += &face([0.0, sign, 0.0], [0.0, 0.1, 1.0], 0, true, &first);
        apart += &face([0.0, 0.0, sign], [0.0, 0.8, 0.1], 0, true, &first);
    }
    [overlapping, apart]
}

/// The world about the boxes.
fn around(shapes: &str, lights: &str) -> String {
    format!(
        "<medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.5 1 1.5'/><rgb name='albedo' value='0.9 0.8 0.6'/>\
         <phase type='hg'><float name='g' value='0.5'/></phase></medium>\
         <medium id='milk' type='homogeneous'><rgb name='sigma_t' value='2 1.5 1'/><rgb name='albedo' value='0.6 0.9 0.8'/></medium>\
         <sensor type='perspective'><float name='fov' value='34'/><transform name='to_world'>\
         <lookat origin='0.4, 0.8, -5' target='0.1, 0, 0' up='0, 1, 0'/></transform>\
         <film type='hdrfilm'><integer name='width' value='4'/><integer name='height' value='4'/><rfilter type='box'/></film></sensor>\
         {shapes}<shape type='rectangle'><transform name='to_world'><scale value='3'/><rotate x='1' angle='-90'/><translate y='-1.2'/></transform>\
         <bsdf type='diffuse'><rgb name='reflectance' value='0.3 0.6 0.9'/></bsdf></shape>{lights}"
    )
}

const LAMP: &str = "<shape type='rectangle'><transform name='to_world'><scale value='0.8'/><rotate x='1' angle='90'/><translate y='2.2'/></transform>\
    <emitter type='area'><rgb name='radiance' value='10'/></emitter></shape>";

/// Compares what integrators see of overlapping bodies with what path tracing sees where nothing overlaps.
fn compare([overlapping, apart]: [String; 2], lights: &str, all: &[IntegratorSettings]) {
    let longest = Some(6);
    let expected = estimate(&scene(&around(&apart, lights)), &path(128, longest), 128);
    let scene = scene(&around(&overlapping, lights));
    for settings in all {
        let found = estimate(&scene, settings, 96);
        for channel in 0..CHANNELS {
            let ((mean, error), (wanted, its)) = (found[channel], expected[channel]);
            let error = error.hypot(its);
            let label = format!("channel {channel}, {settings:?}");
            assert!(error < 0.1 * wanted, "{label}: {mean} and {wanted} +- {error}");
            // Discs of the density estimates blur what lies in corners.
            agrees(&label, (mean, error), wanted, 0.02);
        }
    }
}

/// Media that overlap, with lamps outside of all, within both, and within one.
#[test]
fn all_integrators_see_media_as_without_overlap() {
    let lamps = |intensity: f64| {
        [[-0.3, 0.1, 0.2], [0.7, -0.2, 0.1]].map(|[x, y, z]| {
            format!("<emitter type='point'><point name='position' x='{x}' y='{y}' z='{z}'/><rgb name='intensity' value='{intensity}'/></emitter>")
        })
    };
    let lights = LAMP.to_owned() + &lamps(2.0).concat();
    let longest = Some(6);
    let mut all = integrators(16, 2000, longest);
    for media in [MediaEstimator::Radiance, MediaEstimator::Beams] {
        all.push(IntegratorSettings::Pppm(PppmSettings {
            samples: 4,
            photons: 10_000,
            sigma1: Some(0.05),
            media,
            max_depth: longest,
            ..PppmSettings::default()
        }));
    }
    all.push(IntegratorSettings::Surfaces(SurfacesSettings {
        photons: 100,
        samples: 1,
        sampling: Sampling::Independent,
        max_depth: longest,
        ..SurfacesSettings::default()
    }));
    compare(
        boxes(|_, _| "<bsdf type='null'/>".to_owned(), ["fog", "milk"]),
        &lights,
        &all,
    );
}

/// Clear glass that overlaps a liquid.
#[test]
fn glass_and_liquid_are_as_without_overlap() {
    let bsdf = |plugin: &'static str| {
        move |inside: f64, outside: f64| {
            format!(
                "<bsdf type='{plugin}'><float name='int_ior' value='{inside}'/><float name='ext_ior' value='{outside}'/></bsdf>"
            )
        }
    };
    let lights = "<emitter type='constant'><rgb name='radiance' value='0.3 0.4 0.5'/></emitter>";
    for plugin in ["dielectric", "roughdielectric"] {
        let mut all = integrators(4, 2000, Some(6));
        // The others are too noisy here: few light paths come through glass to the lens, or to what is seen.
        all.retain(|settings| {
            matches!(
                settings,
                IntegratorSettings::Path(_) | IntegratorSettings::Bdpt(_) | IntegratorSettings::Vcm(_)
            )
        });
        compare(boxes(bsdf(plugin), ["", "milk"]), lights, &all);
    }
}

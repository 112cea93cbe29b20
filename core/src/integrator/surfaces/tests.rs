//! Photon surfaces against path tracing, for each kind of path and each technique by itself.

use crate::integrator::IntegratorSettings;
use crate::medium::tests::{agrees, estimate, path, scene};
use crate::random::Sampling;
use crate::scene::Scene;
use crate::settings::{SurfaceKind, SurfacesSettings, Weights};
use crate::spectrum::CHANNELS;
use SurfaceKind::{
    Cones, Connections, Cylinders, Discs, Hyperboloids, InnerSpheres, LightArcs, LightCircles, LightCopies,
    LightPlanes, Planes, Spheres, Toroids, TurnedPlanes,
};

/// Mean cosines of scattering.
const FORWARD: f32 = 0.9;
const EVENLY: f32 = 0.1;

/// Most edges of a path.
const LONGEST: u32 = 6;

/// Fog of coloured extinction, with `g` as the mean cosine of scattering, in a cube of an index as the air's, with an occluder and a floor.
fn fog(paths: &str, g: f32) -> Scene {
    let mut scene = scene(&format!(
        "<medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.4 0.6 0.9'/><rgb name='albedo' value='0.9 0.8 0.7'/>\
        <phase type='hg'><float name='g' value='{g}'/></phase></medium>\
        <sensor type='perspective'><float name='fov' value='30'/><transform name='to_world'>\
        <lookat origin='0, 0, -5' target='0, 0, 0' up='0, 1, 0'/></transform>\
        <film type='hdrfilm'><integer name='width' value='4'/><integer name='height' value='4'/><rfilter type='box'/></film></sensor>\
        <shape type='cube'><bsdf type='null'/><ref name='interior' id='fog'/></shape>\
        <shape type='rectangle'><transform name='to_world'><scale value='3'/><rotate x='1' angle='-90'/><translate y='-1.2'/></transform>\
        <bsdf type='diffuse'/></shape>\
        <shape type='sphere'><point name='center' x='0.3' y='0.5' z='-0.3'/><float name='radius' value='0.2'/></shape>\
        <shape type='rectangle'><transform name='to_world'><scale value='0.5'/><rotate x='1' angle='120'/><translate y='1.6' z='0.6'/></transform>\
        <emitter type='area'><rgb name='radiance' value='9 8 7'/></emitter></shape>"
    ));
    scene.paths = Some(paths.parse().unwrap());
    scene
}

fn surfaces(used: &[SurfaceKind], weights: Weights) -> IntegratorSettings {
    IntegratorSettings::Surfaces(SurfacesSettings {
        photons: 200,
        samples: 1,
        sampling: Sampling::Independent,
        surfaces: used.to_vec(),
        weights,
        max_depth: Some(LONGEST),
    })
}

fn compare(paths: &str, g: f32, iterations: u32, techniques: &[Vec<SurfaceKind>]) {
    let scene = fog(paths, g);
    let expected = estimate(&scene, &path(128, Some(LONGEST)), 256);
    for used in techniques {
        let weights: &[Weights] = match (used.len(), g == FORWARD) {
            // It shares with nothing.
            (1, _) => &[Weights::Average],
            // Evenly, the noise of each by itself would remain.
            (_, true) => &[Weights::Balance],
            _ => &[Weights::Average, Weights::Balance],
        };
        for weights in weights {
            let found = estimate(&scene, &surfaces(used, *weights), iterations);
            for channel in 0..CHANNELS {
                let ((mean, error), (wanted, its)) = (found[channel], expected[channel]);
                let label = format!("{paths}, g = {g}, {used:?}, {weights:?}, channel {channel}");
                agrees(&label, (mean, error.hypot(its)), wanted, 1e-4);
                assert!(error < 0.3 * mean, "{label}: {mean} +- {error} says nothing");
            }
        }
    }
}

/// All that light which media have scattered twice can be found by.
const OF_TWO: [SurfaceKind; 6] = [Planes, Spheres, Cones, Cylinders, Discs, Connections];

/// All that light which media have scattered more often can be found by.
const OF_THREE: [SurfaceKind; 9] = [
    Planes,
    Spheres,
    InnerSpheres,
    Cones,
    Cylinders,
    Discs,
    Toroids,
    Hyperboloids,
    Connections,
];

/// Those that bound each other's noise where media scatter light forward more than once.
const ROBUST: [SurfaceKind; 4] = [Planes, Cones, Cylinders, Connections];

/// All that light from a surface which media have scattered once can be found by.
const OF_SURFACE: [SurfaceKind; 3] = [Spheres, Cones, Connections];

/// All that light from a rectangle which media have scattered once can be found by.
const OF_LIGHT: [SurfaceKind; 8] = [
    Spheres,
    Cones,
    Connections,
    LightCopies,
    LightPlanes,
    TurnedPlanes,
    LightCircles,
    LightArcs,
];

/// Each by itself, and all together. Connections, whose noise has no bound near places of scattering, have cones beside them.
fn each_and_all(kinds: &[SurfaceKind]) -> Vec<Vec<SurfaceKind>> {
    let one = |kind: &SurfaceKind| match kind {
        Connections => vec![Connections, Cones],
        _ => vec![*kind],
    };
    kinds.iter().map(one).chain([kinds.to_vec()]).collect()
}

/// Each beside some that keep its noise within bounds where media scatter forward, and all together.
fn each_beside(companions: &[SurfaceKind], kinds: &[SurfaceKind]) -> Vec<Vec<SurfaceKind>> {
    let others = kinds.iter().filter(|kind| !companions.contains(kind));
    others
        .map(|kind| [&[*kind], companions].concat())
        .chain([companions.to_vec(), kinds.to_vec()])
        .collect()
}

#[test]
fn light_scattered_once_comes_from_lights() {
    compare("L V E", FORWARD, 100, &each_beside(&[Connections], &OF_LIGHT));
    compare("L V E", EVENLY, 100, &each_and_all(&OF_LIGHT));
}

#[test]
fn light_scattered_once_comes_from_surfaces() {
    compare(
        "L D V E",
        FORWARD,
        200,
        &each_beside(&[Connections, Spheres], &OF_SURFACE),
    );
    compare("L D V E", EVENLY, 200, &each_and_all(&OF_SURFACE));
}

#[test]
fn light_scattered_twice_comes_from_lights() {
    compare("L V V E", FORWARD, 200, &each_beside(&ROBUST, &OF_TWO));
    compare("L V V E", EVENLY, 200, &each_and_all(&OF_TWO));
}

#[test]
fn light_scattered_three_times_comes_from_anywhere() {
    compare("L V V V E", FORWARD, 200, &each_beside(&ROBUST, &OF_THREE));
    compare("L V V V E", EVENLY, 200, &each_and_all(&OF_THREE));
}

/// All light at once.
#[test]
fn all_light_is_counted_once() {
    let mut every = [&OF_LIGHT[..], &OF_THREE].concat();
    every.sort_by_key(|kind| *kind as u8);
    every.dedup();
    compare("L .* E", EVENLY, 100, &[OF_SURFACE.to_vec(), every]);
}

//! Media against closed forms, and integrators against each other in them.

mod bodies;
mod slab;

use crate::integrator::{IntegratorSettings, Unobserved, render_iteration};
use crate::random::Sampling;
use crate::scene::{Limits, Scene};
use crate::settings::{BdptSettings, LightSettings, PathSettings, PcfSettings, PppmSettings, VcmSettings};
use crate::spectrum::{CHANNELS, Spectrum};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// A z-value beyond which a test fails. All tests here look at fewer than 200 means, so that they raise a false alarm together with a
/// probability below 200 x 6e-7 = 1.2e-4.
const Z: f64 = 5.0;

pub(crate) fn scene(body: &str) -> Scene {
    scene_with(body, &[])
}

/// A scene with further files.
pub(crate) fn scene_with(body: &str, files: &[(&str, Vec<u8>)]) -> Scene {
    scene_of("3.0.0", body, files)
}

fn scene_of(version: &str, body: &str, files: &[(&str, Vec<u8>)]) -> Scene {
    let text = format!("<scene version='{version}'>{body}</scene>");
    let mut all = BTreeMap::from([("main.xml".to_owned(), text.into_bytes())]);
    all.extend(files.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.clone())));
    let scene = Scene::load(&all, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    scene
}

/// A camera at `origin` that looks along +z through one narrow pixel.
pub(crate) fn narrow_camera(origin: &str) -> String {
    format!(
        "<sensor type='perspective'><float name='fov' value='0.01'/><transform name='to_world'><translate value='{origin}'/></transform>\
         <film type='hdrfilm'><integer name='width' value='1'/><integer name='height' value='1'/><rfilter type='box'/></film></sensor>"
    )
}

pub(crate) fn path(samples: u32, max_depth: Option<u32>) -> IntegratorSettings {
    IntegratorSettings::Path(PathSettings {
        samples,
        sampling: Sampling::Independent,
        max_depth,
    })
}

/// The mean over pixels of each channel, and its standard error over iterations.
pub(crate) fn estimate(scene: &Scene, settings: &IntegratorSettings, iterations: u32) -> [(f64, f64); CHANNELS] {
    let images: Vec<Spectrum> = (1..=iterations)
        .map(|iteration| {
            let pixels = render_iteration(scene, settings, 11, iteration, &Unobserved)
                .unwrap()
                .pixels;
            Spectrum::average(pixels.into_iter())
        })
        .collect();
    std::array::from_fn(|channel| {
        let values: Vec<f64> = images.iter().map(|image| f64::from(image[channel])).collect();
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (count - 1.0);
        (mean, (variance / count).sqrt())
    })
}

/// Compares the mean with what is expected; `rounding` is the relative error that single precision may make.
pub(crate) fn agrees(label: &str, found: (f64, f64), expected: f64, rounding: f64) {
    let (mean, error) = found;
    let allowed = Z * error + rounding * expected.abs();
    assert!(
        (mean - expected).abs() <= allowed,
        "{label}: {mean} +- {error}, not {expected}"
    );
}

const COLOURED: &str = "<rgb name='sigma_t' value='0.5 1 3'/>";

/// Beer's law for each channel: a slab of thickness 2 before a background of radiance 1.
#[test]
fn absorption_follows_beers_law() {
    let scene = scene(&format!(
        "{}<emitter type='constant'/><shape type='cube'><bsdf type='null'/>\
         <medium name='interior' type='homogeneous'>{COLOURED}<float name='albedo' value='0'/></medium></shape>",
        narrow_camera("0 0 -5")
    ));
    let found = estimate(&scene, &path(1 << 12, None), 16);
    for (channel, sigma) in [0.5, 1.0, 3.0_f64].into_iter().enumerate() {
        agrees(
            &format!("channel {channel}"),
            found[channel],
            (-2.0 * sigma).exp(),
            1e-4,
        );
    }
}

/// Light of a point light that a medium which fills all space scatters once: the integral over the camera's ray of
/// `sigma_s p I / d^2` times what comes through.
#[test]
fn single_scattering_of_a_point_light_is_the_integral() {
    for (g, phase) in [
        (0.0, "<phase type='isotropic'/>"),
        (0.6, "<phase type='hg'><float name='g' value='0.6'/></phase>"),
        (-0.5, "<phase type='hg'><float name='g' value='-0.5'/></phase>"),
    ] {
        let scene = scene(&format!(
            "<medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.2 0.4 0.8'/><rgb name='albedo' value='0.9 0.5 0.3'/>{phase}</medium>\
             {}<emitter type='point'><point name='position' x='1' y='0' z='2'/><rgb name='intensity' value='3'/></emitter>\
             <shape type='rectangle'><transform name='to_world'><rotate x='1' angle='180'/><translate z='4'/></transform>\
             <bsdf type='diffuse'><rgb name='reflectance' value='0'/></bsdf></shape>",
            narrow_camera("0 0 0").replace("<film", "<ref id='fog'/><film")
        ));
        let expected = |sigma_t: f64, albedo: f64| {
            let steps = 20_000;
            let step = 4.0 / f64::from(steps);
            let integrand = |t: f64| {
                let offset = [1.0, 2.0 - t];
                let distance = offset[0].hypot(offset[1]);
                // The light goes from the lamp to the ray and on to the camera, along -z.
                let cosine = (2.0 - t) / distance;
                let phase = (1.0 - g * g) / (4.0 * PI * (1.0_f64 + g * g - 2.0 * g * cosine).powf(1.5));
                albedo * sigma_t * phase * 3.0 / (distance * distance) * (-sigma_t * (t + distance)).exp()
            };
            (0..steps).map(|i| integrand((f64::from(i) + 0.5) * step)).sum::<f64>() * step
        };
        for settings in [path(1 << 12, Some(2)), both_ways(1 << 10, 1 << 14, Some(2))] {
            let found = estimate(&scene, &settings, 16);
            for (channel, (sigma_t, albedo)) in [(0.2, 0.9), (0.4, 0.5), (0.8, 0.3)].into_iter().enumerate() {
                agrees(
                    &format!("g = {g}, channel {channel}, {settings:?}"),
                    found[channel],
                    expected(sigma_t, albedo),
                    1e-3,
                );
            }
        }
    }
}

fn both_ways(samples: u32, photons: u32, max_depth: Option<u32>) -> IntegratorSettings {
    IntegratorSettings::Bdpt(BdptSettings {
        samples,
        photons,
        max_depth,
        ..BdptSettings::default()
    })
}

/// All integrators but the sequential one, with discs so small that what they blur does not count.
fn integrators(samples: u32, photons: u32, max_depth: Option<u32>) -> Vec<IntegratorSettings> {
    let sigma1 = Some(0.05);
    vec![
        path(samples, max_depth),
        IntegratorSettings::Light(LightSettings {
            samples,
            photons,
            max_depth,
            ..LightSettings::default()
        }),
        both_ways(samples, photons, max_depth),
        IntegratorSettings::Vcm(VcmSettings {
            samples,
            photons,
            sigma1,
            max_depth,
            ..VcmSettings::default()
        }),
        IntegratorSettings::Pppm(PppmSettings {
            samples,
            photons,
            sigma1,
            max_depth,
            ..PppmSettings::default()
        }),
        IntegratorSettings::Pcf(PcfSettings {
            samples,
            photons,
            max_depth,
            ..PcfSettings::default()
        }),
    ]
}

/// What scatters all that it extinguishes is not seen in a white world, whatever its phase function, colour and bounds.
#[test]
fn a_white_furnace_shows_no_medium() {
    let medium = format!(
        "<medium name='interior' type='homogeneous'>{COLOURED}<float name='albedo' value='1'/>\
         <phase type='hg'><float name='g' value='0.9'/></phase></medium>"
    );
    for bounds in [
        "<bsdf type='null'/>",
        "<bsdf type='dielectric'/>",
        "<bsdf type='roughdielectric'/>",
    ] {
        let scene = scene(&format!(
            "{}<emitter type='constant'/><shape type='sphere'>{bounds}{medium}</shape>",
            narrow_camera("0 0 -5")
        ));
        let found = estimate(&scene, &path(1 << 10, None), 12);
        for (channel, found) in found.into_iter().enumerate() {
            // A rough boundary loses what is reflected at microfacets more than once.
            let lost = if bounds.contains("rough") { 0.05 } else { 1e-3 };
            agrees(&format!("{bounds}, channel {channel}"), found, 1.0, lost);
        }
    }
}

/// A lattice file of Mitsuba's with one channel.
pub(crate) fn vol(size: [i32; 3], value: impl Fn(i32, i32, i32) -> f32) -> Vec<u8> {
    let mut bytes = b"VOL\x03".to_vec();
    for number in [1, size[0], size[1], size[2], 1] {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    for corner in [0.0_f32, 0.0, 0.0, 1.0, 1.0, 1.0] {
        bytes.extend_from_slice(&corner.to_le_bytes());
    }
    for z in 0..size[2] {
        for y in 0..size[1] {
            for x in 0..size[0] {
                bytes.extend_from_slice(&value(x, y, z).to_le_bytes());
            }
        }
    }
    bytes
}

const GRID_IN_CUBE: &str = "<volume name='sigma_t' type='gridvolume'><string name='filename' value='sigma.vol'/>\
     <transform name='to_world'><translate value='-0.5 -0.5 -0.5'/><scale value='2'/></transform></volume>";

/// Delta tracking and ratio tracking through a lattice whose values are all the same find what the closed form does.
#[test]
fn an_even_lattice_is_a_homogeneous_medium() {
    let body = |medium: &str| {
        format!(
            "{}<emitter type='constant'/><emitter type='point'><point name='position' x='3' y='1' z='0'/>\
             <rgb name='intensity' value='20'/></emitter><shape type='cube'><bsdf type='null'/>{medium}</shape>",
            narrow_camera("0 0 -5")
        )
    };
    let rest = "<rgb name='albedo' value='0.9 0.5 0.2'/><float name='scale' value='0.5'/>";
    let even = scene(&body(&format!(
        "<medium name='interior' type='homogeneous'><float name='sigma_t' value='2'/>{rest}</medium>"
    )));
    let lattice = scene_with(
        &body(&format!(
            "<medium name='interior' type='heterogeneous'>{GRID_IN_CUBE}{rest}</medium>"
        )),
        &[("sigma.vol", vol([20, 9, 17], |_, _, _| 2.0))],
    );
    let settings = path(1 << 12, Some(6));
    let (found, expected) = (estimate(&lattice, &settings, 16), estimate(&even, &settings, 16));
    for channel in 0..CHANNELS {
        let (mean, error) = expected[channel];
        agrees(
            &format!("channel {channel}"),
            (found[channel].0, found[channel].1.hypot(error)),
            mean,
            1e-4,
        );
    }
}

/// The share of light that comes through a lattice whose extinction rises linearly is that of the integral.
#[test]
fn a_lattice_absorbs_what_lies_on_the_way() {
    let scene = scene_with(
        &format!(
            "{}<emitter type='constant'/><shape type='cube'><bsdf type='null'/><medium name='interior' type='heterogeneous'>{GRID_IN_CUBE}\
             <float name='albedo' value='0'/></medium></shape>",
            narrow_camera("0 0 -5")
        ),
        &[("sigma.vol", vol([3, 3, 32], |_, _, z| 0.05 * z as f32))],
    );
    // Between the middles of the voxels it is linear, and at the ends it is even: the mean is that of the values.
    let mean = 0.05 * 15.5;
    let found = estimate(&scene, &path(1 << 12, None), 16);
    for (channel, found) in found.into_iter().enumerate() {
        agrees(&format!("channel {channel}"), found, f64::exp(-2.0 * mean), 1e-4);
    }
}

/// The faces of a lattice of Mitsuba 0.6 go through the middles of its outer voxels, and what lies outside of it is empty; a shape without a BSDF bounds
/// the medium and is not seen.
#[test]
fn a_lattice_of_mitsuba_0_6_ends_at_the_middles_of_its_voxels() {
    let mut file = vol([2, 2, 3], |_, _, z| 1.0 + z as f32);
    for (index, corner) in [-1.0_f32, -1.0, -1.0, 1.0, 1.0, 1.0].into_iter().enumerate() {
        file[24 + 4 * index..][..4].copy_from_slice(&corner.to_le_bytes());
    }
    let body = |volume: &str| {
        format!(
            "{}<emitter type='constant'/><shape type='cube'><transform name='toWorld'><scale value='4'/></transform>\
             <medium name='interior' type='heterogeneous'>{volume}<volume name='albedo' type='constvolume'>\
             <spectrum name='value' value='0'/></volume><float name='scale' value='0.25'/></medium></shape>",
            narrow_camera("0.3 0.2 -5")
        )
    };
    let grid = "type='gridvolume'><string name='filename' value='sigma.vol'/>";
    let blocks = "<volume name='density' type='hgridvolume'><string name='filename' value='table'/><string name='prefix' value='b'/>\
                  <string name='postfix' value='.vol'/></volume>";
    for (volume, expected) in [
        // The trapezia of 1, 2 and 3.
        (blocks.to_owned(), 4.0),
        (format!("<volume name='density' {grid}</volume>"), 4.0),
        (
            format!("<volume name='density' type='volcache'><volume {grid}</volume></volume>"),
            4.0,
        ),
        (
            format!(
                "<volume name='density' {grid}<transform name='toWorld'><scale z='2' x='1' y='1'/></transform></volume>"
            ),
            8.0,
        ),
        (
            format!(
                "<volume name='density' {grid}<point name='min' value='-1 -1 0'/><point name='max' value='1 1 1'/></volume>"
            ),
            2.0,
        ),
    ] {
        // Two blocks along z, of which the second has the last value.
        let mut table: Vec<u8> = [-1.0_f32, -1.0, -1.0, 1.0, 1.0, 1.0]
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect();
        table.extend(
            [1, 1, 2, 0, 0, 0, 0, 0, 1]
                .iter()
                .flat_map(|number: &i32| number.to_le_bytes()),
        );
        let files = [
            ("sigma.vol", file.clone()),
            ("table", table),
            ("b000_000_000.vol", vol([2, 2, 2], |_, _, z| 1.0 + z as f32)),
            ("b000_000_001.vol", vol([2, 2, 2], |_, _, z| 2.0 + z as f32)),
        ];
        let scene = scene_of("0.6.0", &body(&volume), &files);
        let found = estimate(&scene, &path(1 << 12, None), 16);
        agrees(&volume, found[0], f64::exp(-0.25 * expected), 1e-4);
    }
}

/// A file of OpenVDB lies where it says: along x, its tile of 0.75 is 128 voxels of 0.5 long.
#[test]
fn trees_of_voxels_lie_where_their_files_say() {
    for (name, bytes) in crate::scene::volume_files().into_iter().step_by(3) {
        let scene = scene_with(
            &format!(
                "{}<emitter type='constant'/><shape type='cube'><bsdf type='null'/><transform name='to_world'><scale value='1000'/></transform>\
                 <medium name='interior' type='heterogeneous'><volume name='sigma_t' type='gridvolume'>\
                 <string name='filename' value='{name}'/><transform name='to_world'><rotate y='1' angle='-90'/></transform></volume>\
                 <float name='albedo' value='0'/><float name='scale' value='{}'/></medium></shape>",
                narrow_camera("-33 32 -2000"),
                1.0 / 48.0
            ),
            &[(name, bytes)],
        );
        let found = estimate(&scene, &path(1 << 12, None), 16);
        agrees(name, found[0], f64::exp(-1.0), 1e-3);
    }
}

/// A glowing slab without scattering has the radiance `emission (1 - exp(-sigma d)) / sigma`.
#[test]
fn a_glowing_slab_has_the_radiance_of_the_closed_form() {
    let scene = scene(&format!(
        "{}<emitter type='constant'><rgb name='radiance' value='0'/></emitter><shape type='cube'><bsdf type='null'/>\
         <medium name='interior' type='homogeneous'>{COLOURED}<float name='albedo' value='0'/><rgb name='emission' value='2 1 4'/></medium></shape>",
        narrow_camera("0 0 -5")
    ));
    let found = estimate(&scene, &path(1 << 10, None), 16);
    for (channel, (sigma, emission)) in [(0.5, 2.0), (1.0, 1.0), (3.0_f64, 4.0)].into_iter().enumerate() {
        let expected = emission * (1.0 - (-2.0 * sigma).exp()) / sigma;
        agrees(&format!("channel {channel}"), found[channel], expected, 1e-4);
    }
}

/// Light goes straight through a pane without an edge that counts: so the lamp behind it is seen by paths of one edge.
#[test]
fn panes_in_media_are_not_counted() {
    let scene = scene(&format!(
        "<medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.1 0.2 0.4'/></medium>{}\
         <shape type='rectangle'><transform name='to_world'><translate z='2'/></transform>\
         <bsdf type='thindielectric'><float name='int_ior' value='1.5'/><float name='ext_ior' value='1'/></bsdf></shape>\
         <shape type='rectangle'><transform name='to_world'><rotate x='1' angle='180'/><translate z='4'/></transform>\
         <emitter type='area'><rgb name='radiance' value='1'/></emitter></shape>",
        narrow_camera("0 0 0").replace("<film", "<ref id='fog'/><film")
    ));
    // What an interface of this index reflects, and a pane with all that goes back and forth in it.
    let reflected: f64 = 0.04;
    let through = 1.0 - 2.0 * reflected / (1.0 + reflected);
    // Nothing connects the lens with a lamp behind a pane.
    let all = integrators(1 << 10, 1 << 10, Some(1));
    for settings in all
        .iter()
        .filter(|settings| !matches!(settings, IntegratorSettings::Light(_)))
    {
        let found = estimate(&scene, settings, 16);
        for (channel, sigma) in [0.1, 0.2, 0.4_f64].into_iter().enumerate() {
            let label = format!("channel {channel}, {settings:?}");
            agrees(&label, found[channel], through * (-4.0 * sigma).exp(), 1e-3);
        }
    }
}

/// A room whose lamp stands behind a pane and a mask, in fog.
const ROOM_WITH_PANES: &str = "<medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.3 0.2 0.1'/>\
    <float name='albedo' value='0.8'/></medium>\
    <sensor type='perspective'><float name='fov' value='60'/><ref id='fog'/><transform name='to_world'>\
    <lookat origin='0, 0, -0.9' target='0, -1, 0.3' up='0, 1, 0'/></transform>\
    <film type='hdrfilm'><integer name='width' value='4'/><integer name='height' value='4'/><rfilter type='box'/></film></sensor>\
    <shape type='cube'><boolean name='flip_normals' value='true'/>\
    <bsdf type='diffuse'><rgb name='reflectance' value='0.3 0.4 0.5'/></bsdf><ref name='exterior' id='fog'/></shape>\
    <shape type='rectangle'><transform name='to_world'><scale value='2'/><rotate x='1' angle='90'/><translate y='0.4'/></transform>\
    <bsdf type='thindielectric'/></shape>\
    <shape type='rectangle'><transform name='to_world'><scale value='2'/><rotate x='1' angle='90'/><translate y='0.6'/></transform>\
    <bsdf type='mask'><float name='opacity' value='0.5'/><bsdf type='diffuse'/></bsdf></shape>\
    <shape type='rectangle'><transform name='to_world'><scale value='0.5'/><rotate x='1' angle='90'/><translate y='0.9'/></transform>\
    <emitter type='area'><rgb name='radiance' value='10'/></emitter></shape>";

/// Integrators agree on paths of limited length where light goes through panes.
#[test]
fn limits_are_the_same_for_all_integrators() {
    let scene = scene(ROOM_WITH_PANES);
    let mut all = integrators(16, 4000, Some(3));
    // Its light paths count panes, since nested lookups ask for their edges.
    all.retain(|settings| !matches!(settings, IntegratorSettings::Pcf(_)));
    agree_with_the_first(&scene, &all, 128, "at most three edges");
}

/// What scatters in media and what does not are all light, whatever the integrator, and integrators agree on each.
#[test]
fn paths_through_media_have_their_letter() {
    let scene = scene(ROOM_WITH_PANES);
    let all = integrators(16, 4000, Some(4));
    let whole = estimate(&scene, &all[0], 128);
    let parts = ["L .* V .* E", "L [SGD]* E"].map(|paths| {
        let mut part = scene.clone();
        part.paths = Some(paths.parse().unwrap());
        part
    });
    for settings in [&all[0], &all[3]] {
        let [scattered, rest] = [0, 1].map(|part| estimate(&parts[part], settings, 128));
        for channel in 0..CHANNELS {
            assert!(scattered[channel].0 > 0.05 * whole[channel].0 && rest[channel].0 > 0.05 * whole[channel].0);
            let error = whole[channel].1.hypot(scattered[channel].1).hypot(rest[channel].1);
            let label = format!("channel {channel}, {settings:?}");
            agrees(
                &label,
                (scattered[channel].0 + rest[channel].0, error),
                whole[channel].0,
                0.01,
            );
        }
    }
    agree_with_the_first(
        &parts[0],
        &[all[0].clone(), all[1].clone(), all[3].clone()],
        128,
        "scattered in media",
    );
}

/// Every integrator sees the same in a room with fog, a ball of glass that holds another medium, and a lamp within the fog.
#[test]
fn integrators_agree_in_media() {
    let scene = scene(
        "<medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.1 0.2 0.3'/><float name='albedo' value='0.8'/>\
         <phase type='hg'><float name='g' value='0.5'/></phase></medium>\
         <sensor type='perspective'><float name='fov' value='50'/><ref id='fog'/><transform name='to_world'>\
         <lookat origin='0, 0.5, -2.5' target='0, -0.2, 0' up='0, 1, 0'/></transform>\
         <film type='hdrfilm'><integer name='width' value='6'/><integer name='height' value='6'/><rfilter type='box'/></film></sensor>\
         <shape type='cube'><boolean name='flip_normals' value='true'/><transform name='to_world'><scale value='3'/></transform>\
         <bsdf type='diffuse'><rgb name='reflectance' value='0.5 0.4 0.3'/></bsdf><ref name='exterior' id='fog'/></shape>\
         <shape type='sphere'><float name='radius' value='0.8'/><bsdf type='roughdielectric'><float name='alpha' value='0.3'/></bsdf>\
         <ref name='exterior' id='fog'/><medium name='interior' type='homogeneous'><rgb name='sigma_t' value='2 1 0.5'/>\
         <float name='albedo' value='0.7'/></medium></shape>\
         <shape type='sphere'><point name='center' x='1' y='2' z='0'/><float name='radius' value='0.5'/>\
         <emitter type='area'><rgb name='radiance' value='10'/></emitter></shape>",
    );
    let all = integrators(4, 2000, None);
    agree_with_the_first(&scene, &all, 128, "all paths");
}

/// Compares all channels of some integrators' pictures with those of the first, which has `iterations`.
fn agree_with_the_first(scene: &Scene, all: &[IntegratorSettings], iterations: u32, what: &str) {
    let reference = estimate(scene, &all[0], iterations);
    for settings in &all[1..] {
        let found = estimate(scene, settings, 128);
        for channel in 0..CHANNELS {
            let (mean, error) = reference[channel];
            let label = format!("{what}, channel {channel}, {settings:?}");
            // Discs of the density estimates blur what lies in corners.
            agrees(&label, (found[channel].0, found[channel].1.hypot(error)), mean, 0.02);
        }
    }
}

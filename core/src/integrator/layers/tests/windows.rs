//! Windows of pictures.

use super::*;
use crate::film::{Window, WindowError};
use crate::integrator::RenderError;
use serde_json::json;

const WINDOW: Window = Window {
    x: 3,
    y: 5,
    width: 7,
    height: 4,
};

/// The pixels of a window of each plane.
fn cut(planes: &[Spectrum], window: Window) -> Vec<Spectrum> {
    let rows = planes.chunks_exact(SIZE as usize).enumerate();
    let inside = rows.filter(|(row, _)| (window.y..window.y + window.height).contains(&(*row as u32 % SIZE)));
    let columns = window.x as usize..(window.x + window.width) as usize;
    inside.flat_map(|(_, row)| row[columns.clone()].to_vec()).collect()
}

fn assert_same(scene: &Scene, asked: &Layers, settings: &IntegratorSettings, window: Window) {
    let whole = render(scene, asked, settings, 2);
    let part = scene.clone().cropped(Some(window)).unwrap();
    let part = render(&part, asked, settings, 2);
    assert_eq!(part.len(), (window.width * window.height * asked.stack()) as usize);
    assert!(part == cut(&whole, window), "{settings:?}");
}

/// Those of every integrator, and of those settings by which pixels depend on each other.
#[test]
fn pixels_of_a_window_are_those_of_the_picture_whatever_the_integrator() {
    let scene = load(ROOM, LAMPS);
    let asked = layers(&["albedo", "cryptomatte:object", "lamp:bulb", "others=L .* D S+ E"]);
    let pcf = |given: serde_json::Value| {
        let serde_json::Value::Object(fields) = given else {
            panic!("{given}")
        };
        crate::integrator::Integrator::find("pcf")
            .unwrap()
            .read(fields)
            .unwrap()
    };
    let more = [
        pcf(json!({"photons": 2_000, "samplers": ["bsdf", "importon"], "samples": 2})),
        pcf(json!({"photons": 2_000, "surface_test": true, "lookup_vertex": 1})),
    ];
    for settings in independent().chain(more) {
        assert_same(&scene, &asked, &settings, WINDOW);
    }
}

/// A window counts from where the scene's own crop begins, and motion and meters change nothing.
#[test]
fn windows_are_those_of_the_picture_that_the_scene_has() {
    let scene = |film: &str, sphere: &str| {
        let xml = format!(
            "<scene version='3.0.0'><sensor type='perspective'><float name='shutter_open' value='0'/>\
             <float name='shutter_close' value='1'/><transform name='to_world'><translate z='-4'/></transform>\
             <film type='hdrfilm'>{film}</film></sensor><shape type='sphere'>{sphere}</shape><emitter type='constant'/></scene>"
        );
        let files = BTreeMap::from([("scene.xml".to_owned(), xml.into_bytes())]);
        Scene::load(&files, "scene.xml", &BTreeMap::new(), &Limits::default()).unwrap()
    };
    let side = |name: &str, value: u32| format!("<integer name='{name}' value='{value}'/>");
    let cropped = [
        ("width", 30),
        ("height", 20),
        ("crop_offset_x", 9),
        ("crop_offset_y", 4),
        ("crop_width", SIZE),
        ("crop_height", SIZE),
    ]
    .map(|(name, value)| side(name, value))
    .concat();
    let moving = "<animation name='to_world'><transform time='0'/><transform time='1'><translate x='1'/></transform></animation>";
    let asked = layers(&["alpha", "cryptomatte:object"]);
    assert_same(&scene(&cropped, ""), &asked, &path(), WINDOW);
    let all = [side("width", SIZE), side("height", SIZE)].concat();
    let moves = scene(&all, moving);
    assert!(moves.frame(7, 1).is_some());
    assert_same(&moves, &asked, &path(), WINDOW);
}

#[test]
fn what_is_no_window_of_a_picture_is_refused() {
    let scene = load(ROOM, LAMPS);
    let beyond = Window { x: 6, ..WINDOW };
    let error = scene.clone().cropped(Some(beyond)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the window 6,5,7x4 is not within the picture, which has 12 x 12 pixels"
    );
    let scene = scene.cropped(Some(WINDOW)).unwrap();
    let sppm = crate::integrator::Integrator::find("sppm").unwrap().defaults();
    let refused = render_iteration(&scene, &sppm, 7, 1, &Unobserved).unwrap_err();
    assert!(matches!(refused, RenderError::Window(WindowError::Sequential("sppm"))));
}

//! Scenes made by others load unchanged. Their folder is not part of the project: `PHOTONFARM_SCENES` names it.

use photonfarm_core::scene::{RecordedFiles, SceneFolder};
use photonfarm_core::settings::IntegratorSettings;
use photonfarm_tests::scenes;
use std::path::PathBuf;

/// Folder, main file, number of shapes, resolution, longest light path.
const SCENES: [(&str, &str, usize, [u32; 2], u32); 6] = [
    ("cbox", "cbox.xml", 8, [256, 256], 6),
    ("cbox", "cbox-rgb.xml", 8, [256, 256], 6),
    ("veach-bidir/mitsuba", "scene.xml", 14, [1024, 1024], 7),
    ("veach-mis/mitsuba", "scene.xml", 9, [1280, 720], 3),
    ("water-caustic/mitsuba", "scene.xml", 10, [1024, 1024], 9),
    ("torus", "scene.xml", 5, [1024, 768], 33),
];

#[test]
#[ignore = "needs PHOTONFARM_SCENES, the folder of scenes made by others"]
fn scenes_made_by_others_load_unchanged() {
    let root = PathBuf::from(std::env::var_os("PHOTONFARM_SCENES").expect("PHOTONFARM_SCENES names the folder"));
    for (folder, main, shapes, resolution, max_depth) in SCENES {
        let files = SceneFolder::new(&root.join(folder)).unwrap_or_else(|error| panic!("{error}"));
        let recorded = RecordedFiles::new(&files);
        let scene = scenes::load(&recorded, main, &[]).unwrap_or_else(|error| panic!("{folder}: {error}"));
        assert_eq!(scene.bindings.len(), shapes, "{folder}/{main}");
        assert_eq!(scene.film.resolution, resolution, "{folder}/{main}");
        assert_eq!(scene.sensor.resolution, resolution, "{folder}/{main}");
        assert_eq!(scene.wishes.max_depth, Some(max_depth), "{folder}/{main}");
        assert!(
            matches!(scene.wishes.integrator, Some(IntegratorSettings::Path(_))),
            "{folder}/{main}"
        );
        assert!(!scene.lights.is_empty(), "{folder}/{main}");
        // The bundle of what was read is the whole scene.
        let bundle = recorded.into_files();
        let again =
            scenes::load(&bundle, main, &[]).unwrap_or_else(|error| panic!("{folder}, from its bundle: {error}"));
        assert_eq!(again.geometry.bounds(), scene.geometry.bounds(), "{folder}/{main}");
    }
}

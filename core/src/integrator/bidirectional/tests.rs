use super::*;
use crate::integrator::{Batches, Unobserved};
use crate::random::Sampling;
use crate::scene::{Limits, Scene, SceneFolder};
use std::collections::BTreeMap;
use std::path::Path;

fn load(name: &str) -> Scene {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/scenes");
    let defines = BTreeMap::from([("res".to_owned(), "16".to_owned())]);
    let files = SceneFolder::new(&folder).unwrap();
    Scene::load(&files, &format!("{name}.xml"), &defines, &Limits::default()).unwrap()
}

fn image(scene: &Scene, techniques: Techniques, only: Option<Only>) -> Vec<Spectrum> {
    let job = Job {
        scene,
        seed: 4,
        iteration: 2,
        sampling: Sampling::Sobol,
        batches: Batches::default(),
    };
    let plan = Plan {
        light_paths: 5_000,
        samples: 3,
        max_edges: 4,
        techniques,
        radius: Some(0.1),
        only,
    };
    render(&job, plan, &Unobserved).unwrap().pixels
}

/// What the techniques show one by one, each with its share, adds up to what they show together.
#[test]
fn techniques_one_by_one_add_up_to_all() {
    let scene = load("mirror-glass");
    let connections = Techniques {
        merge: false,
        ..Techniques::ALL
    };
    let all = image(&scene, connections, None);
    let mut sums = vec![Spectrum::ZERO; all.len()];
    for vertices in 2..=5 {
        for s in 0..=vertices {
            let only = Only {
                s: Some(s),
                t: Some(vertices - s),
                weighted: true,
            };
            for (sum, pixel) in sums.iter_mut().zip(image(&scene, connections, Some(only))) {
                *sum += pixel;
            }
        }
    }
    for (pixel, (sum, all)) in sums.iter().zip(&all).enumerate() {
        let (sum, all) = (sum.luminance(), all.luminance());
        assert!(
            (sum - all).abs() <= 1e-4 * all.max(1e-3),
            "pixel {pixel}: {sum}, not {all}"
        );
    }
}

//! The bits of small images, held against `tests/digests.txt`: across versions, builds and machines they change only where a
//! change means them to. With the variable UPDATE set, the test writes the file.

use photonfarm_core::integrator::{Unobserved, render_next};
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{
    BdptSettings, DirectionSampler, IntegratorSettings, KernelShape, LightSettings, LookupVertex, MediaEstimator,
    PathSettings, PcfSettings, PppmSettings, SppmSettings, SurfacesSettings, VcmSettings,
};
use photonfarm_tests::scenes;
use std::path::Path;

const SCENES: [&str; 10] = [
    "coated",
    "diffuse-box",
    "environment",
    "media",
    "mirror-glass",
    "motion",
    "orthographic",
    "projector",
    "spot-sun",
    "textures",
];

const HEAD: &str = "# BLAKE3 digests of the pixels of small images: scene, integrator, digest. Written by\n\
    #     UPDATE=1 cargo test --workspace --release --test digests\n\
    # A line that changes says that jobs rendered before and after do not mix.\n";

fn integrators() -> [(&'static str, IntegratorSettings); 10] {
    let photons = PppmSettings {
        photons: 2_000,
        samples: 2,
        ..Default::default()
    };
    let beams = PppmSettings {
        media: MediaEstimator::Beams,
        ..photons.clone()
    };
    let surfaces = SurfacesSettings {
        photons: 100,
        ..Default::default()
    };
    let cones = PcfSettings {
        photons: 2_000,
        samples: 2,
        ..Default::default()
    };
    let everything = PcfSettings {
        lookup_vertex: LookupVertex::Fixed(2),
        samplers: vec![
            DirectionSampler::Bsdf,
            DirectionSampler::Camera,
            DirectionSampler::Importon,
        ],
        nested: true,
        kernel: KernelShape::Epanechnikov,
        sigma_by_length: vec![0.7, 1.0],
        theta_glossy: 0.5,
        surface_test: true,
        p: 1.5,
        mis_beta: 1.5,
        ..cones.clone()
    };
    [
        ("path", IntegratorSettings::Path(PathSettings::default())),
        (
            "light",
            IntegratorSettings::Light(LightSettings {
                photons: 2_000,
                ..Default::default()
            }),
        ),
        (
            "bdpt",
            IntegratorSettings::Bdpt(BdptSettings {
                photons: 2_000,
                ..Default::default()
            }),
        ),
        (
            "vcm",
            IntegratorSettings::Vcm(VcmSettings {
                photons: 2_000,
                ..Default::default()
            }),
        ),
        ("pppm", IntegratorSettings::Pppm(photons.clone())),
        ("pppm-beams", IntegratorSettings::Pppm(beams)),
        ("surfaces", IntegratorSettings::Surfaces(surfaces)),
        ("sppm", IntegratorSettings::Sppm(SppmSettings(photons))),
        ("pcf", IntegratorSettings::Pcf(cones)),
        ("pcf-everything", IntegratorSettings::Pcf(everything)),
    ]
}

/// Digest of the pixels of the first two iterations.
fn digest(scene: &Scene, settings: &IntegratorSettings) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut statistics = Vec::new();
    for iteration in 1..=2 {
        let image =
            render_next(scene, settings, 3, iteration, &statistics, &Unobserved).expect("the iteration renders");
        statistics = image.statistics;
        for channel in image.pixels.iter().flat_map(|pixel| pixel.to_rgb()) {
            hasher.update(&channel.to_bits().to_le_bytes());
        }
    }
    hasher.finalize().to_hex()[..32].to_owned()
}

#[test]
fn images_have_the_bits_that_are_written_down() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut page = HEAD.to_owned();
    for name in SCENES {
        let scene = scenes::named(name, 12).expect("the scene loads");
        for (integrator, settings) in integrators() {
            page += &format!("{name}.xml {integrator} {}\n", digest(&scene, &settings));
        }
    }
    let path = folder.join("digests.txt");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, &page).unwrap();
    }
    let written = std::fs::read_to_string(&path).expect("the digests are there");
    let changed: Vec<&str> = page
        .lines()
        .filter(|line| !written.lines().any(|other| other == *line))
        .collect();
    assert!(
        written == page,
        "bits have changed; where that is meant, set UPDATE=1 and run this test again:\n{}",
        changed.join("\n")
    );
}

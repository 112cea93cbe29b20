//! Cryptomatte, and the number of camera paths.

use super::super::cryptomatte::{RANKS, id};
use super::*;
use std::collections::BTreeSet;

const MATTES: [&str; 3] = ["alpha", "cryptomatte:object", "cryptomatte:material"];

/// Before the wall of [`ROOM`], which fills the picture, and its ball: a named ball, and two instances of a group.
const OBJECTS: &str = r#"
    <bsdf type="twosided" id="paint"><bsdf type="diffuse"/></bsdf>
    <shape type="sphere" id="ball"><point name="center" x="-0.6" y="0.6" z="0"/><float name="radius" value="0.3"/><ref id="paint"/></shape>
    <shape type="shapegroup" id="group"><shape type="sphere" id="part"><float name="radius" value="0.2"/><ref id="paint"/></shape></shape>
    <shape type="instance" id="right"><ref id="group"/><transform name="to_world"><translate x="0.7" y="-0.7" z="0.3"/></transform></shape>
    <shape type="instance"><ref id="group"/><transform name="to_world"><translate x="0.7" y="0.7" z="0.3"/></transform></shape>
    <emitter type="constant"/>"#;

type Channels = BTreeMap<String, Vec<f32>>;

fn channels(layers: &Layers, image: &Image) -> Channels {
    let channels = layers.channels(image).unwrap().into_iter();
    channels.map(|channel| (channel.name, channel.samples)).collect()
}

/// Ids and coverage of a pixel, in the order of the file.
fn pairs(channels: &Channels, layer: &str, pixel: usize) -> Vec<(u32, f32)> {
    (0..RANKS)
        .map(|rank| {
            let letters = ["RG", "BA"][rank % 2].split_at(1);
            let value = |letter: &str| channels[&format!("{layer}{:02}.{letter}", rank / 2)][pixel];
            (value(letters.0).to_bits(), value(letters.1))
        })
        .collect()
}

fn scene() -> Scene {
    let mut scene = load(ROOM, OBJECTS);
    scene.film.filter = crate::film::Filter::Gaussian { stddev: 0.5 };
    scene
}

#[test]
fn objects_and_materials_have_their_names() {
    let scene = scene();
    let objects: Vec<String> = scene.names.objects().map(|name| name.into_owned()).collect();
    assert_eq!(objects, ["wall", "shape-2", "ball", "right", "group"]);
    let materials: Vec<String> = scene.names.materials().map(|name| name.into_owned()).collect();
    assert_eq!(materials, ["paint", "material-2", "material-3"]);
}

/// The sum over ids is the share of the pixel that is covered, but for what the first rays and six ids leave out.
#[test]
fn what_covers_a_pixel_is_what_is_seen_there() {
    let (scene, asked) = (scene(), layers(&MATTES));
    let image = average(&scene, &asked, &path(), 100);
    let found = channels(&asked, &image);
    for (layer, names) in [
        ("CryptoObject", ["wall", "shape-2", "ball", "right", "group"].as_slice()),
        ("CryptoMaterial", &["paint", "material-2", "material-3"]),
    ] {
        let known: BTreeSet<u32> = names.iter().map(|name| id(name)).collect();
        let mut seen = BTreeSet::new();
        let mut left_out = 0.0;
        for pixel in 0..(SIZE * SIZE) as usize {
            let pairs = pairs(&found, layer, pixel);
            let alpha = found["A"][pixel];
            let covered: f32 = pairs.iter().map(|pair| pair.1).sum();
            assert!((0.9 * alpha..=alpha + 1e-6).contains(&covered), "{covered} of {alpha}");
            left_out += alpha - covered;
            assert!(pairs.is_sorted_by(|a, b| a.1 >= b.1), "{pairs:?}");
            for (id, coverage) in pairs {
                assert_eq!(id == 0, coverage == 0.0);
                assert!(id == 0 || known.contains(&id), "{id:08x}");
                seen.extend(Some(id).filter(|id| *id != 0));
            }
        }
        assert_eq!(seen, known, "{layer}");
        assert!(left_out < 0.005 * (SIZE * SIZE) as f32, "{left_out}");
    }
    // The middle of the ball, and the corner, where there is the wall.
    let ball = (SIZE / 2 * SIZE + SIZE / 2) as usize;
    let [(first, coverage), ..] = pairs(&found, "CryptoObject", ball)[..] else {
        panic!("there are six pairs")
    };
    assert!(first == id("shape-2") && coverage > 0.9, "{first:08x}: {coverage}");
    assert_eq!(pairs(&found, "CryptoObject", 0)[0].0, id("wall"));
}

/// With whatever was found out before, by whichever iteration, and any number of threads.
#[test]
fn mattes_have_the_same_bits_wherever_they_are_rendered() {
    let (scene, asked) = (scene(), layers(&MATTES));
    let alone: Vec<_> = [1, 2, 40]
        .map(|iteration| render(&scene, &asked, &path(), iteration))
        .into();
    for threads in [1, 2, 7] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let memory = Memory::default();
        for (expected, iteration) in alone.iter().zip([1, 2, 40]).rev() {
            let found = pool.install(|| render_remembering(&scene, &asked, &memory, &path(), iteration));
            assert!(found == *expected, "{threads} threads, iteration {iteration}");
        }
    }
}

/// Of as many iterations as a job may have, whichever nodes are at hand.
#[test]
fn ids_come_back_out_of_means() {
    let scene = scene();
    let asked = layers(&["cryptomatte:object"]);
    let [width, height] = asked.stacked(scene.film.resolution);
    let leaf = Node::leaf(0, width, height, &render(&scene, &asked, &path(), 1)).unwrap();
    let of_one = channels(&asked, &Image::average(std::slice::from_ref(&leaf)).unwrap());
    let node = |level: u32, index: u32| {
        let mut node = Node {
            level,
            index,
            ..leaf.clone()
        };
        node.pixels
            .iter_mut()
            .for_each(|value| *value *= (1_u32 << level) as f32);
        node
    };
    let whole = |iterations: u32| -> Vec<Node> {
        let levels = (0..u32::BITS).rev().filter(|level| iterations >> level & 1 == 1);
        levels.map(|level| node(level, 0)).collect()
    };
    let gaps: Vec<Node> = (0..500).map(|index| node(index % 12, index)).collect();
    for nodes in [
        whole(3),
        whole(7),
        whole(1_000),
        whole(8_191),
        whole((1 << 20) - 1),
        gaps,
    ] {
        let found = channels(&asked, &Image::average(&nodes).unwrap());
        for (name, samples) in &found {
            let known = of_one[name].iter().zip(samples);
            let same = |a: &f32, b: &f32| match name.ends_with(['R', 'B']) {
                true => a.to_bits() == b.to_bits(),
                false => (a - b).abs() < 1e-5,
            };
            assert!(
                known.into_iter().all(|(a, b)| same(a, b)),
                "{name}, {} nodes",
                nodes.len()
            );
        }
    }
}

#[test]
fn a_file_says_whose_ids_they_are() {
    let asked = layers(&["cryptomatte:material", "depth"]);
    assert_eq!(asked.lists(), [false, true]);
    let attributes = asked.attributes(&["ball".into()], &["paint".into()]);
    let values: Vec<&str> = attributes.iter().map(|(_, value)| value.as_str()).collect();
    let manifest = format!("{{\"paint\":\"{:08x}\"}}", id("paint"));
    assert_eq!(
        values,
        ["CryptoMaterial", "MurmurHash3_32", "uint32_to_float32", &manifest]
    );
}

#[test]
fn samples_are_counted() {
    let (scene, asked) = (load(ROOM, LAMPS), layers(&["samples"]));
    for settings in independent() {
        let mut fields = crate::settings::fields_of(&settings);
        fields.insert("samples".into(), 3.into());
        fields.remove("type");
        let settings = settings.integrator().read(fields).unwrap();
        assert_eq!(settings.samples(), 3, "{}", settings.name());
        let counted = channels(&asked, &average(&scene, &asked, &settings, 2));
        assert_eq!(counted["samples.Y"], [6.0; (SIZE * SIZE) as usize]);
    }
}

#[test]
fn channels_of_two_layers_are_never_called_the_same() {
    for names in [
        ["halves", "half_b=L E"],
        ["cryptomatte:object", "CryptoObject02=L E"],
        ["samples", "samples"],
    ] {
        assert!(matches!(Layers::parse(&names), Err(LayerError::Twice(_))), "{names:?}");
    }
    layers(&["cryptomatte:object", "cryptomatte:material", "CryptoObject03=L E"]);
}

//! What textures as written become.

use super::{BTreeMap, LIGHT, Limits, Scene, warnings};
use crate::material::Material;
use crate::math::{Vec2, Vec3};
use crate::scene::SceneFaults;
use crate::texture::{Texels, Texture, TexturePoint};

/// A scene with an image of two texels with alpha: `a.png`, red of alpha 0.2 and grey (0.4) of alpha 1.
fn load(body: &str) -> Result<Scene, SceneFaults> {
    load_within(body, &Limits::default())
}

fn load_within(body: &str, limits: &Limits) -> Result<Scene, SceneFaults> {
    let mut png = std::io::Cursor::new(Vec::new());
    let mut image = image::RgbaImage::from_pixel(2, 1, image::Rgba([102, 102, 102, 255]));
    image.put_pixel(0, 0, image::Rgba([255, 0, 0, 51]));
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let text = format!("<scene version='3.0.0'>\n{LIGHT}<sensor type='perspective'/>{body}</scene>");
    let files = BTreeMap::from([
        ("main.xml".to_owned(), text.into_bytes()),
        ("a.png".to_owned(), png.into_inner()),
    ]);
    Scene::load(&files, "main.xml", &BTreeMap::new(), limits)
}

/// A ball with the texture as `name` of its BSDF.
fn ball(bsdf: &str, name: &str, texture: &str) -> String {
    let texture = texture.replacen("<texture ", &format!("<texture name='{name}' "), 1);
    format!("<shape type='sphere'><bsdf type='{bsdf}'>{texture}</bsdf></shape>")
}

/// A reflectance and what is warned about.
fn reflectance(texture: &str) -> (Texture, Vec<String>) {
    let scene = load(&ball("diffuse", "reflectance", texture)).unwrap_or_else(|faults| panic!("{texture}\n{faults}"));
    match &scene.materials[scene.bindings[0].material as usize] {
        Material::Diffuse { reflectance } => (reflectance.clone(), warnings(&scene)),
        other => panic!("{other:?}"),
    }
}

fn fault(body: &str) -> String {
    load(body).map(|_| ()).unwrap_err().to_string()
}

fn uv(u: f32, v: f32) -> TexturePoint {
    TexturePoint::of_uv(Vec2::new(u, v))
}

#[track_caller]
fn assert_value(texture: &Texture, at: TexturePoint, expected: [f32; 3]) {
    let found = texture.eval(&at).to_rgb();
    assert!(
        (0..3).all(|c| (found[c] - expected[c]).abs() < 1e-5),
        "{found:?}, expected {expected:?}"
    );
}

const IMAGE: &str = "<texture type='bitmap'><string name='filename' value='a.png'/><string name='filter_type' value='nearest'/>MORE</texture>";

fn image(more: &str) -> String {
    IMAGE.replace("MORE", more)
}

#[test]
fn channels_of_images_are_numbers() {
    let raw = "<boolean name='raw' value='true'/>";
    for (channel, expected) in [
        ("r", [1.0, 0.4]),
        ("g", [0.0, 0.4]),
        ("a", [0.2, 1.0]),
        ("luminance", [0.212_671, 0.4]),
    ] {
        let (texture, warned) = reflectance(&image(&format!("{raw}<string name='channel' value='{channel}'/>")));
        for (u, expected) in [(0.25, expected[0]), (0.75, expected[1])] {
            assert_value(&texture, uv(u, 0.5), [expected; 3]);
        }
        assert!(warned.is_empty(), "{channel} {warned:?}");
    }
    // Alpha is linear without a word.
    let (alpha, _) = reflectance(&image("<string name='channel' value='a'/>"));
    assert_value(&alpha, uv(0.25, 0.5), [0.2; 3]);
    let (inverted, _) = reflectance(&image(&format!(
        "{raw}<boolean name='invert' value='true'/><string name='channel' value='a'/>"
    )));
    assert_value(&inverted, uv(0.25, 0.5), [0.8; 3]);
    let (gamma, warned) = reflectance(&image("<float name='gamma' value='2'/>"));
    assert_value(&gamma, uv(0.75, 0.5), [0.16; 3]);
    assert!(warned.is_empty(), "{warned:?}");
    let (black, _) = reflectance(&image("<string name='wrap_mode' value='zero'/>"));
    assert_value(&black, uv(1.25, 0.5), [0.0; 3]);
    assert_value(&black, uv(0.25, 0.5), [1.0, 0.0, 0.0]);
}

/// Numbers of a BSDF take the luminance of an image, which may be linear without a warning.
#[test]
fn numbers_take_the_luminance() {
    let body = ball("principled", "roughness", &image("<boolean name='raw' value='true'/>"));
    let scene = load(&body).unwrap();
    let Material::Principled(body) = &scene.materials[scene.bindings[0].material as usize] else {
        panic!("another material");
    };
    assert_value(&body.roughness, uv(0.25, 0.5), [0.212_671; 3]);
    assert_eq!(warnings(&scene), Vec::<String>::new());
}

#[test]
fn textures_within_textures() {
    let number = |name: &str, value: f32| format!("<float name='{name}' value='{value}'/>");
    let mixed = format!(
        "<texture name='color0' type='mix'>{}{}</texture>",
        number("tex1", 0.2),
        number("amount", 0.25)
    );
    let chequers = format!(
        "<texture type='checkerboard'>{mixed}{}</texture>",
        number("color1", 0.1)
    );
    let (texture, warned) = reflectance(&chequers);
    assert_value(&texture, uv(0.1, 0.1), [0.4; 3]);
    assert_value(&texture, uv(0.6, 0.1), [0.1; 3]);
    assert!(warned.is_empty(), "{warned:?}");
    let scaled = |factor: &str| reflectance(&format!("<texture type='scale'>{factor}{chequers}</texture>"));
    let (texture, warned) = scaled(&number("scale", 0.5));
    assert_value(&texture, uv(0.1, 0.1), [0.2; 3]);
    assert!(warned.is_empty(), "{warned:?}");
    let (texture, warned) = scaled("<rgb name='scale' value='4 1 0'/>");
    assert_value(&texture, uv(0.1, 0.1), [1.0, 0.4, 0.0]);
    assert!(
        warned.len() == 1 && warned[0].contains("`scale`: the product may be above 1"),
        "{warned:?}"
    );
    let (grid, warned) = reflectance("<texture type='gridtexture'><float name='lineWidth' value='0.1'/></texture>");
    assert_value(&grid, uv(0.5, 0.5), [0.2; 3]);
    assert_value(&grid, uv(0.5, 0.05), [0.4; 3]);
    assert!(warned.is_empty(), "{warned:?}");
}

#[test]
fn textures_in_space() {
    let place = "<transform name='to_world'><translate x='10'/></transform>";
    let at = |x: f32, y: f32, z: f32| TexturePoint {
        position: Vec3::new(x, y, z),
        ..uv(0.1, 0.1)
    };
    let cubes = format!("<texture type='checkerboard'><integer name='dimension' value='3'/>{place}</texture>");
    let (cubes, _) = reflectance(&cubes);
    assert_value(&cubes, at(10.5, 0.5, 0.5), [0.4; 3]);
    assert_value(&cubes, at(9.5, 0.5, 0.5), [0.2; 3]);
    let planar = format!(
        "<texture type='checkerboard'><string name='mapping' value='planar'/><vector name='v1' x='0' y='0' z='0.5'/>{place}</texture>"
    );
    let (planar, _) = reflectance(&planar);
    assert_value(&planar, at(0.0, 0.1, 0.3), [0.4; 3]);
    assert_value(&planar, at(0.0, 0.1, 1.3), [0.2; 3]);
    for (plugin, more) in [
        ("fbm", "<integer name='octaves' value='3'/>"),
        ("wrinkled", "<float name='roughness' value='0.4'/>"),
        ("windy", ""),
        (
            "marble",
            "<float name='variation' value='0.5'/><float name='scale' value='2'/>",
        ),
        (
            "dots",
            "<float name='inside' value='0.7'/><string name='mapping' value='spherical'/>",
        ),
        ("directionmix", "<vector name='dir' x='1' y='1' z='0'/>"),
    ] {
        let (texture, warned) = reflectance(&format!(
            "<texture type='{plugin}'>{more}{}</texture>",
            if plugin == "directionmix" { "" } else { place }
        ));
        assert!(warned.is_empty(), "{warned:?}");
        for i in 0..100 {
            let value = texture.eval(&at(0.37 * i as f32, 1.0, 0.11 * i as f32));
            assert!(value.is_valid() && value.max_component() <= 1.0, "{plugin} {value:?}");
        }
    }
}

#[test]
fn reflectances_of_images_end_at_one() {
    let body = ball(
        "diffuse",
        "reflectance",
        "<texture type='bitmap'><string name='filename' value='b.pfm'/></texture>",
    );
    let text = format!("<scene version='3.0.0'>\n{LIGHT}<sensor type='perspective'/>{body}</scene>");
    let pfm = [b"Pf\n1 1\n-1\n".as_slice(), &1.5_f32.to_le_bytes()].concat();
    let files = BTreeMap::from([("main.xml".to_owned(), text.into_bytes()), ("b.pfm".to_owned(), pfm)]);
    let scene = Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap();
    let Material::Diffuse { reflectance } = &scene.materials[0] else {
        panic!("another material");
    };
    assert_value(reflectance, uv(0.5, 0.5), [1.0; 3]);
    let warned = warnings(&scene);
    assert!(
        warned.len() == 1 && warned[0].contains("a texel is 1.5: what is above 1 counts as 1"),
        "{warned:?}"
    );
}

/// Textures may name each other; neither circles nor those that would be looked up without end are taken.
#[test]
fn circles_and_forests_of_textures_are_refused() {
    let ball_of = |id: &str| {
        format!("<shape type='sphere'><bsdf type='diffuse'><ref name='reflectance' id='{id}'/></bsdf></shape>")
    };
    let circle =
        "<texture type='scale' id='a'><ref id='b'/></texture><texture type='scale' id='b'><ref id='a'/></texture>";
    assert!(fault(&format!("{circle}{}", ball_of("a"))).contains("contains itself"));
    let doubled = |n: usize, textures: &dyn Fn(usize) -> String| -> String {
        (1..=n)
            .map(|i| format!("<texture id='t{i}' {}</texture>", textures(i)))
            .collect()
    };
    let twice = |i: usize| {
        let before = i - 1;
        format!("type='mix'><ref name='tex1' id='t{before}'/><ref name='tex2' id='t{before}'/>")
    };
    let first = "<texture id='t0' type='checkerboard'/>";
    let forest = format!("{first}{}{}", doubled(40, &twice), ball_of("t40"));
    assert!(
        fault(&forest).contains("number of textures that one is made of"),
        "{}",
        fault(&forest)
    );
    let few = format!("{first}{}{}", doubled(6, &twice), ball_of("t6"));
    assert!(load(&few).is_ok());
    let once = |i: usize| format!("type='scale'><ref id='t{}'/>", i - 1);
    let chain = format!("{}{first}{}", ball_of("t200"), doubled(200, &once));
    let message = fault(&chain);
    assert!(message.contains("nesting depth of textures"), "{message}");
}

#[test]
fn unknown_textures_are_told_the_known_ones() {
    let message = fault(&ball("diffuse", "reflectance", "<texture type='marbel'/>"));
    assert!(message.contains("did you mean `marble`?"), "{message}");
}

/// Textures of one value are that value.
#[test]
fn even_textures_are_their_value() {
    for (texture, expected) in [
        (
            "<texture type='uniform'><float name='value' value='0.25'/></texture>",
            [0.25; 3],
        ),
        (
            "<texture type='srgb'><rgb name='color' value='0.1, 0.2, 0.4'/></texture>",
            [0.1, 0.2, 0.4],
        ),
        (
            "<texture type='rawconstant'><vector name='value' value='0.5, 0.5, 2'/></texture>",
            [0.5, 0.5, 1.0],
        ),
    ] {
        let (found, warnings) = reflectance(texture);
        assert_eq!((found.mean().to_rgb(), warnings), (expected, vec![]), "{texture}");
    }
}

/// Textures that memory may not hold lie in a file, and look the same.
#[test]
fn textures_beyond_their_memory_are_read_from_a_file() {
    let ball = ball("diffuse", "reflectance", &image(""));
    let limits = Limits {
        texture_bytes: 5,
        ..Limits::default()
    };
    let scenes = [Limits::default(), limits].map(|limits| load_within(&ball, &limits).unwrap());
    let [whole, tiled] = scenes.each_ref().map(|scene| {
        let Material::Diffuse { reflectance } = &scene.materials[scene.bindings[0].material as usize] else {
            panic!("{:?}", scene.materials)
        };
        let Texture::Bitmap(bitmap, _) = reflectance else {
            panic!("{reflectance:?}")
        };
        bitmap.clone()
    });
    assert!(matches!(tiled.texels, Texels::Tiled(_)) && !matches!(whole.texels, Texels::Tiled(_)));
    assert!(whole.texels.memory() == 6 && tiled.texels.memory() == 0);
    for u in [0.1, 0.3, 0.5, 0.8, 1.2] {
        assert_eq!(tiled.eval(Vec2::new(u, 0.5)), whole.eval(Vec2::new(u, 0.5)));
    }
    assert!(scenes[0].tiles.is_none() && scenes[1].tiles.as_ref().unwrap().take_failure().is_none());
}

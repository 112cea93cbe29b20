//! A corpus of broken scenes: each gives the error that names what is wrong, with its file and line.

use photonfarm_core::scene::{Limits, Scene, SceneError, SceneFaults};
use std::collections::BTreeMap;

type Files = BTreeMap<String, Vec<u8>>;

/// A scene that loads, with `body` from line 5 on.
fn scene(body: &str) -> String {
    format!(
        "<scene version=\"3.0.0\">\n<sensor type=\"perspective\"/>\n<emitter type=\"constant\"/>\n\
         <shape type=\"sphere\"/>\n{body}\n</scene>\n"
    )
}

fn files(main: &str, others: &[(&str, &[u8])]) -> Files {
    let mut files: Files = others
        .iter()
        .map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec()))
        .collect();
    files.insert("main.xml".into(), main.into());
    files
}

fn load(files: &Files, limits: &Limits) -> Result<Scene, SceneError> {
    Scene::load(files, "main.xml", &BTreeMap::new(), limits).map_err(only)
}

/// The fault of a scene that has one: nothing that follows from it is told as well.
fn only(faults: SceneFaults) -> SceneError {
    assert_eq!(faults.all().len(), 1, "{faults}");
    faults.first().clone()
}

/// The name of the error's variant.
fn kind(error: &SceneError) -> String {
    let debug = format!("{error:?}");
    debug.split([' ', '{']).next().unwrap_or_default().to_owned()
}

fn assert_error(result: Result<Scene, SceneError>, kind_: &str, file: &str, line: u32, fragment: &str, case: &str) {
    let error = result.expect_err(case);
    let message = error.to_string();
    assert_eq!(kind(&error), kind_, "{case}\n{message}");
    assert_eq!(
        (error.file(), error.line().unwrap_or(0)),
        (file, line),
        "{case}\n{message}"
    );
    let place = if line == 0 {
        format!("{file}: ")
    } else {
        format!("{file}:{line}: ")
    };
    assert!(message.starts_with(&place), "{case}\n{message}");
    assert!(
        message.contains(fragment),
        "{case}\nexpected `{fragment}` in: {message}"
    );
}

/// Bodies that are wrong in their first line, a line each: error, part of the message, body.
const BODIES: &str = include_str!("broken_bodies.txt");

#[test]
fn the_template_loads() {
    load(&files(&scene(""), &[]), &Limits::default()).unwrap();
}

#[test]
fn broken_bodies_name_their_line() {
    let cases = BODIES.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    for case in cases.clone() {
        let parts: Vec<&str> = case.splitn(3, '|').map(str::trim).collect();
        let [kind, fragment, body] = parts[..] else {
            panic!("not a case: {case}")
        };
        let main = scene(body);
        let result = load(&files(&main, &[]), &Limits::default());
        assert_error(result, kind, "main.xml", 5, fragment, case);
    }
    assert!(cases.count() > 100);
}

/// The faults of a body, each without its place, `main.xml:5: `.
fn told(body: &str) -> Vec<String> {
    let files = files(&scene(body), &[]);
    let faults = Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).expect_err(body);
    let message = |fault: &SceneError| {
        let message = fault.to_string();
        let rest = message.strip_prefix("main.xml:5: ");
        rest.unwrap_or_else(|| panic!("{body}\n{message}")).to_owned()
    };
    faults.all().iter().map(message).collect()
}

#[test]
fn all_bad_attributes_of_an_element_are_told() {
    for (body, expected) in [
        (
            "<shape type='sphere'><float nme='radius' value='big' vlue='1'/></shape>",
            &[
                "<float>: unknown attribute `nme`; did you mean `name`? allowed: name, value",
                "<float>: unknown attribute `vlue`; did you mean `value`? allowed: name, value",
                "<float> value: `big` is not a number",
            ][..],
        ),
        (
            "<shape type='sphere'><float/></shape>",
            &[
                "<float>: attribute `name` is missing",
                "<float>: attribute `value` is missing",
            ],
        ),
        (
            "<shape type='sphere'><point name='center' x='a' y='1' z='$c'/></shape>",
            &[
                "<point> z: unknown parameter `c`; allowed: none",
                "<point name=\"center\"> x: `a` is not a number",
            ],
        ),
        (
            "<shape type='sphere'><point name='center' value='1 2' x='1' y='2'/></shape>",
            &[
                "<point name=\"center\"> x: it cannot be combined with `value`",
                "<point name=\"center\"> y: it cannot be combined with `value`",
                "<point name=\"center\"> value: expected one or three numbers, found 2",
            ],
        ),
        // Each operation of a transform, and what lies within one.
        (
            "<shape type='sphere'><transform name='to_world'><translate x='a' y='b'/><turn/><scale value='0'/>\
             <rotate x='1' angel='3'><float/></rotate></transform></shape>",
            &[
                "<translate> x: `a` is not a number",
                "<translate> y: `b` is not a number",
                "<transform>: unknown element `turn`; allowed: translate, rotate, scale, matrix, lookat",
                "<scale> value: the transform has no finite inverse, or the last row of its matrix is not 0 0 0 1",
                "<rotate>: unknown attribute `angel`; did you mean `angle`? allowed: x, y, z, value, angle",
                "<rotate>: unknown element `float`; allowed: none",
            ],
        ),
        // An object whose attributes are wrong is read on, with a type or without one.
        (
            "<shape type='sphere' colour='red' size='2'><float name='radios' value='1'/></shape>",
            &[
                "<shape>: unknown attribute `colour`; allowed: type, id, name",
                "<shape>: unknown attribute `size`; allowed: type, id, name",
            ],
        ),
        (
            "<shape tpye='sphere'><float name='radius' value='x'/></shape>",
            &[
                "<shape>: unknown attribute `tpye`; did you mean `type`? allowed: type, id, name",
                "<float name=\"radius\"> value: `x` is not a number",
            ],
        ),
        (
            "<default nam='a' value='1'/><ref idd='a'/><alias is='b'/><include/>",
            &[
                "<default>: unknown attribute `nam`; did you mean `name`? allowed: name, value",
                "<ref>: unknown attribute `idd`; did you mean `id`? allowed: id, name",
                "<alias>: unknown attribute `is`; did you mean `id`? allowed: id, as",
                "<include>: attribute `filename` is missing",
            ],
        ),
    ] {
        assert_eq!(told(body), expected, "{body}");
    }
}

#[test]
fn broken_cameras_and_films_name_their_line() {
    for (kind, fragment, sensor) in [
        ("Value", "`fov`", "<float name='fov' value='180'/>"),
        (
            "Value",
            "not both",
            "<float name='fov' value='60'/><string name='focal_length' value='50mm'/>",
        ),
        (
            "Value",
            "is not a length",
            "<string name='focal_length' value='fifty'/>",
        ),
        ("Value", "`z` is not one of", "<string name='fov_axis' value='z'/>"),
        ("Value", "below `far_clip`", "<float name='near_clip' value='2e4'/>"),
        (
            "Value",
            "scaled or sheared",
            "<transform name='to_world'><scale value='2'/></transform>",
        ),
        (
            "Value",
            "1 lies before `shutter_open`, 2",
            "<float name='shutterOpen' value='2'/><float name='shutterClose' value='1'/>",
        ),
        (
            "Value",
            "scaled or sheared",
            "<animation name='to_world'><transform time='0'/><transform time='1'><scale value='2'/></transform></animation>",
        ),
        (
            "Value",
            "1 to 65536",
            "<film type='hdrfilm'><integer name='width' value='0'/></film>",
        ),
        (
            "Value",
            "1 to 65536",
            "<film type='hdrfilm'><integer name='width' value='99999999999'/></film>",
        ),
        (
            "Limit",
            "67108864",
            "<film type='hdrfilm'><integer name='width' value='65536'/><integer name='height' value='65536'/></film>",
        ),
        (
            "Value",
            "8 is out of range; allowed: 1 to 6",
            "<film type='hdrfilm'><integer name='width' value='9'/><integer name='crop_offset_x' value='3'/><integer name='crop_width' value='8'/></film>",
        ),
        ("Unknown", "unknown type `hdrflim`", "<film type='hdrflim'/>"),
        (
            "Value",
            "`sample_count`",
            "<sampler type='independent'><integer name='sample_count' value='0'/></sampler>",
        ),
    ] {
        let main = scene("").replace(
            "<sensor type=\"perspective\"/>",
            &format!("<sensor type='perspective'>{sensor}</sensor>"),
        );
        assert_error(
            load(&files(&main, &[]), &Limits::default()),
            kind,
            "main.xml",
            2,
            fragment,
            sensor,
        );
    }
    for (plugin, kind, fragment, sensor) in [
        ("distant", "Unsupported", "type `distant`", ""),
        ("thinlens", "Missing", "aperture_radius", ""),
        (
            "orthographic",
            "Value",
            "lies beyond",
            "<transform name='to_world'><scale x='1e15'/></transform>",
        ),
        (
            "orthographic",
            "Value",
            "a pixel's side",
            "<transform name='to_world'><scale x='1e-36' y='1e-36'/></transform>",
        ),
        (
            "orthographic",
            "Value",
            "viewing direction",
            "<transform name='to_world'><scale z='1e-30'/></transform>",
        ),
    ] {
        let main = scene("").replace(
            "<sensor type=\"perspective\"/>",
            &format!("<sensor type='{plugin}'>{sensor}</sensor>"),
        );
        assert_error(
            load(&files(&main, &[]), &Limits::default()),
            kind,
            "main.xml",
            2,
            fragment,
            sensor,
        );
    }
}

#[test]
fn broken_documents_are_refused() {
    let laughs =
        "<!DOCTYPE scene [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;\">]>\n<scene version='3.0.0'>&b;</scene>";
    for (kind, line, fragment, text) in [
        ("Xml", 1, "", ""),
        ("Xml", 1, "", "<scene"),
        ("Xml", 1, "", "<scene version='3.0.0'>"),
        ("Xml", 1, "DTD", laughs),
        ("Missing", 1, "attribute `version`", "<scene></scene>"),
        ("Value", 1, "not a version", "<scene version='9.0.0'/>"),
        (
            "Unknown",
            2,
            "unknown root element `bsdf`",
            "<?xml version='1.0'?>\n<bsdf type='null' version='3.0.0'/>",
        ),
        ("Missing", 1, "a <shape>", "<scene version='3.0.0'/>"),
        (
            "Missing",
            1,
            "a <shape>",
            "<scene version='3.0.0'><sensor type='perspective'/><emitter type='point'/></scene>",
        ),
    ] {
        assert_error(
            load(&files(text, &[]), &Limits::default()),
            kind,
            "main.xml",
            line,
            fragment,
            text,
        );
    }
    let not_text = Files::from([("main.xml".to_owned(), b"<scene>\n\xff</scene>".to_vec())]);
    assert_error(
        load(&not_text, &Limits::default()),
        "Xml",
        "main.xml",
        2,
        "not UTF-8",
        "not text",
    );
    assert_error(
        load(&Files::new(), &Limits::default()),
        "NotFound",
        "main.xml",
        0,
        "`main.xml`",
        "nothing",
    );
}

#[test]
fn definitions_must_name_a_parameter_of_the_scene() {
    let main = scene(
        "<default name='radius' value='1'/>\n<shape type='sphere'><float name='radius' value='$radius'/></shape>",
    );
    let with = |name: &str, value: &str| {
        let defines = BTreeMap::from([(name.to_owned(), value.to_owned())]);
        Scene::load(&files(&main, &[]), "main.xml", &defines, &Limits::default()).map_err(only)
    };
    assert!(with("radius", "2").is_ok());
    assert_error(
        with("radios", "2"),
        "Unknown",
        "main.xml",
        0,
        "unknown parameter `radios`; did you mean `radius`? allowed: radius",
        "-D",
    );
    assert_error(with("radius", "x"), "Value", "main.xml", 6, "`x` is not a number", "-D");
}

#[test]
fn includes_are_followed_and_their_cycles_found() {
    let part: &[u8] = b"<scene version='0.5.0'>\n<default name='r' value='2'/>\n<include filename='b.xml'/>\n</scene>";
    let good: &[u8] = b"<shape version='3.0.0' type='sphere'>\n<float name='radius' value='$r'/>\n</shape>";
    let main = scene("<include filename='sub/a.xml'/>");
    let scene_of = |b: &[u8]| {
        load(
            &files(&main, &[("sub/a.xml", part), ("sub/b.xml", b)]),
            &Limits::default(),
        )
    };
    assert_eq!(scene_of(good).unwrap().bindings.len(), 2);
    // A file of the including file's folder is found as well, after those beside the included one.
    assert!(
        load(
            &files(&main, &[("sub/a.xml", part), ("b.xml", good)]),
            &Limits::default()
        )
        .is_ok()
    );
    let wrong = b"<shape version='3.0.0' type='sphere'>\n<float name='radius' value='$q'/>\n</shape>";
    assert_error(
        scene_of(wrong),
        "Unknown",
        "sub/b.xml",
        2,
        "unknown parameter `q`",
        "nested file",
    );
    let back = b"<scene version='3.0.0'>\n<include filename='a.xml'/></scene>";
    let chain = "main.xml, sub/a.xml, sub/b.xml, sub/a.xml";
    assert_error(scene_of(back), "IncludeCycle", "sub/b.xml", 2, chain, "cycle");
    let own = b"<scene version='3.0.0'><include filename='main.xml'/></scene>";
    assert_error(scene_of(own), "IncludeCycle", "sub/b.xml", 1, "main.xml", "cycle");
}

#[test]
fn limits_are_named_with_their_values() {
    let default = Limits::default;
    let deep = format!("{}{}", "<bsdf type='twosided'>".repeat(70), "</bsdf>".repeat(70));
    let very_deep = format!(
        "{}{}",
        "<bsdf type='twosided'>".repeat(300_000),
        "</bsdf>".repeat(300_000)
    );
    let doubling: String = (1..40)
        .map(|i| format!("<default name='a{i}' value='$a{}$a{}'/>", i - 1, i - 1))
        .collect();
    let doubling = format!("<default name='a0' value='aaaaaaaa'/>{doubling}");
    let many: String = (0..40).map(|i| format!(" a{i}='1'")).collect();
    let long = format!(
        "<default name='a' value='{}'/>{}",
        "a".repeat(200_000),
        "<default name='b' value='$a'/>".repeat(400)
    );
    let tiny: &[u8] = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 3\n";
    let obj = "<shape type='obj'><string name='filename' value='a.obj'/></shape>";
    for (limits, file, line, fragment, body) in [
        (
            default(),
            "main.xml",
            5,
            "nesting depth of elements: 65 is over the limit of 64",
            deep.as_str(),
        ),
        (
            default(),
            "main.xml",
            5,
            "nesting depth of elements",
            very_deep.as_str(),
        ),
        (default(), "main.xml", 5, "filled-in value", doubling.as_str()),
        (
            default(),
            "main.xml",
            5,
            "attributes of one element: 33 is over the limit of 32",
            &format!("<bsdf{many}/>"),
        ),
        (
            default(),
            "main.xml",
            5,
            "bytes of XML, parameters filled in",
            long.as_str(),
        ),
        (
            Limits {
                xml_nodes: 5,
                ..default()
            },
            "main.xml",
            0,
            "number of XML nodes: 6 is over the limit of 5",
            "",
        ),
        (
            Limits {
                xml_bytes: 50,
                ..default()
            },
            "main.xml",
            0,
            "bytes of XML",
            "",
        ),
        (
            Limits { shapes: 1, ..default() },
            "main.xml",
            5,
            "number of shapes: 2 is over the limit of 1",
            "<shape type='cube'/>",
        ),
        (
            Limits { files: 1, ..default() },
            "main.xml",
            5,
            "number of files: 2 is over the limit of 1",
            obj,
        ),
        (
            Limits {
                total_bytes: 210,
                ..default()
            },
            "main.xml",
            5,
            "bytes of all files",
            obj,
        ),
        (
            Limits {
                file_bytes: 39,
                ..default()
            },
            "main.xml",
            0,
            "bytes of file `main.xml`",
            obj,
        ),
        (
            Limits {
                triangles: 1,
                ..default()
            },
            "a.obj",
            0,
            "number of triangles of the scene: 2 is over the limit of 1",
            obj,
        ),
        (
            Limits {
                vertices: 2,
                ..default()
            },
            "a.obj",
            0,
            "number of vertices of the scene: 3 is over the limit of 2",
            obj,
        ),
        (
            Limits {
                mesh_bytes: 9,
                ..default()
            },
            "a.obj",
            0,
            "bytes of mesh files of the scene",
            obj,
        ),
    ] {
        let result = load(&files(&scene(body), &[("a.obj", tiny)]), &limits);
        assert_error(result, "Limit", file, line, fragment, &body[..body.len().min(200)]);
    }
    let often = scene(&"<include filename='a.xml'/>\n".repeat(5));
    let limits = Limits {
        includes: 4,
        ..default()
    };
    let result = load(&files(&often, &[("a.xml", b"<scene version='3.0.0'/>")]), &limits);
    assert_error(
        result,
        "Limit",
        "main.xml",
        9,
        "number of inclusions: 5 is over the limit of 4",
        "includes",
    );
}

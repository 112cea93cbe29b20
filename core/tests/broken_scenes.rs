//! A corpus of broken scenes: each gives the error that names what is wrong, with its file and line.

use photonfarm_core::scene::{Limits, Scene, SceneError};
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
    Scene::load(files, "main.xml", &BTreeMap::new(), limits)
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

/// Bodies that are wrong in their first line: error, part of the message, body.
const BODIES: &[(&str, &str, &str)] = &[
    // Elements, attributes, properties and types that do not exist.
    ("Unknown", "unknown element `blob`", "<blob/>"),
    ("Unknown", "unknown element `luminaire`", "<luminaire type='area'/>"),
    ("Unsupported", "<medium>", "<medium type='homogeneous'/>"),
    (
        "Unknown",
        "unknown attribute `colour`",
        "<shape type='sphere' colour='red'/>",
    ),
    (
        "Unknown",
        "unknown property `radios`",
        "<shape type='sphere'><float name='radios' value='1'/></shape>",
    ),
    (
        "Unknown",
        "unknown property `int_ior`",
        "<bsdf type='diffuse'><float name='intIOR' value='1.5'/></bsdf>",
    ),
    ("Unknown", "unknown type `sphare`", "<shape type='sphare'/>"),
    ("Unsupported", "type `cylinder`", "<shape type='cylinder'/>"),
    ("Unknown", "unknown type `lambert`", "<bsdf type='lambert'/>"),
    ("Unsupported", "type `mask`", "<bsdf type='mask'/>"),
    ("Unknown", "unknown type `sun`", "<texture type='sun'/>"),
    ("Unsupported", "type `sunsky`", "<emitter type='sunsky'/>"),
    ("Unknown", "unknown type `magic`", "<integrator type='magic'/>"),
    (
        "Unknown",
        "unknown nested object `<sampler>`",
        "<shape type='sphere'><sampler type='independent'/></shape>",
    ),
    ("Unknown", "unknown nested object `<film>`", "<film type='hdrfilm'/>"),
    (
        "Unknown",
        "unknown element `float`",
        "<bsdf type='diffuse'><float name='a' value='1'><float/></float></bsdf>",
    ),
    (
        "Unknown",
        "unknown element `turn`",
        "<shape type='sphere'><transform name='to_world'><turn/></transform></shape>",
    ),
    // Missing parts.
    ("Missing", "attribute `type`", "<shape/>"),
    (
        "Missing",
        "attribute `value`",
        "<shape type='sphere'><float name='radius'/></shape>",
    ),
    (
        "Missing",
        "attribute `z`",
        "<shape type='sphere'><point name='center' x='1' y='2'/></shape>",
    ),
    ("Missing", "property `filename`", "<shape type='obj'/>"),
    ("Missing", "one or two nested BSDFs", "<bsdf type='twosided'/>"),
    // Values.
    (
        "Value",
        "`abc` is not a number",
        "<shape type='sphere'><float name='radius' value='abc'/></shape>",
    ),
    (
        "Value",
        "not a finite number",
        "<shape type='sphere'><float name='radius' value='nan'/></shape>",
    ),
    (
        "Value",
        "not a finite number",
        "<shape type='sphere'><float name='radius' value='1e400'/></shape>",
    ),
    (
        "Value",
        "not a finite number",
        "<shape type='sphere'><point name='center' value='0 0 inf'/></shape>",
    ),
    (
        "Value",
        "allowed: numbers above 0",
        "<shape type='sphere'><float name='radius' value='0'/></shape>",
    ),
    (
        "Value",
        "allowed: numbers above 0",
        "<shape type='sphere'><float name='radius' value='-1'/></shape>",
    ),
    (
        "Value",
        "too small or reaches",
        "<shape type='sphere'><float name='radius' value='1e20'/></shape>",
    ),
    (
        "Value",
        "too small",
        "<shape type='sphere'><float name='radius' value='1e-30'/></shape>",
    ),
    (
        "Value",
        "expected a value of type float",
        "<shape type='sphere'><string name='radius' value='1'/></shape>",
    ),
    (
        "Value",
        "expected a value of type boolean",
        "<shape type='sphere'><float name='flip_normals' value='1'/></shape>",
    ),
    (
        "Value",
        "neither `true` nor",
        "<shape type='sphere'><boolean name='flip_normals' value='1'/></shape>",
    ),
    (
        "Value",
        "given twice",
        "<shape type='sphere'><float name='radius' value='1'/><float name='radius' value='2'/></shape>",
    ),
    (
        "Value",
        "given twice",
        "<shape type='obj'><string name='faceNormals' value=''/><string name='face_normals' value=''/></shape>",
    ),
    ("Value", "belongs inside an object", "<float name='radius' value='1'/>"),
    (
        "Value",
        "found 2",
        "<bsdf type='diffuse'><rgb name='reflectance' value='1 1'/></bsdf>",
    ),
    (
        "Value",
        "#rrggbb",
        "<bsdf type='diffuse'><rgb name='reflectance' value='#12'/></bsdf>",
    ),
    (
        "Value",
        "above 1",
        "<bsdf type='diffuse'><rgb name='reflectance' value='0.5 1.5 0.5'/></bsdf>",
    ),
    (
        "Value",
        "negative",
        "<bsdf type='diffuse'><rgb name='reflectance' value='0.5 -0.5 0.5'/></bsdf>",
    ),
    (
        "Value",
        "must rise",
        "<bsdf type='diffuse'><spectrum name='reflectance' value='500:1 400:1'/></bsdf>",
    ),
    (
        "Value",
        "either `value` or `filename`",
        "<bsdf type='diffuse'><spectrum name='reflectance'/></bsdf>",
    ),
    (
        "Value",
        "`ext_ior`",
        "<bsdf type='dielectric'><float name='extIOR' value='0'/></bsdf>",
    ),
    (
        "Value",
        "`int_ior`",
        "<bsdf type='dielectric'><float name='int_ior' value='-1.5'/></bsdf>",
    ),
    (
        "Value",
        "ratio of indices",
        "<bsdf type='dielectric'><float name='int_ior' value='1e-9'/></bsdf>",
    ),
    (
        "Value",
        "no dielectric `unobtainium`",
        "<bsdf type='dielectric'><string name='int_ior' value='unobtainium'/></bsdf>",
    ),
    (
        "Value",
        "no conductor `mud`",
        "<bsdf type='conductor'><string name='material' value='mud'/></bsdf>",
    ),
    (
        "Value",
        "not both",
        "<bsdf type='conductor'><string name='material' value='Al'/><rgb name='k' value='1'/></bsdf>",
    ),
    (
        "Value",
        "negative",
        "<bsdf type='conductor'><rgb name='k' value='-1'/></bsdf>",
    ),
    (
        "Value",
        "both 0",
        "<bsdf type='conductor'><rgb name='k' value='0'/></bsdf>",
    ),
    (
        "Value",
        "`alpha`",
        "<bsdf type='roughconductor'><float name='alpha' value='0'/></bsdf>",
    ),
    (
        "Value",
        "`phong` is not one of",
        "<bsdf type='roughconductor'><string name='distribution' value='phong'/></bsdf>",
    ),
    (
        "Value",
        "must reflect only",
        "<bsdf type='twosided'><bsdf type='dielectric'/></bsdf>",
    ),
    (
        "Value",
        "only one <bsdf>",
        "<shape type='sphere'><bsdf type='diffuse'/><bsdf type='null'/></shape>",
    ),
    ("Value", "only one <sensor>", "<sensor type='perspective'/>"),
    (
        "Value",
        "no finite inverse",
        "<shape type='cube'><transform name='to_world'><scale x='0'/></transform></shape>",
    ),
    (
        "Value",
        "16 or 9 numbers",
        "<shape type='cube'><transform name='to_world'><matrix value='1 2'/></transform></shape>",
    ),
    (
        "Value",
        "parallel",
        "<shape type='cube'><transform name='to_world'><lookat origin='0 0 0' target='0 1 0' up='0 1 0'/></transform></shape>",
    ),
    (
        "Value",
        "axis of rotation",
        "<shape type='cube'><transform name='to_world'><rotate angle='3'/></transform></shape>",
    ),
    (
        "Value",
        "same factor",
        "<shape type='sphere'><transform name='to_world'><scale x='2'/></transform></shape>",
    ),
    (
        "Value",
        "coordinates reach",
        "<shape type='cube'><transform name='to_world'><scale value='1e12'/></transform></shape>",
    ),
    (
        "Value",
        "no triangle with an area",
        "<shape type='cube'><transform name='to_world'><scale value='1e-20'/></transform></shape>",
    ),
    (
        "Value",
        "no area",
        "<shape type='disk'><transform name='to_world'><scale x='1e-20'/></transform></shape>",
    ),
    ("Value", "an environment already", "<emitter type='constant'/>"),
    ("Value", "no shape uses", "<emitter type='area'/>"),
    (
        "Value",
        "must have type `area`",
        "<shape type='sphere'><emitter type='point'/></shape>",
    ),
    (
        "Value",
        "negative",
        "<shape type='sphere'><emitter type='area'><rgb name='radiance' value='-1'/></emitter></shape>",
    ),
    (
        "Value",
        "above 1e12",
        "<emitter type='point'><rgb name='intensity' value='1e30'/></emitter>",
    ),
    (
        "Value",
        "not both",
        "<emitter type='point'><point name='position' value='0'/><transform name='to_world'/></emitter>",
    ),
    (
        "Value",
        "no length",
        "<emitter type='directional'><vector name='direction' value='0'/></emitter>",
    ),
    (
        "Value",
        "`cutoff_angle`",
        "<emitter type='spot'><float name='cutoff_angle' value='0'/></emitter>",
    ),
    (
        "Value",
        "above `cutoff_angle`",
        "<emitter type='spot'><float name='beam_width' value='30'/></emitter>",
    ),
    (
        "Value",
        "-1 for no limit",
        "<integrator type='path'><integer name='max_depth' value='0'/></integrator>",
    ),
    (
        "Value",
        "hiding emitters",
        "<integrator type='path'><boolean name='hide_emitters' value='true'/></integrator>",
    ),
    (
        "Value",
        "`alpha`",
        "<integrator type='pppm'><float name='alpha' value='2'/></integrator>",
    ),
    (
        "Value",
        "`photons`",
        "<integrator type='pcf'><float name='photons' value='1.5'/></integrator>",
    ),
    (
        "Value",
        "`samplers`",
        "<integrator type='pcf'><string name='samplers' value='bsdf, sun'/></integrator>",
    ),
    (
        "Value",
        "lookup_vertex",
        "<integrator type='pcf'><integer name='lookup_vertex' value='0'/></integrator>",
    ),
    ("Value", "within another element", "<scene version='3.0.0'/>"),
    (
        "Value",
        "directly in <scene>",
        "<bsdf type='diffuse'><path value='x'/></bsdf>",
    ),
    // References.
    (
        "Reference",
        "already defined at main.xml:5",
        "<bsdf type='null' id='a'/><bsdf type='null' id='a'/>",
    ),
    (
        "Reference",
        "no object has this id",
        "<shape type='sphere'><ref id='nobody'/></shape>",
    ),
    (
        "Reference",
        "contains itself",
        "<bsdf type='twosided' id='a'><ref id='a'/></bsdf>",
    ),
    (
        "Reference",
        "contains itself",
        "<bsdf type='twosided' id='a'><ref id='b'/></bsdf><bsdf type='twosided' id='b'><ref id='a'/></bsdf>",
    ),
    ("Reference", "no object above", "<alias id='a' as='b'/>"),
    // Parameters.
    (
        "Unknown",
        "unknown parameter `spp`",
        "<shape type='sphere'><float name='radius' value='$spp'/></shape>",
    ),
    ("Value", "1 to 64 characters", "<default name='' value='1'/>"),
    // Files.
    (
        "NotFound",
        "`nothing.obj`",
        "<shape type='obj'><string name='filename' value='nothing.obj'/></shape>",
    ),
    (
        "FileName",
        "leaves the scene's folder",
        "<shape type='obj'><string name='filename' value='../up.obj'/></shape>",
    ),
    (
        "FileName",
        "leaves the scene's folder",
        "<include filename='a/../../b.xml'/>",
    ),
    (
        "FileName",
        "absolute names",
        "<shape type='ply'><string name='filename' value='/etc/passwd'/></shape>",
    ),
    (
        "FileName",
        "not allowed",
        "<shape type='ply'><string name='filename' value='C:\\x.ply'/></shape>",
    ),
    (
        "FileName",
        "not allowed",
        "<include filename='http://example.org/scene.xml'/>",
    ),
    ("FileName", "it is empty", "<include filename=''/>"),
    ("FileName", "leaves the scene's folder", "<path value='../elsewhere'/>"),
    (
        "NotFound",
        "`nothing.spd`",
        "<bsdf type='diffuse'><spectrum name='reflectance' filename='nothing.spd'/></bsdf>",
    ),
    // Not well-formed, or not what the format allows.
    ("Xml", "text `hello`", "hello"),
    ("Xml", "text `hello`", "<bsdf type='null'>hello</bsdf>"),
    ("Xml", "", "<bsdf type='null'></shape>"),
    ("Xml", "", "<bsdf type='null' type='null'/>"),
    ("Xml", "", "<bsdf type=null/>"),
    ("Xml", "", "<bsdf type='&unknown;'/>"),
    ("Xml", "no namespaces", "<bsdf type='null' xmlns:a='http://b'/>"),
];

#[test]
fn the_template_loads() {
    load(&files(&scene(""), &[]), &Limits::default()).unwrap();
}

#[test]
fn broken_bodies_name_their_line() {
    for (kind, fragment, body) in BODIES {
        let main = scene(body);
        assert_error(
            load(&files(&main, &[]), &Limits::default()),
            kind,
            "main.xml",
            5,
            fragment,
            body,
        );
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
        ("Value", "motion blur", "<float name='shutter_close' value='1'/>"),
        (
            "Unknown",
            "unknown property `aperture_radius`",
            "<float name='aperture_radius' value='1'/>",
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
            "crops are not supported",
            "<film type='hdrfilm'><integer name='crop_width' value='5'/></film>",
        ),
        ("Unsupported", "type `ldrfilm`", "<film type='ldrfilm'/>"),
        (
            "Unsupported",
            "negative lobes",
            "<film type='hdrfilm'><rfilter type='mitchell'/></film>",
        ),
        (
            "Unknown",
            "unknown property `radius`",
            "<film type='hdrfilm'><rfilter type='gaussian'><float name='radius' value='2'/></rfilter></film>",
        ),
        (
            "Value",
            "`sample_count`",
            "<sampler type='independent'><integer name='sample_count' value='0'/></sampler>",
        ),
        ("Unknown", "unknown type `best`", "<sampler type='best'/>"),
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
    let main = scene("").replace("perspective", "orthographic");
    assert_error(
        load(&files(&main, &[]), &Limits::default()),
        "Unsupported",
        "main.xml",
        2,
        "orthographic",
        "sensor",
    );
    let main = scene("").replace("perspective", "thinlens");
    assert_error(
        load(&files(&main, &[]), &Limits::default()),
        "Missing",
        "main.xml",
        2,
        "aperture_radius",
        "lens",
    );
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
        ("Missing", 1, "a <sensor>", "<scene version='3.0.0'/>"),
        (
            "Missing",
            1,
            "a <shape>",
            "<scene version='3.0.0'><sensor type='perspective'/><emitter type='constant'/></scene>",
        ),
        (
            "Missing",
            1,
            "an <emitter>",
            "<scene version='3.0.0'><sensor type='perspective'/><shape type='sphere'/></scene>",
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
        Scene::load(&files(&main, &[]), "main.xml", &defines, &Limits::default())
    };
    assert!(with("radius", "2").is_ok());
    assert_error(
        with("radios", "2"),
        "Unknown",
        "main.xml",
        0,
        "unknown parameter `radios`; allowed: radius",
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
            1,
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

//! What is wrong with a scene, with its line, and what is warned about.

use super::{describe_with, files, load_with};
use crate::scene::{Limits, Scene};
use std::collections::BTreeMap;

/// The faults of a text, one a line.
fn faults_of(text: &str) -> Vec<String> {
    let faults = load_with(text, &[]).err().unwrap_or_else(|| panic!("it loads: {text}"));
    faults.all().iter().map(ToString::to_string).collect()
}

#[test]
fn faults_name_line_directive_and_parameter() {
    for (text, expected) in [
        (
            "\nWorldBegn",
            "main.pbrt:2: scene file: unknown pbrt directive `WorldBegn`; did you mean",
        ),
        ("Shape", "main.pbrt:1: the type or the name is missing"),
        ("Shape 5", "main.pbrt:1: the type or the name is missing"),
        ("\"Shape\"", "expected a directive"),
        (
            "WorldBegin\nShape \"spere\"",
            "main.pbrt:2: Shape \"spere\": unknown type `spere`; did you mean `sphere`?",
        ),
        (
            "Shape \"sphere\"\n\"float radius\" [1 2]",
            "main.pbrt:2: Shape \"sphere\" `radius`: expected one number, found 2",
        ),
        ("Shape \"sphere\" \"float radius\" -1", "`radius`: -1 is out of range"),
        (
            "WorldBegin\nLightSource \"infinite\"\n\"point3 portal\" [0 0 0 1 0 0 1 1 0]",
            "main.pbrt:3: LightSource \"infinite\" `portal`: expected 12 numbers, found 9",
        ),
        (
            "WorldBegin\nLightSource \"infinite\"\n\"point3 portal\" [0 0 0 1 0 0 1 1 0 0 1 0.1]",
            "main.pbrt:3: LightSource \"infinite\" `portal`: its points are not the corners of a flat rectangle",
        ),
        (
            "LightSource \"infinite\" \"point3 portal\" [0 0 0 1e10 0 0 1e10 1 0 0 1 0]",
            "`portal`: it reaches beyond 1e9",
        ),
        (
            "Shape \"sphere\" \"float radius\" \"a\"",
            "`radius`: expected one number, found 1",
        ),
        (
            "Shape \"sphere\" \"flot radius\" 1",
            "unknown parameter type `flot`; did you mean `float`?",
        ),
        (
            "Shape \"sphere\" \"radius\" 1",
            "\"radius\" is not of the form \"type name\"",
        ),
        ("Shape \"sphere\" \"float radius\" []", "`radius`: it has no values"),
        ("Shape \"sphere\" \"float radius\" [1", "a list never ends"),
        ("Shape \"sphere\" \"float radius\" 1e", "`1e` is not a number"),
        ("Shape \"sphere\" \"float radius", "a text in quotes never ends"),
        (
            "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1]",
            "`P`: 8 numbers are no multiple of 3",
        ),
        ("Shape \"trianglemesh\"", "`P`: it is missing"),
        (
            "Shape \"curve\" \"point3 P\" [0 0 0 1 0 0 1 1 0 2 2 0 3 3 0]",
            "Shape \"curve\" `P`: 5 points make no such curve",
        ),
        (
            "Shape \"curve\" \"integer degree\" -7 \"point3 P\" [0 0 0 1 0 0]",
            "`degree`: -7 is out of range",
        ),
        (
            "Shape \"heightfield\" \"integer nu\" 65536 \"integer nv\" 65536 \"float Pz\" [1 2]",
            "`Pz`: there are 2 heights for 65536 times 65536",
        ),
        ("Shape \"hyperboloid\" \"point3 p2\" [0 0 1]", "or is the axis"),
        (
            "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 3]",
            "index 3 is out of range: there are 3 points",
        ),
        (
            "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 -1]",
            "index -1 is out of range",
        ),
        (
            "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 1.5]",
            "1.5 is not an integer",
        ),
        (
            "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"normal N\" [0 0 1]",
            "`N`: there are 1 for 3 points",
        ),
        (
            "Shape \"plymesh\" \"string filename\" \"no.ply\"",
            "file `no.ply` was not found",
        ),
        ("Scale 0 1 1 Shape \"sphere\" \"float zmin\" 0.5", "no finite inverse"),
        ("Transform [1 2 3]", "a number is missing"),
        ("Rotate 3 0 0 0", "Rotate: the axis has no length"),
        ("LookAt 0 0 0 0 0 0 0 1 0", "LookAt: eye and target are the same"),
        ("CoordSysTransform \"nowhere\"", "unknown coordinate system `nowhere`"),
        ("NamedMaterial \"gold\"", "NamedMaterial: unknown name `gold`"),
        (
            "Material \"diffuse\" \"texture reflectance\" \"t\"",
            "`reflectance`: there is no texture `t` before it",
        ),
        (
            "Material \"diffuse\" \"rgb reflectance\" [1 0]",
            "`reflectance`: expected 3 numbers, found 2",
        ),
        (
            "Material \"diffuse\" \"spectrum reflectance\" [500 1]",
            "two or more samples",
        ),
        (
            "Material \"diffuse\" \"spectrum reflectance\" \"no.spd\"",
            "there is no file `no.spd`, and no spectrum of the name",
        ),
        (
            "Material \"mix\" \"string materials\" [\"a\"]",
            "expected two names, found 1",
        ),
        ("Texture \"a\" \"spectrum\" \"stripes\"", "unknown class `stripes`"),
        (
            "Texture \"a\" \"spectra\" \"scale\"",
            "unknown type `spectra`; did you mean `spectrum`?",
        ),
        ("Texture \"a\" \"float\" \"imagemap\"", "`filename`: it is missing"),
        ("LightSource \"sun\"", "LightSource \"sun\": unknown type `sun`"),
        ("LightSource \"point\" \"blackbody I\" 5", "5 K is out of range"),
        ("AreaLightSource \"area1\"", "unknown type `area1`"),
        ("Film \"rgb\" \"float iso\" 0", "`iso`: 0 is out of range"),
        (
            "Camera \"perspective\" \"float shutterclose\" 0",
            "the picture would be black",
        ),
        (
            "\nAttributeBegin\nTransformBegin\nAttributeEnd",
            "main.pbrt:4: AttributeEnd: what ends here is TransformBegin of main.pbrt:3",
        ),
        ("ObjectInstance \"a\"", "no object of the name has been defined"),
        (
            "ObjectBegin \"a\" ObjectBegin \"b\" ObjectEnd ObjectEnd",
            "an object cannot begin in another",
        ),
        (
            "Attribute \"shapes\" \"float radius\" 1",
            "Attribute: unknown name `shapes`; did you mean `shape`?",
        ),
        ("ColorSpace \"rgb\"", "ColorSpace: unknown name `rgb`"),
        ("ActiveTransform Never", "expected one of All, StartTime, EndTime"),
        ("TransformTimes 1 1", "the second time is not after the first"),
        ("Include \"no.pbrt\"", "file `no.pbrt` was not found"),
    ] {
        let found = faults_of(text);
        assert!(found.iter().any(|fault| fault.contains(expected)), "{text}: {found:?}");
        assert!(
            found.iter().all(|fault| fault.starts_with("main.pbrt")),
            "{text}: {found:?}"
        );
    }
}

#[test]
fn several_faults_are_told_together() {
    let text = "WorldBegin\nShape \"cube\"\nMaterial \"wood\"\nLightSource \"sun\"\nNamedMaterial \"x\"";
    let lines: Vec<String> = faults_of(text).iter().map(|fault| fault[..11].to_owned()).collect();
    assert_eq!(lines, ["main.pbrt:2", "main.pbrt:4", "main.pbrt:5"]);
}

#[test]
fn what_is_not_known_is_warned_about() {
    let (_, warnings) = describe_with(
        "WorldBegin MakeNamedMedium \"fog\" \"string type\" \"homogeneous\" \"string preset\" \"mud\"\nShape \"sphere\" \"float radios\" 2\nShape \"nurbs\" \"point3 P\" [0 0 0]
        LightSource \"point\" \"float brightness\" 2",
        &[],
    );
    for expected in [
        "main.pbrt:1: MakeNamedMedium \"fog\" `preset`: there is no such substance",
        "main.pbrt:2: Shape \"sphere\": parameter \"float radios\" is not known here and left out; did you mean `radius`?",
        "main.pbrt:3: Shape \"nurbs\": this type does not exist here: the shape is left out",
        "main.pbrt:4: LightSource \"point\": parameter \"float brightness\" is not known here",
    ] {
        assert!(
            warnings.iter().any(|warning| warning.starts_with(expected)),
            "{expected}: {warnings:?}"
        );
    }
}

/// What pbrt takes with a warning, or other programs that read its files have of their own.
#[test]
fn what_can_be_rendered_otherwise_is_warned_about() {
    for (text, expected) in [
        (
            "Material \"difuse\"",
            "Material \"difuse\": there is no type `difuse`: it is rendered as `diffuse` of reflectance 0.5; did you mean `diffuse`?",
        ),
        (
            "Material \"diffuse\" \"rgb reflectance\" [1 2 3]",
            "`reflectance`: [1.0, 2.0, 3.0] is above 1: what is above 1 counts as 1",
        ),
        (
            "Camera \"omni\" \"string lensfile\" \"x/dgauss.22deg.3.0mm_aperture0.6.json\" \"float filmdistance\" 0.2",
            "Camera \"omni\": there are perspective, orthographic, spherical and realistic: it is rendered as `perspective`",
        ),
        ("AttributeEnd", "AttributeEnd: there is no AttributeBegin before it"),
        (
            "WorldBegin\nAttributeBegin",
            "main.pbrt:2: AttributeBegin: the scene ends before it does",
        ),
        (
            "ObjectBegin \"a\" ObjectEnd ObjectBegin \"a\" Shape \"sphere\" ObjectEnd ObjectInstance \"a\"",
            "ObjectBegin \"a\": it takes the place of an object of the name",
        ),
        (
            "AreaLightSource \"diffuse\" Shape \"sphere\" \"float alpha\" 0",
            "`alpha`: the lamp is seen",
        ),
        (
            "Shape \"curve\" \"point3 P\" [0 0 0 0 0 0 0 0 0 0 0 0] \"string type\" \"cylinder\"",
            "Shape \"curve\": it has no length and is left out",
        ),
        (
            "Volume \"homogeneous\" \"color sigma_a\" [1 1 1]",
            "Volume: volumes of pbrt-v2 are left out",
        ),
    ] {
        let (_, warnings) = describe_with(text, &[]);
        assert!(
            warnings.iter().any(|warning| warning.contains(expected)),
            "{text}: {warnings:?}"
        );
    }
    let (_, warnings) = describe_with(
        "Renderer \"sampler\" VolumeIntegrator \"emission\" SurfaceIntegrator \"path\"
        LookAt 0, 1, 2 0, 0, 0 0, 1, 0 PixelFilter \"box\" \"float xwidth\" .5 \"float ywidth\" .5 Camera \"perspective\"",
        &[],
    );
    assert!(warnings.is_empty(), "{warnings:?}");
}

#[test]
fn what_has_no_end_is_bounded() {
    let others: [(&str, &[u8]); 1] = [("a.pbrt", b"\nInclude \"a.pbrt\"")];
    let faults = load_with("Include \"a.pbrt\"", &others).unwrap_err();
    assert!(
        faults
            .to_string()
            .contains("a.pbrt:2: <include>: the files include each other"),
        "{faults}"
    );
    let limited = |text: &str, limits: Limits, others: &[(&str, &[u8])]| {
        let faults = Scene::load(&files(text, others), "main.pbrt", &BTreeMap::new(), &limits).unwrap_err();
        faults.to_string()
    };
    let deep = "AttributeBegin ".repeat(65);
    assert!(limited(&deep, Limits::default(), &[]).contains("nesting of attributes: 65 is over the limit of 64"));
    let limits = Limits {
        includes: 3,
        ..Limits::default()
    };
    let often = "Include \"b.pbrt\" ".repeat(4);
    assert!(
        limited(&often, limits, &[("b.pbrt", b"Identity")])
            .contains("number of included files: 4 is over the limit of 3")
    );
    let limits = Limits {
        total_bytes: 100,
        ..Limits::default()
    };
    let content = " ".repeat(40);
    let text = "Include \"b.pbrt\" ".repeat(2);
    assert!(
        limited(&text, limits, &[("b.pbrt", content.as_bytes())])
            .contains("bytes of scene files, repetitions included")
    );
    let limits = Limits {
        shapes: 2,
        ..Limits::default()
    };
    let many = "Shape \"sphere\" ".repeat(3);
    assert!(limited(&many, limits, &[]).contains("number of shapes: 3 is over the limit of 2"));
    let limits = Limits {
        triangles: 2000,
        ..Limits::default()
    };
    let hair = "Shape \"curve\" \"point3 P\" [0 0 0 1 0 0 1 1 0 1 1 1] \"float width\" 0.01 ".repeat(9);
    assert!(limited(&hair, limits, &[]).contains("number of triangles of the scene"));
    let many = "Attribute \"shape\" \"float radius\" 1 ".repeat(300);
    assert!(limited(&many, Limits::default(), &[]).contains("number of attributes: 257"));
    let subdivided =
        "Shape \"loopsubdiv\" \"integer levels\" 16 \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2]";
    assert!(limited(subdivided, Limits::default(), &[]).contains("number of triangles after subdivision"));
}

//! Materials, textures and shapes.

use super::{Object, describe, describe_with, load, load_with};
use crate::material::ior;
use crate::scene::description::{Description, Kind, Value};
use flate2::{Compression, write::GzEncoder};
use glam::DVec3;
use std::io::Write;

/// What `Material` makes of parameters, below the wrapping for two sides.
fn material(described: &Description) -> &Object {
    let shape = described
        .objects
        .iter()
        .find(|object| object.kind == Kind::Shape)
        .expect("a shape");
    let bsdf = described.child(shape, None);
    match bsdf.plugin.as_str() {
        "twosided" => described.child(bsdf, None),
        _ => bsdf,
    }
}

fn described(kind: &str, parameters: &str) -> Description {
    describe(&format!("WorldBegin Material \"{kind}\" {parameters} Shape \"sphere\""))
}

#[test]
fn each_material_has_its_counterpart() {
    for (kind, parameters, plugin, two_sided) in [
        ("diffuse", "", "diffuse", true),
        ("conductor", "", "conductor", true),
        ("conductor", "\"float roughness\" 0.1", "roughconductor", true),
        ("dielectric", "", "dielectric", false),
        ("dielectric", "\"float roughness\" 0.1", "roughdielectric", false),
        ("thindielectric", "", "thindielectric", false),
        ("coateddiffuse", "", "plastic", true),
        ("coateddiffuse", "\"float roughness\" 0.1", "roughplastic", true),
        ("coatedconductor", "", "coating", true),
        (
            "coatedconductor",
            "\"float interface.roughness\" 0.1",
            "roughcoating",
            true,
        ),
        ("diffusetransmission", "", "difftrans", false),
        ("interface", "", "null", false),
        ("", "", "null", false),
        ("hair", "\"float eumelanin\" 1.3", "diffuse", true),
        ("measured", "\"string filename\" \"a.bsdf\"", "diffuse", true),
        ("subsurface", "\"string name\" \"Skin1\"", "plastic", true),
        ("matte", "\"rgb Kd\" [1 0 0]", "diffuse", true),
        ("matte", "\"float sigma\" 20", "roughdiffuse", true),
        ("plastic", "", "pbrtplastic", true),
        ("plastic", "\"rgb Ks\" [0 0 0]", "diffuse", true),
        ("substrate", "\"color Ks\" [1 1 1]", "pbrtsubstrate", true),
        ("uber", "", "pbrtplastic", true),
        ("uber", "\"rgb opacity\" [0.5 0.5 0.5]", "mask", false),
        ("metal", "", "roughconductor", true),
        ("mirror", "", "conductor", true),
        ("glass", "\"rgb Kr\" [1 1 1] \"float index\" 1.3", "dielectric", false),
        ("translucent", "", "difftrans", false),
        ("disney", "\"float metallic\" 1", "principled", false),
    ] {
        let text = format!("WorldBegin Material \"{kind}\" {parameters} Shape \"sphere\"");
        let (described, warnings) = describe_with(&text, &[]);
        assert_eq!(material(&described).plugin, plugin, "{kind} {parameters}");
        let wrapped = described.objects.iter().any(|object| object.plugin == "twosided");
        assert!(wrapped == two_sided || plugin == "mask", "{kind} {parameters}");
        assert!(
            warnings.iter().all(|warning| !warning.contains("not known here")),
            "{warnings:?}"
        );
    }
}

/// The width of the distribution is the root of the roughness, unless the file says that it is the roughness.
#[test]
fn roughness_is_mapped() {
    let alpha = |kind: &str, parameters: &str, name: &str| material(&described(kind, parameters)).number(name);
    assert_eq!(alpha("conductor", "\"float roughness\" 0.25", "alpha"), 0.5);
    assert_eq!(
        alpha(
            "conductor",
            "\"float roughness\" 0.25 \"bool remaproughness\" false",
            "alpha"
        ),
        0.25
    );
    assert_eq!(
        alpha(
            "conductor",
            "\"float roughness\" 0.25 \"bool remaproughness\" [\"false\"]",
            "alpha"
        ),
        0.25
    );
    let axes = "\"float uroughness\" 0.04 \"float vroughness\" 0.25";
    assert_eq!(
        [alpha("conductor", axes, "alpha_u"), alpha("conductor", axes, "alpha_v")],
        [0.2, 0.5]
    );
    assert_eq!(material(&described("conductor", axes)).text("distribution"), "ggx");
    // Roughness 0.1 of pbrt-v3 has the width of its polynomial.
    assert!((alpha("metal", "\"float roughness\" 0.1", "alpha") - 0.461_76).abs() < 1e-5);
    // There 0 is not smooth, unless it is glass.
    assert!((alpha("metal", "\"float roughness\" 0", "alpha") - 0.047).abs() < 1e-3);
    assert_eq!(
        material(&described("glass", "\"float uroughness\" 0")).plugin,
        "dielectric"
    );
    // Textures are mapped as numbers are.
    let textured = describe(
        "WorldBegin Texture \"t\" \"float\" \"fbm\" Material \"conductor\" \"texture roughness\" \"t\" Shape \"sphere\"",
    );
    let curve = textured.child(material(&textured), Some("alpha"));
    assert_eq!((curve.plugin.as_str(), curve.text("curve")), ("curve", "root"));
    assert_eq!(textured.child(curve, Some("tex")).plugin, "fbm");
    // What is smoother than a thousandth is smooth.
    let smooth = described("conductor", "\"float roughness\" 0.0009 \"bool remaproughness\" false");
    assert_eq!(material(&smooth).plugin, "conductor");
}

#[test]
fn optical_constants() {
    let copper = ior::conductor("Cu").unwrap().0.to_rgb().map(f64::from);
    assert_eq!(material(&described("conductor", "")).rgb("eta"), copper);
    let gold = ior::conductor("Au").unwrap().1.to_rgb().map(f64::from);
    let text = "\"spectrum eta\" \"metal-Au-eta\" \"spectrum k\" [\"metal-Au-k\"]";
    assert_eq!(material(&described("conductor", text)).rgb("k"), gold);
    let glass = described("dielectric", "\"spectrum eta\" \"glass-BK7\"");
    assert_eq!(
        (material(&glass).number("int_ior"), material(&glass).number("ext_ior")),
        (1.5168, 1.0)
    );
    assert_eq!(material(&described("dielectric", "")).number("int_ior"), 1.5);
    assert_eq!(
        material(&described("dielectric", "\"float eta\" 1.33")).number("int_ior"),
        1.33
    );
    // A conductor of a reflectance: (k^2) / (4 + k^2) at a right angle.
    let metal = described("conductor", "\"rgb reflectance\" [0.5 0.9 0]");
    let [r, g, b] = material(&metal).rgb("k").map(|k| k * k / (4.0 + k * k));
    assert!(
        (r - 0.5).abs() < 1e-6 && (g - 0.9).abs() < 1e-6 && b == 0.0,
        "{r} {g} {b}"
    );
    let coated = described("coatedconductor", "\"float interface.eta\" 2");
    let metal = coated.the(Kind::Bsdf, "conductor");
    assert_eq!(metal.rgb("eta"), copper.map(|eta| eta / 2.0), "under the coat");
}

#[test]
fn colours_of_surfaces() {
    let reflectance = |parameters: &str| material(&described("diffuse", parameters)).rgb("reflectance");
    assert_eq!(reflectance("\"rgb reflectance\" [0.1 0.2 0.3]"), [0.1, 0.2, 0.3]);
    let grey = reflectance("\"spectrum reflectance\" [300 0.5 900 0.5]");
    assert!(grey.iter().all(|channel| (channel - 0.5).abs() < 5e-3), "{grey:?}");
    let spd: (&str, &[u8]) = ("a.spd", b"# wavelength value\n300 0.25\n900 0.25\n");
    let text = "WorldBegin Material \"diffuse\" \"spectrum reflectance\" \"a.spd\" Shape \"sphere\"";
    let (described, _) = describe_with(text, &[spd]);
    let grey = material(&described).rgb("reflectance");
    assert!(grey.iter().all(|channel| (channel - 0.25).abs() < 5e-3), "{grey:?}");
    let wide = "WorldBegin ColorSpace \"rec2020\" Material \"diffuse\" \"rgb reflectance\" [1 1 1] Shape \"sphere\"";
    let white = material(&describe(wide)).rgb("reflectance");
    assert!(white.iter().all(|channel| (channel - 1.0).abs() < 1e-6), "{white:?}");
    assert_eq!(
        material(&describe("WorldBegin Shape \"sphere\"")).plugin,
        "diffuse",
        "without a material"
    );
}

#[test]
fn materials_by_name_mixed_bumped_and_cut_out() {
    let text = "WorldBegin
        MakeNamedMaterial \"a\" \"string type\" \"dielectric\"
        MakeNamedMaterial \"b\" \"string type\" [\"diffuse\"] \"rgb reflectance\" [1 0 0]
        MakeNamedMaterial \"c\" \"string type\" \"mix\" \"string materials\" [\"a\" \"b\"] \"float amount\" 0.25
        Texture \"bumps\" \"float\" \"fbm\" \"integer octaves\" 3
        Texture \"holes\" \"float\" \"checkerboard\"
        AttributeBegin NamedMaterial \"a\" AttributeEnd
        NamedMaterial \"c\" Shape \"disk\"
        Material \"diffuse\" \"texture displacement\" \"bumps\" Shape \"sphere\" \"texture alpha\" \"holes\"
        Material \"diffuse\" \"string normalmap\" \"n.png\" Shape \"cylinder\" \"float alpha\" 0.5";
    let described = describe(text);
    let mix = described.child(described.the(Kind::Shape, "disk"), None);
    assert_eq!((mix.plugin.as_str(), mix.number("weight")), ("blendbsdf", 0.25));
    let parts: Vec<_> = mix
        .children
        .iter()
        .map(|child| &*described.objects[child.target].plugin)
        .collect();
    assert_eq!(parts, ["dielectric", "twosided"]);
    let masks: Vec<&Object> = described
        .objects
        .iter()
        .filter(|object| object.plugin == "mask")
        .collect();
    let mask = masks[0];
    assert_eq!(described.child(mask, Some("opacity")).plugin, "checkerboard");
    let bump = described.child(mask, None);
    let inner: Vec<_> = bump
        .children
        .iter()
        .map(|child| &*described.objects[child.target].plugin)
        .collect();
    assert_eq!(
        (bump.plugin.as_str(), inner, bump.number("scale")),
        ("bumpmap", vec!["fbm", "twosided"], 1.0)
    );
    let mask = masks[1];
    assert_eq!(mask.number("opacity"), 0.5);
    let map = described.child(mask, None);
    let image = described.child(map, Some("normalmap"));
    assert!(map.plugin == "normalmap" && image.is_set("raw") && image.text("filename") == "n.png");
}

/// Textures that are the same everywhere are colours and numbers.
#[test]
fn constant_textures_are_folded() {
    let text = |reflectance: &str| {
        format!(
            "WorldBegin Texture \"a\" \"spectrum\" \"constant\" \"rgb value\" [0.2 0.4 0.8]
            Texture \"f\" \"float\" \"constant\" \"float value\" 0.5
            Texture \"b\" \"spectrum\" \"scale\" \"texture tex\" \"a\" \"texture scale\" \"f\"
            Texture \"old\" \"color\" \"scale\" \"texture tex1\" \"a\" \"rgb tex2\" [1 0.5 0.5]
            Texture \"m\" \"spectrum\" \"mix\" \"texture tex1\" \"a\" \"rgb tex2\" [1 1 1] \"float amount\" 0.5
            Texture \"i\" \"spectrum\" \"imagemap\" \"string filename\" \"a.png\" \"bool invert\" true \"float scale\" 0.5
            Texture \"s\" \"spectrum\" \"scale\" \"texture tex\" \"i\" \"float scale\" 0.5
            Material \"diffuse\" \"texture reflectance\" \"{reflectance}\" Shape \"sphere\""
        )
    };
    let near = |name: &str, expected: [f64; 3]| {
        let rgb = material(&describe(&text(name))).rgb("reflectance");
        assert!(
            rgb.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6),
            "{name}: {rgb:?}"
        );
    };
    near("a", [0.2, 0.4, 0.8]);
    near("b", [0.1, 0.2, 0.4]);
    near("old", [0.2, 0.2, 0.4]);
    near("m", [0.6, 0.7, 0.9]);
    let described = describe(&text("s"));
    let scale = described.child(material(&described), Some("reflectance"));
    assert_eq!((scale.plugin.as_str(), scale.number("scale")), ("scale", 0.5));
    let inner = described.child(scale, Some("tex"));
    assert_eq!((inner.plugin.as_str(), inner.number("scale")), ("scale", 0.5));
    assert!(described.child(inner, Some("tex")).is_set("invert"));
}

/// Where a texture's coordinates lie for u and v of the surface.
fn place(texture: &Object, u: f64, v: f64) -> [f64; 2] {
    let Value::Transform(to_uv) = texture.value("to_uv") else {
        panic!("to_uv is a transform");
    };
    let [x, y, _] = to_uv.matrix().transform_point3(DVec3::new(u, v, 0.0)).to_array();
    [x, y]
}

#[test]
fn textures_lie_on_surfaces_as_in_pbrt() {
    let texture = |class: &str, parameters: &str| {
        let text = format!(
            "WorldBegin Translate 1 2 3 Texture \"t\" \"spectrum\" \"{class}\" {parameters}
            Material \"diffuse\" \"texture reflectance\" \"t\" Shape \"sphere\""
        );
        describe(&text)
    };
    let of = |described: &Description| -> usize {
        described
            .objects
            .iter()
            .position(|object| object.kind == Kind::Texture)
            .expect("a texture")
    };
    // v runs up the image in pbrt.
    let map = texture(
        "imagemap",
        "\"string filename\" \"a.png\" \"float uscale\" 2 \"float vscale\" 3 \"float vdelta\" 0.25",
    );
    assert_eq!(place(&map.objects[of(&map)], 0.25, 0.25), [0.5, 0.0]);
    // Squares of side 1, and ours of side 1/2.
    let board = texture(
        "checkerboard",
        "\"float uscale\" 4 \"rgb tex1\" [1 0 0] \"rgb tex2\" [0 0 1]",
    );
    let board = &board.objects[of(&board)];
    assert_eq!(place(board, 0.5, 1.0), [1.0, 0.5]);
    assert_eq!(
        (board.rgb("color0"), board.rgb("color1")),
        ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    );
    let solid = texture("checkerboard", "\"integer dimension\" 3");
    assert_eq!(solid.objects[of(&solid)].number("dimension"), 3.0);
    let planar = texture("dots", "\"string mapping\" \"planar\" \"vector3 v1\" [0 0 2]");
    let planar = &planar.objects[of(&planar)];
    assert!(planar.text("mapping") == "planar" && matches!(planar.value("v1"), Value::Vector(v) if v.z == 2.0));
    assert_eq!(planar.corners()[0], DVec3::new(1.0, 2.0, 3.0));
    let marble = texture("marble", "\"float variation\" 0.3");
    let marble = &marble.objects[of(&marble)];
    assert_eq!(
        (
            marble.number("octaves"),
            marble.number("roughness"),
            marble.number("variation")
        ),
        (8.0, 0.5, 0.3)
    );
    assert_eq!(marble.corners()[0], DVec3::new(1.0, 2.0, 3.0));
    for (class, plugin) in [
        ("fbm", "fbm"),
        ("wrinkled", "wrinkled"),
        ("windy", "windy"),
        ("directionmix", "directionmix"),
    ] {
        let described = texture(class, "");
        assert_eq!(described.objects[of(&described)].plugin, plugin);
    }
    let corners = texture("bilerp", "\"rgb v10\" [1 0 0] \"float udelta\" 0.5");
    let corners = &corners.objects[of(&corners)];
    assert_eq!((corners.rgb("v10"), corners.number("v11")), ([1.0, 0.0, 0.0], 1.0));
    assert_eq!(place(corners, 0.25, 0.25), [0.75, 0.25]);
    let unit = texture("uv", "");
    assert!(unit.objects[of(&unit)].is_set("repeats"));
    for (parameters, name, set) in [
        ("\"string encoding\" \"linear\"", "raw", true),
        ("\"bool gamma\" \"false\"", "raw", true),
        ("\"string encoding\" \"sRGB\"", "raw", false),
    ] {
        let map = texture("imagemap", &format!("\"string filename\" \"a.png\" {parameters}"));
        assert_eq!(map.objects[of(&map)].is_set(name), set, "{parameters}");
    }
}

/// A triangle with a normal that the file gives, or without.
fn ply(normals: bool) -> Vec<u8> {
    let (properties, values) = match normals {
        true => ("property float nx\nproperty float ny\nproperty float nz\n", " 0 0 1"),
        false => ("", ""),
    };
    let vertices: String = ["0 0 0", "1 0 0", "0 1 0"]
        .map(|vertex| format!("{vertex}{values}\n"))
        .concat();
    format!(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{properties}element face 1\n\
         property list uchar int vertex_indices\nend_header\n{vertices}3 0 1 2\n"
    )
    .into_bytes()
}

#[test]
fn mesh_files_are_flat_without_normals_and_may_be_packed() {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(&ply(true)).unwrap();
    let packed = encoder.finish().unwrap();
    let (smooth, flat) = (ply(true), ply(false));
    let others: [(&str, &[u8]); 3] = [("s.ply", &smooth), ("f.ply", &flat), ("p.ply.gz", &packed)];
    let text = "WorldBegin LightSource \"infinite\" Shape \"plymesh\" \"string filename\" \"s.ply\"
        Shape \"plymesh\" \"string filename\" \"f.ply\" Shape \"plymesh\" \"string filename\" \"p.ply.gz\"";
    let (described, _) = describe_with(text, &others);
    let flat: Vec<bool> = described
        .objects
        .iter()
        .filter(|o| o.plugin == "ply")
        .map(|o| o.is_set("face_normals"))
        .collect();
    assert_eq!(flat, [false, true, false]);
    let scene = load_with(text, &others).unwrap();
    assert_eq!(scene.bindings.len(), 3);
}

#[test]
fn meshes_in_the_file() {
    let mesh = |shape: &str| {
        let described = describe(&format!("WorldBegin Shape {shape}"));
        match described.the(Kind::Shape, "mesh").value("mesh") {
            Value::Mesh(mesh) => mesh.get(),
            other => panic!("{other:?}"),
        }
    };
    let square =
        "\"point3 P\" [0 0 0 1 0 0 1 1 0 0 1 0] \"integer indices\" [0 1 2 0 2 3] \"point2 uv\" [0 0 1 0 1 1 0 1]";
    let found = mesh(&format!(
        "\"trianglemesh\" {square} \"normal N\" [0 0 2 0 0 2 0 0 2 0 0 2]"
    ));
    assert_eq!(found.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(
        (
            found.positions.len(),
            found.uvs[2].to_array(),
            found.normals[3].to_array()
        ),
        (4, [1.0, 1.0], [0.0, 0.0, 1.0])
    );
    let found =
        mesh("\"loopsubdiv\" \"integer levels\" 2 \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2]");
    assert_eq!(found.triangles.len(), 16);
    let found = mesh("\"bilinearmesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0 1 1 0] \"point2 uv\" [0 0 2 0 0 2 2 2]");
    assert_eq!((found.triangles.len(), found.uvs[3].to_array()), (2, [2.0, 2.0]));
    // The mantle of a cylinder: its area, by the angle that it goes about.
    let found = mesh("\"cylinder\" \"float radius\" 2 \"float zmin\" 0 \"float zmax\" 3 \"float phimax\" 90");
    let inside = |p: &crate::math::Vec3| {
        p.x > -1e-6 && p.y > -1e-6 && (0.0..=3.0).contains(&p.z) && (p.truncate().length() - 2.0).abs() < 1e-5
    };
    assert!(found.positions.iter().all(inside));
    let cut = mesh("\"sphere\" \"float radius\" 2 \"float zmin\" 1");
    assert!(
        cut.positions
            .iter()
            .all(|p| p.z > 0.999 && (p.length() - 2.0).abs() < 1e-5)
    );
    // A straight line about the axis is a cylinder's, an oblique one reaches its waist in the middle.
    let found = mesh("\"hyperboloid\" \"point3 p1\" [2 0 0] \"point3 p2\" [2 0 3] \"float phimax\" 90");
    assert!(
        found.positions.iter().all(inside)
            && found
                .normals
                .iter()
                .zip(&found.positions)
                .all(|(n, p)| n.dot(*p) > 1.99)
    );
    let found = mesh("\"hyperboloid\" \"point3 p1\" [1 -1 -1] \"point3 p2\" [1 1 1]");
    let on_it = |p: &crate::math::Vec3| (p.truncate().length_squared() - 1.0 - p.z * p.z).abs() < 1e-5;
    assert!(found.positions.iter().all(on_it));
    let found = mesh("\"heightfield\" \"integer nu\" 3 \"integer nv\" 2 \"float Pz\" [0 1 2 3 4 5]");
    assert_eq!(
        (found.positions[4].to_array(), found.triangles.len()),
        ([0.5, 1.0, 4.0], 4)
    );
    assert_eq!(found.triangles[0], [0, 1, 4]);
    let ring = mesh("\"disk\" \"float radius\" 2 \"float innerradius\" 1 \"float height\" 5");
    assert!(
        ring.positions
            .iter()
            .all(|p| p.z == 5.0 && p.truncate().length() > 0.999)
    );
}

/// Curves that follow each other and are alike make one mesh; what is between them does not matter.
#[test]
fn curves_are_tubes() {
    let curve = |points: &str, more: &str| {
        format!("Shape \"curve\" \"string type\" \"cylinder\" \"point3 P\" [{points}] {more} ")
    };
    let straight = "0 0 0 0 0 1 0 0 2 0 0 3";
    let text = format!(
        "WorldBegin {} Shape \"sphere\" {} AttributeBegin Translate 5 0 0 {} AttributeEnd {}",
        curve(straight, "\"float width\" 0.5"),
        curve(straight, "\"float width0\" 0.5 \"float width1\" 0.1"),
        curve("0 0 0 0 0 1 0 0 2", "\"integer degree\" 2"),
        curve("0 0 0 0 0 3 0 0 6 0 0 9 0 0 12", "\"string basis\" \"bspline\""),
    );
    let (described, warnings) = describe_with(&text, &[]);
    assert!(warnings.is_empty(), "{warnings:?}");
    let meshes: Vec<_> = described
        .objects
        .iter()
        .filter_map(
            |object| match object.properties.get("mesh").map(|property| &property.value) {
                Some(Value::Mesh(mesh)) => Some(mesh.get()),
                _ => None,
            },
        )
        .collect();
    assert_eq!(meshes.len(), 3);
    let reach = |mesh: &crate::scene::mesh::RawMesh, wide: std::ops::RangeInclusive<f32>, z: [f32; 2]| {
        let (mut lower, mut upper) = (f32::MAX, f32::MIN);
        for p in &mesh.positions {
            assert!(wide.contains(&p.truncate().length()), "{p}");
            (lower, upper) = (lower.min(p.z), upper.max(p.z));
        }
        assert!(
            (lower - z[0]).abs() < 1e-6 && (upper - z[1]).abs() < 1e-6,
            "{lower} {upper}"
        );
    };
    // The first two, of half the width, which sinks to a tenth of it.
    reach(&meshes[0], 0.049..=0.2505, [0.0, 3.0]);
    reach(&meshes[1], 0.499..=0.501, [0.0, 2.0]);
    reach(&meshes[2], 0.499..=0.501, [3.0, 9.0]);
    let flat = describe_with("WorldBegin Shape \"curve\" \"point3 P\" [0 0 0 0 0 1 0 0 2 0 0 3]", &[]).1;
    assert!(flat.len() == 1 && flat[0].contains("rendered as tubes"), "{flat:?}");
    let lit = describe(&format!(
        "WorldBegin AreaLightSource \"diffuse\" {0} {0}",
        curve(straight, "")
    ));
    assert_eq!(lit.child(lit.the(Kind::Shape, "mesh"), None).kind, Kind::Bsdf);
    assert_eq!(lit.the(Kind::Emitter, "area").kind, Kind::Emitter);
}

/// pbrt's own coordinates on a sphere count for textures, which ours has otherwise.
#[test]
fn textured_spheres_are_meshes_with_the_coordinates_of_pbrt() {
    let text = "WorldBegin Texture \"t\" \"spectrum\" \"checkerboard\" Material \"diffuse\" \"texture reflectance\" \"t\" Shape \"sphere\"";
    let described = describe(text);
    let Value::Mesh(mesh) = described.the(Kind::Shape, "mesh").value("mesh") else {
        panic!("a mesh");
    };
    let mesh = mesh.get();
    for (p, uv) in mesh.positions.iter().zip(&mesh.uvs) {
        // v goes from the lower pole up, u from +x towards +y.
        let z = -f64::from(uv.y * std::f32::consts::PI).cos();
        assert!((f64::from(p.z) - z).abs() < 1e-5, "{p} {uv}");
        if uv.x == 0.25 {
            assert!(p.x.abs() < 1e-6 && p.y >= -1e-6, "{p} {uv}");
        }
    }
}

/// Every directive of a scene is taken, and nothing is left out in silence.
#[test]
fn a_scene_of_all_directives_loads() {
    let text = "
        Option \"string rendercoordsys\" \"cameraworld\" Option \"seed\" 7 ColorSpace \"srgb\"
        LookAt 0 0 -5  0 0 0  0 1 0 Scale 1 1 1 Rotate 0 0 0 1 Translate 0 0 0
        Camera \"perspective\" \"float fov\" 45 Sampler \"zsobol\" \"integer pixelsamples\" 2
        Film \"rgb\" \"integer xresolution\" [16] \"integer yresolution\" [16] \"string filename\" \"out.exr\"
        PixelFilter \"box\" Integrator \"volpath\" \"bool regularize\" true Accelerator \"bvh\"
        TransformTimes 0 1 ActiveTransform All MakeNamedMedium \"fog\" \"string type\" \"homogeneous\"
        WorldBegin CoordinateSystem \"a\" CoordSysTransform \"a\" MediumInterface \"\" \"\"
        AttributeBegin ReverseOrientation ReverseOrientation Attribute \"shape\" \"float radius\" 2 AttributeEnd
        TransformBegin Identity ConcatTransform [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1] TransformEnd
        LightSource \"point\" \"rgb I\" [1 1 1] \"point3 from\" [0 5 0] Material \"diffuse\" Shape \"sphere\"";
    let scene = load(text);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
}

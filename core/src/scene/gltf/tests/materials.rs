//! Materials and their textures.

use super::*;

#[test]
fn colours_of_vertices_are_linear_and_multiply_the_base_colour() {
    let coloured = [
        (r#""POSITION": 0"#, r#""POSITION": 0, "COLOR_0": 2"#),
        (
            r#""count": 3, "type": "SCALAR"}"#,
            r#""count": 3, "type": "SCALAR"},
{"bufferView": 2, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC4"}"#,
        ),
        (
            r#""componentType": 5126, "count": 5"#,
            r#""componentType": 5126, "count": 3"#,
        ),
    ];
    let scene = described(&coloured).unwrap();
    let attribute = &scene.mesh(0).attributes[0];
    assert_eq!(attribute.name, "vertex_color");
    let first = attribute.values[0].to_rgb();
    assert_eq!(first, [1.0, 128.0 / 255.0, 0.0]);
    let textures: Vec<&str> = scene
        .all(Kind::Texture)
        .iter()
        .map(|texture| texture.plugin.as_str())
        .collect();
    assert_eq!(textures, ["mesh_attribute", "scale"]);
}

/// Plugins by the material: clear glass and smooth metal have their own.
#[test]
fn materials_become_the_plugins_that_are_made_for_them() {
    let plugins = |changes: &str, extensions: &str| {
        let material = format!(r#"{{"name": "Paint", {extensions} "pbrMetallicRoughness": {{{changes}}}}}"#);
        let found = described(&[(
            r#"{"name": "Paint", "pbrMetallicRoughness": {"metallicFactor": 0}}"#,
            &material,
        )]);
        let found = found.unwrap();
        let mut names: Vec<String> = found.all(Kind::Bsdf).iter().map(|bsdf| bsdf.plugin.clone()).collect();
        names.extend(found.all(Kind::Emitter).iter().map(|emitter| emitter.plugin.clone()));
        names.join(" ")
    };
    let glass =
        r#""extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {}},"#;
    let pane = r#""extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}},"#;
    let matt = r#""extensions": {"KHR_materials_specular": {"specularFactor": 0}},"#;
    let unlit = r#""extensions": {"KHR_materials_unlit": {}},"#;
    for (changes, extensions, expected) in [
        (r#""metallicFactor": 0"#, "", "principled twosided"),
        ("", "", "principled twosided"),
        (r#""metallicFactor": 0"#, matt, "diffuse twosided"),
        (r#""roughnessFactor": 0"#, "", "conductor twosided"),
        (r#""metallicFactor": 0, "roughnessFactor": 0"#, glass, "dielectric"),
        (r#""metallicFactor": 0"#, glass, "roughdielectric"),
        (r#""metallicFactor": 0"#, pane, "principledthin"),
        ("", unlit, "diffuse twosided area"),
        ("", r#""emissiveFactor": [1, 0, 0],"#, "principled twosided area"),
        (
            r#""baseColorFactor": [1, 1, 1, 0.5]"#,
            r#""alphaMode": "BLEND","#,
            "principled twosided mask",
        ),
        (
            r#""baseColorFactor": [1, 1, 1, 0.5]"#,
            r#""alphaMode": "MASK","#,
            "principled twosided",
        ),
        (r#""baseColorFactor": [1, 1, 1, 0.5]"#, "", "principled twosided"),
    ] {
        assert_eq!(plugins(changes, extensions), expected, "{changes} {extensions}");
    }
}

/// The cutoff of MASK, and the scale of a normal texture, are worked into the image.
#[test]
fn masks_are_cut_and_normals_steepened_in_the_image() {
    let (files, main) = blender("textures");
    let json = String::from_utf8_lossy(&files[&main]).into_owned();
    assert!(json.contains(r#""alphaMode":"BLEND""#));
    let mut bytes = files[&main].clone();
    let at = json.find(r#""alphaMode":"BLEND""#).unwrap();
    bytes[at..at + 19].copy_from_slice(br#""alphaMode":"MASK" "#);
    let scene = Described::of(&BTreeMap::from([(main.clone(), bytes)]), &main, &[]).unwrap();
    let mask = scene
        .all(Kind::Bsdf)
        .into_iter()
        .find(|bsdf| bsdf.plugin == "mask")
        .unwrap();
    let opacity = mask
        .children
        .iter()
        .find(|child| child.name.as_deref() == Some("opacity"))
        .unwrap();
    let Value::File(file) = &scene.description.objects[opacity.target].properties["filename"].value else {
        panic!("{mask:?}");
    };
    // Blender's leaf is opaque in its middle and clear at its corners.
    let levels = image::load_from_memory(&file.bytes).unwrap().into_luma8();
    assert_eq!((levels.get_pixel(16, 16).0, levels.get_pixel(0, 0).0), ([255], [0]));
    let steeper = texture::Change::Steeper { scale: 2.0 };
    // A slope of 3/4 in x, and of 0 in y, becomes one of 3/2.
    let encoded = |c: f64| ((0.5 * c + 0.5) * 65535.0).round() as u16;
    let [x, y, z, _] = steeper.pixel([encoded(0.6), encoded(0.0), encoded(0.8), 9]);
    let length = libm::sqrt(1.5 * 1.5 + 1.0);
    let expected = [1.5 / length, 0.0, 1.0 / length].map(encoded);
    near(&[x, y, z].map(f64::from), &expected.map(f64::from), 2.0);
}

/// A turn of the coordinates is against the clock as the picture is seen: u' = c u + s v and v' = c v - s u, as Blender's importer and the
/// sample viewer of Khronos have it.
#[test]
fn texture_coordinates_are_scaled_turned_and_moved() {
    let transform = document::TextureTransform {
        offset: [0.25, 0.5],
        rotation: std::f64::consts::FRAC_PI_2,
        scale: [2.0, 3.0],
        tex_coord: None,
    };
    let map = texture::to_uv(&transform).unwrap();
    let at = map.point(Vec3::new(1.0, 1.0, 0.0));
    assert!((at - Vec3::new(3.25, -1.5, 0.0)).length() < 1e-6, "{at}");
}

/// The medium of a solid that lets light through and has a thickness, and what is warned about.
#[test]
fn volumes_fill_solids() {
    let of = |extensions: &str| {
        let material = format!(
            r#"{{"name": "Paint", "extensions": {{{extensions}}}, "pbrMetallicRoughness": {{"metallicFactor": 0}}}}"#
        );
        let plain = r#"{"name": "Paint", "pbrMetallicRoughness": {"metallicFactor": 0}}"#;
        described(&[(plain, &material)]).unwrap()
    };
    let clear = r#""KHR_materials_transmission": {"transmissionFactor": 1}"#;
    let volume = |thickness: f64| {
        format!(
            r#""KHR_materials_volume": {{"thicknessFactor": {thickness}, "attenuationDistance": 0.5, "attenuationColor": [0.25, 0.5, 1]}}"#
        )
    };
    let scatter = r#""KHR_materials_volume_scatter": {"multiscatterColor": [0, 0.5, 1], "scatterAnisotropy": 0.3}"#;
    let rgb = |object: &Object, name: &str| match object.properties[name].value {
        Value::Rgb(rgb) => rgb,
        ref other => panic!("{other:?}"),
    };
    for (extensions, albedo, phases) in [
        (format!("{clear}, {}", volume(0.1)), [0.0; 3], 0),
        (format!("{clear}, {}, {scatter}", volume(0.1)), [0.0, 0.911_709, 1.0], 1),
    ] {
        let found = of(&extensions);
        assert_eq!(found.warnings, Vec::<String>::new());
        let media = found.all(Kind::Medium);
        let sigma_t = [2.0 * 4.0_f64.ln(), 2.0 * 2.0_f64.ln(), 0.0];
        near(&rgb(media[0], "sigma_t"), &sigma_t, 1e-9);
        near(&rgb(media[0], "albedo"), &albedo, 1e-4);
        assert_eq!((media.len(), found.all(Kind::Phase).len()), (1, phases));
        let shape = found.all(Kind::Shape)[0];
        let inside = shape
            .children
            .iter()
            .filter(|child| child.name.as_deref() == Some("interior"));
        assert_eq!(inside.count(), 1);
        // The surface has its own colour alone.
        let glass = found.all(Kind::Bsdf)[0];
        assert_eq!(rgb(glass, "specular_transmittance"), [1.0; 3]);
    }
    for extensions in [
        clear.to_owned(),
        volume(0.1),
        format!("{clear}, {}", volume(0.0)),
        format!(r#"{clear}, "KHR_materials_volume": {{"thicknessFactor": 1}}"#),
    ] {
        let found = of(&extensions);
        assert!(found.all(Kind::Medium).is_empty(), "{extensions}");
        assert_eq!(found.warnings, Vec::<String>::new());
    }
    let alone = of(&format!("{clear}, {scatter}"));
    assert!(
        alone.warnings[0].contains("KHR_materials_volume_scatter is left out"),
        "{:?}",
        alone.warnings
    );
}

//! What the properties of BSDFs with many numbers become.

use super::{LIGHT, load, warnings};
use crate::material::{Highlight, Material, WardModel};
use crate::texture::Texture;

/// The material of a ball and what is warned about.
fn material(bsdf: &str) -> (Material, Vec<String>) {
    let body = format!("{LIGHT}<sensor type='perspective'/><shape type='sphere'>{bsdf}</shape>");
    let scene = load(&body, None).unwrap_or_else(|faults| panic!("{body}\n{faults}"));
    let index = scene.bindings[0].material as usize;
    (scene.materials[index].clone(), warnings(&scene))
}

fn fault(bsdf: &str) -> String {
    let body = format!("{LIGHT}<shape type='sphere'>{bsdf}</shape>");
    load(&body, None).map(|_| ()).unwrap_err().to_string()
}

fn numbers<const N: usize>(textures: [&Texture; N]) -> [f32; N] {
    textures.map(|texture| texture.mean()[0])
}

#[test]
fn principled_bodies_have_mitsubas_defaults_and_properties() {
    let (Material::Principled(body), warned) = material("<bsdf type='principled'/>") else {
        panic!("another material");
    };
    let first = numbers([&body.base_color, &body.roughness, &body.metallic, &body.clearcoat]);
    assert_eq!(first, [0.5, 0.5, 0.0, 0.0]);
    // Mitsuba 3.9.1: 2 / (1 - sqrt(0.08 * 0.5)) - 1.
    assert!(
        (body.eta - 1.5).abs() < 1e-6 && warned.is_empty(),
        "{body:?} {warned:?}"
    );
    let names = [
        "roughness",
        "anisotropic",
        "metallic",
        "spec_trans",
        "spec_tint",
        "sheen",
        "sheen_tint",
        "flatness",
        "clearcoat",
        "clearcoat_gloss",
    ];
    let properties: String = (1..)
        .zip(names)
        .map(|(i, name)| format!("<float name='{name}' value='{}'/>", f64::from(i) / 16.0))
        .collect();
    let xml = format!(
        "<bsdf type='principled'><rgb name='baseColor' value='0.1 0.2 0.3'/>{properties}<float name='eta' value='1.2'/>\
         <float name='main_specular_sampling_rate' value='2'/></bsdf>"
    );
    let (Material::Principled(body), warned) = material(&xml) else {
        panic!("another material");
    };
    let found = numbers([
        &body.roughness,
        &body.anisotropic,
        &body.metallic,
        &body.spec_trans,
        &body.spec_tint,
        &body.sheen,
        &body.sheen_tint,
        &body.flatness,
        &body.clearcoat,
        &body.clearcoat_gloss,
    ]);
    assert_eq!(found, std::array::from_fn(|i| (i + 1) as f32 / 16.0));
    assert_eq!((body.base_color.mean().to_rgb(), body.eta), ([0.1, 0.2, 0.3], 1.2));
    assert!(warned.is_empty(), "{warned:?}");
}

#[test]
fn the_index_of_a_principled_body_is_given_once_and_is_not_one() {
    let eta = |property: &str| match material(&format!("<bsdf type='principled'>{property}</bsdf>")).0 {
        Material::Principled(body) => body.eta,
        other => panic!("{other:?}"),
    };
    // Mitsuba 3.9.1 prints these.
    assert!((eta("<float name='specular' value='0'/>") - 1.018_05).abs() < 1e-5);
    assert_eq!(eta("<float name='eta' value='1'/>"), 1.001);
    let both = "<bsdf type='principled'><float name='eta' value='1.5'/><float name='specular' value='0.5'/></bsdf>";
    assert!(fault(both).contains("either `eta` or `specular`"), "{}", fault(both));
    let rough = "<bsdf type='principled'><float name='roughness' value='1.5'/></bsdf>";
    assert!(
        fault(rough).contains("`roughness`: 1.5 is out of range; allowed: 0 to 1"),
        "{}",
        fault(rough)
    );
}

#[test]
fn principled_sheets_halve_diff_trans() {
    let xml =
        "<bsdf type='principledthin'><float name='diff_trans' value='1.5'/><float name='eta' value='1.33'/></bsdf>";
    let (Material::PrincipledThin(sheet), warned) = material(xml) else {
        panic!("another material");
    };
    assert_eq!(
        numbers([&sheet.diff_trans, &sheet.eta, &sheet.spec_trans]),
        [0.75, 1.33, 0.0]
    );
    assert!(warned.is_empty(), "{warned:?}");
}

#[test]
fn two_sides_take_principled_bodies_that_do_not_transmit() {
    let both = |spec_trans: f32| {
        format!(
            "<bsdf type='twosided'><bsdf type='principled'><float name='spec_trans' value='{spec_trans}'/></bsdf></bsdf>"
        )
    };
    assert!(matches!(material(&both(0.0)).0, Material::TwoSided { .. }));
    assert!(fault(&both(0.5)).contains("a side must reflect only"));
}

#[test]
fn highlights_of_the_old_dialect() {
    let glossy = |bsdf: &str| match material(bsdf) {
        (Material::Glossy(surface), warned) => (surface, warned),
        other => panic!("{other:?}"),
    };
    let (surface, warned) = glossy("<bsdf type='phong'/>");
    assert_eq!(
        numbers([&surface.diffuse_reflectance, &surface.specular_reflectance]),
        [0.5, 0.2]
    );
    assert!(matches!(&surface.highlight, Highlight::Phong { exponent } if exponent.mean()[0] == 30.0));
    assert!(warned.is_empty(), "{warned:?}");
    let bright =
        "<bsdf type='phong'><rgb name='specularReflectance' value='1'/><float name='exponent' value='5'/></bsdf>";
    let (surface, warned) = glossy(bright);
    let [diffuse, specular] = numbers([&surface.diffuse_reflectance, &surface.specular_reflectance]);
    assert!((diffuse - 1.0 / 3.0).abs() < 1e-6 && (specular - 2.0 / 3.0).abs() < 1e-6);
    assert!(warned.len() == 1 && warned[0].contains("add up to 1.5"), "{warned:?}");
    let ward = "<bsdf type='ward'><string name='variant' value='ward-duer'/><float name='alphaU' value='0.3'/></bsdf>";
    let Highlight::Ward { alpha, model } = glossy(ward).0.highlight else {
        panic!("another highlight");
    };
    assert_eq!((numbers([&alpha[0], &alpha[1]]), model), ([0.3, 0.1], WardModel::Duer));
}

#[test]
fn diffuse_surfaces_of_the_old_dialect_and_of_pbrt() {
    let rough = "<bsdf type='roughdiffuse'><float name='alpha' value='0.7'/><boolean name='useFastApprox' value='true'/></bsdf>";
    assert!(matches!(
        material(rough).0,
        Material::RoughDiffuse { alpha, fast: true, .. } if alpha.mean()[0] == 0.7
    ));
    let albedos = |bsdf: &str| match material(bsdf).0 {
        Material::Transmitter {
            reflectance,
            transmittance,
        } => numbers([&reflectance, &transmittance]),
        other => panic!("{other:?}"),
    };
    assert_eq!(albedos("<bsdf type='difftrans'/>"), [0.0, 0.5]);
    assert_eq!(albedos("<bsdf type='diffusetransmission'/>"), [0.25, 0.25]);
}

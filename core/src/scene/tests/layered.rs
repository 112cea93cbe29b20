//! BSDFs that are made of others, as scenes write them.

use super::{LIGHT, load, warnings};
use crate::material::Material;
use crate::texture::Texture;

const DIFFUSE: &str = "<bsdf type='diffuse'/>";

/// The material of a ball and what is warned about, or what is wrong.
fn material(bsdf: &str) -> Result<(Material, Vec<String>), String> {
    let body = format!("{LIGHT}<sensor type='perspective'/><shape type='sphere'>\n{bsdf}</shape>");
    let scene = load(&body, None).map_err(|faults| faults.to_string())?;
    let index = scene.bindings[0].material as usize;
    Ok((scene.materials[index].clone(), warnings(&scene)))
}

fn silent(bsdf: &str) -> Material {
    let (material, warnings) = material(bsdf).unwrap_or_else(|faults| panic!("{bsdf}\n{faults}"));
    assert_eq!(warnings, Vec::<String>::new(), "{bsdf}");
    material
}

#[test]
fn every_type_is_read_without_a_word() {
    let coat =
        "<float name='intIOR' value='1.7'/><spectrum name='sigmaA' value='0.1'/><float name='thickness' value='2'/>";
    let board = "<texture type='checkerboard'/>";
    let named = "<texture type='checkerboard' name='normalmap'/>";
    type Is = fn(&Material) -> bool;
    let cases: [(String, Is); 10] = [
        (format!("<bsdf type='mask'>{DIFFUSE}</bsdf>"), |m| {
            matches!(m, Material::Mask { opacity: Texture::Constant(opacity), .. } if opacity[0] == 0.5)
        }),
        (
            format!("<bsdf type='mask'><texture type='checkerboard' name='opacity'/>{DIFFUSE}</bsdf>"),
            |m| matches!(m, Material::Mask { opacity: Texture::Pattern(_), .. }),
        ),
        (
            format!("<bsdf type='blendbsdf'><float name='weight' value='0.25'/>{DIFFUSE}<bsdf type='plastic'/></bsdf>"),
            |m| match m {
                Material::Blend { nested, .. } => matches!(**nested, [Material::Diffuse { .. }, Material::Plastic { .. }]),
                _ => false,
            },
        ),
        (
            format!("<bsdf type='mixturebsdf'><string name='weights' value='0.7, 0.3'/>{DIFFUSE}<bsdf type='conductor'/></bsdf>"),
            |m| matches!(m, Material::Mixture(parts) if parts.len() == 2 && parts[0].0 == 0.7),
        ),
        (format!("<bsdf type='normalmap'>{named}{DIFFUSE}</bsdf>"), |m| {
            matches!(m, Material::NormalMap { tilt, .. } if tilt.flip_invalid_normals && tilt.shadowing)
        }),
        (
            format!("<bsdf type='bumpmap'>{board}<float name='scale' value='3'/>{DIFFUSE}</bsdf>"),
            |m| matches!(m, Material::BumpMap { scale: 3.0, .. }),
        ),
        (format!("<bsdf type='coating'>{coat}{DIFFUSE}</bsdf>"), |m| {
            matches!(m, Material::Coating(coating) if coating.rough.is_none() && coating.thickness == 2.0)
        }),
        ("<bsdf type='thindielectric'/>".to_owned(), |m| matches!(m, Material::ThinDielectric { .. })),
        (
            "<bsdf type='twosided'><bsdf type='roughplastic'><float name='alpha' value='0.2'/></bsdf></bsdf>".to_owned(),
            |m| matches!(m, Material::TwoSided { front, .. } if matches!(**front, Material::RoughPlastic { .. })),
        ),
        (
            "<bsdf type='roughconductor'><boolean name='sample_visible' value='false'/><texture type='checkerboard' name='alpha'/>\
             <texture type='checkerboard' name='eta'/></bsdf>"
                .to_owned(),
            |m| {
                matches!(m, Material::RoughConductor { eta: Texture::Pattern(_), distribution, .. }
                    if matches!(distribution.alpha[1], Texture::Pattern(_)))
            },
        ),
    ];
    for (bsdf, is) in cases {
        let material = silent(&bsdf);
        assert!(is(&material), "{bsdf}: {material:?}");
    }
}

#[test]
fn approximations_are_warned_about() {
    for (bsdf, what) in [
        (
            format!("<bsdf type='roughcoating'>{DIFFUSE}</bsdf>"),
            "an approximation",
        ),
        (
            "<bsdf type='roughplastic'><texture type='checkerboard' name='alpha'/></bsdf>".to_owned(),
            "mean roughness",
        ),
        (
            "<bsdf type='coating'><bsdf type='dielectric'/></bsdf>".to_owned(),
            "the coat is left out",
        ),
        (
            format!("<bsdf type='mixturebsdf'><string name='weights' value='3, 1'/>{DIFFUSE}{DIFFUSE}</bsdf>"),
            "above 1",
        ),
    ] {
        let (_, warnings) = material(&bsdf).unwrap_or_else(|faults| panic!("{bsdf}\n{faults}"));
        assert!(
            warnings.len() == 1 && warnings[0].contains("main.xml:4") && warnings[0].contains(what),
            "{bsdf}: {warnings:?}"
        );
    }
}

#[test]
fn what_cannot_be_rendered_is_an_error() {
    let deep = |depth: usize| {
        format!(
            "{}{DIFFUSE}{}",
            "<bsdf type='mask'>".repeat(depth),
            "</bsdf>".repeat(depth)
        )
    };
    assert!(material(&deep(15)).is_ok());
    let many = format!("<bsdf type='blendbsdf' id='b0'>{DIFFUSE}{DIFFUSE}</bsdf>\n")
        + &(1..10)
            .map(|i| {
                format!(
                    "<bsdf type='blendbsdf' id='b{i}'><ref id='b{0}'/><ref id='b{0}'/></bsdf>\n",
                    i - 1
                )
            })
            .collect::<String>();
    for (bsdf, what) in [
        (deep(16), "depth of BSDFs"),
        ("<bsdf type='mask'/>".to_owned(), "one nested BSDF (found 0)"),
        (
            format!("<bsdf type='blendbsdf'>{DIFFUSE}</bsdf>"),
            "two nested BSDFs (found 1)",
        ),
        (
            format!("<bsdf type='mixturebsdf'><string name='weights' value='0.5, x'/>{DIFFUSE}{DIFFUSE}</bsdf>"),
            "expected numbers from 0 to 1",
        ),
        (
            format!("<bsdf type='normalmap'>{DIFFUSE}</bsdf>"),
            "a texture `normalmap`",
        ),
        (
            format!("<bsdf type='twosided'><bsdf type='mask'>{DIFFUSE}</bsdf></bsdf>"),
            "lets light through",
        ),
    ] {
        let faults = material(&bsdf).map(|_| ()).unwrap_err();
        assert!(
            faults.contains("main.xml:4") && faults.contains(what),
            "{bsdf}: {faults}"
        );
    }
    let body = format!("{LIGHT}<sensor type='perspective'/>{many}<shape type='sphere'><ref id='b9'/></shape>");
    let faults = load(&body, None).map(|_| ()).unwrap_err().to_string();
    assert!(faults.contains("number of BSDFs within one"), "{faults}");
}

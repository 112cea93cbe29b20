//! A surface with two lobes, of which one is a delta function.

use super::statistics::{QUADRATURE, albedo, mean_weight};
use super::*;
use crate::texture::{Pattern, UvTransform};

/// A white base under a coat that absorbs nothing loses nothing, and makes nothing: what the coat reflects and what the base returns
/// add up to one from everywhere, and so do the weights of samples.
#[test]
fn white_plastic_keeps_all_energy() {
    for eta in [1.0, 1.3, 1.49, 2.4, 1.0 / 1.33] {
        for nonlinear in [false, true] {
            let material = plastic(eta, 1.0, nonlinear);
            for wo in outgoing().into_iter().filter(|wo| wo.z > 0.0) {
                let coat = f64::from(fresnel::dielectric(wo.z, eta).reflectance);
                let base = albedo(&material, wo, TransportMode::Flux);
                assert!(
                    (coat + base - 1.0).abs() < 5.0 * QUADRATURE,
                    "{eta} {wo}: {coat} and {base}"
                );
                let (mean, error) = mean_weight(&material, wo, TransportMode::Radiance, 20_000, |_| true);
                assert!(
                    (mean - 1.0).abs() < 4.0 * error + QUADRATURE,
                    "{eta} {wo}: {mean} +- {error}"
                );
            }
        }
    }
}

/// The delta lobe is chosen with the probability that its samples name, and carries what Fresnel's equations reflect.
#[test]
fn the_coat_is_sampled_as_often_as_it_says() {
    const SAMPLES: u64 = 40_000;
    let material = plastic(1.49, 0.3, true);
    for wo in outgoing().into_iter().filter(|wo| wo.z > 0.0) {
        let samples = (0..SAMPLES).filter_map(|path| draw(&material, wo, &mut random(path), TransportMode::Radiance));
        let mirrored: Vec<BsdfSample> = samples.filter(|sample| sample.delta).collect();
        let probability = f64::from(mirrored[0].pdf);
        let share = mirrored.len() as f64 / SAMPLES as f64;
        let error = (probability * (1.0 - probability) / SAMPLES as f64).sqrt();
        assert!(
            (share - probability).abs() < 4.0 * error,
            "{wo}: {share} of {probability}"
        );
        let reflectance = fresnel::dielectric(wo.z, 1.49).reflectance;
        for sample in &mirrored {
            assert!(
                (sample.f[0] * sample.wi.z - reflectance).abs() < 1e-6 * reflectance,
                "{sample:?}"
            );
            assert!((sample.wi - Vec3::new(-wo.x, -wo.y, wo.z)).length() < 1e-6 && sample.pdf == mirrored[0].pdf);
        }
    }
}

/// Delta and glossy are properties of lobes: a coated surface is a mirror and diffuse at once.
#[test]
fn a_coated_surface_has_a_delta_lobe_and_a_diffuse_one() {
    let bsdf = plastic(1.49, 0.5, false).resolve(&AT, Vec3::Z);
    assert!(bsdf.has_delta() && bsdf.has_smooth() && !bsdf.is_glossier_than(1e9));
    let deltas = |bsdf: &Bsdf| {
        let mut deltas = Vec::new();
        bsdf.each_lobe(&mut |lobe| deltas.push(lobe.is_delta()));
        deltas
    };
    assert_eq!(deltas(&bsdf), [true, false]);
    assert_eq!(bsdf.least_roughness(), Some(f32::INFINITY));
    let diffuse = Material::Diffuse { reflectance: WHITE }.resolve(&AT, Vec3::Z);
    assert!(!diffuse.has_delta() && deltas(&diffuse) == [false]);
    assert!(glass(1.5).resolve(&AT, Vec3::Z).has_delta());
}

/// Textures are looked up once, at the point that the material is resolved for.
#[test]
fn resolving_looks_textures_up_at_the_point() {
    let chequers = Texture::from(Pattern::Checkerboard {
        even: grey(0.75),
        odd: grey(0.25),
        to_uv: UvTransform::IDENTITY,
    });
    let material = Material::Diffuse { reflectance: chequers };
    for (uv, albedo) in [(Vec2::new(0.25, 0.25), 0.75), (Vec2::new(0.75, 0.25), 0.25)] {
        let bsdf = material.resolve(&TexturePoint { uv, ..AT }, Vec3::Z);
        assert_eq!(
            bsdf.f(Vec3::Z, Vec3::Z, TransportMode::Flux)[0],
            albedo * crate::math::FRAC_1_PI
        );
    }
}

//! Tests of the lights, and the scenes they use.

mod direct;
mod emission;
mod motion;
mod portal;

use super::*;
use crate::geometry::{Shape, ShapeId, TriangleMesh};
use crate::math::Vec2;
use crate::random::{PathRandom, Stream};
use crate::texture::{Bitmap, Texture, TextureFilter, UvTransform, WrapMode};
use glam::{DMat4, DVec3, DVec4};
use std::sync::Arc;

/// Chi-square tests of this module, for Sidak's correction.
const FAMILY: usize = 30;
/// Deviations that a z-test allows: a false alarm has probability 6.3e-5 each, fixed by the seed.
const DEVIATIONS: f64 = 4.0;

fn gray(value: f32) -> Spectrum {
    Spectrum::splat(value)
}

/// A right-handed frame at `origin` whose z axis is `axis`, scaled by `scale`.
fn facing(origin: Vec3, axis: Vec3, scale: Vec3) -> Transform {
    let frame = Frame::from_normal(axis.normalize());
    let column = |v: Vec3, s: f32| (v * s).as_dvec3().extend(0.0);
    Transform::from_matrix(DMat4::from_cols(
        column(frame.s, scale.x),
        column(frame.t, scale.y),
        column(frame.n, scale.z),
        origin.as_dvec3().extend(1.0),
    ))
    .unwrap()
}

fn disk(origin: Vec3, axis: Vec3, scale: Vec3) -> Shape {
    Shape::Disk {
        to_world: facing(origin, axis, scale),
        flip_normals: false,
    }
}

fn sphere(center: Vec3, radius: f32, flip_normals: bool) -> Shape {
    let to_local = facing(center, Vec3::Z, Vec3::splat(radius)).inverted();
    Shape::Sphere {
        center,
        radius,
        to_local,
        flip_normals,
    }
}

/// A plane figure of four unequal triangles about `origin` that faces `axis`.
fn patch(origin: Vec3, axis: Vec3) -> Shape {
    let map = facing(origin, axis, Vec3::ONE);
    let corners = [(0.2, 0.1), (1.0, 0.0), (0.0, 1.5), (-1.0, 0.0), (0.0, -0.7)];
    Shape::Mesh(Arc::new(TriangleMesh {
        positions: corners.iter().map(|(x, y)| map.point(Vec3::new(*x, *y, 0.0))).collect(),
        triangles: vec![[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]],
        ..TriangleMesh::default()
    }))
}

/// Area of [`patch`]: half the product of its diagonals.
const PATCH_AREA: f64 = 2.2;

/// A smooth image with one bright texel; columns from the seam on differ.
fn image(width: usize, height: usize) -> Arc<Bitmap> {
    let mut texels: Vec<Spectrum> = (0..width * height)
        .map(|i| Spectrum::from_rgb([0.2 + (i % 5) as f32 * 0.3, 0.1 + (i % 3) as f32 * 0.2, 0.3]))
        .collect();
    texels[width * (height / 3)] = gray(20.0);
    texels[width * (height / 2) + 3] = gray(0.0);
    Arc::new(Bitmap {
        width,
        height,
        texels: texels.into(),
        wrap: WrapMode::Repeat,
        filter: TextureFilter::Bilinear,
    })
}

fn environment(width: usize, height: usize) -> Light {
    let to_world = facing(Vec3::ZERO, Vec3::new(0.3, 0.8, -0.5), Vec3::ONE);
    Light::Environment {
        image: image(width, height),
        mapping: Mapping::LatitudeLongitude,
        scale: 2.0,
        to_world,
    }
}

/// A square image of the sphere.
fn equal_area(size: usize) -> Light {
    Light::Environment {
        image: image(size, size),
        mapping: Mapping::EqualArea,
        scale: 1.5,
        to_world: facing(Vec3::ZERO, Vec3::new(-0.4, 0.3, 0.6), Vec3::ONE),
    }
}

/// Where [`goniometric`] puts its lamp.
const LAMP: Vec3 = Vec3::new(1.0, -2.0, 0.5);

/// The image of an environment about a point.
fn goniometric(environment: Light) -> Light {
    let Light::Environment {
        image,
        mapping,
        scale,
        to_world,
    } = environment
    else {
        unreachable!()
    };
    let moved = Transform::from_matrix(DMat4::from_translation(LAMP.as_dvec3())).unwrap();
    Light::Goniometric {
        to_world: moved.after(&to_world),
        image,
        mapping,
        scale,
    }
}

fn sun(half_angle: f32) -> Light {
    Light::Sun {
        towards: Vec3::new(0.48, 0.64, -0.6),
        half_angle,
        irradiance: Spectrum::from_rgb([3.0, 2.0, 1.0]),
    }
}

/// A projector at (1, 2, 3) that looks at the origin.
fn projector() -> Light {
    let matrix = DMat4::look_to_lh(DVec3::ZERO, DVec3::new(-1.0, -2.0, -3.0), DVec3::Y).inverse();
    let texels = (0..8).map(|i| Spectrum::from_rgb([1.0 + (i % 4) as f32, 10.0 + (i / 4) as f32, 0.5]));
    let image = Bitmap {
        width: 4,
        height: 2,
        texels: texels.collect::<Vec<_>>().into(),
        wrap: WrapMode::Repeat,
        filter: TextureFilter::Nearest,
    };
    let identity = UvTransform {
        linear: [Vec2::X, Vec2::Y],
        offset: Vec2::ZERO,
    };
    Light::Projector {
        to_world: Transform::from_matrix(DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0)) * matrix).unwrap(),
        fov_x: 40.0_f32.to_radians(),
        aspect: 2.0,
        image: Texture::Bitmap(Arc::new(image), identity),
        scale: 2.0,
        even: Even::Plane,
    }
}

fn area_light(shape: u32, radiance: f32) -> Light {
    Light::Area {
        shape: ShapeId(shape),
        radiance: Texture::Constant(gray(radiance)),
        two_sided: false,
    }
}

fn two_sided_light(shape: u32, radiance: f32) -> Light {
    Light::Area {
        shape: ShapeId(shape),
        radiance: Texture::Constant(gray(radiance)),
        two_sided: true,
    }
}

fn random(seed: u64) -> PathRandom {
    PathRandom::new(seed, 1, Stream::Light, 0)
}

/// Mean of `samples` draws and its standard error.
fn mean(samples: usize, mut draw: impl FnMut() -> f64) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 0..samples {
        let value = draw();
        sum += value;
        squares += value * value;
    }
    let n = samples as f64;
    let mean = sum / n;
    (mean, ((squares / n - mean * mean).max(0.0) / n).sqrt())
}

fn assert_mean(label: &str, (mean, error): (f64, f64), expected: f64) {
    let allowed = DEVIATIONS * error + 1e-5 * expected.abs();
    assert!(
        (mean - expected).abs() <= allowed,
        "{label}: {mean} +- {error}, expected {expected}"
    );
}

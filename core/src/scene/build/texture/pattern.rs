//! Textures that are computed, or made of other textures.

use super::super::Builder;
use super::{Role, colour};
use crate::math::{Transform, Vec2, Vec3};
use crate::scene::description::Kind;
use crate::scene::error::SceneError;
use crate::scene::reader::{ANY, Reader};
use crate::scene::spectrum::Use;
use crate::spectrum::Spectrum;
use crate::texture::{Curve, Mapping, Noise, Octaves, Pattern, Texture, UvTransform};
use glam::DMat4;
use std::ops::RangeInclusive;

/// The types of textures that are rendered.
pub(super) const SUPPORTED: [&str; 17] = [
    "bitmap",
    "uniform",
    "srgb",
    "rawconstant",
    "mesh_attribute",
    "checkerboard",
    "gridtexture",
    "scale",
    "mix",
    "directionmix",
    "dots",
    "bilerp",
    "curve",
    "fbm",
    "wrinkled",
    "windy",
    "marble",
];
/// Functions of a texture's values.
const CURVES: [(&str, Curve); 2] = [("root", Curve::Root), ("pbrt3_roughness", Curve::OldRoughness)];
/// The most octaves of noise.
const OCTAVES: RangeInclusive<i64> = 1..=32;
/// The largest factors on lengths and noise.
const FACTOR: RangeInclusive<f64> = -1e6..=1e6;

/// How a texture gets its coordinates: from the position in a space, or those of the surface.
pub(super) struct Coordinates(Option<(Mapping, Transform)>);

impl Coordinates {
    /// A texture with these coordinates.
    pub(super) fn of(self, texture: Texture) -> Texture {
        match self.0 {
            None => texture,
            Some((mapping, to_local)) => Texture::from(Pattern::Mapped {
                texture,
                mapping,
                to_local,
            }),
        }
    }
}

impl Builder<'_, '_> {
    /// A texture that is computed, or made of other textures; `None` where its type is none of these.
    pub(super) fn pattern(&mut self, reader: &Reader, role: Role) -> Result<Option<Texture>, SceneError> {
        let plugin = reader.object.plugin.as_str();
        let pattern = match plugin {
            "checkerboard" => return self.checkerboard(reader, role).map(Some),
            "gridtexture" => {
                reader.ignore(&["filter_type", "max_anisotropy"]);
                let grid = Pattern::Grid {
                    ground: self.colour_or_texture(reader, "color0", role, 0.2)?,
                    line: self.colour_or_texture(reader, "color1", role, 0.4)?,
                    width: reader.float_or("line_width", 0.0..=0.5, 0.01)? as f32,
                    to_uv: uv_transform(reader)?,
                };
                return Ok(Some(self.mapping(reader)?.of(grid.into())));
            }
            "dots" => {
                let dots = Pattern::Dots {
                    inside: self.colour_or_texture(reader, "inside", role, 1.0)?,
                    outside: self.colour_or_texture(reader, "outside", role, 0.0)?,
                    to_uv: uv_transform(reader)?,
                };
                return Ok(Some(self.mapping(reader)?.of(dots.into())));
            }
            "bilerp" => {
                let corner = |name: &str, default: f32| -> Result<Spectrum, SceneError> {
                    let given = colour(reader, name, role.used)?;
                    Ok(given.unwrap_or(Spectrum::splat(default)))
                };
                let corners = Pattern::Corners {
                    colours: [
                        corner("v00", 0.0)?,
                        corner("v10", 0.0)?,
                        corner("v01", 1.0)?,
                        corner("v11", 1.0)?,
                    ],
                    to_uv: uv_transform(reader)?,
                    repeats: reader.boolean("repeats", false)?,
                    most: role.most(),
                };
                return Ok(Some(self.mapping(reader)?.of(corners.into())));
            }
            "curve" => Pattern::Curve {
                texture: self.colour_or_texture(reader, "tex", role, 0.5)?,
                curve: reader.choice("curve", &CURVES, Curve::Root)?,
            },
            "scale" => return self.scale(reader, role).map(Some),
            "mix" => Pattern::Mix {
                first: self.colour_or_texture(reader, "tex1", role, 0.0)?,
                second: self.colour_or_texture(reader, "tex2", role, 1.0)?,
                amount: self.share_or_texture(reader, "amount", 0.5)?,
            },
            "directionmix" => Pattern::DirectionMix {
                first: self.colour_or_texture(reader, "tex1", role, 0.0)?,
                second: self.colour_or_texture(reader, "tex2", role, 1.0)?,
                direction: direction(reader)?,
            },
            "fbm" => noise(reader, role, Noise::Brownian(octaves(reader)?))?,
            "wrinkled" => noise(reader, role, Noise::Wrinkled(octaves(reader)?))?,
            "windy" => noise(reader, role, Noise::Windy)?,
            "marble" => {
                let marble = Noise::Marble {
                    octaves: octaves(reader)?,
                    scale: reader.float_or("scale", FACTOR, 1.0)? as f32,
                    variation: reader.float_or("variation", FACTOR, 0.2)? as f32,
                };
                noise(reader, role, marble)?
            }
            _ => return Ok(None),
        };
        Ok(Some(pattern.into()))
    }

    fn checkerboard(&mut self, reader: &Reader, role: Role) -> Result<Texture, SceneError> {
        let even = self.colour_or_texture(reader, "color0", role, 0.4)?;
        let odd = self.colour_or_texture(reader, "color1", role, 0.2)?;
        if reader.integer("dimension", 2..=3)? == Some(3) {
            let to_local = to_local(reader)?;
            return Ok(Pattern::Cubes { even, odd, to_local }.into());
        }
        let to_uv = uv_transform(reader)?;
        Ok(self
            .mapping(reader)?
            .of(Pattern::Checkerboard { even, odd, to_uv }.into()))
    }

    /// A texture times a number, a colour or another texture. Mitsuba 0.x gives the first any name.
    fn scale(&mut self, reader: &Reader, role: Role) -> Result<Texture, SceneError> {
        let factor_role = Role {
            used: Use::Constant,
            ..role
        };
        let factor = self.colour_or_texture(reader, "scale", factor_role, 1.0)?;
        let children = reader.children(Kind::Texture);
        let nested = children.iter().find(|child| child.name.as_deref() != Some("scale"));
        let texture = match nested {
            Some(child) => {
                let built = self.texture(child.target, role);
                match self.description.attempt(child.target, built)? {
                    Some(texture) => texture,
                    None => Texture::Constant(Spectrum::ONE),
                }
            }
            None => self.colour_or_texture(reader, "value", role, 1.0)?,
        };
        let most = role.most();
        if role.used == Use::Reflectance && texture.brightest() * factor.brightest() > most {
            let message = "the product may be above 1, where it counts as 1";
            reader.warn_of("scale", message);
        }
        Ok(match (&texture, &factor) {
            (Texture::Constant(a), Texture::Constant(b)) => Texture::Constant((*a * *b).map(|c| c.min(most))),
            _ => Pattern::Scale { texture, factor, most }.into(),
        })
    }

    /// How a texture gets its coordinates.
    pub(super) fn mapping(&mut self, reader: &Reader) -> Result<Coordinates, SceneError> {
        #[derive(Clone, Copy)]
        enum Written {
            Uv,
            Spherical,
            Cylindrical,
            Planar,
        }
        let choices = [
            ("uv", Written::Uv),
            ("spherical", Written::Spherical),
            ("cylindrical", Written::Cylindrical),
            ("planar", Written::Planar),
        ];
        let mapping = match reader.choice("mapping", &choices, Written::Uv)? {
            Written::Uv => return Ok(Coordinates(None)),
            Written::Spherical => Mapping::Spherical,
            Written::Cylindrical => Mapping::Cylindrical,
            Written::Planar => {
                let axis = |name: &str, default: glam::DVec3| -> Result<Vec3, SceneError> {
                    Ok(reader.vector(name)?.unwrap_or(default).as_vec3())
                };
                Mapping::Planar([axis("v1", glam::DVec3::X)?, axis("v2", glam::DVec3::Y)?])
            }
        };
        Ok(Coordinates(Some((mapping, to_local(reader)?))))
    }
}

/// From the world to the space of a texture, whose place in the world `to_world` is.
fn to_local(reader: &Reader) -> Result<Transform, SceneError> {
    Ok(reader.transform("to_world")?.unwrap_or_default().inverted())
}

fn noise(reader: &Reader, role: Role, noise: Noise) -> Result<Pattern, SceneError> {
    Ok(Pattern::Noise {
        noise,
        to_local: to_local(reader)?,
        most: role.most(),
    })
}

fn octaves(reader: &Reader) -> Result<Octaves, SceneError> {
    Ok(Octaves {
        count: reader.integer("octaves", OCTAVES)?.unwrap_or(8) as u32,
        falloff: reader.float_or("roughness", 0.0..=1.0, 0.5)? as f32,
    })
}

fn direction(reader: &Reader) -> Result<Vec3, SceneError> {
    let direction = reader.vector("dir")?.unwrap_or(glam::DVec3::Y);
    match direction.try_normalize() {
        Some(direction) => Ok(direction.as_vec3()),
        None => Err(reader.wrong("dir", "it has no length")),
    }
}

/// The first two rows of `to_uv`, or the scale and offset of the 0.x dialect.
pub(super) fn uv_transform(reader: &Reader) -> Result<UvTransform, SceneError> {
    let both = reader.float("uvscale", ANY)?;
    let scale = ["uscale", "vscale"].map(|name| reader.float(name, ANY));
    let offset = ["uoffset", "voffset"].map(|name| reader.float(name, ANY));
    let ([u_scale, v_scale], [u_offset, v_offset]) = (scale, offset);
    let (scale, offset) = ([u_scale?.or(both), v_scale?.or(both)], [u_offset?, v_offset?]);
    let old = scale.iter().chain(&offset).any(Option::is_some);
    let matrix = match reader.transform("to_uv")? {
        Some(_) if old => return Err(reader.wrong("to_uv", "it cannot be combined with uscale, voffset and the like")),
        Some(transform) => transform.matrix(),
        None => {
            let scale = glam::DVec3::new(scale[0].unwrap_or(1.0), scale[1].unwrap_or(1.0), 1.0);
            let offset = glam::DVec3::new(offset[0].unwrap_or(0.0), offset[1].unwrap_or(0.0), 0.0);
            DMat4::from_scale(scale) * DMat4::from_translation(offset)
        }
    };
    let row = |i: usize| matrix.row(i).as_vec4();
    let transform = UvTransform {
        linear: [Vec2::new(row(0).x, row(0).y), Vec2::new(row(1).x, row(1).y)],
        offset: Vec2::new(row(0).w, row(1).w),
    };
    let finite = transform
        .linear
        .iter()
        .chain([&transform.offset])
        .all(|v| v.is_finite());
    if finite {
        Ok(transform)
    } else {
        Err(reader.wrong("to_uv", "it is out of the range of single precision"))
    }
}

//! Textures that are computed, or made of other textures.

use super::noise::perlin;
use super::{Mapping, Noise, Texture, TexturePoint, UvTransform};
use crate::math::{Transform, Vec2, Vec3, ln, sqr};
use crate::spectrum::Spectrum;

/// A texture that is computed, or made of others.
#[derive(Clone, Debug)]
pub enum Pattern {
    /// Two textures in a chequer pattern, squares of side 1/2; `to_uv` is applied to the surface coordinates first.
    Checkerboard {
        /// Where both coordinates lie in the lower, or both in the upper half of their unit (Mitsuba's `color0`).
        even: Texture,
        /// Elsewhere (Mitsuba's `color1`).
        odd: Texture,
        /// Applied to the surface coordinates.
        to_uv: UvTransform,
    },
    /// Two textures in cubes of side 1 (pbrt's `checkerboard` in three dimensions).
    Cubes {
        /// In the cube that begins at the origin.
        even: Texture,
        /// Beside it.
        odd: Texture,
        /// From the world to the texture's own space.
        to_local: Transform,
    },
    /// Lines at whole coordinates (Mitsuba 0.x's `gridtexture`).
    Grid {
        /// Between the lines.
        ground: Texture,
        /// On them.
        line: Texture,
        /// Half of their width.
        width: f32,
        /// Applied to the surface coordinates.
        to_uv: UvTransform,
    },
    /// Discs in some of the unit squares (pbrt's `dots`).
    Dots {
        /// In the discs.
        inside: Texture,
        /// Around them.
        outside: Texture,
        /// Applied to the surface coordinates.
        to_uv: UvTransform,
    },
    /// The product of two textures, at most a bound.
    Scale {
        /// The one.
        texture: Texture,
        /// The other.
        factor: Texture,
        /// Where the product is larger it counts as this.
        most: f32,
    },
    /// Two textures, the second with the weight `amount`, the first with what is left.
    Mix {
        /// Where `amount` is 0.
        first: Texture,
        /// Where `amount` is 1.
        second: Texture,
        /// In [0, 1].
        amount: Texture,
    },
    /// Two textures, the first with the weight `|cos|` of the surface's normal with a direction (pbrt's `directionmix`).
    DirectionMix {
        /// Where the surface faces along the direction.
        first: Texture,
        /// Where it lies along it.
        second: Texture,
        /// Of unit length.
        direction: Vec3,
    },
    /// Noise in space.
    Noise {
        /// What is made of it.
        noise: Noise,
        /// From the world to the texture's own space.
        to_local: Transform,
        /// Where the value is larger it counts as this; negative ones count as 0.
        most: f32,
    },
    /// Four colours, linear along u and along v between them (pbrt-v3's `bilerp`, and its `uv` of four colours that repeat).
    Corners {
        /// At (0, 0), (1, 0), (0, 1) and (1, 1).
        colours: [Spectrum; 4],
        /// Applied to the surface coordinates.
        to_uv: UvTransform,
        /// Whether each unit square shows the same, and not what goes on from (0, 0) to (1, 1).
        repeats: bool,
        /// Where the value is larger it counts as this; negative ones count as 0.
        most: f32,
    },
    /// A function of each value of a texture.
    Curve {
        /// The texture.
        texture: Texture,
        /// The function.
        curve: Curve,
    },
    /// A texture with coordinates from the position in space.
    Mapped {
        /// The texture.
        texture: Texture,
        /// The coordinates.
        mapping: Mapping,
        /// From the world to the space of the mapping.
        to_local: Transform,
    },
}

/// Functions of values, which rise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Curve {
    /// The root, by which pbrt-v4 makes a roughness the width of a distribution.
    Root,
    /// The polynomial of the logarithm by which pbrt-v3 does (`TrowbridgeReitzDistribution::RoughnessToAlpha`).
    OldRoughness,
}

impl Curve {
    /// The value of the function; of what is negative that of 0.
    #[must_use]
    pub fn of(self, value: f32) -> f32 {
        match self {
            Self::Root => value.max(0.0).sqrt(),
            Self::OldRoughness => {
                let x = ln(value.max(1e-3));
                1.621_42 + x * (0.819_955 + x * (0.173_4 + x * (0.017_120_1 + x * 0.000_640_711)))
            }
        }
    }
}

/// Share of the squares that have a dot, over the period of the noise.
const SQUARES_WITH_DOT: f32 = 0.394_165;
/// Share of the plane that dots of radius 0.35 cover.
const DOTTED: f32 = SQUARES_WITH_DOT * std::f32::consts::PI * 0.35 * 0.35;

/// Distance over which textures are compared that do not tell their slope.
const SLOPE_STEP: f32 = 1.0 / 2048.0;

impl Pattern {
    pub(super) fn eval(&self, at: &TexturePoint) -> Spectrum {
        match self {
            Self::Checkerboard { even, odd, to_uv } => {
                let cell = to_uv.apply(at.uv);
                let upper = (cell - cell.floor()).cmpgt(Vec2::splat(0.5));
                if upper.x == upper.y { even } else { odd }.eval(at)
            }
            Self::Cubes { even, odd, to_local } => {
                let cube = at.local(to_local).floor();
                let parity = (cube.x + cube.y + cube.z) % 2.0;
                if parity == 0.0 { even } else { odd }.eval(at)
            }
            Self::Grid {
                ground,
                line,
                width,
                to_uv,
            } => {
                let place = to_uv.apply(at.uv);
                let distance = (place - place.round()).abs();
                if distance.min_element() < *width { line } else { ground }.eval(at)
            }
            Self::Dots { inside, outside, to_uv } => {
                if is_in_dot(to_uv.apply(at.uv)) { inside } else { outside }.eval(at)
            }
            Self::Scale { texture, factor, most } => (texture.eval(at) * factor.eval(at)).map(|c| c.min(*most)),
            Self::Mix { first, second, amount } => {
                let amount = amount.eval(at);
                let rest = amount.map(|share| 1.0 - share);
                first.eval(at) * rest + second.eval(at) * amount
            }
            Self::DirectionMix {
                first,
                second,
                direction,
            } => {
                let amount = at.normal.dot(*direction).abs().min(1.0);
                first.eval(at) * amount + second.eval(at) * (1.0 - amount)
            }
            Self::Noise { noise, to_local, most } => noise.eval(at.local(to_local)).map(|c| c.clamp(0.0, *most)),
            Self::Corners {
                colours: [c00, c10, c01, c11],
                to_uv,
                repeats,
                most,
            } => {
                let place = to_uv.apply(at.uv);
                let p = if *repeats { place - place.floor() } else { place };
                let (lower, upper) = (*c00 * (1.0 - p.x) + *c10 * p.x, *c01 * (1.0 - p.x) + *c11 * p.x);
                (lower * (1.0 - p.y) + upper * p.y).map(|c| c.max(0.0).min(*most))
            }
            Self::Curve { texture, curve } => texture.eval(at).map(|value| curve.of(value)),
            Self::Mapped {
                texture,
                mapping,
                to_local,
            } => {
                let uv = mapping.coordinates(to_local, at);
                texture.eval(&TexturePoint { uv, ..*at })
            }
        }
    }

    /// As [`Texture::gradient`]. Noise in space has none: how the position changes with the coordinates is not known here.
    pub(super) fn gradient(&self, at: &TexturePoint) -> Vec2 {
        if let Self::Scale {
            texture,
            factor: Texture::Constant(factor),
            ..
        } = self
        {
            return texture.gradient(at) * factor.number();
        }
        let value = |offset: Vec2| {
            let uv = at.uv + offset;
            self.eval(&TexturePoint { uv, ..*at }).number()
        };
        let slope = |step: Vec2| (value(step) - value(-step)) / (2.0 * SLOPE_STEP);
        Vec2::new(slope(Vec2::X * SLOPE_STEP), slope(Vec2::Y * SLOPE_STEP))
    }

    /// As [`Texture::mean`]; parts count as independent of each other.
    pub(super) fn mean(&self) -> Spectrum {
        let mixed = |a: &Texture, b: &Texture, share: f32| a.mean() * (1.0 - share) + b.mean() * share;
        match self {
            Self::Checkerboard { even, odd, .. } | Self::Cubes { even, odd, .. } => (even.mean() + odd.mean()) * 0.5,
            Self::Grid {
                ground, line, width, ..
            } => mixed(line, ground, sqr((1.0 - 2.0 * width).max(0.0))),
            Self::Dots { inside, outside, .. } => mixed(outside, inside, DOTTED),
            Self::Scale { texture, factor, most } => (texture.mean() * factor.mean()).map(|c| c.min(*most)),
            Self::Mix { first, second, amount } => mixed(first, second, amount.mean().mean()),
            Self::DirectionMix { first, second, .. } => mixed(first, second, 0.5),
            Self::Noise { noise, most, .. } => noise.mean(|value| value.map(|c| c.clamp(0.0, *most))),
            Self::Corners { colours, most, .. } => Spectrum::average(colours.iter().copied()).map(|c| c.min(*most)),
            Self::Curve { texture, curve } => texture.mean().map(|value| curve.of(value)),
            Self::Mapped { texture, .. } => texture.mean(),
        }
    }

    /// As [`Texture::brightest`].
    pub(super) fn brightest(&self) -> f32 {
        match self {
            Self::Checkerboard { even: a, odd: b, .. }
            | Self::Cubes { even: a, odd: b, .. }
            | Self::Grid { ground: a, line: b, .. }
            | Self::Dots {
                inside: a, outside: b, ..
            }
            | Self::Mix {
                first: a, second: b, ..
            }
            | Self::DirectionMix {
                first: a, second: b, ..
            } => a.brightest().max(b.brightest()),
            Self::Scale { texture, factor, most } => (texture.brightest() * factor.brightest()).min(*most),
            Self::Noise { most, .. } => *most,
            Self::Corners {
                colours,
                repeats: true,
                most,
                ..
            } => colours
                .iter()
                .map(|colour| colour.max_component())
                .fold(0.0, f32::max)
                .min(*most),
            Self::Corners { most, .. } => *most,
            Self::Curve { texture, curve } => curve.of(texture.brightest()),
            Self::Mapped { texture, .. } => texture.brightest(),
        }
    }
}

/// Whether a point lies in a dot: noise decides which squares have one, and where in its square it lies (Pharr, Jakob and Humphreys
/// 2016, section 10.5.2).
fn is_in_dot(p: Vec2) -> bool {
    const RADIUS: f32 = 0.35;
    let noise = |x: f32, y: f32| perlin(Vec3::new(x, y, 0.5));
    let cell = (p + Vec2::splat(0.5)).floor();
    if noise(cell.x + 0.5, cell.y + 0.5) <= 0.0 {
        return false;
    }
    let shift = Vec2::new(noise(cell.x + 1.5, cell.y + 2.8), noise(cell.x + 4.5, cell.y + 9.8));
    let centre = cell + shift * (0.5 - RADIUS);
    (p - centre).length_squared() < sqr(RADIUS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::Octaves;
    use glam::{DMat4, DVec3};

    fn grey(v: f32) -> Texture {
        Texture::Constant(Spectrum::splat(v))
    }

    fn uv(u: f32, v: f32) -> TexturePoint {
        TexturePoint::of_uv(Vec2::new(u, v))
    }

    fn place(x: f32, y: f32, z: f32) -> TexturePoint {
        TexturePoint {
            position: Vec3::new(x, y, z),
            ..uv(0.0, 0.0)
        }
    }

    #[test]
    fn textures_nest() {
        let chequers = Texture::from(Pattern::Checkerboard {
            even: grey(0.8),
            odd: Texture::from(Pattern::Mix {
                first: grey(0.2),
                second: grey(0.6),
                amount: grey(0.25),
            }),
            to_uv: UvTransform::IDENTITY,
        });
        let scaled = |factor: f32| {
            Texture::from(Pattern::Scale {
                texture: chequers.clone(),
                factor: grey(factor),
                most: 1.0,
            })
        };
        let close = |texture: Texture, at: TexturePoint, v: f32| (texture.grey(&at) - v).abs() < 1e-6;
        assert!(close(scaled(0.5), uv(0.1, 0.1), 0.4) && close(scaled(0.5), uv(0.6, 0.1), 0.15));
        assert!(close(scaled(2.0), uv(0.1, 0.1), 1.0) && close(scaled(2.0), uv(0.6, 0.1), 0.6));
        assert!((scaled(0.5).mean()[0] - 0.275).abs() < 1e-6 && scaled(2.0).brightest() == 1.0);
    }

    #[test]
    fn a_grid_has_lines_at_whole_coordinates() {
        let grid = Texture::from(Pattern::Grid {
            ground: grey(0.2),
            line: grey(0.4),
            width: 0.01,
            to_uv: UvTransform::IDENTITY,
        });
        for (u, v, expected) in [
            (0.5, 0.5, 0.2),
            (0.009, 0.5, 0.4),
            (0.5, 0.991, 0.4),
            (-2.011, 0.3, 0.2),
        ] {
            assert_eq!(grid.grey(&uv(u, v)), expected, "{u} {v}");
        }
        // Counted on a fine raster.
        let n = 1000;
        let sum: f64 = (0..n * n)
            .map(|i| f64::from(grid.grey(&uv((i % n) as f32 / n as f32, (i / n) as f32 / n as f32))))
            .sum();
        assert!((sum / f64::from(n * n) - f64::from(grid.mean()[0])).abs() < 1e-3);
    }

    #[test]
    fn cubes_alternate_in_the_space_of_the_texture() {
        let to_local = Transform::from_matrix(DMat4::from_scale(DVec3::splat(2.0))).unwrap();
        let cubes = Texture::from(Pattern::Cubes {
            even: grey(1.0),
            odd: grey(0.0),
            to_local,
        });
        let cases = [
            (0.1, 0.1, 0.1, 1.0),
            (0.6, 0.1, 0.1, 0.0),
            (0.6, 0.6, 0.1, 1.0),
            (-0.1, 0.1, 0.1, 0.0),
        ];
        for (x, y, z, expected) in cases {
            assert_eq!(cubes.grey(&place(x, y, z)), expected, "{x} {y} {z}");
        }
    }

    /// Dots are discs of radius 0.35 that stay in their square.
    #[test]
    fn dots_lie_in_some_of_the_squares() {
        let dots = Texture::from(Pattern::Dots {
            inside: grey(1.0),
            outside: grey(0.0),
            to_uv: UvTransform::IDENTITY,
        });
        let (squares, n) = (20, 16);
        for square in 0..squares * squares {
            let corner = Vec2::new((square % squares) as f32 - 0.5, (square / squares) as f32 - 0.5);
            let inside = (0..n * n).filter(|i| {
                let within = Vec2::new((i % n) as f32 + 0.5, (i / n) as f32 + 0.5) / n as f32;
                dots.grey(&TexturePoint::of_uv(corner + within)) == 1.0
            });
            let share = inside.count() as f32 / (n * n) as f32;
            let disc = std::f32::consts::PI * sqr(0.35);
            assert!(share == 0.0 || (share - disc).abs() < 0.04, "{corner} {share}");
        }
        // The middle of a square lies in its dot, which is shifted by 0.15 per axis at most.
        let middles = (0..256 * 256).map(|i| TexturePoint::of_uv(Vec2::new((i % 256) as f32, (i / 256) as f32)));
        let dotted = middles.filter(|middle| dots.grey(middle) == 1.0).count();
        assert!((dotted as f32 / 65_536.0 - SQUARES_WITH_DOT).abs() < 1e-5, "{dotted}");
    }

    /// Expected values by hand: bilinear between the corners, and the roots and pbrt-v3's polynomial of them.
    #[test]
    fn corners_are_joined_and_curves_follow_values() {
        let corners = |repeats| Pattern::Corners {
            colours: [0.0, 0.5, 1.0, 0.25].map(Spectrum::splat),
            to_uv: UvTransform::IDENTITY,
            repeats,
            most: 1.0,
        };
        let goes_on = Texture::from(corners(false));
        let repeats = Texture::from(corners(true));
        for (u, v, first, second) in [
            (0.0, 0.0, 0.0, 0.0),
            (0.75, 0.0, 0.375, 0.375),
            (0.0, 0.75, 0.75, 0.75),
            (0.5, 0.5, 0.4375, 0.4375),
            (1.5, 0.0, 0.75, 0.25),
            (-0.5, 0.0, 0.0, 0.25),
            (0.0, 3.0, 1.0, 0.0),
        ] {
            assert_eq!(
                (goes_on.grey(&uv(u, v)), repeats.grey(&uv(u, v))),
                (first, second),
                "{u} {v}"
            );
        }
        assert_eq!((goes_on.mean()[0], repeats.brightest()), (0.4375, 1.0));
        let curved = |curve, at| {
            let texture = goes_on.clone();
            Texture::from(Pattern::Curve { texture, curve }).grey(&uv(at, 0.0))
        };
        assert_eq!(curved(Curve::Root, 0.5), 0.5);
        assert!((curved(Curve::OldRoughness, 0.2) - 0.461_76).abs() < 1e-4);
    }

    #[test]
    fn mixing_by_direction_follows_the_normal() {
        let mix = Texture::from(Pattern::DirectionMix {
            first: grey(1.0),
            second: grey(0.0),
            direction: Vec3::Y,
        });
        let facing = |normal: Vec3| TexturePoint { normal, ..uv(0.0, 0.0) };
        assert_eq!(mix.grey(&facing(-Vec3::Y)), 1.0);
        assert!((mix.grey(&facing(Vec3::new(0.6, 0.8, 0.0))) - 0.8).abs() < 1e-6);
        assert_eq!(mix.grey(&facing(Vec3::X)), 0.0);
    }

    #[test]
    fn noise_is_clamped_and_finite_anywhere() {
        let octaves = Octaves { count: 8, falloff: 0.5 };
        let marble = Noise::Marble {
            octaves,
            scale: 3.0,
            variation: 0.4,
        };
        for noise in [Noise::Brownian(octaves), Noise::Wrinkled(octaves), Noise::Windy, marble] {
            let texture = Texture::from(Pattern::Noise {
                noise,
                to_local: Transform::default(),
                most: 1.0,
            });
            let (mut low, mut high) = (f32::MAX, f32::MIN);
            for i in 0..1000 {
                let t = i as f32 * 0.173;
                let value = texture.eval(&place(t, 0.7 * t - 3.0, -0.3 * t));
                assert!(value.is_valid() && value.max_component() <= 1.0);
                (low, high) = (low.min(value[0]), high.max(value[0]));
            }
            assert!(high > low + 0.1, "{noise:?} {low} {high}");
            for x in [f32::MAX, 1e30, -1e9, f32::NAN, f32::INFINITY] {
                let value = texture.eval(&place(x, 0.0, 0.0));
                assert!(value.is_valid(), "{noise:?} {x} {value:?}");
            }
            let mean = texture.mean();
            assert!(
                mean.is_valid() && mean.max_component() < 1.0 && mean[0] > 0.01,
                "{noise:?} {mean:?}"
            );
        }
    }
}

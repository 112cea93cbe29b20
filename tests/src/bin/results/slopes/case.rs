//! What is measured: scenes whose radiance and whose kernel averages are known, and the exponents that theory gives.

use anyhow::Result;
use photonfarm_core::integrator::{Bandwidth, bandwidth};
use photonfarm_core::material::{Tangents, TransportMode};
use photonfarm_core::math::{Frame, Vec2, Vec3};
use photonfarm_core::random::Sampling;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{DirectionSampler, IntegratorSettings, LookupVertex, PcfSettings, PppmSettings};
use photonfarm_core::texture::TexturePoint;
use photonfarm_tests::scenes::{self, View};
use std::f64::consts::{PI, TAU};

/// First spatial bandwidth [scene units].
const SIGMA1: f32 = 0.6;

/// First angular bandwidth \[degrees\].
const THETA1: f32 = 12.0;

/// Height of the spot light's image above the floor [scene units].
const HEIGHT: f64 = 1.5;

/// What radiance on the floor depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Varies {
    /// Position alone: a diffuse floor under a spot light, by way of a mirror. The radiance looked at is 1.
    WithPosition,
    /// Direction alone: a rough mirror under a directional light.
    WithDirection,
}

impl Varies {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::WithPosition => "position",
            Self::WithDirection => "direction",
        }
    }

    /// The camera looks at the origin from far away, so that every point of the kernel's disc sees it in the same direction.
    pub(super) fn scene(self) -> Result<Scene> {
        let (camera, shapes) = match self {
            Self::WithPosition => (
                "70, 70, 0",
                format!(
                    r#"<shape type="disk">
                        <transform name="to_world"><scale value="1.2"/><rotate x="1" angle="-90"/></transform>
                        <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>
                    </shape>
                    <shape type="disk">
                        <transform name="to_world">
                            <scale value="0.3"/><rotate x="1" angle="90"/><translate y="1"/>
                        </transform>
                        <bsdf type="conductor"/>
                    </shape>
                    <emitter type="spot">
                        <transform name="to_world"><lookat origin="0, 0.5, 0" target="0, 1, 0" up="1, 0, 0"/></transform>
                        <rgb name="intensity" value="{}"/>
                        <float name="beam_width" value="25"/><float name="cutoff_angle" value="26"/>
                    </emitter>"#,
                    HEIGHT * HEIGHT * PI / 0.5
                ),
            ),
            Self::WithDirection => (
                "34.2, 93.97, 0",
                r#"<shape type="disk">
                    <transform name="to_world"><scale value="0.7"/><rotate x="1" angle="-90"/></transform>
                    <bsdf type="roughconductor">
                        <string name="distribution" value="ggx"/><float name="alpha" value="0.2"/>
                    </bsdf>
                </shape>
                <emitter type="directional">
                    <vector name="direction" x="0.342" y="-0.9397" z="0"/>
                    <rgb name="irradiance" value="1"/>
                </emitter>"#
                    .to_owned(),
            ),
        };
        let view = View {
            origin: camera,
            target: "0, 0, 0",
            up: "0, 0, 1",
            fov: 0.01,
            resolution: [1, 1],
        };
        scenes::seen(&view, &shapes)
    }

    /// Edges of the only paths that carry light.
    fn edges(self) -> u32 {
        match self {
            Self::WithPosition => 3,
            Self::WithDirection => 2,
        }
    }

    /// Radiance that the camera sees, without kernels.
    pub(super) fn truth(self, scene: &Scene) -> f64 {
        match self {
            Self::WithPosition => 1.0,
            Self::WithDirection => rough_mirror(scene, 0.0),
        }
    }

    /// Share of light paths that land in the disc of radius `sigma` about the point looked at.
    fn share_of_disc(self, sigma: f64) -> f64 {
        match self {
            // The spot's paths fill its cutoff angle of 26 degrees evenly.
            Self::WithPosition => (1.0 - (sigma / HEIGHT).atan().cos()) / (1.0 - 26.0_f64.to_radians().cos()),
            // The directional light's paths fill the disc around the scene, of radius 0.7 sqrt(2), evenly.
            Self::WithDirection => sigma * sigma * 20.0_f64.to_radians().cos() / (0.7 * 0.7 * 2.0),
        }
    }

    /// Mean of an estimate with kernels of this size: the mean of radiance over the kernel.
    pub(super) fn kernel_mean(self, scene: &Scene, kernel: Bandwidth) -> f64 {
        match self {
            // Radiance at distance r from the middle is (1 + r^2 / h^2)^(-3/2); over a disc that has a closed form.
            Self::WithPosition => {
                let s = (f64::from(kernel.sigma) / HEIGHT).powi(2);
                2.0 / s * (1.0 - 1.0 / (1.0 + s).sqrt())
            }
            Self::WithDirection => rough_mirror(scene, f64::from(kernel.theta)),
        }
    }
}

/// Cones within the kernel that have the variance of one path's cones, when they are aimed at the camera: for weights `1 / pdf`
/// under the lobe `exp(-2 u)`, `u = (1 - cos) / (1 - cos theta)`, one over the mean of `exp(2 u) / 2` for `u` in [0, 1].
const AIMED_SHARE: f64 = 0.626;

/// Radiance of the rough mirror towards the camera, averaged over directions up to `theta` from there.
fn rough_mirror(scene: &Scene, theta: f64) -> f64 {
    const RINGS: u32 = 12;
    const SPOKES: u32 = 12;
    let axis = Vec3::new(0.342, 0.0, 0.9397).normalize();
    let to_light = Vec3::new(-0.342, 0.0, 0.9397).normalize();
    let frame = Frame::from_normal(axis);
    let at = TexturePoint::of_uv(Vec2::ZERO);
    let tangents = || Tangents {
        du: Vec3::X,
        dv: Vec3::Y,
    };
    let radiance = |wo: Vec3| {
        let f = scene.materials[0]
            .resolve_on(&at, wo, &tangents)
            .f(wo, to_light, TransportMode::Radiance);
        f64::from(f.luminance()) * f64::from(to_light.z)
    };
    if theta == 0.0 {
        return radiance(axis);
    }
    let mut sum = 0.0;
    for ring in 0..RINGS {
        // Rings of equal solid angle: the middle of each.
        let one_minus_cos = (f64::from(ring) + 0.5) / f64::from(RINGS) * (1.0 - theta.cos());
        let (cos, sin) = (1.0 - one_minus_cos, (one_minus_cos * (2.0 - one_minus_cos)).sqrt());
        for spoke in 0..SPOKES {
            let phi = TAU * (f64::from(spoke) + 0.5) / f64::from(SPOKES);
            let local = Vec3::new((sin * phi.cos()) as f32, (sin * phi.sin()) as f32, cos as f32);
            sum += radiance(frame.to_world(local));
        }
    }
    sum / f64::from(RINGS * SPOKES)
}

/// An estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Method {
    /// `pppm`.
    Pppm,
    /// `pcf` at the first camera vertex.
    Pcf {
        /// Order of the angular bandwidth.
        p: f32,
        /// Whether cones are aimed at the camera as well.
        aimed: bool,
    },
}

/// One estimator on one scene with one schedule.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case {
    pub(super) varies: Varies,
    pub(super) method: Method,
    pub(super) alpha: f32,
    /// Light paths per iteration.
    pub(super) photons: u32,
}

/// Exponents of `N` in the limit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exponents {
    pub(crate) bias: f64,
    pub(crate) variance: f64,
}

impl Case {
    pub(super) fn name(&self) -> String {
        match self.method {
            Method::Pppm => format!("pppm, alpha {}", number(self.alpha)),
            Method::Pcf { p, aimed } => {
                let samplers = if aimed { "bsdf and camera" } else { "bsdf" };
                format!("{samplers}, alpha {}, p {}", number(self.alpha), number(p))
            }
        }
    }

    pub(super) fn settings(&self) -> IntegratorSettings {
        let max_depth = Some(self.varies.edges());
        match self.method {
            Method::Pppm => IntegratorSettings::Pppm(PppmSettings {
                photons: self.photons,
                samples: 1,
                alpha: self.alpha,
                sampling: Sampling::Independent,
                sigma1: Some(SIGMA1),
                max_depth,
                ..Default::default()
            }),
            Method::Pcf { p, aimed } => IntegratorSettings::Pcf(PcfSettings {
                photons: self.photons,
                samples: 1,
                alpha: self.alpha,
                p,
                sampling: Sampling::Independent,
                sigma1: Some(SIGMA1),
                theta1: THETA1,
                lookup_vertex: LookupVertex::Fixed(1),
                samplers: if aimed {
                    vec![DirectionSampler::Bsdf, DirectionSampler::Camera]
                } else {
                    vec![DirectionSampler::Bsdf]
                },
                max_depth,
                ..Default::default()
            }),
        }
    }

    /// The exponents of the papers: variance `-alpha`, bias `(alpha - 1) / (p + 1)` for `pcf` (Chang 2019) and `alpha - 1` for
    /// `pppm` (Knaus and Zwicker 2011).
    pub(crate) fn published(&self) -> Exponents {
        let alpha = f64::from(self.alpha);
        let p = match self.method {
            Method::Pppm => 0.0,
            Method::Pcf { p, .. } => f64::from(p),
        };
        Exponents {
            bias: (alpha - 1.0) / (p + 1.0),
            variance: -alpha,
        }
    }

    /// The exponents of this scene and these samplers, in the limit.
    ///
    /// The published bias is that of its slower part, `sigma^2`. Where radiance does not depend on position only `theta^2` is left,
    /// which shrinks `p` times as fast. The published variance is one over the kernel's volume, which supposes that cones
    /// point wherever the material sends them. Aimed at the camera within a lobe as wide as `theta`, their density grows as
    /// `theta^-2`, and one over the disc's area is left.
    pub(crate) fn refined(&self) -> Exponents {
        let published = self.published();
        let Method::Pcf { p, aimed } = self.method else {
            return published;
        };
        let directional = self.varies == Varies::WithDirection;
        Exponents {
            bias: published.bias * if directional { f64::from(p) } else { 1.0 },
            variance: if aimed {
                -1.0 - published.bias
            } else {
                published.variance
            },
        }
    }

    /// Whether its bias is worth a line: it does not depend on how cones are aimed, and noise is least where they are.
    pub(super) fn shows_bias(&self) -> bool {
        !matches!(self.method, Method::Pcf { aimed: false, .. })
    }

    /// Share of light paths whose record lies within the kernel.
    ///
    /// A path that lands in the disc leaves its cone within `theta` of the camera with probability `cos(45 degrees) sin^2 theta` if the
    /// diffuse material chooses; aimed, the cones of a path do as well together as [`AIMED_SHARE`] of a cone within `theta`.
    fn share(&self, kernel: Bandwidth) -> f64 {
        let direction = match self.method {
            Method::Pppm => 1.0,
            Method::Pcf { aimed: true, .. } => AIMED_SHARE,
            Method::Pcf { aimed: false, .. } => 0.5_f64.sqrt() * f64::from(kernel.theta).sin().powi(2),
        };
        self.varies.share_of_disc(f64::from(kernel.sigma)) * direction
    }

    /// Bias over the true value, and variance up to a factor, of the averages over `counts` iterations as [`Self::refined`]
    /// has them, without the limit: from the kernel's size in each iteration. A path counts with probability `q`, the
    /// share of paths in the kernel, so an iteration's variance over its squared mean is in proportion to `1 / q - 1`.
    pub(super) fn predicted(&self, scene: &Scene, counts: &[u32]) -> (Vec<f64>, Vec<f64>) {
        let settings = self.settings();
        let truth = self.varies.truth(scene);
        let (mut bias, mut variance) = (0.0, 0.0);
        let last = *counts.last().expect("a number of iterations");
        let mut curves = (Vec::new(), Vec::new());
        for i in 1..=last {
            let kernel = bandwidth(scene, &settings, i).expect("the integrator has kernels");
            let mean = self.varies.kernel_mean(scene, kernel) / truth;
            bias += mean - 1.0;
            variance += mean * mean * (1.0 / self.share(kernel) - 1.0);
            if counts.contains(&i) {
                let n = f64::from(i);
                curves.0.push(bias / n);
                curves.1.push(variance / (n * n));
            }
        }
        curves
    }
}

/// A setting as people write it: thirds as fractions.
pub(super) fn number(value: f32) -> String {
    if value == 2.0 / 3.0 {
        "2/3".into()
    } else {
        value.to_string()
    }
}

//! A BSDF in a frame that is tilted against the surface's: Mitsuba's `normalmap` and `bumpmap`.

use super::{Bsdf, BsdfSample, GRAZING, Lobe, TransportMode};
use crate::math::{FRAC_1_PI, Frame, ONE_MINUS_EPSILON, Vec2, Vec3, sqr};
use crate::spectrum::Spectrum;

/// How a tilted frame keeps to the surface that is there (both as in Mitsuba 3.9).
#[derive(Clone, Copy, Debug)]
pub struct Tilt {
    /// A normal that the camera's side does not see is mirrored about the surface's (Schüssler et al. 2017, "Microfacet-based
    /// Normal Mapping for Robust Monte Carlo Path Tracing").
    pub flip_invalid_normals: bool,
    /// Light at grazing angles is weakened, as microfacets that lean as far would (Conty Estevez et al. 2019, "A Microfacet-Based
    /// Shadowing Function to Solve the Bump Terminator Problem").
    pub shadowing: bool,
}

/// A BSDF `g` in a tilted frame, whose normal is `n'`.
///
/// What the tilted surface scatters falls with the cosine of its own normal, and callers multiply by that of the surface's. So
/// `f = g |n' . l| / |n . l|`, with `l` the direction to the light: `wi` in radiance and `wo` in flux, which makes the two
/// modes adjoint: `f(wo, wi, Radiance) = f(wi, wo, Flux)`. Where a direction lies on one side of the surface and on the other of the tilted
/// one, nothing is scattered.
///
/// Where invalid normals are mirrored, the frame depends on where the camera is, which a light path does not know when it samples `wi`. So both frames
/// are sampled: that for a camera at `wo` mostly, and the other one with the probability [`Self::other`].
#[derive(Clone, Debug)]
pub(super) struct Perturbed {
    nested: Bsdf,
    /// The tilted normal, of unit length, in the surface's frame.
    normal: Vec3,
    tilt: Tilt,
}

impl Perturbed {
    /// `normal` need not have unit length; without a direction it is the surface's.
    pub(super) fn new(nested: Bsdf, normal: Vec3, tilt: Tilt) -> Self {
        Self {
            nested,
            normal: normal.try_normalize().unwrap_or(Vec3::Z),
            tilt,
        }
    }

    /// How often the frame is sampled that is not the one for a camera at `wo`: about the share of directions that see the mirrored
    /// normal, the angle between both normals over pi.
    fn other(&self) -> f32 {
        match self.tilt.flip_invalid_normals {
            true => Vec2::new(self.normal.x, self.normal.y).length() * FRAC_1_PI,
            false => 0.0,
        }
    }

    /// Whether the normal is mirrored for a camera in the direction `w`.
    fn flips(&self, w: Vec3) -> bool {
        self.tilt.flip_invalid_normals && w.z * w.dot(self.normal) <= 0.0
    }

    /// The tilted frame, whose normal is mirrored or not; its first axis is nearest to the surface's.
    fn frame(&self, mirrored: bool) -> Frame {
        let n = match mirrored {
            true => Vec3::new(-self.normal.x, -self.normal.y, self.normal.z),
            false => self.normal,
        };
        let s = (Vec3::X - n * n.x).try_normalize().unwrap_or(Vec3::Y);
        Frame { s, t: n.cross(s), n }
    }

    /// What `g` is multiplied by for light from `l`, which the frame sees as `l_tilted`.
    fn factor(&self, frame: &Frame, l: Vec3, l_tilted: Vec3) -> f32 {
        let shadowing = if self.tilt.shadowing {
            shadowing(frame.n, l)
        } else {
            1.0
        };
        shadowing * (l_tilted.z / l.z).abs()
    }

    /// As [`Bsdf::f`].
    pub(super) fn f(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> Spectrum {
        let (camera, light) = match mode {
            TransportMode::Radiance => (wo, wi),
            TransportMode::Flux => (wi, wo),
        };
        let frame = self.frame(self.flips(camera));
        let (wo_tilted, wi_tilted) = (frame.to_local(wo), frame.to_local(wi));
        if !same_side(wo, wo_tilted) || !same_side(wi, wi_tilted) {
            return Spectrum::ZERO;
        }
        self.nested.f(wo_tilted, wi_tilted, mode) * self.factor(&frame, light, frame.to_local(light))
    }

    /// As [`Bsdf::pdf`].
    pub(super) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let (mirrored, other) = (self.flips(wo), self.other());
        let of = |mirrored: bool| {
            let frame = self.frame(mirrored);
            let (wo_tilted, wi_tilted) = (frame.to_local(wo), frame.to_local(wi));
            match same_side(wo, wo_tilted) && same_side(wi, wi_tilted) {
                true => self.nested.pdf(wo_tilted, wi_tilted),
                false => 0.0,
            }
        };
        let pdf = of(mirrored);
        match other > 0.0 {
            true => (1.0 - other) * pdf + other * of(!mirrored),
            false => pdf,
        }
    }

    /// As [`Bsdf::draw`].
    pub(super) fn draw(&self, wo: Vec3, lobe: f32, u: Vec2, mode: TransportMode) -> Option<BsdfSample> {
        let (camera_at_wo, other) = (self.flips(wo), self.other());
        let (mirrored, lobe) = match lobe < other {
            true => (!camera_at_wo, lobe / other),
            false => (camera_at_wo, (lobe - other) / (1.0 - other)),
        };
        let frame = self.frame(mirrored);
        let wo_tilted = frame.to_local(wo);
        if !same_side(wo, wo_tilted) {
            return None;
        }
        let sample = self.nested.draw(wo_tilted, lobe.min(ONE_MINUS_EPSILON), u, mode)?;
        let wi = frame.to_world(sample.wi);
        if !same_side(wi, sample.wi) {
            return None;
        }
        if !sample.delta {
            return Some(BsdfSample {
                wi,
                f: self.f(wo, wi, mode),
                pdf: self.pdf(wo, wi),
                ..sample
            });
        }
        let camera_at_wi = self.flips(wi);
        let (light, light_tilted, seen) = match mode {
            TransportMode::Radiance => (wi, sample.wi, camera_at_wo == mirrored),
            TransportMode::Flux => (wo, wo_tilted, camera_at_wi == mirrored),
        };
        let f = match seen {
            true => sample.f * self.factor(&frame, light, light_tilted),
            false => Spectrum::ZERO,
        };
        let probability = |camera: bool| if camera == mirrored { 1.0 - other } else { other };
        let tilt = ((wo_tilted.z * wi.z) / (sample.wi.z * wo.z)).abs();
        Some(BsdfSample {
            wi,
            f,
            pdf: sample.pdf * probability(camera_at_wo),
            reversal: sample.reversal * tilt * probability(camera_at_wi) / probability(camera_at_wo),
            ..sample
        })
    }

    /// As [`Bsdf::immerse`].
    pub(super) fn immerse(&mut self, index: f32) {
        self.nested.immerse(index);
    }

    /// As [`Bsdf::each_lobe`].
    pub(super) fn each_lobe(&self, visit: &mut dyn FnMut(&Lobe)) {
        self.nested.each_lobe(&mut |lobe| visit(lobe));
    }
}

/// Whether a direction is on the same side of the surface and, as `tilted` says, of the tilted one, and on neither grazes.
fn same_side(w: Vec3, tilted: Vec3) -> bool {
    w.z * tilted.z > 0.0 && w.z.abs() > GRAZING && tilted.z.abs() > GRAZING
}

/// Smith's masking of GGX for the direction `l`, with a roughness that follows from the tilt of the normal: `alpha^2 = tan^2 / 8`, at
/// most 1 (Conty Estevez et al. 2019).
fn shadowing(normal: Vec3, l: Vec3) -> f32 {
    let tan_squared = |w: Vec3| (sqr(w.x) + sqr(w.y)) / sqr(w.z);
    let alpha_squared = (0.125 * tan_squared(normal)).min(1.0);
    2.0 / (1.0 + (1.0 + alpha_squared * tan_squared(l)).sqrt())
}

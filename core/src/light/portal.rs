//! Portals: rectangles through which light from infinity comes in, as pbrt-v4's (`PortalImageInfiniteLight`).
//!
//! Light arrives at a point from a direction where the way into that direction passes the rectangle, against its outward normal, and
//! nowhere else. A light with a portal is sampled alone, and not in the mixture of the lights at infinity that have none.

use super::background::Background;
use super::{EmissionSample, LightId, LightSample, Origin};
use crate::geometry::Ray;
use crate::math::warp::square_to_cosine_hemisphere;
use crate::math::{DVec2, DVec3, FRAC_1_PI, Frame, PI, Transform, Vec3, to_unit_vec2};
use crate::spectrum::Spectrum;

/// What the cosine between edges that should be parallel may be short of one, and that of edges that should be perpendicular may be off
/// zero, as in pbrt-v4.
const SKEWNESS: f64 = 1e-3;

/// Share of the connections that look for what is bright beyond a portal rather than for the portal.
const BRIGHT: f64 = 0.5;

/// Solid angle \[sr\] below which a portal is sampled by area: the rounding of larger ones is below 1e-9.
const SMALL: f64 = 1e-6;

/// Roundings of the coordinates that lie between the two parts of the way of a light path, so that a surface in the plane of the portal
/// blocks one of them at least.
const OVERLAP: f32 = 4.0;

/// A rectangle that light passes to one side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Portal {
    corner: DVec3,
    /// Unit vectors: along the edges from the corner, and outwards, from where light comes.
    axes: [DVec3; 3],
    /// Lengths of the edges [scene units].
    lengths: DVec2,
}

impl Portal {
    /// The portal with the corners `[a, b, c, d]` [scene units], one after the other. Light comes from the side of `(d - a) x (b - a)`.
    /// `None` where they are not the corners of a rectangle.
    #[must_use]
    pub fn new(corners: [Vec3; 4]) -> Option<Self> {
        let [a, b, c, d] = corners.map(|corner| corner.as_dvec3());
        let edges = [b - a, c - b, c - d, d - a].map(|edge| edge.try_normalize());
        let [Some(ab), Some(bc), Some(dc), Some(ad)] = edges else {
            return None;
        };
        let parallel = |p: DVec3, q: DVec3| (p.dot(q) - 1.0).abs() <= SKEWNESS;
        let perpendicular = |p: DVec3, q: DVec3| p.dot(q).abs() <= SKEWNESS;
        let is_rectangle = parallel(ab, dc)
            && parallel(bc, ad)
            && perpendicular(ab, bc)
            && perpendicular(bc, dc)
            && perpendicular(dc, ad)
            && perpendicular(ad, ab);
        if !is_rectangle {
            return None;
        }
        let outwards = ad.cross(ab).normalize();
        let axes = [ad, outwards.cross(ad), outwards];
        // As in pbrt, two opposite corners say how large it is.
        let lengths = DVec2::new(axes[0].dot(c - a), axes[1].dot(c - a));
        (lengths.min_element() > 0.0).then_some(Self {
            corner: a,
            axes,
            lengths,
        })
    }

    /// Its area [scene units squared].
    #[must_use]
    pub fn area(&self) -> f32 {
        (self.lengths.x * self.lengths.y) as f32
    }

    /// Cosine between a unit vector and the outward normal.
    fn cos(&self, direction: Vec3) -> f32 {
        self.axes[2].dot(direction.as_dvec3()) as f32
    }

    /// Whether the ray from `from` goes out through it.
    fn is_passed(&self, from: Vec3, direction: Vec3) -> bool {
        let direction = direction.as_dvec3();
        let [x, y, z] = self.axes.map(|axis| axis.dot(direction));
        let [x0, y0, height] = self.from(from);
        if z <= 0.0 || height <= 0.0 {
            return false;
        }
        let way = height / z;
        (0.0..=self.lengths.x).contains(&(x * way - x0)) && (0.0..=self.lengths.y).contains(&(y * way - y0))
    }

    /// The corner as seen from a point, along the axes.
    fn from(&self, from: Vec3) -> [f64; 3] {
        self.axes.map(|axis| axis.dot(self.corner - from.as_dvec3()))
    }

    /// As it is seen from a point; `None` from outside.
    fn seen(&self, from: Vec3) -> Option<Seen<'_>> {
        let [x, y, height] = self.from(from);
        (height > 0.0).then(|| Seen::new(self, [x, x + self.lengths.x], [y, y + self.lengths.y], height))
    }

    /// A point of it.
    fn point(&self, u: DVec2) -> Vec3 {
        let along = u * self.lengths;
        (self.corner + along.x * self.axes[0] + along.y * self.axes[1]).as_vec3()
    }
}

/// A portal as it is seen from a point, to be sampled by solid angle (Urena, Fajardo and King 2013, "An area-preserving parametrization
/// for spherical rectangles"). Places are relative to the point, along the axes of the portal.
#[derive(Debug)]
struct Seen<'a> {
    portal: &'a Portal,
    x: [f64; 2],
    y: [f64; 2],
    height: f64,
    /// Solid angle of what lies between x = 0 and its lower end in x, negative where that end is below 0 \[sr\].
    before: f64,
    solid_angle: f64,
}

impl<'a> Seen<'a> {
    fn new(portal: &'a Portal, x: [f64; 2], y: [f64; 2], height: f64) -> Self {
        // Solid angle of the rectangle between the foot of the point and a corner.
        let quarter = |x: f64, y: f64| libm::atan2(x * y, height * (x * x + y * y + height * height).sqrt());
        let strip = |x: f64| quarter(x, y[1]) - quarter(x, y[0]);
        let [before, after] = x.map(strip);
        Self {
            portal,
            x,
            y,
            height,
            before,
            solid_angle: after - before,
        }
    }

    /// A unit direction to it with density [`Self::pdf`].
    fn sample(&self, u: DVec2) -> Vec3 {
        let local = if self.solid_angle < SMALL {
            let lengths = self.portal.lengths;
            DVec2::new(self.x[0] + u.x * lengths.x, self.y[0] + u.y * lengths.y)
        } else {
            self.sample_by_solid_angle(u)
        };
        let [x, y, z] = self.portal.axes;
        (local.x * x + local.y * y + self.height * z).normalize().as_vec3()
    }

    fn sample_by_solid_angle(&self, u: DVec2) -> DVec2 {
        let ([x0, x1], [y0, y1], height2) = (self.x, self.y, self.height * self.height);
        let [b0, b1] = [y0, y1].map(|y| y / (y * y + height2).sqrt());
        // The angle whose strip from x = 0 on has the share of the solid angle; its sine is 0 at x = 0.
        let angle = self.before + u.x * self.solid_angle;
        let slope = (b1 - libm::cos(angle) * b0) / libm::sin(angle);
        let sine = (1.0 / (slope * slope + b0 * b0).sqrt()).copysign(slope);
        let x = (sine * self.height / (1.0 - sine * sine).max(0.0).sqrt()).clamp(x0, x1);
        let distance2 = x * x + height2;
        let [h0, h1] = [y0, y1].map(|y| y / (distance2 + y * y).sqrt());
        let h = h0 + u.y * (h1 - h0);
        let y = h * (distance2 / (1.0 - h * h).max(f64::MIN_POSITIVE)).sqrt();
        DVec2::new(x, y.clamp(y0, y1))
    }

    /// Solid-angle density [1/sr] of a direction that meets it.
    fn pdf(&self, direction: Vec3) -> f32 {
        if self.solid_angle >= SMALL {
            return (1.0 / self.solid_angle) as f32;
        }
        let cos = self.portal.axes[2].dot(direction.as_dvec3());
        let distance = self.height / cos;
        (distance * distance / (self.portal.lengths.x * self.portal.lengths.y * cos)) as f32
    }
}

/// A light at infinity that shines through a portal alone. Directions are unit vectors towards the light.
#[derive(Clone, Debug)]
pub(super) struct Opening {
    portal: Portal,
    beyond: Background,
}

impl Opening {
    pub(super) fn new(portal: Portal, beyond: Background) -> Self {
        Self { portal, beyond }
    }

    /// What is beyond where `to_world` puts it; the portal stays where it is.
    pub(super) fn moved(&self, to_world: &Transform) -> Self {
        Self::new(self.portal, self.beyond.moved(to_world))
    }

    /// Whether light from `direction` can arrive at `from`.
    pub(super) fn is_passed(&self, from: Vec3, direction: Vec3) -> bool {
        self.portal.is_passed(from, direction)
    }

    /// Radiance that arrives from `direction` where light can [W/(m^2 sr)].
    pub(super) fn radiance(&self, direction: Vec3) -> Spectrum {
        self.beyond.radiance(direction)
    }

    /// Share of the connections that are sampled as what is beyond; none where every direction is as bright.
    fn bright_share(&self) -> f64 {
        match self.beyond {
            Background::Constant(_) => 0.0,
            Background::Environment(_) | Background::Sun(_) => BRIGHT,
        }
    }

    /// A direction from `from` with density [`Self::pdf`], which may miss the portal; `None` where no light arrives.
    fn sample(&self, from: Vec3, mut u: DVec2) -> Option<Vec3> {
        let seen = self.portal.seen(from)?;
        let bright = self.bright_share();
        if u.x < bright {
            u.x /= bright;
            return self.beyond.sample(u);
        }
        u.x = (u.x - bright) / (1.0 - bright);
        Some(seen.sample(u))
    }

    /// Solid-angle density [1/sr] of a direction that passes the portal, as seen from `from`.
    pub(super) fn pdf(&self, from: Vec3, direction: Vec3) -> f32 {
        let Some(seen) = self.portal.seen(from) else {
            return 0.0;
        };
        let bright = self.bright_share() as f32;
        let portal = (1.0 - bright) * seen.pdf(direction);
        if bright > 0.0 {
            portal + bright * self.beyond.pdf(direction)
        } else {
            portal
        }
    }

    /// Connects `from` with the light, which is chosen with `probability`.
    #[inline(never)]
    pub(super) fn connect(&self, probability: f32, from: Vec3, u: DVec2) -> Option<LightSample> {
        let wi = self.sample(from, u).filter(|wi| self.is_passed(from, *wi))?;
        let pdf = self.pdf(from, wi);
        Some(LightSample {
            wi,
            distance: f32::INFINITY,
            radiance: self.radiance(wi),
            pdf: pdf * probability,
            delta: false,
            arrival: self.pdf_emission(wi) / pdf,
        })
    }

    /// Starts a light path on the portal. `probability` is that of choosing this light, `light`.
    #[inline(never)]
    pub(super) fn emit(
        &self,
        (light, probability): (LightId, f32),
        u_position: DVec2,
        u_direction: DVec2,
    ) -> Option<EmissionSample> {
        let outwards = self.portal.axes[2].as_vec3();
        let towards = match self.beyond {
            Background::Constant(_) => {
                let local = square_to_cosine_hemisphere(to_unit_vec2(u_direction));
                Frame::from_normal(outwards).to_world(local).normalize()
            }
            Background::Environment(_) | Background::Sun(_) => self.beyond.sample(u_direction)?,
        };
        let pdf_direction = probability * self.pdf_direction(towards);
        if pdf_direction <= 0.0 {
            return None;
        }
        let across = self.across(towards);
        Some(EmissionSample {
            ray: Ray {
                origin: self.portal.point(u_position),
                direction: -towards,
                max_distance: f32::INFINITY,
            },
            flux: self.beyond.radiance(towards) * (across / pdf_direction),
            origin: Origin::Portal(light),
            pdf_position: 1.0 / across,
            pdf_direction,
        })
    }

    /// The way back to infinity from where the ray of a light path begins.
    pub(super) fn way_before(&self, ray: &Ray) -> Ray {
        let overlap = OVERLAP * f32::EPSILON * ray.origin.abs().max_element();
        Ray {
            origin: ray.origin - overlap * self.portal.axes[2].as_vec3(),
            direction: -ray.direction,
            ..*ray
        }
    }

    /// Area of the portal as it faces `direction` [scene units squared].
    fn across(&self, direction: Vec3) -> f32 {
        self.portal.area() * self.portal.cos(direction)
    }

    /// Solid-angle density [1/sr] with which a light path comes from `direction`.
    fn pdf_direction(&self, direction: Vec3) -> f32 {
        let cos = self.portal.cos(direction);
        match self.beyond {
            _ if cos <= 0.0 => 0.0,
            Background::Constant(_) => cos * FRAC_1_PI,
            Background::Environment(_) | Background::Sun(_) => self.beyond.pdf(direction),
        }
    }

    /// Density of light paths that come from `direction`: by solid angle, and by area that faces it [1/(sr unit^2)].
    pub(super) fn pdf_emission(&self, direction: Vec3) -> f32 {
        self.pdf_direction(direction) / self.across(direction)
    }

    /// Luminous part of the power that comes through, as if all directions were as bright as in the mean.
    pub(super) fn power(&self) -> f32 {
        self.beyond.mean_luminance() * PI * self.portal.area()
    }

    /// Density with which a connection at `from` is made with the direction that a light path comes from, over that with which the path
    /// does.
    pub(super) fn connection_over_emission(&self, from: Vec3, direction: Vec3) -> f32 {
        self.pdf(from, direction) / self.pdf_direction(direction)
    }
}

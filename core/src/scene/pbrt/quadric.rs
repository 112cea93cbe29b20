//! Spheres, discs, cylinders, cones, paraboloids and hyperboloids, whole or cut.

use super::Reading;
use super::grid::{ALONG, Profile, Revolution, columns, patch};
use super::parameter::Parameters;
use super::shape::Made;
use crate::scene::description::Value;
use crate::scene::error::SceneError;
use glam::{DMat4, DVec3};
use std::f64::consts::TAU;

impl Reading<'_, '_> {
    /// How far a shape goes about its axis \[radians\], at most around.
    fn phi_max(&self, parameters: &Parameters) -> Result<f64, SceneError> {
        Ok(parameters.positive_or("phimax", 360.0)?.min(360.0).to_radians())
    }

    /// Adds what a profile sweeps about the axis, as a mesh. A light has the whole of it.
    fn revolution(
        &mut self,
        parameters: &Parameters,
        curved: bool,
        phi_max: f64,
        profile: impl Fn(f64) -> Profile,
    ) -> Result<Option<Made>, SceneError> {
        let surface = Revolution {
            profile,
            curved,
            phi_max,
        };
        let made = self.add_mesh(parameters, surface.mesh(), self.turned())?;
        Ok(made.map(|made| Made { lights: 1, ..made }))
    }

    pub(super) fn sphere(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let radius = parameters.positive_or("radius", 1.0)?;
        let z_min = parameters.float_or("zmin", -radius)?.clamp(-radius, radius);
        let z_max = parameters.float_or("zmax", radius)?.clamp(-radius, radius);
        let (z_min, z_max) = (z_min.min(z_max), z_min.max(z_max));
        let phi_max = self.phi_max(parameters)?;
        let whole = phi_max == TAU && z_min == -radius && z_max == radius;
        if whole && !self.is_textured(parameters)? && self.state.to_world.iter().all(|matrix| scales_evenly(*matrix)) {
            // Our sphere is turned over by a mirroring, as pbrt's is.
            let flip = self.state.reverse_orientation;
            let shape = self.add_shape("sphere", parameters, DMat4::IDENTITY, flip)?;
            self.draft.set(shape, "radius", Value::Float(radius));
            return Ok(Some(Made {
                object: shape,
                lights: 1,
            }));
        }
        let [theta_min, theta_max] = [z_min, z_max].map(|z| libm::acos((z / radius).clamp(-1.0, 1.0)));
        let profile = |v: f64| {
            let (sin, cos) = libm::sincos(theta_min + (theta_max - theta_min) * v);
            Profile {
                r: radius * sin,
                z: radius * cos,
                normal: [sin, cos],
            }
        };
        self.revolution(parameters, true, phi_max, profile)
    }

    pub(super) fn disk(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let height = parameters.float_or("height", 0.0)?;
        let radius = parameters.positive_or("radius", 1.0)?;
        let inner = parameters.float_or("innerradius", 0.0)?.clamp(0.0, radius);
        let phi_max = self.phi_max(parameters)?;
        if inner == 0.0 && phi_max == TAU && !self.is_textured(parameters)? {
            let placed =
                DMat4::from_translation(DVec3::Z * height) * DMat4::from_scale(DVec3::new(radius, radius, 1.0));
            let shape = self.add_shape("disk", parameters, placed, self.turned())?;
            return Ok(Some(Made {
                object: shape,
                lights: 1,
            }));
        }
        let profile = |v: f64| Profile {
            r: radius + (inner - radius) * v,
            z: height,
            normal: [0.0, 1.0],
        };
        self.revolution(parameters, false, phi_max, profile)
    }

    pub(super) fn cylinder(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let radius = parameters.positive_or("radius", 1.0)?;
        let [z_min, z_max] = [parameters.float_or("zmin", -1.0)?, parameters.float_or("zmax", 1.0)?];
        let (z_min, z_max) = (z_min.min(z_max), z_min.max(z_max));
        if z_min == z_max {
            return parameters.fault("zmax", "the cylinder has no height");
        }
        let phi_max = self.phi_max(parameters)?;
        let profile = |v: f64| Profile {
            r: radius,
            z: z_min + (z_max - z_min) * v,
            normal: [1.0, 0.0],
        };
        self.revolution(parameters, false, phi_max, profile)
    }

    pub(super) fn cone(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let radius = parameters.positive_or("radius", 1.0)?;
        let height = parameters.positive_or("height", 1.0)?;
        let phi_max = self.phi_max(parameters)?;
        let profile = |v: f64| Profile {
            r: radius * (1.0 - v),
            z: height * v,
            normal: [height, radius],
        };
        self.revolution(parameters, false, phi_max, profile)
    }

    /// What a line from `p1` to `p2` sweeps about the axis.
    pub(super) fn hyperboloid(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let p1 = parameters.vector("p1")?.unwrap_or(DVec3::ZERO);
        let p2 = parameters.vector("p2")?.unwrap_or(DVec3::ONE);
        let phi_max = self.phi_max(parameters)?;
        let on_axis = |p: DVec3| p.x == 0.0 && p.y == 0.0;
        if p1 == p2 || (on_axis(p1) && on_axis(p2)) {
            return parameters.fault("p2", "the line from `p1` has no length, or is the axis");
        }
        let along = p2 - p1;
        let mesh = patch(columns(phi_max), ALONG, |u, v| {
            let (sin, cos) = libm::sincos(u * phi_max);
            let turn = |p: DVec3| DVec3::new(p.x * cos - p.y * sin, p.x * sin + p.y * cos, p.z);
            let (point, up) = (turn(p1 + along * v), turn(along));
            let about = DVec3::new(-point.y, point.x, 0.0);
            (point, about.cross(up))
        });
        let made = self.add_mesh(parameters, mesh, self.turned())?;
        Ok(made.map(|made| Made { lights: 1, ..made }))
    }

    pub(super) fn paraboloid(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let radius = parameters.positive_or("radius", 1.0)?;
        let [z_min, z_max] = [parameters.float_or("zmin", 0.0)?, parameters.float_or("zmax", 1.0)?];
        let (z_min, z_max) = (z_min.min(z_max).max(0.0), z_min.max(z_max));
        if z_min >= z_max {
            return parameters.fault("zmax", "the paraboloid has no height above 0");
        }
        let phi_max = self.phi_max(parameters)?;
        // z = k r^2.
        let k = z_max / (radius * radius);
        let profile = |v: f64| {
            let z = z_min + (z_max - z_min) * v;
            let r = (z / k).sqrt();
            Profile {
                r,
                z,
                normal: [2.0 * k * r, -1.0],
            }
        };
        self.revolution(parameters, true, phi_max, profile)
    }
}

/// Whether a map scales by the same factor in all directions.
fn scales_evenly(matrix: DMat4) -> bool {
    let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|axis| axis.truncate());
    let scale = axes[0].length();
    let even = axes.iter().all(|axis| (axis.length() - scale).abs() <= 1e-4 * scale);
    let square = (0..3).all(|i| axes[i].dot(axes[(i + 1) % 3]).abs() <= 1e-4 * scale * scale);
    even && square && scale > 0.0
}

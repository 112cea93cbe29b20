//! Spheres, discs, cylinders, cones and paraboloids, whole or cut.

use super::Reading;
use super::grid::{Profile, Revolution};
use super::parameter::Parameters;
use super::shape::Made;
use crate::scene::description::Value;
use crate::scene::error::SceneError;
use glam::{DMat4, DVec3};
use std::f64::consts::TAU;

impl Reading<'_, '_> {
    /// How far a shape goes about its axis [radians], at most around.
    fn phi_max(&self, parameters: &Parameters) -> Result<f64, SceneError> {
        Ok(parameters.positive_or("phimax", 360.0)?.min(360.0).to_radians())
    }

    /// Adds a surface of revolution as a mesh.
    fn revolution<F: Fn(f64) -> Profile>(
        &mut self,
        parameters: &Parameters,
        surface: &Revolution<F>,
        area: f64,
    ) -> Result<Option<Made>, SceneError> {
        let made = self.add_mesh(parameters, surface.mesh(), self.turned())?;
        // A light has the whole area, and not that of a triangle.
        Ok(made.map(|made| Made {
            area: self.world_area(area),
            ..made
        }))
    }

    /// The area in the world of a shape, where its transform scales evenly.
    fn world_area(&self, area: f64) -> Option<f64> {
        even_scale(self.state.to_world[0]).map(|scale| area * scale * scale)
    }

    pub(super) fn sphere(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let radius = parameters.positive_or("radius", 1.0)?;
        let z_min = parameters.float_or("zmin", -radius)?.clamp(-radius, radius);
        let z_max = parameters.float_or("zmax", radius)?.clamp(-radius, radius);
        let (z_min, z_max) = (z_min.min(z_max), z_min.max(z_max));
        let phi_max = self.phi_max(parameters)?;
        let area = phi_max * radius * (z_max - z_min);
        let whole = phi_max == TAU && z_min == -radius && z_max == radius;
        if whole
            && !self.is_textured(parameters)?
            && self.state.to_world.iter().all(|matrix| even_scale(*matrix).is_some())
        {
            // Our sphere is turned over by a mirroring, as pbrt's is.
            let flip = self.state.reverse_orientation;
            let shape = self.add_shape("sphere", parameters, DMat4::IDENTITY, flip)?;
            self.draft.set(shape, "radius", Value::Float(radius));
            return Ok(Some(Made {
                object: shape,
                area: self.world_area(area),
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
        self.revolution(
            parameters,
            &Revolution {
                profile,
                curved: true,
                phi_max,
            },
            area,
        )
    }

    pub(super) fn disk(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let height = parameters.float_or("height", 0.0)?;
        let radius = parameters.positive_or("radius", 1.0)?;
        let inner = parameters.float_or("innerradius", 0.0)?.clamp(0.0, radius);
        let phi_max = self.phi_max(parameters)?;
        let area = 0.5 * phi_max * (radius * radius - inner * inner);
        if inner == 0.0 && phi_max == TAU && !self.is_textured(parameters)? {
            let placed =
                DMat4::from_translation(DVec3::Z * height) * DMat4::from_scale(DVec3::new(radius, radius, 1.0));
            let shape = self.add_shape("disk", parameters, placed, self.turned())?;
            return Ok(Some(Made {
                object: shape,
                area: self.world_area(area),
            }));
        }
        let profile = |v: f64| Profile {
            r: radius + (inner - radius) * v,
            z: height,
            normal: [0.0, 1.0],
        };
        self.revolution(
            parameters,
            &Revolution {
                profile,
                curved: false,
                phi_max,
            },
            area,
        )
    }

    pub(super) fn cylinder(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let radius = parameters.positive_or("radius", 1.0)?;
        let [z_min, z_max] = [parameters.float_or("zmin", -1.0)?, parameters.float_or("zmax", 1.0)?];
        let (z_min, z_max) = (z_min.min(z_max), z_min.max(z_max));
        if z_min == z_max {
            return parameters.fault("zmax", "the cylinder has no height");
        }
        let phi_max = self.phi_max(parameters)?;
        let area = phi_max * radius * (z_max - z_min);
        let profile = |v: f64| Profile {
            r: radius,
            z: z_min + (z_max - z_min) * v,
            normal: [1.0, 0.0],
        };
        self.revolution(
            parameters,
            &Revolution {
                profile,
                curved: false,
                phi_max,
            },
            area,
        )
    }

    pub(super) fn cone(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let radius = parameters.positive_or("radius", 1.0)?;
        let height = parameters.positive_or("height", 1.0)?;
        let phi_max = self.phi_max(parameters)?;
        let side = libm::hypot(radius, height);
        let profile = |v: f64| Profile {
            r: radius * (1.0 - v),
            z: height * v,
            normal: [height, radius],
        };
        let area = 0.5 * phi_max * radius * side;
        self.revolution(
            parameters,
            &Revolution {
                profile,
                curved: false,
                phi_max,
            },
            area,
        )
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
        let part = |z: f64| {
            let root = (1.0 + 4.0 * k * z).sqrt();
            root * root * root
        };
        let area = phi_max / (12.0 * k * k) * (part(z_max) - part(z_min));
        self.revolution(
            parameters,
            &Revolution {
                profile,
                curved: true,
                phi_max,
            },
            area,
        )
    }
}

/// The factor by which a map scales, where it is the same in all directions.
fn even_scale(matrix: DMat4) -> Option<f64> {
    let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|axis| axis.truncate());
    let scale = axes[0].length();
    let even = axes.iter().all(|axis| (axis.length() - scale).abs() <= 1e-4 * scale);
    let square = (0..3).all(|i| axes[i].dot(axes[(i + 1) % 3]).abs() <= 1e-4 * scale * scale);
    (even && square && scale > 0.0).then_some(scale)
}

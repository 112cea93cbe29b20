//! Scenes, their settings, and parts of their image.

use crate::Options;
use anyhow::{Context, Result, bail};
use photonfarm_core::math::Vec2;
use photonfarm_core::random::Sampling;
use photonfarm_core::scene::{Scene, SceneFolder};
use photonfarm_core::sensor::Projection;
use photonfarm_core::settings::{
    DirectionSampler, IntegratorSettings, LookupVertex, PathSettings, PcfSettings, PppmSettings,
};
use photonfarm_tests::scenes;
use std::path::{Path, PathBuf};

/// The folder of the torus scene, where it is given.
pub(super) fn torus(options: &Options) -> Option<PathBuf> {
    options.others.as_ref().map(|folder| folder.join("torus"))
}

/// The scene of a folder at a size of `size` pixels.
pub(super) fn load(folder: &Path, size: [u32; 2]) -> Result<Scene> {
    let [width, height] = size;
    let files = SceneFolder::new(folder)?;
    scenes::load(&files, "scene.xml", &[("width", width), ("height", height)])
        .with_context(|| format!("cannot load the scene in {}", folder.display()))
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    /// Column and row of its top left pixel.
    pub(super) at: [u32; 2],
    /// Pixels across and down.
    pub(super) size: [u32; 2],
}

impl Block {
    /// Indices of its pixels in an image of the given width.
    pub(super) fn pixels(self, width: u32) -> impl Iterator<Item = usize> {
        let ([x, y], [across, down]) = (self.at, self.size);
        (y..y + down).flat_map(move |row| (x..x + across).map(move |column| (row * width + column) as usize))
    }
}

/// Narrows the scene's camera to a block of its image: the film becomes the block, and each of its pixels sees what it saw before.
///
/// # Errors
/// A camera without a perspective.
pub(super) fn crop(scene: &mut Scene, block: Block) -> Result<()> {
    let size = Vec2::from(scene.sensor.resolution.map(|n| n as f32));
    let Projection::Perspective {
        fov_x, principal_point, ..
    } = &mut scene.sensor.projection
    else {
        bail!("only a camera with a perspective can be narrowed to a block of its image");
    };
    let (at, cropped) = (
        Vec2::from(block.at.map(|n| n as f32)),
        Vec2::from(block.size.map(|n| n as f32)),
    );
    // Image position s in fractions of the film lies at slope * (1 - 2 (s + principal_point)) on the plane before the camera.
    let slope = (0.5 * *fov_x).tan() * cropped.x / size.x;
    let corner = size / cropped * (Vec2::ONE - 2.0 * at / size - 2.0 * *principal_point);
    *fov_x = 2.0 * slope.atan();
    *principal_point = 0.5 * (Vec2::ONE - corner);
    scene.sensor.resolution = block.size;
    scene.film.resolution = block.size;
    Ok(())
}

/// `path` with the scene's longest paths. Sampling is independent in all figures: the theory they are held against is about
/// independent iterations.
pub(super) fn path(scene: &Scene, samples: u32) -> IntegratorSettings {
    IntegratorSettings::Path(PathSettings {
        samples,
        sampling: Sampling::Independent,
        max_depth: scene.wishes.max_depth,
    })
}

/// `pppm` with the scene's longest paths and the usual alpha.
pub(super) fn pppm(scene: &Scene, photons: u32, samples: u32, sigma1: f32) -> IntegratorSettings {
    IntegratorSettings::Pppm(PppmSettings {
        photons,
        samples,
        sampling: Sampling::Independent,
        sigma1: Some(sigma1),
        max_depth: scene.wishes.max_depth,
        ..Default::default()
    })
}

/// `pcf` with the scene's longest paths and the thesis's usual values: alpha 0.2, p 1, theta1 18 degrees.
pub(super) fn pcf(scene: &Scene, photons: u32, samples: u32, sigma1: f32) -> PcfSettings {
    PcfSettings {
        photons,
        samples,
        sampling: Sampling::Independent,
        sigma1: Some(sigma1),
        max_depth: scene.wishes.max_depth,
        ..Default::default()
    }
}

/// Cones by the material alone.
pub(super) const BSDF: &[DirectionSampler] = &[DirectionSampler::Bsdf];
/// And by camera connections.
pub(super) const CAMERA: &[DirectionSampler] = &[DirectionSampler::Bsdf, DirectionSampler::Camera];
/// And by importons.
pub(super) const IMPORTON: &[DirectionSampler] = &[
    DirectionSampler::Bsdf,
    DirectionSampler::Camera,
    DirectionSampler::Importon,
];

/// `settings` with cones read at `lookup` and aimed by `samplers`.
pub(super) fn aimed(settings: &PcfSettings, lookup: LookupVertex, samplers: &[DirectionSampler]) -> IntegratorSettings {
    IntegratorSettings::Pcf(PcfSettings {
        lookup_vertex: lookup,
        samplers: samplers.to_vec(),
        ..settings.clone()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cropped_camera_sees_the_same_through_its_pixels() {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/box"));
        let whole = load(folder, [40, 30]).unwrap();
        let mut part = load(folder, [40, 30]).unwrap();
        let at = [7, 19];
        crop(&mut part, Block { at, size: [5, 3] }).unwrap();
        for pixel in [Vec2::ZERO, Vec2::new(5.0, 3.0), Vec2::new(1.5, 2.5)] {
            let before = whole.sensor.ray(pixel + Vec2::new(7.0, 19.0), Vec2::ZERO);
            let after = part.sensor.ray(pixel, Vec2::ZERO);
            assert!(
                (before.direction - after.direction).length() < 1e-5,
                "{before:?} {after:?}"
            );
        }
    }
}

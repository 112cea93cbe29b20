//! Layers of what the camera's rays meet first.

use super::Channel;
use super::matte::{self, Matte, Settled};
use crate::geometry::SurfacePoint;
use crate::integrator::{Counts, Job, Observer, RenderError, Sample, trace_pixels};
use crate::material::TransportMode;
use crate::math::Vec3;
use crate::path::{Vertex, Way};
use crate::spectrum::Spectrum;

/// Something of the surface that a ray of the camera meets first. A ray that meets none adds zeros: values are weighted with `alpha`, as a
/// compositor expects of an image whose alpha is multiplied in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Surface {
    /// One where a ray meets a surface; where it meets none, the share of light from behind that media on its way keep back.
    Alpha,
    /// The share of light that the surface scatters: the mean of `f cos / pdf` over directions sampled from the material, with a variance
    /// of zero for a diffuse surface. Zero on surfaces that only emit.
    Albedo,
    /// The shading normal in the world, on the side of the camera.
    Normal,
    /// The distance from where the ray starts [scene units].
    Depth,
    /// The place in the world [scene units].
    Position,
}

/// What a layer shows of what a ray of the camera meets first.
#[derive(Clone, Copy, Debug)]
pub(super) enum Seen {
    /// Something of the surface.
    Surface(Surface),
    /// What the surface is of.
    Matte(Matte),
}

impl Seen {
    fn planes(self) -> usize {
        match self {
            Self::Surface(surface) => surface.planes(),
            Self::Matte(_) => matte::PLANES,
        }
    }
}

impl Surface {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Alpha => "alpha",
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Depth => "depth",
            Self::Position => "position",
        }
    }

    /// Whether values may be below zero, which takes a plane of its own.
    fn is_signed(self) -> bool {
        matches!(self, Self::Normal | Self::Position)
    }

    pub(super) fn planes(self) -> usize {
        1 + usize::from(self.is_signed())
    }

    fn value(self, sample: &mut Sample, point: &SurfacePoint) -> Vec3 {
        let wo = -sample.camera.ray.direction;
        match self {
            Self::Alpha => Vec3::ONE,
            Self::Albedo => {
                let vertex = Vertex::new(sample.tracer.scene, *point, wo, TransportMode::Radiance);
                let weight = vertex.sample(sample.random).map(|scattered| scattered.weight());
                Vec3::from_array(weight.unwrap_or(Spectrum::ZERO).to_rgb())
            }
            Self::Normal => match point.frame.n.dot(wo) < 0.0 {
                true => -point.frame.n,
                false => point.frame.n,
            },
            Self::Depth => Vec3::splat(point.distance),
            Self::Position => point.position,
        }
    }

    /// Adds a pixel's values in the order of planes.
    fn add(self, sample: &mut Sample, hit: Option<&SurfacePoint>, list: &mut Vec<Spectrum>) {
        let value = match hit {
            Some(point) => self.value(sample, point),
            None if self == Self::Alpha => Vec3::splat(kept_back(sample)),
            None => Vec3::ZERO,
        };
        list.push(spectrum(value.max(Vec3::ZERO)));
        if self.is_signed() {
            list.push(spectrum((-value).max(Vec3::ZERO)));
        }
    }

    /// The channels that the means in the planes give.
    pub(super) fn channels(self, planes: &[&[Spectrum]]) -> Vec<Channel> {
        let letters: &[&str] = match self {
            Self::Alpha => &["A"],
            Self::Albedo => &["R", "G", "B"],
            Self::Normal | Self::Position => &["X", "Y", "Z"],
            Self::Depth => &["Z"],
        };
        let value = |index: usize, pixel: usize| match planes {
            [above, below] => above[pixel].to_rgb()[index] - below[pixel].to_rgb()[index],
            _ => planes[0][pixel].to_rgb()[index],
        };
        let channel = |(index, letter): (usize, &&str)| Channel {
            name: match self {
                // The names that every program knows.
                Self::Alpha => "A".to_owned(),
                _ => format!("{}.{letter}", self.name()),
            },
            samples: (0..planes[0].len()).map(|pixel| value(index, pixel)).collect(),
        };
        letters.iter().enumerate().map(channel).collect()
    }
}

/// The planes of some layers, one after the other, by one ray for each pixel. Mattes need the ids that are settled.
pub(super) fn render(
    job: &Job,
    layers: &[Seen],
    settled: Option<&Settled>,
    observer: &dyn Observer,
    counts: &mut Counts,
) -> Result<Vec<Vec<Spectrum>>, RenderError> {
    let planes: usize = layers.iter().map(|layer| layer.planes()).sum();
    if planes == 0 {
        return Ok(Vec::new());
    }
    let (_, lists) = trace_pixels(job, 1, 0..job.pixel_count(), observer, counts, |mut sample, list| {
        let hit = sample.tracer.first_seen(&sample.camera.ray);
        for layer in layers {
            match (layer, settled) {
                (Seen::Surface(surface), _) => surface.add(&mut sample, hit.as_ref(), list),
                (Seen::Matte(matte), Some(settled)) => {
                    let met = hit.as_ref().map(|point| settled.of(job.scene, point));
                    list.extend(matte.values(settled, sample.pixel, met));
                }
                (Seen::Matte(_), None) => unreachable!("ids are settled where there is a matte"),
            }
        }
        Spectrum::ZERO
    })?;
    let values: Vec<Spectrum> = lists.into_iter().flatten().collect();
    let plane = |first: usize| values.iter().skip(first).step_by(planes).copied().collect();
    Ok((0..planes).map(plane).collect())
}

/// The share of the light at infinity that media keep back from the camera, the mean over channels.
fn kept_back(sample: &mut Sample) -> f32 {
    let scene = sample.tracer.scene;
    if scene.media.is_none() {
        return 0.0;
    }
    let way = Way {
        ray: sample.camera.ray,
        length: f32::INFINITY,
        space: scene.space_of_camera(),
    };
    1.0 - sample.tracer.transmittance_to_camera(&way, sample.random).share.mean()
}

fn spectrum(value: Vec3) -> Spectrum {
    Spectrum::from_rgb(value.to_array())
}

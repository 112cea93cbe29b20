//! Mattes: which objects and materials the camera's rays meet first, as Cryptomatte.
//!
//! A list of ids in the order of their coverage is no mean, and layers are means. So the ids of a pixel are settled before its coverage: they
//! are those that the camera's rays of the first [`ROUNDS`] iterations meet most often. That is a function of scene and seed, whoever
//! renders whichever iteration, and found once by each who renders any. An iteration then has, for each pixel and each of its
//! [`RANKS`] ids, the id in pieces of at most 11 bits, and 1 where its own ray met this one and otherwise 0. The mean of the last is the coverage.
//! The pieces are the same in all iterations, and come back out of the mean: the sums of up to 2^13 such numbers are exact, in
//! any order, and so are sums over nodes of powers of two. Over more that are no node, each addition is off by 2^-24 of the sum at most,
//! which only after some thousand additions may be half of the last bit of 11.

use super::Channel;
use super::cryptomatte::{self, RANKS};
use crate::geometry::SurfacePoint;
use crate::integrator::{Batches, Counts, Job, Observer, RenderError, trace_pixels};
use crate::random::Sampling;
use crate::scene::Scene;
use crate::spectrum::Spectrum;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

/// First iterations whose rays settle the ids of a pixel.
const ROUNDS: u32 = 32;

/// Pixels whose ids are settled at a time, so that memory has a bound.
const PIXELS_AT_A_TIME: usize = 1 << 18;

/// Bits of the pieces of an id.
const PIECES: [u32; 3] = [11, 11, 10];

/// Values of an id and its coverage.
const VALUES: usize = PIECES.len() + 1;

/// Planes of a matte: three values of a pixel each.
pub(super) const PLANES: usize = RANKS * VALUES / 3;

/// What a matte tells apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Matte {
    /// Shapes and instances.
    Object,
    /// Materials.
    Material,
}

/// The ids of a pixel, most frequent first; 0 where there are no more.
type Ids = [u32; RANKS];

/// The ids of a pixel with their coverage, the most covered first.
type Pairs = [(u32, f32); RANKS];

/// What layers find out of a scene once for many iterations: it changes no bit of any. It belongs to one scene and its layers.
#[derive(Debug, Default)]
pub struct Memory(Mutex<Option<(Key, Arc<Settled>)>>);

/// What the settled ids depend on beside the scene.
type Key = (u64, Sampling);

/// The ids of all shapes and materials, and those of each pixel that is rendered.
#[derive(Debug)]
pub(super) struct Settled {
    ids: [Vec<u32>; 2],
    pixels: [Vec<Ids>; 2],
}

impl Memory {
    /// The settled ids of a job. They may be found twice at a time: whoever holds a lock while others work could wait for itself.
    pub(super) fn settled(&self, job: &Job, observer: &dyn Observer) -> Result<Arc<Settled>, RenderError> {
        let key = (job.seed, job.sampling);
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, settled)) = known().as_ref().filter(|(of, _)| *of == key) {
            return Ok(settled.clone());
        }
        let settled = Arc::new(Settled::find(job, observer)?);
        *known() = Some((key, settled.clone()));
        Ok(settled)
    }
}

impl Settled {
    fn find(job: &Job, observer: &dyn Observer) -> Result<Self, RenderError> {
        let names = &job.at_rest.names;
        let mut settled = Self {
            ids: [
                names.objects().map(|name| cryptomatte::id(&name)).collect(),
                names.materials().map(|name| cryptomatte::id(&name)).collect(),
            ],
            pixels: Default::default(),
        };
        let count = job.pixel_count();
        for first in (0..count).step_by(PIXELS_AT_A_TIME) {
            let pixels = first..count.min(first + PIXELS_AT_A_TIME);
            let mut met = vec![[[0; 2]; ROUNDS as usize]; pixels.len()];
            for round in 0..ROUNDS {
                let frame = job.at_rest.frame(job.seed, round + 1);
                let job = Job {
                    scene: frame.as_ref().unwrap_or(job.at_rest),
                    iteration: round + 1,
                    batches: Batches::default(),
                    ..*job
                };
                let found = settled.meet(&job, pixels.clone(), observer, &mut Counts::default())?;
                for (met, found) in met.iter_mut().zip(found) {
                    met[round as usize] = found;
                }
            }
            for (kind, pixels) in settled.pixels.iter_mut().enumerate() {
                pixels.extend(met.iter().map(|met| most_frequent(&met.map(|ids| ids[kind]))));
            }
        }
        Ok(settled)
    }

    /// The ids of object and material that the ray of each pixel meets first, 0 where it meets nothing.
    fn meet(
        &self,
        job: &Job,
        pixels: Range<usize>,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<Vec<[u32; 2]>, RenderError> {
        let (_, found) = trace_pixels(job, 1, pixels, observer, counts, |sample, list| {
            let hit = sample.tracer.first_seen(&sample.camera.ray);
            list.push(hit.map_or([0; 2], |point| self.of(job.scene, &point)));
            Spectrum::ZERO
        })?;
        Ok(found.concat())
    }

    /// The ids at a point.
    pub(super) fn of(&self, scene: &Scene, point: &SurfacePoint) -> [u32; 2] {
        let [objects, materials] = &self.ids;
        [
            objects[point.outer.0 as usize],
            materials[scene.binding(point.shape).material as usize],
        ]
    }
}

/// The most frequent ids but 0, and of those that are equally frequent the lower ones first.
fn most_frequent(met: &[u32; ROUNDS as usize]) -> Ids {
    let mut met = *met;
    met.sort_unstable();
    let mut runs: Vec<(usize, u32)> = met
        .chunk_by(|a, b| a == b)
        .map(|run| (run.len(), run[0]))
        .filter(|(_, id)| *id != 0)
        .collect();
    runs.sort_unstable_by_key(|(count, id)| (std::cmp::Reverse(*count), *id));
    let mut ids = runs.into_iter().map(|(_, id)| id);
    std::array::from_fn(|_| ids.next().unwrap_or(0))
}

impl Matte {
    /// What channels are called before their number.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Object => "CryptoObject",
            Self::Material => "CryptoMaterial",
        }
    }

    /// What stands before the dot in the names of its channels, two ranks each.
    pub(super) fn groups(self) -> impl Iterator<Item = String> {
        (0..RANKS / 2).map(move |number| format!("{}{number:02}", self.name()))
    }

    /// The attributes of a file that has the layer.
    pub(super) fn attributes(self, names: &[String]) -> Vec<(String, String)> {
        cryptomatte::attributes(self.name(), names.iter().map(String::as_str))
    }

    /// The values of pixel number `pixel`, in the order of the planes, whose ray has met `met` in this iteration.
    pub(super) fn values(self, settled: &Settled, pixel: usize, met: Option<[u32; 2]>) -> [Spectrum; PLANES] {
        let kind = self as usize;
        let value = |index: usize| {
            let id = settled.pixels[kind][pixel][index / VALUES];
            match PIECES.get(index % VALUES) {
                Some(bits) => {
                    let below: u32 = PIECES[..index % VALUES].iter().sum();
                    (id >> below & ((1 << bits) - 1)) as f32
                }
                None => f32::from(u8::from(id != 0 && met.is_some_and(|met| met[kind] == id))),
            }
        };
        std::array::from_fn(|plane| Spectrum::from_rgb([0, 1, 2].map(|letter| value(3 * plane + letter))))
    }

    /// The channels that the means in the planes give: pairs of an id and its coverage, the most covered first.
    pub(super) fn channels(self, planes: &[&[Spectrum]]) -> Vec<Channel> {
        let pairs: Vec<Pairs> = (0..planes[0].len()).map(|pixel| pairs(planes, pixel)).collect();
        let channel = |name: String, value: &dyn Fn(&Pairs) -> f32| Channel {
            name,
            samples: pairs.iter().map(value).collect(),
        };
        let group = |(name, first): (String, usize)| {
            let id = |rank: usize| move |pairs: &Pairs| f32::from_bits(pairs[rank].0);
            let coverage = |rank: usize| move |pairs: &Pairs| pairs[rank].1;
            [
                channel(format!("{name}.R"), &id(first)),
                channel(format!("{name}.G"), &coverage(first)),
                channel(format!("{name}.B"), &id(first + 1)),
                channel(format!("{name}.A"), &coverage(first + 1)),
            ]
        };
        self.groups().zip((0..RANKS).step_by(2)).flat_map(group).collect()
    }
}

/// The ids of a pixel with their coverage; those that nothing was met of count as none.
fn pairs(planes: &[&[Spectrum]], pixel: usize) -> Pairs {
    let mean = |index: usize| planes[index / 3][pixel].to_rgb()[index % 3];
    let mut pairs: Pairs = std::array::from_fn(|rank| {
        let mut below = 0;
        let mut id = 0;
        for (piece, bits) in PIECES.iter().enumerate() {
            id |= ((mean(VALUES * rank + piece) + 0.5) as u32) << below;
            below += bits;
        }
        match mean(VALUES * rank + PIECES.len()) {
            0.0 => (0, 0.0),
            coverage => (id, coverage),
        }
    });
    pairs.sort_by(|a, b| b.1.total_cmp(&a.1));
    pairs
}

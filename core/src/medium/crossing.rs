//! Crossing a medium without being scattered by it, and what comes through up to any place on the way.

use super::field::{Collision, Field};
use super::{Extinction, Medium, Volume, at, seen_length, transmitted};
use crate::geometry::Ray;
use crate::math::{exp, exp_m1, ln_1p};
use crate::random::PathRandom;
use crate::spectrum::{CHANNELS, Spectrum};

/// What becomes of light on a whole way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crossing {
    /// An estimate of the share that comes through.
    pub(crate) share: Spectrum,
    /// Radiance that the medium adds by its glow.
    pub(crate) glow: Spectrum,
}

/// Shares of light that come through along a way from its start, in the order of distances: each from its distance on to the next. Before
/// the first all comes through.
pub(crate) type Steps = Vec<(f32, Spectrum)>;

/// Estimates of the share of light that comes through up to every distance along a way.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Passage<'a> {
    /// The closed form, by the extinction.
    Even(Spectrum),
    /// The same over the mean of all channels.
    Flown(Spectrum),
    /// Ratio tracking: the running product is an estimate for every distance at once.
    Steps(&'a [(f32, Spectrum)]),
}

/// A tentative collision of ratio tracking.
struct Tentative {
    collision: Collision,
    /// The extinction there over the bound.
    real: Spectrum,
    /// Share of light that comes up to it, and that goes on behind it.
    before: Spectrum,
    after: Spectrum,
}

/// Shares of light below which ratio tracking goes on by Russian roulette: what it takes is bounded by the extinction then.
const LEAST_SHARE: f32 = 0.05;

/// How ratio tracking ends before its way does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Roulette {
    /// By the share of light below [`LEAST_SHARE`].
    Late,
    /// At each collision by the mean over channels of what it takes away: as flights end.
    Always,
}

/// Part of the choice among tentative collisions that is made by what the bound is, whatever the extinction: a kernel sees light
/// that is scattered beside them, too.
const CHOSEN_BY_BOUND: f32 = 0.05;

impl Passage<'_> {
    /// The share at `distance`.
    pub(crate) fn share(&self, distance: f32) -> Spectrum {
        match self {
            Self::Even(sigma_t) => transmitted(*sigma_t, distance),
            Self::Flown(sigma_t) => {
                // The channel with the least extinction decides over the others, however far it is.
                let least = sigma_t.channels().into_iter().fold(f32::INFINITY, f32::min);
                let share = transmitted(sigma_t.map(|sigma| sigma - least), distance);
                share * (1.0 / share.mean())
            }
            Self::Steps(steps) => match steps.partition_point(|(start, _)| *start <= distance) {
                0 => Spectrum::ONE,
                after => steps[after - 1].1,
            },
        }
    }

    /// The next distance beyond `distance` at which the share changes at once; infinite where it never does.
    pub(crate) fn next_step(&self, distance: f32) -> f32 {
        match self {
            Self::Even(_) | Self::Flown(_) => f32::INFINITY,
            Self::Steps(steps) => {
                let next = steps.partition_point(|(start, _)| *start <= distance);
                steps.get(next).map_or(f32::INFINITY, |(start, _)| *start)
            }
        }
    }
}

impl Medium {
    /// What comes through up to every distance where the extinction is the same everywhere; over the mean of all channels where `flown`.
    pub(crate) fn even_passage(&self, flown: bool) -> Option<Passage<'static>> {
        match (&self.extinction, flown) {
            (Extinction::Uniform(sigma_t), false) => Some(Passage::Even(*sigma_t)),
            (Extinction::Uniform(sigma_t), true) => Some(Passage::Flown(*sigma_t)),
            (Extinction::Varying(_), _) => None,
        }
    }

    /// A colour in proportion to how much each channel is scattered, as far as it is the same everywhere.
    pub(crate) fn scattered_colour(&self) -> Spectrum {
        let albedo = match &self.albedo {
            Volume::Constant(albedo) => *albedo,
            Volume::Grid(_) => Spectrum::ONE,
        };
        match &self.extinction {
            Extinction::Uniform(sigma_t) => *sigma_t * albedo,
            Extinction::Varying(_) => albedo,
        }
    }

    /// Crosses the medium along a ray of the length `ray.max_distance`, perhaps infinite. [`Self::passage`] with the same random numbers is its course.
    pub(crate) fn cross(&self, ray: &Ray, mut random: PathRandom) -> Crossing {
        match &self.extinction {
            Extinction::Uniform(sigma_t) => Crossing {
                share: transmitted(*sigma_t, ray.max_distance),
                glow: self.emission.constant() * sigma_t.map(|sigma| seen_length(sigma, ray.max_distance)),
            },
            Extinction::Varying(field) => {
                let mut glow = Spectrum::ZERO;
                let share = ratio_track(field, ray, Roulette::Late, &mut random, |tentative| {
                    let emission = self.emission.at(at(ray, tentative.collision.distance));
                    glow += tentative.before * emission * (1.0 / tentative.collision.bound);
                });
                Crossing { share, glow }
            }
        }
    }

    /// What comes through up to every distance along a ray of the length `ray.max_distance`. `steps` holds what has to be kept of it.
    pub(crate) fn passage<'a>(&self, ray: &Ray, mut random: PathRandom, steps: &'a mut Steps) -> Passage<'a> {
        match &self.extinction {
            Extinction::Uniform(sigma_t) => Passage::Even(*sigma_t),
            Extinction::Varying(field) => {
                keep_steps(field, ray, Roulette::Late, &mut random, steps);
                Passage::Steps(steps)
            }
        }
    }

    /// As [`Self::passage`] along a ray that is as long as a flight, in one channel or another, comes along `ray`: with the share of light over the
    /// probability that the flight comes so far. `steps` holds what has to be kept of it.
    pub(crate) fn short_passage<'a>(
        &self,
        ray: &Ray,
        mut random: PathRandom,
        steps: &'a mut Steps,
    ) -> (f32, Passage<'a>) {
        match &self.extinction {
            Extinction::Uniform(sigma_t) => {
                let channel = (random.next_1d() * CHANNELS as f32) as usize;
                let free = -ln_1p(-random.next_1d()) / sigma_t[channel];
                // Without extinction in the channel it is infinite, or no number.
                let end = if free < ray.max_distance {
                    free
                } else {
                    ray.max_distance
                };
                (end, Passage::Flown(*sigma_t))
            }
            Extinction::Varying(field) => {
                keep_steps(field, ray, Roulette::Always, &mut random, steps);
                (ray.max_distance, Passage::Steps(steps))
            }
        }
    }

    /// A distance along a ray of the length `ray.max_distance`, chosen about as collisions are, and the share of light that comes through up to there
    /// over the density of the choice \[scene units\]. `None` where nothing is found.
    pub(crate) fn choose_distance(&self, ray: &Ray, mut random: PathRandom) -> Option<(f32, Spectrum)> {
        match &self.extinction {
            Extinction::Uniform(sigma_t) => choose_evenly(*sigma_t, ray.max_distance, &mut random),
            Extinction::Varying(field) => {
                let mut choices = random.apart();
                let (mut chosen, mut sum) = (None, 0.0);
                ratio_track(field, ray, Roulette::Late, &mut random, |tentative| {
                    let weight = tentative.before.mean() * (tentative.real.max_component() + CHOSEN_BY_BOUND);
                    sum += weight;
                    // Each is kept with the probability of its weight over the sum.
                    if choices.next_1d() * sum < weight {
                        let share = tentative.before * (1.0 / tentative.collision.bound);
                        chosen = Some((tentative.collision.distance, share * (1.0 / weight)));
                    }
                });
                chosen.map(|(distance, share)| (distance, share * sum))
            }
        }
    }
}

/// Goes through all tentative collisions along a ray, and tells the share of light that comes through (Novak, Selle and Jarosz 2014).
fn ratio_track(
    field: &Field,
    ray: &Ray,
    roulette: Roulette,
    random: &mut PathRandom,
    mut visit: impl FnMut(Tentative),
) -> Spectrum {
    let mut choices = random.apart();
    let mut share = Spectrum::ONE;
    field.collisions(ray, ray.max_distance, random, |collision| {
        let real = field.at(&collision) * (1.0 / collision.bound);
        let before = share;
        let fictitious = real.map(|real| (1.0 - real).max(0.0));
        share *= fictitious;
        let survival = match roulette {
            Roulette::Late => share.max_component() / LEAST_SHARE,
            Roulette::Always => fictitious.mean(),
        };
        if survival < 1.0 {
            share *= if choices.next_1d() < survival {
                1.0 / survival
            } else {
                0.0
            };
        }
        visit(Tentative {
            collision,
            real,
            before,
            after: share,
        });
        !share.is_black()
    });
    share
}

/// The shares of light behind each tentative collision.
fn keep_steps(field: &Field, ray: &Ray, roulette: Roulette, random: &mut PathRandom, steps: &mut Steps) {
    steps.clear();
    ratio_track(field, ray, roulette, random, |tentative| {
        steps.push((tentative.collision.distance, tentative.after));
    });
}

/// A distance below `end` with the mean of the densities that collisions have in the channels in which there are any, on the
/// condition that there is one.
fn choose_evenly(sigma_t: Spectrum, end: f32, random: &mut PathRandom) -> Option<(f32, Spectrum)> {
    // Probability of a collision.
    let collides = sigma_t.map(|sigma| if sigma > 0.0 { -exp_m1(-sigma * end) } else { 0.0 });
    let channels = (0..CHANNELS).filter(|channel| collides[*channel] > 0.0);
    let count = channels.clone().count();
    let choice = (random.next_1d() * count as f32) as usize;
    let channel = channels.clone().nth(choice.min(count.checked_sub(1)?))?;
    let distance = -ln_1p(-random.next_1d() * collides[channel]) / sigma_t[channel];
    let density = |channel: usize| sigma_t[channel] * exp(-sigma_t[channel] * distance) / collides[channel];
    let density = channels.map(density).sum::<f32>() / count as f32;
    (density > 0.0).then(|| (distance.min(end), transmitted(sigma_t, distance) * (1.0 / density)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Vec3;
    use crate::medium::tests::{narrow_camera, scene_with, vol};
    use crate::random::Stream;
    use crate::scene::Scene;

    /// A cube from -1 to 1 on each axis, filled by an even medium and by a lattice that rises along z.
    fn media() -> Scene {
        let camera = narrow_camera("0 0 -5");
        scene_with(
            &format!(
                "{camera}<shape type='cube'><bsdf type='null'/><medium name='interior' type='homogeneous'><rgb name='sigma_t' value='0 1 3'/></medium></shape>\
             <shape type='cube'><transform name='to_world'><translate x='5'/></transform><bsdf type='null'/><medium name='interior' type='heterogeneous'>\
             <volume name='sigma_t' type='gridvolume'><string name='filename' value='sigma.vol'/><transform name='to_world'>\
             <translate value='-0.5 -0.5 -0.5'/><scale value='2'/></transform></volume></medium></shape>\
             <emitter type='constant'/>"
            ),
            &[("sigma.vol", vol([2, 3, 20], |_, _, z| 0.2 * z as f32))],
        )
    }

    fn ray() -> Ray {
        Ray {
            origin: Vec3::new(0.1, 0.2, -1.5),
            direction: Vec3::Z,
            max_distance: 2.5,
        }
    }

    /// Optical depth of the media at a distance along the ray, channel by channel.
    fn depth(lattice: bool, distance: f64) -> [f64; CHANNELS] {
        if !lattice {
            return [0.0, distance, 3.0 * distance];
        }
        let steps = 4_000;
        let step = distance / f64::from(steps);
        let value = |at: f64| {
            let voxel = ((at - 0.5) * 10.0 - 0.5).clamp(0.0, 19.0);
            if (0.5..2.5).contains(&at) { 0.2 * voxel } else { 0.0 }
        };
        [(0..steps).map(|i| value((f64::from(i) + 0.5) * step)).sum::<f64>() * step; CHANNELS]
    }

    fn numbers(path: u64) -> PathRandom {
        PathRandom::new(1, 1, Stream::Probe, path)
    }

    /// Means within five standard errors of what is expected: with fewer than 100 means a false alarm has a probability below 1e-4.
    fn agrees(label: &str, values: &[f64], expected: f64) {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let error = (variance / count).sqrt();
        assert!(
            (mean - expected).abs() <= 5.0 * error + 1e-4 * expected,
            "{label}: {mean} +- {error}, not {expected}"
        );
    }

    /// At every distance the share is that of the closed form, and the whole way comes through as its end says.
    #[test]
    fn shares_are_those_of_beers_law_at_every_distance() {
        let scene = media();
        for (lattice, medium) in [false, true].into_iter().zip(&scene.media.as_ref().unwrap().media) {
            for distance in [0.3_f32, 1.1, 1.9, 2.5] {
                let depth = depth(lattice, f64::from(distance));
                for (channel, depth) in depth.into_iter().enumerate() {
                    let mut steps = Steps::new();
                    let shares = (0..20_000).map(|path| {
                        let passage = medium.passage(&ray(), numbers(path), &mut steps);
                        let share = passage.share(distance);
                        if distance == ray().max_distance {
                            assert_eq!(share, medium.cross(&ray(), numbers(path)).share);
                        }
                        f64::from(share[channel])
                    });
                    let label = format!("lattice {lattice}, {distance}, channel {channel}");
                    agrees(&label, &shares.collect::<Vec<_>>(), (-depth).exp());
                    let short = (0..20_000).map(|path| {
                        let (end, passage) = medium.short_passage(&ray(), numbers(path), &mut steps);
                        let reached = f64::from(u8::from(end >= distance));
                        reached * f64::from(passage.share(distance)[channel])
                    });
                    agrees(&format!("short, {label}"), &short.collect::<Vec<_>>(), (-depth).exp());
                }
            }
        }
    }

    /// Chosen distances integrate the share that comes through.
    #[test]
    fn chosen_distances_have_the_density_that_they_say() {
        let scene = media();
        for (lattice, medium) in [false, true].into_iter().zip(&scene.media.as_ref().unwrap().media) {
            let begin = if lattice { 0.5 } else { 0.0 };
            for channel in 0..CHANNELS {
                let steps = 200;
                let step = (2.5 - begin) / f64::from(steps);
                let integrand = |at: f64| (-depth(lattice, at)[channel]).exp() * (1.0 + at * at);
                let expected = (0..steps)
                    .map(|i| integrand(begin + (f64::from(i) + 0.5) * step))
                    .sum::<f64>()
                    * step;
                let found: Vec<f64> = (0..40_000)
                    .map(|path| match medium.choose_distance(&ray(), numbers(path)) {
                        Some((at, share)) => f64::from(share[channel]) * (1.0 + f64::from(at).powi(2)),
                        None => 0.0,
                    })
                    .collect();
                agrees(&format!("lattice {lattice}, channel {channel}"), &found, expected);
            }
        }
    }
}

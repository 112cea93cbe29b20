//! Photon surfaces (Deng, Jiao, Bitterli and Jarosz 2019): light in media without blur.
//!
//! Light paths sweep out surfaces in media. Two of the numbers that say where a light path ends are left open, such as its last two lengths: its end can lie
//! anywhere on a plane then ([`technique`], [`sweep`], [`shape`]; of the place on a light, [`lamp`]). A camera ray that crosses the plane closes a path, whose
//! contribution is divided by the Jacobian `|n . psi|` (equation 24). Another choice of the two numbers makes another surface, which finds the same paths with another
//! density; each path counts by the balance heuristic over all of them. All these densities are known: so a path of the contribution `f` counts as
//! `f / sum_k M_k p_k`, whatever has found it. This is equation 25 with an exponent of 1, since a score is `f / p`.
//!
//! Which technique counts a path: camera paths cross media and are scattered by surfaces alone, and are connected with lights there. Of paths that media scatter, take
//! the place of scattering that is nearest to the camera, and the vertex before it:
//!
//! * It lies in a medium, or at a light at a finite distance, or a lobe of a surface scatters there that is no delta function: photon surfaces, by the [`tail::Kind`] of
//!   the tail. Connections are among them.
//! * It is a mirror or clear glass, or a light at infinity: a camera path that goes on from the medium, and from there on finds all light.
//!
//! So each path is counted once and the estimate has no bias, but for lights that shine along the normals of a shape, whose light that is scattered once
//! is missing. Light that media emit themselves is found by camera paths, however often it was scattered.
//!
//! Surfaces end where lengths end that are drawn at random ("short" surfaces). Their densities are those of the medium in which the tail begins, wherever it leads
//! ([`rates::Rates`]), and what comes through is found for the path itself: so the estimate holds in lattices, too, and through the bounds of media.

mod lamp;
mod rates;
pub(super) mod settings;
mod shape;
mod sweep;
mod tail;
mod technique;
#[cfg(test)]
mod tests;

use super::camera_path::{CameraPath, Counted};
use super::light_paths::{self, LightPaths};
use super::{Counts, Iteration, Job, Observer, Phase, RenderError, Sample, edge_limit, render_pixels};
use crate::density::{Passable, RayMap, count_edges};
use crate::geometry::Ray;
use crate::math::Vec3;
use crate::medium::{Medium, Passage, Space, Steps};
use crate::path::{Crossed, Tracer, Walk, Way};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::settings::{SurfaceKind, SurfacesSettings, Weights};
use crate::spectrum::Spectrum;
use lamp::Lamp;
use rates::Rates;
use shape::Shape;
use tail::Tail;
use technique::{Chain, Densities, Technique};

pub(super) fn render(
    job: &Job,
    settings: &SurfacesSettings,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let mut counts = Counts::default();
    let max_edges = edge_limit(settings.max_depth);
    let estimator = match job.scene.media {
        Some(_) => Some(SurfaceEstimator::new(job, settings, max_edges, observer, &mut counts)?),
        None => None,
    };
    observer.phase(Phase::TraceCamera);
    let pixels = render_pixels(job, settings.samples, observer, &mut counts, |sample| {
        let Sample {
            tracer, camera, random, ..
        } = sample;
        let mut path = CameraPath::new(tracer, camera.ray, random, max_edges);
        path.cross_media();
        let mut pieces = Vec::new();
        loop {
            let met = path.trace_edge();
            pieces.extend(path.take_crossed());
            let Some(vertex) = path.arrive(&met) else { break };
            path.add_next_event(&vertex);
            if path.go_on(&vertex).is_none() {
                break;
            }
        }
        let mut radiance = path.radiance;
        if let Some(estimator) = &estimator {
            for piece in &pieces {
                radiance += estimator.light_on(piece, tracer, random);
            }
        }
        radiance
    })?;
    Ok(Iteration {
        pixels,
        counts,
        statistics: Vec::new(),
    })
}

/// A photon surface.
#[derive(Clone, Copy, Debug)]
struct Surface {
    shape: Shape,
    technique: Technique,
    /// The tail that sweeps it out.
    tail: u32,
}

impl Passable for Surface {
    /// Where a ray meets it is found out with the tail.
    type Found = ();

    fn bounds(&self) -> (Vec3, Vec3) {
        self.shape.bounds()
    }

    fn pass(&self, _ray: &Ray) -> Option<()> {
        Some(())
    }
}

/// Tails of light paths, in the order of paths.
#[derive(Default)]
struct Tails<'s> {
    tails: Vec<Tail<'s>>,
    /// For each path, where its tails end.
    ends: Vec<u32>,
}

/// Light that media scatter towards the camera.
struct SurfaceEstimator<'s> {
    scene: &'s Scene,
    tails: Vec<Tail<'s>>,
    ends: Vec<u32>,
    map: RayMap<Surface>,
    used: Vec<SurfaceKind>,
    weights: Weights,
    light_paths: u32,
    max_edges: u32,
    glows: bool,
}

/// A piece of a camera path's edge that looks for light.
struct Query<'q> {
    piece: &'q Crossed,
    medium: &'q Medium,
    passage: Passage<'q>,
    /// How connections choose a place.
    rates: Rates,
    /// Most edges of a light path that counts.
    limit: u8,
}

impl<'s> SurfaceEstimator<'s> {
    /// Traces the light paths of an iteration.
    fn new(
        job: &Job<'s>,
        settings: &SurfacesSettings,
        max_edges: u32,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<Self, RenderError> {
        observer.phase(Phase::TraceLight);
        let scene = job.scene;
        let paths = LightPaths {
            sequence: job.light_sequence(settings.photons),
            range: 0..settings.photons,
            max_edges: max_edges.saturating_sub(1),
        };
        let used = &settings.surfaces;
        let lamps = match used.iter().any(|kind| kind.is_of_lights()) {
            true => Lamp::all(scene),
            false => Vec::new(),
        };
        let chunks = paths.trace_with(scene, observer, counts, |tracer, _, start, random, out: &mut Tails| {
            if let Some(start) = start {
                out.tails
                    .extend(Tail::of_light(scene, &start, &lamps, &mut random.apart()));
                let walk = Walk::from_light(scene, &start, random);
                trace_tails(walk, paths.max_edges, tracer, random, &mut out.tails);
            }
            out.ends.push(out.tails.len() as u32);
        })?;
        observer.phase(Phase::BuildMap);
        let (mut tails, mut ends) = (Vec::new(), Vec::new());
        for chunk in chunks {
            let before = tails.len() as u32;
            ends.extend(chunk.ends.iter().map(|end| before + end));
            tails.extend(chunk.tails);
        }
        let surfaces: Vec<Surface> = tails
            .iter()
            .enumerate()
            .flat_map(|(number, tail)| {
                Technique::of(tail)
                    .iter()
                    .filter(|technique| used.contains(&technique.kind()))
                    .filter_map(move |technique| {
                        Some(Surface {
                            shape: technique.shape(tail)?,
                            technique: *technique,
                            tail: number as u32,
                        })
                    })
            })
            .collect();
        counts.records_stored += surfaces.len() as u64;
        Ok(Self {
            scene,
            tails,
            ends,
            map: RayMap::build(vec![surfaces]),
            used: used.clone(),
            weights: settings.weights,
            light_paths: settings.photons,
            max_edges,
            glows: scene.media.iter().flat_map(|media| &media.media).any(Medium::glows),
        })
    }

    /// What a medium scatters towards the camera on a piece of a camera path.
    fn light_on(&self, piece: &Crossed, tracer: &mut Tracer<'s>, random: &mut PathRandom) -> Spectrum {
        let mut radiance = Spectrum::ZERO;
        let Some((_, medium)) = self.scene.medium(piece.space) else {
            return radiance;
        };
        let (Some(rates), true) = (Rates::of(medium), piece.counted_edges < self.max_edges) else {
            return radiance;
        };
        let mut steps = Steps::new();
        let query = Query {
            piece,
            medium,
            passage: medium.passage(&piece.ray, piece.random.clone(), &mut steps),
            rates,
            limit: count_edges(self.max_edges - piece.counted_edges),
        };
        self.map.along(&piece.ray, |Surface { shape, technique, tail }, ()| {
            let tail = &self.tails[*tail as usize];
            technique.each_chain(tail, shape, &piece.ray, |distance, chain| {
                radiance += self.found(&query, tail, *technique, (distance, chain), tracer, random);
            });
        });
        let (distance, density) = rates.sample_below(piece.ray.max_distance, random);
        if self.used.contains(&SurfaceKind::Connections) {
            let place = piece.ray.origin + piece.ray.direction * distance;
            for tail in self.tails_of_one_path(random.next_1d()) {
                if tail.is_whole()
                    && let Some(chain) = Chain::connecting(tail, place)
                {
                    let chain = (distance, &chain);
                    radiance += self.found(&query, tail, Technique::Connection, chain, tracer, random);
                }
            }
        }
        radiance + self.go_on(&query, distance, density, tracer, random)
    }

    fn tails_of_one_path(&self, u: f32) -> &[Tail<'s>] {
        let path = ((u * self.light_paths as f32) as usize).min(self.ends.len() - 1);
        let start = path.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.tails[start as usize..self.ends[path] as usize]
    }

    /// What a chain that a technique has found brings to the camera, with its share. It ends at `distance` of the piece.
    fn found(
        &self,
        query: &Query,
        tail: &Tail,
        technique: Technique,
        (distance, chain): (f32, &Chain),
        tracer: &mut Tracer,
        random: &mut PathRandom,
    ) -> Spectrum {
        let Crossed { ray, beta, states, .. } = query.piece;
        let nothing = Spectrum::ZERO;
        if tail.edges > query.limit || tail.states & states == 0 {
            return nothing;
        }
        let place = ray.origin + ray.direction * distance;
        let density = self.density(query, tail, technique, chain, distance);
        if !(density > 0.0 && density.is_finite()) {
            return nothing;
        }
        let phase = query.medium.phase.pdf(-chain.directions[0], -ray.direction);
        let scattered = query.medium.scattering(place) * phase * query.passage.share(distance);
        if scattered.is_black() {
            return nothing;
        }
        *beta * scattered * self.arriving(tail, chain, tracer, random) * (1.0 / density)
    }

    /// The sum over techniques of the density with which they find the chain, times how often they are tried.
    fn density(&self, query: &Query, tail: &Tail, technique: Technique, chain: &Chain, distance: f32) -> f32 {
        let phase = tail.medium(self.scene).map(|(_, medium)| &medium.phase);
        let turned = |from: Vec3, to: Vec3| phase.map_or(0.0, |phase| phase.pdf(-from, to));
        let first = tail.kind.first();
        let directions = std::array::from_fn(|segment| match segment {
            0 if first == 0 => tail.spread.pdf(chain.directions[0].dot(chain.axis(tail))),
            _ if segment < first => turned(chain.directions[segment + 1], chain.directions[segment]),
            _ => 1.0,
        });
        let ray = &query.piece.ray;
        let densities = Densities {
            kind: tail.kind,
            chain,
            lengths: chain.lengths.map(|length| tail.rates.density(length)),
            exceeded: chain.lengths.map(|length| tail.rates.exceeds(length)),
            directions,
            aside: turned(chain.directions[2], chain.directions[0]),
            ray: ray.direction,
            place: query.rates.density_below(distance, ray.max_distance),
        };
        let tried = |technique: Technique| match technique {
            Technique::Connection => densities.of(technique, tail.sweep()),
            _ => self.light_paths as f32 * densities.of(technique, tail.sweep()),
        };
        let used = || {
            Technique::of(tail)
                .iter()
                .filter(|technique| self.used.contains(&technique.kind()))
        };
        match self.weights {
            Weights::Balance => used().map(|technique| tried(*technique)).sum(),
            Weights::Average => used().count() as f32 * tried(technique),
        }
    }

    /// What arrives at the end of a chain, per solid angle and length as they are measured there \[W/(sr unit^2)\].
    fn arriving(&self, tail: &Tail, chain: &Chain, tracer: &mut Tracer, random: &mut PathRandom) -> Spectrum {
        let first = tail.kind.first();
        let mut light = tail.sent(&self.scene.lights, chain);
        let mut place = chain.start.map_or(tail.start, |point| point.position);
        let mut space = Space::EMPTY;
        for segment in (0..=first).rev() {
            if light.is_black() {
                return light;
            }
            let (direction, length) = (chain.directions[segment], chain.lengths[segment]);
            let passed = if segment == first {
                tail.through_first(chain, tracer, random)
            } else {
                let ray = Ray {
                    origin: place,
                    direction,
                    max_distance: length,
                };
                tracer.follow(&Way { ray, length, space }.up_to(length), random)
            };
            let Some((share, at_end)) = passed else {
                return Spectrum::ZERO;
            };
            light *= share;
            space = at_end;
            place += direction * length;
            if segment > 0 {
                let Some((_, inside)) = self.scene.medium(space) else {
                    return Spectrum::ZERO;
                };
                let phase = inside.phase.pdf(-direction, chain.directions[segment - 1]);
                light *= inside.scattering(place) * phase;
            }
        }
        light
    }

    /// What a camera path finds that goes on from a place in the medium, of all light that no photon surface finds.
    fn go_on(
        &self,
        query: &Query,
        distance: f32,
        density: f32,
        tracer: &mut Tracer<'s>,
        random: &mut PathRandom,
    ) -> Spectrum {
        let piece = query.piece;
        let place = piece.ray.origin + piece.ray.direction * distance;
        let share = query.passage.share(distance) * query.medium.scattering(place);
        let weight = piece.beta * share * (1.0 / density);
        if weight.is_black() || !weight.channels().iter().all(|channel| channel.is_finite()) {
            return Spectrum::ZERO;
        }
        let Some((walk, mut vertex)) = Walk::scattered(self.scene, piece, distance, weight, random) else {
            return Spectrum::ZERO;
        };
        let mut path = CameraPath::going_on(tracer, walk, random, self.max_edges);
        path.count(Counted::Beyond);
        let (mut edges, mut finds_all) = (0, false);
        loop {
            path.add_next_event(&vertex);
            let Some(scattered) = path.go_on(&vertex) else { break };
            if edges == 1 && scattered.bsdf.delta {
                finds_all = true;
                path.count(Counted::All);
            }
            // What media emit is found by nothing else.
            if edges > 0 && !finds_all && !self.glows {
                break;
            }
            let met = path.trace_edge();
            edges += 1;
            let Some(arrived) = path.arrive(&met) else { break };
            vertex = arrived;
            if edges == 1 {
                path.count(Counted::Nothing);
                if !self.glows && !vertex.has_delta() {
                    break;
                }
            }
        }
        path.radiance
    }
}

/// Goes along a light path and draws its tails.
fn trace_tails<'s>(
    mut walk: Walk,
    max_edges: u32,
    tracer: &mut Tracer<'s>,
    random: &mut PathRandom,
    tails: &mut Vec<Tail<'s>>,
) {
    let scene = tracer.scene;
    let mut from_medium = false;
    while walk.has_edge_left(max_edges) {
        tail::add_along(&walk, from_medium, tracer, &mut random.apart(), tails);
        let met = light_paths::advance(&mut walk, tracer, random);
        let Some(vertex) = walk.arrive(scene, &met) else { return };
        if let Some(point) = vertex.surface().filter(|_| !vertex.is_delta()) {
            tails.push(Tail::of_surface(scene, &vertex, point, &mut random.apart()));
        }
        let Some(scattered) = vertex.sample(random) else { return };
        if !walk.go_on(&vertex, &scattered, random) {
            return;
        }
        from_medium = vertex.surface().is_none();
    }
}

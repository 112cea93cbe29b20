//! Ray queries.
//!
//!     cargo bench -p photonfarm-core --bench rays
//!
//! `divan` prints rays per second and thread. The meshes are bumpy tori in a closed box, so that every ray hits.
//! `closest_hit_incoherent` is the figure to compare with other ray tracers: rays that leave random surface points
//! with cosine-weighted directions. `obvhs_cwbvh` traces the same rays through the compressed wide hierarchy of the
//! library that builds ours, with its own triangle test.

use divan::Bencher;
use divan::counter::ItemsCount;
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::triangle::Triangle;
use photonfarm_core::geometry::{Geometry, Ray, Shape, ShapeId, TriangleMesh};
use photonfarm_core::math::warp::{square_to_cosine_hemisphere, square_to_sphere};
use photonfarm_core::math::{Frame, TAU, Vec3, sin_cos};
use photonfarm_core::random::{PathRandom, Stream};
use std::sync::LazyLock;
use std::time::Duration;

const THREADS: [usize; 2] = [1, 2];
const RAYS: usize = 100_000;

fn main() {
    divan::main();
}

/// A mesh with its hierarchies and rays.
struct Setup {
    geometry: Geometry,
    peer: (CwBvh, Vec<Triangle>),
    coherent: Vec<Ray>,
    incoherent: Vec<Ray>,
    shadow: Vec<Ray>,
}

/// About 41,000 and 1,000,000 triangles.
static SMALL: LazyLock<Setup> = LazyLock::new(|| Setup::new(143));
static LARGE: LazyLock<Setup> = LazyLock::new(|| Setup::new(707));

#[derive(Clone, Copy, Debug)]
enum Size {
    Triangles41k,
    Triangles1M,
}

const SIZES: [Size; 2] = [Size::Triangles41k, Size::Triangles1M];

impl Size {
    fn setup(self) -> &'static Setup {
        match self {
            Self::Triangles41k => &SMALL,
            Self::Triangles1M => &LARGE,
        }
    }
}

/// A closed torus of `2 * rings * rings` triangles with bumps of several sizes.
fn torus(rings: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for i in 0..rings {
        for j in 0..rings {
            let (u, v) = (TAU * i as f32 / rings as f32, TAU * j as f32 / rings as f32);
            let bump = 1.0 + 0.2 * sin_cos(9.0 * u).0 * sin_cos(7.0 * v).1 + 0.05 * sin_cos(40.0 * u + 30.0 * v).0;
            let ((sin_u, cos_u), (sin_v, cos_v)) = (sin_cos(u), sin_cos(v));
            let radius = 1.0 + 0.4 * bump * cos_v;
            mesh.positions
                .push(Vec3::new(radius * cos_u, radius * sin_u, 0.4 * bump * sin_v));
            let at = |i: u32, j: u32| (i % rings) * rings + j % rings;
            mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    mesh
}

/// The box [-2, 2]^3.
fn room() -> TriangleMesh {
    let corner = |i: u32| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 4.0 - 2.0;
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    TriangleMesh {
        positions: (0..8).map(corner).collect(),
        triangles: faces
            .iter()
            .flat_map(|f| [[f[0], f[2], f[1]], [f[0], f[3], f[2]]])
            .collect(),
        ..TriangleMesh::default()
    }
}

impl Setup {
    fn new(rings: u32) -> Self {
        let meshes = [torus(rings), room()];
        let triangles: Vec<Triangle> = meshes
            .iter()
            .flat_map(|mesh| {
                mesh.triangles
                    .iter()
                    .map(|t| t.map(|i| mesh.positions[i as usize].to_array().into()))
            })
            .map(|[v0, v1, v2]| Triangle { v0, v1, v2 })
            .collect();
        let peer = build_cwbvh_from_tris(&triangles, BvhBuildParams::slow_build(), &mut Duration::default());
        let geometry = Geometry::build(meshes.into_iter().map(|mesh| Shape::Mesh(mesh.into())).collect());
        let eye = Vec3::new(1.9, 0.3, 1.7);
        let side = (RAYS as f32).sqrt() as usize;
        let coherent = (0..side * side)
            .map(|i| {
                let (x, y) = (
                    (i % side) as f32 / side as f32 - 0.5,
                    (i / side) as f32 / side as f32 - 0.5,
                );
                let direction = Frame::from_normal(-eye.normalize())
                    .to_world(Vec3::new(x, y, 0.7))
                    .normalize();
                Ray {
                    origin: eye,
                    direction,
                    max_distance: f32::INFINITY,
                }
            })
            .collect();
        let mut incoherent = Vec::with_capacity(RAYS);
        let mut shadow = Vec::with_capacity(RAYS);
        for path in 0..RAYS {
            let mut random = PathRandom::new(1, 1, Stream::Camera, path as u64);
            let first = Ray {
                origin: eye,
                direction: square_to_sphere(random.next_2d()),
                max_distance: f32::INFINITY,
            };
            let point = geometry.intersect(&first).expect("the room is closed");
            let frame = Frame::from_normal(if point.geometric_normal.dot(first.direction) > 0.0 {
                -point.geometric_normal
            } else {
                point.geometric_normal
            });
            let direction = frame
                .to_world(square_to_cosine_hemisphere(random.next_2d()))
                .normalize();
            incoherent.push(point.ray_towards(direction));
            let light = Vec3::new(random.next_1d() - 0.5, random.next_1d() - 0.5, 1.99) - point.position;
            shadow.push(point.shadow_ray(light.normalize(), light.length()));
        }
        Self {
            geometry,
            peer: (peer, triangles),
            coherent,
            incoherent,
            shadow,
        }
    }
}

/// Benches `query` over all `rays`.
fn over(bencher: Bencher, rays: &'static [Ray], query: impl Fn(&Ray) -> bool + Sync) {
    bencher
        .counter(ItemsCount::new(rays.len()))
        .bench(|| rays.iter().filter(|ray| query(divan::black_box(ray))).count());
}

#[divan::bench(args = SIZES, threads = THREADS, sample_count = 20)]
fn closest_hit_coherent(bencher: Bencher, size: Size) {
    let setup = size.setup();
    over(bencher, &setup.coherent, |ray| setup.geometry.intersect(ray).is_some());
}

#[divan::bench(args = SIZES, threads = THREADS, sample_count = 20)]
fn closest_hit_incoherent(bencher: Bencher, size: Size) {
    let setup = size.setup();
    over(bencher, &setup.incoherent, |ray| {
        setup.geometry.intersect(ray).is_some()
    });
}

#[divan::bench(args = SIZES, threads = THREADS, sample_count = 20)]
fn any_hit_towards_a_light(bencher: Bencher, size: Size) {
    let setup = size.setup();
    over(bencher, &setup.shadow, |ray| setup.geometry.occluded(ray));
}

#[divan::bench(args = SIZES, threads = THREADS, sample_count = 20)]
fn obvhs_cwbvh_incoherent(bencher: Bencher, size: Size) {
    let setup = size.setup();
    let (bvh, triangles) = &setup.peer;
    over(bencher, &setup.incoherent, |ray| {
        let ray = obvhs::ray::Ray::new_inf(ray.origin.to_array().into(), ray.direction.to_array().into());
        let mut hit = obvhs::ray::RayHit::none();
        bvh.ray_traverse(ray, &mut hit, |ray, id| {
            triangles[bvh.primitive_indices[id] as usize].intersect(ray)
        })
    });
}

#[divan::bench(sample_count = 5)]
fn build_41k(bencher: Bencher) {
    bencher
        .with_inputs(|| vec![Shape::Mesh(torus(143).into())])
        .bench_values(Geometry::build);
}

#[divan::bench(sample_count = 1)]
fn build_1m(bencher: Bencher) {
    bencher
        .with_inputs(|| vec![Shape::Mesh(torus(707).into())])
        .bench_values(Geometry::build);
}

/// Fitting the hierarchy to the mesh after it has moved, as each iteration of a scene in motion does.
#[divan::bench(sample_count = 5)]
fn refit_1m(bencher: Bencher) {
    let shape = Shape::Mesh(torus(707).into());
    let geometry = Geometry::build(vec![shape.clone()]);
    bencher
        .with_inputs(|| shape.clone())
        .bench_values(|shape| geometry.moved([(ShapeId(0), shape)]));
}

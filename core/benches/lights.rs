//! Choosing among many lights.
//!
//!     cargo bench -p photonfarm-core --bench lights
//!
//! `divan` prints items per second on one thread. A choice takes time that grows as the logarithm of the number of lights, and with
//! misses of the cache.

use divan::Bencher;
use divan::counter::ItemsCount;
use photonfarm_core::geometry::Geometry;
use photonfarm_core::light::{Light, Lights};
use photonfarm_core::math::Vec3;
use photonfarm_core::math::warp::square_to_sphere;
use photonfarm_core::random::{PathRandom, Stream};
use photonfarm_core::spectrum::Spectrum;

const NUMBERS: [u32; 3] = [100, 10_000, 1_000_000];
const CHOICES: u64 = 10_000;

fn main() {
    divan::main();
}

/// That many point lights of uneven power in a constant environment, and no shape.
fn lights(number: u32) -> (Lights, Geometry) {
    let geometry = Geometry::build(Vec::new());
    let mut random = PathRandom::new(1, 1, Stream::Light, 0);
    let mut point = || Light::Point {
        position: square_to_sphere(random.next_2d()),
        intensity: Spectrum::splat(random.next_1d()),
    };
    let mut lights: Vec<Light> = (0..number).map(|_| point()).collect();
    lights.push(Light::Constant {
        radiance: Spectrum::ONE,
    });
    (Lights::build(lights, &geometry), geometry)
}

/// Connections of a point with a light; items are connections.
#[divan::bench(args = NUMBERS)]
fn sample_direct(bencher: Bencher, number: u32) {
    let (lights, geometry) = lights(number);
    bencher.counter(ItemsCount::new(CHOICES)).bench(|| {
        (0..CHOICES)
            .filter_map(|path| {
                let mut random = PathRandom::new(2, 1, Stream::Camera, path);
                lights.sample_direct(&geometry, Vec3::ZERO, random.next_choice(), random.next_choice_2d())
            })
            .map(|sample| sample.distance)
            .filter(|distance| distance.is_finite())
            .sum::<f32>()
    });
}

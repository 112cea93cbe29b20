//! The diffusion limit: light that comes through a thick slab which absorbs nothing.

use super::{agrees, estimate, path, scene};
use std::f64::consts::PI;

/// How far beyond a bound the mean radiance seems to come to nothing, in mean free paths (Milne's problem; Chandrasekhar 1960).
const EXTRAPOLATED: f64 = 0.710_446;

/// A lamp of radiance 1 shines into one end of a tube whose walls are mirrors, so that the slab seems to have no end, and a meter stands at the
/// other end. Of a slab of the optical thickness tau, `4 / 3 / (tau + 2 q)` comes through, with q of Milne's problem; what is left out
/// falls as `exp(-2 tau)`.
#[test]
fn a_thick_slab_lets_through_what_diffusion_says() {
    let end = |z: &str, angle: u32, kind: &str| {
        format!(
            "<shape type='rectangle'><transform name='to_world'><rotate y='1' angle='{angle}'/><translate z='{z}'/></transform>\
             <bsdf type='diffuse'><rgb name='reflectance' value='0'/></bsdf>{kind}</shape>"
        )
    };
    let lamp = end(
        "-0.999",
        0,
        "<emitter type='area'><rgb name='radiance' value='1'/></emitter>",
    );
    let meter = end(
        "0.999",
        180,
        "<sensor type='irradiancemeter'><ref id='fog'/><film type='hdrfilm'><integer name='width' value='1'/>\
         <integer name='height' value='1'/><rfilter type='box'/></film></sensor>",
    );
    let scene = scene(&format!(
        "<medium id='fog' type='homogeneous'><float name='sigma_t' value='2'/><float name='albedo' value='1'/></medium>\
         <shape type='cube'><boolean name='flip_normals' value='true'/><bsdf type='conductor'><string name='material' value='none'/></bsdf></shape>\
         {lamp}{meter}"
    ));
    let found = estimate(&scene, &path(1 << 12, None), 16);
    let expected = PI * 4.0 / 3.0 / (2.0 * 2.0 * 0.999 + 2.0 * EXTRAPOLATED);
    agrees("irradiance", found[0], expected, 1e-3);
    assert!(found[0].1 < 0.02 * expected, "{:?} says nothing", found[0]);
}

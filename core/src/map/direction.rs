use crate::math::Vec3;

/// Largest value of a coordinate.
const SCALE: f32 = 32767.0;

/// A unit direction in 32 bits: octahedral map (Cigolle et al. 2014), 16 bits a coordinate.
#[must_use]
pub fn encode_direction(d: Vec3) -> u32 {
    let d = d / (d.x.abs() + d.y.abs() + d.z.abs());
    let (x, y) = if d.z >= 0.0 { (d.x, d.y) } else { fold(d.x, d.y) };
    let quantise = |v: f32| u32::from((v * SCALE).round() as i16 as u16);
    quantise(x) << 16 | quantise(y)
}

/// The unit direction of [`encode_direction`], to about 7e-5 radians.
#[must_use]
pub fn decode_direction(code: u32) -> Vec3 {
    let restore = |bits: u32| f32::from(bits as u16 as i16) / SCALE;
    let (x, y) = (restore(code >> 16), restore(code));
    let z = 1.0 - x.abs() - y.abs();
    let (x, y) = if z >= 0.0 { (x, y) } else { fold(x, y) };
    Vec3::new(x, y, z).normalize()
}

/// Folds the lower half of the octahedron over the corners of the square.
fn fold(x: f32, y: f32) -> (f32, f32) {
    ((1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y))
}

//! The light of a clear day: the sky and the sun, as functions of the sun's place and of the air.
//!
//! The models work in a frame of their own, in which +z is up. Mitsuba 3 has the south along +x and the east along -y there.
//!
//! Radiances and irradiances are in Mitsuba's unit: those of the spectral models [W/(m^2 nm sr), W/(m^2 nm)], integrated over wavelength by
//! the observer of the CIE and divided by the integral of its y.

mod hosek_wilkie;
mod preetham;
mod sun_position;

pub use hosek_wilkie::{Sky, sun_irradiance};
pub use preetham::sun_spectrum;
pub use sun_position::{Moment, sun_direction};

/// Angle that the sun is seen under in both sun models \[degrees\].
pub const SUN_APERTURE: f64 = 0.5358;

/// What divides integrals over the observer of the CIE, so that the constant spectrum 1 has luminance 1: the integral of y \[nm\].
const Y_INTEGRAL: f64 = 106.750_259_399_414_06;

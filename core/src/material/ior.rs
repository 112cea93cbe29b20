//! Indices of refraction by name.
//!
//! Dielectrics: real indices at 589 nm and 0 to 20 degrees Celsius from handbooks (Hecht, *Optics*, 4th edition),
//! under the names and with the values of Mitsuba 3.9.1. Conductors: complex indices from the measured spectra that
//! Mitsuba 3.9.1 ships (Palik, *Handbook of Optical Constants of Solids*; SOPRA; luxpop.com), integrated against the CIE
//! 1931 colour-matching functions and turned to linear Rec. 709 by `core/tools/conductor_table.py`.

use super::conductors::CONDUCTORS;
use crate::spectrum::Spectrum;

const DIELECTRICS: &[(&str, f32)] = &[
    ("vacuum", 1.0),
    ("helium", 1.000_036),
    ("hydrogen", 1.000_132),
    ("air", 1.000_277),
    ("carbon dioxide", 1.000_45),
    ("water", 1.333),
    ("acetone", 1.36),
    ("ethanol", 1.361),
    ("carbon tetrachloride", 1.461),
    ("glycerol", 1.4729),
    ("benzene", 1.501),
    ("silicone oil", 1.520_45),
    ("bromine", 1.661),
    ("water ice", 1.31),
    ("fused quartz", 1.458),
    ("pyrex", 1.47),
    ("acrylic glass", 1.49),
    ("polypropylene", 1.49),
    ("bk7", 1.5046),
    ("sodium chloride", 1.544),
    ("amber", 1.55),
    ("pet", 1.575),
    ("diamond", 2.419),
];

/// Index of refraction of a transparent medium; `None` for an unknown name.
#[must_use]
pub fn dielectric(name: &str) -> Option<f32> {
    DIELECTRICS.iter().find(|entry| entry.0 == name).map(|entry| entry.1)
}

/// Real and imaginary part of the index of a conductor; `None` for an unknown name. `none` is a perfect mirror.
#[must_use]
pub fn conductor(name: &str) -> Option<(Spectrum, Spectrum)> {
    let entry = CONDUCTORS.iter().find(|entry| entry.0 == name)?;
    Some((Spectrum::from_rgb(entry.1), Spectrum::from_rgb(entry.2)))
}

/// The names that [`dielectric`] knows.
pub fn dielectric_names() -> impl Iterator<Item = &'static str> {
    DIELECTRICS.iter().map(|entry| entry.0)
}

/// The names that [`conductor`] knows.
pub fn conductor_names() -> impl Iterator<Item = &'static str> {
    CONDUCTORS.iter().map(|entry| entry.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_found_once_with_a_usable_index() {
        for name in dielectric_names() {
            assert!((1.0..3.0).contains(&dielectric(name).unwrap()), "{name}");
            assert_eq!(dielectric_names().filter(|other| *other == name).count(), 1);
        }
        for name in conductor_names() {
            let (eta, k) = conductor(name).unwrap();
            assert!(
                eta.is_valid() && k.is_valid() && (eta + k).max_component() > 0.5,
                "{name}"
            );
            assert_eq!(conductor_names().filter(|other| *other == name).count(), 1);
        }
        assert_eq!((dielectric("unobtainium"), conductor("unobtainium")), (None, None));
    }

    /// Values of Mitsuba 3.9.1, variant scalar_rgb.
    #[test]
    fn gold_and_the_perfect_mirror_are_mitsubas() {
        let (eta, k) = conductor("Au").unwrap();
        assert_eq!(
            (eta.to_rgb(), k.to_rgb()),
            ([0.143_036, 0.375_307, 1.442_05], [3.983, 2.385_56, 1.603_36])
        );
        assert_eq!(conductor("none"), Some((Spectrum::ZERO, Spectrum::ONE)));
    }
}

//! What fills solids, by the numbers of KHR_materials_volume and KHR_materials_volume_scatter.

use super::document::Volume;

/// The extinction coefficient of KHR_materials_volume, -ln(c) / d; `None` where nothing is lost.
pub(super) fn extinction(volume: &Volume) -> Option<[f64; 3]> {
    let distance = volume.attenuation_distance.filter(|distance| *distance > 0.0)?;
    // What lets nothing through would be infinite.
    let sigma_t = volume
        .attenuation_color
        .map(|colour| (-libm::log(colour.clamp(DARKEST, 1.0)) / distance).clamp(0.0, MOST_EXTINCTION));
    (sigma_t != [0.0; 3]).then_some(sigma_t)
}

/// The albedo of one scattering for the colour that many of them give (KHR_materials_volume_scatter, "Multi-Scatter Albedo", after Kulla and Conty
/// 2017, "Revisiting Physically Based Shading at Imageworks").
pub(super) fn single_scattering(colour: f64) -> f64 {
    let root = (9.592_17 + 41.680_8 * colour + 17.712_6 * colour * colour).sqrt();
    let s = 4.097_12 + 4.208_63 * colour - root;
    (1.0 - s * s).clamp(0.0, 1.0)
}

/// The darkest colour that is left over the attenuation distance.
const DARKEST: f64 = 1e-6;
/// The largest extinction coefficient \[1/m\].
const MOST_EXTINCTION: f64 = 1e12;

#[cfg(test)]
mod tests {
    use super::*;

    /// Over the attenuation distance the attenuation colour is left.
    #[test]
    fn extinction_leaves_the_colour_over_the_distance() {
        let volume = |distance: Option<f64>, color: [f64; 3]| Volume {
            thickness_factor: 1.0,
            attenuation_distance: distance,
            attenuation_color: color,
        };
        let sigma_t = extinction(&volume(Some(0.5), [0.25, 0.5, 1.0])).unwrap();
        for (sigma, colour) in sigma_t.into_iter().zip([0.25, 0.5, 1.0]) {
            assert!((libm::exp(-0.5 * sigma) - colour).abs() < 1e-12);
        }
        assert_eq!(extinction(&volume(Some(0.5), [1.0; 3])), None);
        assert_eq!(extinction(&volume(None, [0.5; 3])), None);
        assert_eq!(extinction(&volume(Some(0.0), [0.5; 3])), None);
        let black = extinction(&volume(Some(1e-300), [0.0; 3])).unwrap();
        assert!(black.iter().all(|sigma| sigma.is_finite()));
    }

    /// Without scattering nothing is scattered once, and what scatters all looks white.
    #[test]
    fn the_ends_of_the_albedo_are_kept() {
        assert!(single_scattering(0.0).abs() < 1e-4);
        assert!((single_scattering(1.0) - 1.0).abs() < 1e-4);
        // The formula at 1/2, by hand: the root is 5.904297, s = 0.297138.
        assert!(
            (single_scattering(0.5) - 0.911_709).abs() < 1e-4,
            "{}",
            single_scattering(0.5)
        );
    }
}

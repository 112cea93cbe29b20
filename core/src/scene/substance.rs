//! Media that were measured, by the names that Mitsuba 0.6 and pbrt have for them.

/// Coefficients of a medium for red, green and blue \[1/mm\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Substance {
    pub(crate) name: &'static str,
    /// Reduced scattering coefficient: what scatters evenly in all directions and spreads light as far.
    pub(crate) sigma_s: [f64; 3],
    pub(crate) sigma_a: [f64; 3],
}

const fn substance(name: &'static str, sigma_s: [f64; 3], sigma_a: [f64; 3]) -> Substance {
    Substance { name, sigma_s, sigma_a }
}

/// Up to `Wholemilk`: Jensen, Marschner, Levoy and Hanrahan 2001, "A Practical Model for Subsurface Light Transport", figure 5. The rest: Narasimhan,
/// Gupta, Donner, Ramamoorthi, Nayar and Jensen 2006, "Acquiring Scattering Properties of Participating Media by Dilution", table 2, as
/// pbrt-v4 has it (`media.cpp`).
#[rustfmt::skip]
const SUBSTANCES: [Substance; 49] = [
    substance("Apple", [2.29, 2.39, 1.97], [0.0030, 0.0034, 0.046]),
    substance("Chicken1", [0.15, 0.21, 0.38], [0.015, 0.077, 0.19]),
    substance("Chicken2", [0.19, 0.25, 0.32], [0.018, 0.088, 0.20]),
    substance("Cream", [7.38, 5.47, 3.15], [0.0002, 0.0028, 0.0163]),
    substance("Ketchup", [0.18, 0.07, 0.03], [0.061, 0.97, 1.45]),
    substance("Marble", [2.19, 2.62, 3.00], [0.0021, 0.0041, 0.0071]),
    substance("Potato", [0.68, 0.70, 0.55], [0.0024, 0.0090, 0.12]),
    substance("Skimmilk", [0.70, 1.22, 1.90], [0.0014, 0.0025, 0.0142]),
    substance("Skin1", [0.74, 0.88, 1.01], [0.032, 0.17, 0.48]),
    substance("Skin2", [1.09, 1.59, 1.79], [0.013, 0.070, 0.145]),
    substance("Spectralon", [11.6, 20.4, 14.9], [0.0, 0.0, 0.0]),
    substance("Wholemilk", [2.55, 3.21, 3.77], [0.0011, 0.0024, 0.014]),
    substance("Lowfat Milk", [0.89187, 1.5136, 2.532], [0.002875, 0.00575, 0.0115]),
    substance("Reduced Milk", [2.4858, 3.1669, 4.5214], [0.0025556, 0.0051111, 0.012778]),
    substance("Regular Milk", [4.5513, 5.8294, 7.136], [0.0015333, 0.0046, 0.019933]),
    substance("Espresso", [0.72378, 0.84557, 1.0247], [4.7984, 6.5751, 8.8493]),
    substance("Mint Mocha Coffee", [0.31602, 0.38538, 0.48131], [3.772, 5.8228, 7.82]),
    substance("Lowfat Soy Milk", [0.30576, 0.34233, 0.61664], [0.0014375, 0.0071875, 0.035937]),
    substance("Regular Soy Milk", [0.59223, 0.73866, 1.4693], [0.0019167, 0.0095833, 0.065167]),
    substance("Lowfat Chocolate Milk", [0.64925, 0.83916, 1.1057], [0.0115, 0.0368, 0.1564]),
    substance("Regular Chocolate Milk", [1.4585, 2.1289, 2.9527], [0.010063, 0.043125, 0.14375]),
    substance("Coke", [8.9053e-5, 8.372e-5, 0.0], [0.10014, 0.16503, 0.2468]),
    substance("Pepsi", [6.1697e-5, 4.2564e-5, 0.0], [0.091641, 0.14158, 0.20729]),
    substance("Sprite", [6.0306e-6, 6.4139e-6, 6.5504e-6], [0.001886, 0.0018308, 0.0020025]),
    substance("Gatorade", [0.0024574, 0.003007, 0.0037325], [0.024794, 0.019289, 0.008878]),
    substance("Chardonnay", [1.7982e-5, 1.3758e-5, 1.2023e-5], [0.010782, 0.011855, 0.023997]),
    substance("White Zinfandel", [1.7501e-5, 1.9069e-5, 1.288e-5], [0.012072, 0.016184, 0.019843]),
    substance("Merlot", [2.1129e-5, 0.0, 0.0], [0.11632, 0.25191, 0.29434]),
    substance("Budweiser Beer", [2.4356e-5, 2.4079e-5, 1.0564e-5], [0.011492, 0.024911, 0.057786]),
    substance("Coors Light Beer", [5.0922e-5, 4.301e-5, 0.0], [0.006164, 0.013984, 0.034983]),
    substance("Clorox", [0.0024035, 0.0031373, 0.003991], [0.0033542, 0.014892, 0.026297]),
    substance("Apple Juice", [0.00013612, 0.00015836, 0.000227], [0.012957, 0.023741, 0.052184]),
    substance("Cranberry Juice", [0.00010402, 0.00011646, 7.8139e-5], [0.039437, 0.094223, 0.12426]),
    substance("Grape Juice", [5.382e-5, 0.0, 0.0], [0.10404, 0.23958, 0.29325]),
    substance("Ruby Grapefruit Juice", [0.011002, 0.010927, 0.011036], [0.085867, 0.18314, 0.25262]),
    substance("White Grapefruit Juice", [0.22826, 0.23998, 0.32748], [0.0138, 0.018831, 0.056781]),
    substance("Shampoo", [0.0007176, 0.0008303, 0.0009016], [0.014107, 0.045693, 0.061717]),
    substance("Strawberry Shampoo", [0.00015671, 0.00015947, 1.518e-5], [0.01449, 0.05796, 0.075823]),
    substance("Head & Shoulders Shampoo", [0.023805, 0.028804, 0.034306], [0.084621, 0.15688, 0.20365]),
    substance("Lemon Tea Powder", [0.040224, 0.045264, 0.051081], [2.4288, 4.5757, 7.2127]),
    // Mitsuba calls it the former, pbrt the latter.
    substance("Orange Juice Powder", [0.00015617, 0.00017482, 0.0001762], [0.001449, 0.003441, 0.007863]),
    substance("Orange Powder", [0.00015617, 0.00017482, 0.0001762], [0.001449, 0.003441, 0.007863]),
    substance("Pink Lemonade Powder", [0.00012103, 0.00013073, 0.00012528], [0.001165, 0.002366, 0.003195]),
    substance("Cappuccino Powder", [1.8436, 2.5851, 2.1662], [35.844, 49.547, 61.084]),
    substance("Salt Powder", [0.027333, 0.032451, 0.031979], [0.28415, 0.3257, 0.34148]),
    substance("Sugar Powder", [0.00022272, 0.00025513, 0.000271], [0.012638, 0.031051, 0.050124]),
    substance("Suisse Mocha Powder", [2.7979, 3.5452, 4.3365], [17.502, 27.004, 35.433]),
    substance("Suisse Mocha", [2.7979, 3.5452, 4.3365], [17.502, 27.004, 35.433]),
    substance("Pacific Ocean Surface Water", [0.0001764, 0.00032095, 0.00019617], [0.031845, 0.031324, 0.030147]),
];

/// What Mitsuba 0.6 takes for a medium that says nothing.
pub(crate) const SKIN: Substance = SUBSTANCES[8];

/// The substance of a name, whatever its case and blanks.
pub(crate) fn named(name: &str) -> Option<Substance> {
    let plain = |name: &str| name.replace(' ', "").to_ascii_lowercase();
    let wanted = plain(name);
    SUBSTANCES.into_iter().find(|substance| plain(substance.name) == wanted)
}

/// The names of all of them.
pub(crate) fn names() -> impl Iterator<Item = &'static str> {
    SUBSTANCES.iter().map(|substance| substance.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_found_in_any_case() {
        for name in ["skin1", "Skin1", "SKIN 1"] {
            assert_eq!(named(name), Some(SKIN));
        }
        assert_eq!(named("whole milk").map(|milk| milk.sigma_s), Some([2.55, 3.21, 3.77]));
        assert_eq!(named("head & shoulders shampoo").map(|it| it.sigma_a[2]), Some(0.20365));
        assert_eq!(named("skin3"), None);
        let mut all: Vec<&str> = names().collect();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), SUBSTANCES.len());
    }
}

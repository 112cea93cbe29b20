"""The comparison must pass equal pictures and fail wrong ones, at the sizes at which it is used."""

import math
import unittest

import numpy as np

import noise


def renders(seed, count=8, size=60, gain=1.0, patch=1.0, tail=2.0):
    """Renders of a gradient with skewed noise, as a path tracer's."""
    generator = np.random.default_rng(seed)
    truth = np.linspace(0.2, 1.0, size)[None, :, None] * np.array([1.0, 0.8, 0.6]) * np.ones((size, 1, 1)) * gain
    truth[8:24, 8:24] *= patch
    return truth * generator.gamma(tail, 1 / tail, (count, size, size, 1))


class Comparison(unittest.TestCase):
    def test_equal_pictures_pass(self):
        for seed in range(20):
            verdict = noise.compare(renders(2 * seed), renders(2 * seed + 1))
            self.assertEqual(verdict.faults, [], f"seed {seed}")

    def test_unequal_noise_passes(self):
        for seed in range(20):
            verdict = noise.compare(renders(2 * seed, tail=8.0), renders(2 * seed + 1, tail=2.0))
            self.assertEqual(verdict.faults, [], f"seed {seed}")

    def test_a_wrong_brightness_fails(self):
        self.assertIn("means differ", noise.compare(renders(1, gain=1.03), renders(2)).faults)

    def test_a_wrong_brightness_fails_under_fireflies(self):
        a, b = renders(1, gain=1.02, tail=20.0), renders(2, tail=20.0)
        for stack, pixel in ((a, 3), (b, 50)):
            stack[:2, pixel, pixel] = 1e5
        self.assertIn("medians differ", noise.compare(a, b).faults)

    def test_a_wrong_patch_fails(self):
        self.assertIn("a block differs", noise.compare(renders(1, patch=1.35), renders(2)).faults)

    def test_a_shifted_picture_fails(self):
        verdict = noise.compare(renders(1)[:, :, ::-1], renders(2))
        self.assertIn("too many pixels differ", verdict.faults)

    def test_rounding_alone_passes_and_a_constant_offset_fails(self):
        flat = np.full((8, 32, 32, 3), 0.5)
        self.assertEqual(noise.compare(flat, flat * (1 + 5e-5)).faults, [])
        self.assertNotEqual(noise.compare(flat, flat * 1.002).faults, [])

    def test_an_infinite_pixel_is_refused(self):
        bad = renders(1)
        bad[0, 3, 3] = math.inf
        with self.assertRaises(ValueError):
            noise.compare(bad, renders(2))

    def test_scores_are_standard_normal(self):
        generator = np.random.default_rng(5)
        z = noise.z_scores(generator.normal(size=(8, 200000)), generator.normal(size=(8, 200000)))
        self.assertAlmostEqual(float((abs(z) > 3).mean()), noise.PIXEL_SHARE, delta=6e-4)
        self.assertAlmostEqual(float(z.std()), 1.0, delta=0.02)

    def test_relative_variance_is_that_of_the_noise(self):
        # A gamma distribution of shape k has a variance of its squared mean over k.
        for tail in (4.0, 16.0):
            pictures = renders(1, count=200, tail=tail)
            value, error = noise.relative_variance(pictures, 0)
            self.assertAlmostEqual(value, 1 / tail, delta=5 * error)
            self.assertAlmostEqual(noise.relative_variance(0.5 * pictures, 0)[0], value, places=9)

    def test_a_pixel_lit_in_one_render_counts_for_the_number_of_renders(self):
        pictures = np.zeros((6, 1, 1, 3))
        pictures[2] = 7.0
        self.assertAlmostEqual(noise.relative_variance(pictures, 0)[0], 6.0, places=12)

    def test_sidak_limit(self):
        self.assertAlmostEqual(noise.sidak(0.05, 1), 1.95996, places=4)
        single = math.erfc(noise.sidak(0.05, 100) / math.sqrt(2))
        self.assertAlmostEqual(1 - (1 - single) ** 100, 0.05, places=9)


if __name__ == "__main__":
    unittest.main()

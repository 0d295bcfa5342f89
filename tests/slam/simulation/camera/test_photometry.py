import numpy as np
import pytest

from slam.simulation.camera import photometry

RNG = np.random.default_rng


@pytest.mark.slow
@pytest.mark.parametrize("tau_s", [0.2, 1.0, 2.0])
def test_tones_vary_with_their_standard_deviation_and_time_constant(tau_s):
    """Two-sided, over 600 flights of 40 s: standard deviation and correlation after one time constant."""
    stamps = np.arange(600) / 15
    walks = np.log([photometry.tones(stamps, 0.1, 0.3, tau_s, RNG(seed)) for seed in range(600)])
    assert walks[:, 0].std(0) == pytest.approx([0.1, 0.1, 0.1, 0.3], rel=0.12)
    assert walks.std((0, 1)) == pytest.approx([0.1, 0.1, 0.1, 0.3], rel=0.04)
    assert abs(walks.mean((0, 1)) / [0.1, 0.1, 0.1, 0.3]).max() < 0.06
    lag = round(15 * tau_s)
    later, sooner = walks[:, lag:], walks[:, :-lag]
    correlation = (later * sooner).mean((0, 1)) / walks.var((0, 1))
    assert correlation == pytest.approx([np.exp(-1)] * 4, abs=0.06)
    across = np.corrcoef(walks[..., 0].ravel(), walks[..., 1].ravel())[0, 1]
    assert abs(across) < 0.07


def test_without_memory_each_picture_is_toned_anew():
    walk = np.log(photometry.tones(np.arange(20_000) / 15, 0.1, 0.3, 0.0, RNG(0)))
    assert walk.std(0) == pytest.approx([0.1, 0.1, 0.1, 0.3], rel=0.03)
    assert abs(np.mean(walk[1:] * walk[:-1], axis=0) / walk.var(0)).max() < 0.03
    assert photometry.tones(np.array([0.3]), 0.1, 0.1, 0.0, RNG(0)).shape == (1, 4)


def test_toning_is_gain_times_power():
    light = np.array([[[51.0, 102.0, 255.0]]], np.float32)
    out = photometry.apply_tone(light, np.array([0.9, 1.1, 1.0, 1.4]))
    assert out[0, 0] == pytest.approx([255 * 0.9 * 0.2**1.4, 255 * 1.1 * 0.4**1.4, 255.0], rel=1e-5)
    assert photometry.apply_tone(light, np.ones(4)) == pytest.approx(light, rel=1e-5)


def test_vignetting_falls_with_the_square_to_the_corner():
    share = photometry.falloff((176, 144), (87.5, 71.5), 0.4)
    assert share[0, 0] == share[-1, -1] == pytest.approx(0.6)
    half = 1 - 0.4 * (44**2 + 0.5**2) / (87.5**2 + 71.5**2)
    assert share[72, 87 + 44] == pytest.approx(half, abs=0.002)
    # Off-centre, the far corner is the dark one, and none is below nothing.
    off = photometry.falloff((176, 144), (60.0, 71.5), 1.5)
    assert off[0, -1] == 0 < off[0, 0] < 1


def test_saturation_leaves_grey_grey_and_brightness_scales():
    light = np.array([[[80.0, 80.0, 80.0], [20.0, 120.0, 200.0]]], np.float32)
    half = photometry.process(light, 0.5, 1.0)
    luma = 0.114 * 20 + 0.587 * 120 + 0.299 * 200
    assert half[0, 0] == pytest.approx([80, 80, 80], rel=1e-5)
    assert half[0, 1] == pytest.approx([(v + luma) / 2 for v in (20, 120, 200)], rel=1e-5)
    assert photometry.process(light, 0.0, 1.2)[0, 1] == pytest.approx([1.2 * luma] * 3, rel=1e-5)
    assert photometry.process(light, 1.0, 2.0)[0, 1] == pytest.approx([40, 240, 255], rel=1e-5)
    assert photometry.process(light, 1.0, 1.0) is light


def test_digits_are_rounded_clipped_and_noisy():
    light = np.array([[[-3.0, 99.6, 300.0]]], np.float32)
    assert photometry.digitise(light, 0.0, RNG(0)).tolist() == [[[0, 100, 255]]]
    even = np.full((200, 200, 3), 120, np.uint8)
    assert photometry.digitise(even, 3.0, RNG(0)).std() == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.02)
    assert photometry.digitise(even, 3.0, RNG(0)).dtype == np.uint8

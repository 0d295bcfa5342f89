"""What is stated of gain and zero of a rangefinder is weighed against wider priors, over a made floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle import range_evidence as module
from backend.bundle.problem import ScalePrior
from backend.bundle.range_evidence import RangeEvidence, RangePrior, range_evidence
from backend.bundle.refinement import refine
from backend.significance import STRONG_NATS, VERY_STRONG_NATS
from tests.backend.made_floor import Scene, make

EXACT, GAIN, ZERO = RangePrior(0.0, 0.0), RangePrior(0.05, 0.0), RangePrior(0.0, 0.1)
BOTH = RangePrior(GAIN.gain_std, ZERO.zero_std_m)
SCENE = Scene(attitude_std_rad=0.003, height_swing=0.3)
GPS_M = (0.02, 0.02)


def told(scene: Scene, seed: int = 0, lengths: ScalePrior | None = None) -> RangeEvidence:
    """What the scene tells of gain and zero, on a map in which both are held as exact."""
    made = make(scene, seed)
    return range_evidence(refine(made.measurements, made.start, made.floor_z_m).optimum, EXACT, BOTH, lengths)


def gains(found: RangeEvidence) -> tuple[float, float]:
    """Evidence of a free gain and of a free zero over that of exact ones."""
    exact = found.log_evidence(EXACT)
    return found.log_evidence(GAIN) - exact, found.log_evidence(ZERO) - exact


def test_ranges_that_are_exact_as_stated_are_not_doubted():
    assert max(gains(told(SCENE))) < 0.1


def test_a_wrong_zero_shows_where_the_height_changes():
    found = told(replace(SCENE, range_datum_m=-0.1))
    by_gain, by_zero = gains(found)
    assert by_zero > VERY_STRONG_NATS
    assert by_gain < 0.1, "a gain and the scale of the map are one"
    (_, zero_m), (_, std_m) = found.errors(ZERO)
    assert abs(zero_m + 0.1) < 3 * std_m
    assert std_m < 0.02


def test_at_one_height_nothing_tells_a_zero_from_the_scale():
    level = replace(SCENE, height_swing=0.0)
    assert max(gains(told(replace(level, range_datum_m=0.1)))) < 0.1
    # Positions do: then it is a gain as well.
    by_gain, by_zero = gains(told(replace(level, range_datum_m=0.06, position_std_m=GPS_M)))
    assert min(by_gain, by_zero) > VERY_STRONG_NATS
    assert abs(by_gain - by_zero) < STRONG_NATS


def test_lengths_of_another_instrument_show_a_gain():
    by_gain, by_zero = gains(told(SCENE, lengths=ScalePrior(1 / 1.1, 0.02)))
    assert by_gain > VERY_STRONG_NATS
    assert by_zero < by_gain
    assert max(gains(told(SCENE, lengths=ScalePrior(1.02, 0.02)))) < STRONG_NATS


def test_hills_that_the_beams_hear_are_no_noise_of_the_ranges(monkeypatch: pytest.MonkeyPatch):
    """What the pictures show of the ground below counts, so that its rise with the flight is no zero."""
    made = make(replace(SCENE, rolling=0.05, wavelengths=(3.0, 5.0), pixel_std=0.1), 0)
    place, height = made.point[:, :2], made.point[:, 2]
    below_m = []
    for r in made.measurements.ranges:
        near = np.argsort(np.linalg.norm(place - made.w_T_b[r.k, :2, 3], axis=1))[:8]
        below_m.append(height[near].mean())
    ranges = tuple(
        replace(r, range_m=r.range_m - below)
        for r, below in zip(made.measurements.ranges, below_m, strict=True)
    )
    optimum = refine(replace(made.measurements, ranges=ranges), made.start).optimum
    found_m = module.ground_below_m(optimum.problem, optimum.at, optimum.at.point[:, 2])[0]
    assert np.corrcoef(found_m, below_m)[0, 1] > 0.9
    assert np.polyfit(found_m, below_m, 1)[0] == pytest.approx(1.0, abs=0.25)
    _, (_, with_ground_m) = range_evidence(optimum, EXACT, BOTH).errors(ZERO)
    monkeypatch.setattr(module, "ground_below_m", lambda *_: np.zeros((2, len(ranges))))
    _, (_, without_m) = range_evidence(optimum, EXACT, BOTH).errors(ZERO)
    assert with_ground_m < 0.7 * without_m


def test_copies_of_all_ranges_hardly_tell_the_zero_better():
    made = make(replace(SCENE, keyframes=30), 0)
    std_m = []
    for copies in (1, 9):
        measured = replace(made.measurements, ranges=made.measurements.ranges * copies)
        optimum = refine(measured, made.start, made.floor_z_m).optimum
        std_m.append(range_evidence(optimum, EXACT, BOTH).errors(ZERO)[1][1])
    assert std_m[1] > 0.7 * std_m[0]


def test_an_exact_zero_is_as_uncertain_as_the_relief_that_the_beams_hear():
    found = told(replace(SCENE, relief=0.03))
    assert found.prior_std(EXACT)[1] == pytest.approx(found.floor_std_m)
    assert found.floor_std_m == pytest.approx(0.03, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("ground", [{}, {"rolling": 0.05}, {"walls": 0.2}])
@pytest.mark.parametrize("zero_m", [0.0, 0.06])
def test_the_zero_is_within_what_the_evidence_says(ground: dict[str, float], zero_m: float):
    """Over flat ground, hills, and structure."""
    off = list[float]()
    for seed in range(6):
        found = told(replace(SCENE, keyframes=30, range_datum_m=zero_m, **ground), seed)
        (_, zero), (_, std_m) = found.errors(ZERO)
        off.append((zero - zero_m) / std_m)
        assert zero_m or gains(found)[1] < VERY_STRONG_NATS
    assert np.mean(np.square(off)) < 2.8, "the limit of a chi-square variable over 6, at 1 %"

"""The refinement on made cameras over a made floor: truth, covariances and noise levels."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from backend.bundle.minimise import BundleCost, BundleMinimum, minimise_bundle
from backend.bundle.problem import Variables
from backend.bundle.refinement import Bundle, refine
from tests.backend.bundle.made_scenes import SCENES, SEEDS, SONAR, SURVEY, errors_squared, position_rms
from tests.backend.made_floor import CAMERA, Made, Scene, aligned, make, mark_nees

SLOWER = (
    "sonar, no attitude", "pixels three times as noisy as stated", "relief and a coarse sonar",
    "gps and attitude over a slope", "rtk, lens wrong", "relief", "gps", "gps over a slope",
    "gps and attitude", "tilted mount",
)  # fmt: skip
"""Each is two of the others together, a part of one of them, or has a test of its own: in test_noise.py, or
that of the tilted mount in test_reduced_system.py."""
NAMES = [pytest.param(name, marks=pytest.mark.slow) if name in SLOWER else name for name in SCENES]


@lru_cache
def solved(name: str) -> tuple[tuple[Made, Bundle], ...]:
    """A scene drawn and refined twenty times."""
    made = [make(SCENES[name], seed) for seed in SEEDS]
    return tuple((m, refine(m.measurements, m.start, m.floor_z_m)) for m in made)


def some(name: str) -> list[Bundle]:
    """A scene drawn and refined eight times."""
    made = (make(SCENES[name], seed) for seed in SEEDS[:8])
    return [refine(m.measurements, m.start, m.floor_z_m) for m in made]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["height of the floor by a coarse gps", "scale by a coarse sonar"])
def test_landmark_covariances_are_consistent(name: str):
    """A floor of unknown height misplaces no mark; a wrong scale moves marks from the floor's origin."""
    scene = {
        "height of the floor by a coarse gps": Scene(position_std_m=(0.02, 0.5), slope_rad=(0.04, -0.03)),
        "scale by a coarse sonar": Scene(range_std_m=0.2),
    }[name]
    drawn = []
    for seed in range(40):
        made = make(scene, seed)
        bundle = refine(made.measurements, made.start, made.floor_z_m)
        drawn.append([mark_nees(made, bundle, k) for k in (1, scene.keyframes // 2 - 1)])
    of_each = np.sum(drawn, axis=0)
    assert (chi2.ppf(0.0005, 2 * len(drawn)) < of_each).all()
    assert (of_each < chi2.ppf(0.9995, 2 * len(drawn))).all()


@pytest.mark.parametrize("name", NAMES)
def test_pose_covariances_are_consistent(name: str):
    """One pose a draw is independent of other draws: its sum is chi-square. All poses: a closer look."""
    drawn = np.array([errors_squared(made, bundle) for made, bundle in solved(name)])
    lower, upper = chi2.ppf([0.001, 0.999], 6 * len(SEEDS)) / len(SEEDS)
    for pose in (drawn.shape[1] // 2, -1):
        assert lower < drawn[:, pose].mean() < upper
    assert 4.6 < drawn.mean() < 7.4


@pytest.mark.parametrize("name", NAMES)
def test_noise_levels_are_recovered(name: str):
    scene, found = SCENES[name], [bundle.noise for _, bundle in solved(name)]
    expected = {"pixel_scale": scene.pixel_std / scene.told_pixel_std}
    if scene.relief:
        expected["relief"] = scene.relief
    if scene.range_std_m is not None:
        expected["range_m"] = scene.range_std_m
    if scene.attitude_std_rad is not None:
        # Chance autocorrelation of few keyframes counts upward only; what poses follow of the attitudes where
        # pictures are poor, downward.
        level = np.mean([level.roll_pitch_rad for level in found])
        assert 0.9 * scene.attitude_std_rad < level < 1.35 * scene.attitude_std_rad
    for kind, put_in in expected.items():
        assert np.mean([getattr(level, kind) for level in found]) == pytest.approx(put_in, rel=0.2), kind
    if scene.position_std_m is not None:
        horizontal, _, vertical = np.mean([level.position_m for level in found], axis=0)
        if name == "rtk, lens wrong":
            # The fit follows such positions. Their noise is found from above, and the rounds end before it.
            assert scene.position_std_m[0] < horizontal < 2 * scene.position_std_m[0]
            assert scene.position_std_m[1] < vertical < 2 * scene.position_std_m[1]
        else:
            assert (horizontal, vertical) == pytest.approx(scene.position_std_m, rel=0.2)
    if not scene.relief:
        assert np.mean([level.relief for level in found]) < 0.004


@pytest.mark.parametrize("name", NAMES)
def test_no_good_observation_is_dropped(name: str):
    dropped = sum(bundle.dropped_observations for _, bundle in solved(name))
    assert dropped <= 1e-3 * sum(len(made.measurements.tracks.track) for made, _ in solved(name))


def test_exact_measurements_give_back_the_truth():
    """Start, scale and heights were centimetres off."""
    scene = replace(
        SONAR, pixel_std=1e-3, told_pixel_std=1e-3, attitude_std_rad=1e-5, range_std_m=1e-5, tilt_std_rad=0.1
    )
    made = make(scene, 1)
    bundle = refine(made.measurements, made.start)
    assert position_rms(made, made.start) > 0.01
    assert np.abs(aligned(bundle.w_T_b, made.w_T_b) - made.w_T_b).max() < 1e-4
    assert bundle.floor_slope_rad == pytest.approx((0.0, 0.0), abs=1e-4)


def test_exact_positions_give_back_a_leaning_floor():
    scene = replace(
        SURVEY,
        pixel_std=1e-3,
        told_pixel_std=1e-3,
        relief=0,
        position_std_m=(1e-3, 1e-3),
        slope_rad=(0.04, -0.03),
    )
    made = make(scene, 1)
    bundle = refine(made.measurements, made.start, made.floor_z_m - 2.0)
    assert np.abs(bundle.w_T_b - made.w_T_b).max() < 0.01
    assert bundle.floor_slope_rad == pytest.approx((0.04, -0.03), abs=1e-4)
    assert bundle.floor_z_m == pytest.approx(made.floor_z_m, abs=0.01)


def test_a_hillside_is_no_noise_of_attitude_and_altitude():
    scene = replace(SURVEY, attitude_std_rad=0.03, position_std_m=(1.0, 3.0), slope_rad=(0.45, -0.25))
    made = make(scene, 1)
    bundle = refine(made.measurements, made.start, made.floor_z_m)
    assert bundle.floor_slope_rad == pytest.approx(scene.slope_rad, abs=0.03)
    assert bundle.noise.roll_pitch_rad < 0.06
    assert (bundle.noise.position_m < (2.0, 2.0, 6.0)).all()
    assert bundle.noise.slope_rad == pytest.approx(np.hypot(0.45, 0.25) / np.sqrt(2), rel=0.1)


def lens_errors(found: list[tuple[Made, Bundle]]) -> np.ndarray:
    """(flights, 9) errors of the calibration over their standard deviations."""
    lenses = [(made.lens, bundle.lens) for made, bundle in found]
    return np.array([(lens.calibration - true) / lens.std for true, lens in lenses if lens is not None])


def test_the_lens_is_found():
    """Tilted pictures over a floor determine the focal length, and their corners the distortion."""
    found = solved("gps, camera unknown")
    lenses = np.array([bundle.lens.calibration for _, bundle in found if bundle.lens is not None])
    focal = lenses[:, 0] / CAMERA.focal_px[0]
    assert focal.mean() == pytest.approx(1.02, abs=0.006)
    assert 0.001 < focal.std() < 0.02
    assert lenses[:, 4].mean() == pytest.approx(-0.03, abs=0.01)


@pytest.mark.slow
def test_every_number_of_an_uncertain_lens_is_found_within_what_it_tells():
    off = lens_errors(solved("rtk, lens wrong"))
    assert len(off) == len(SEEDS)
    # 95 % of a normal variable is within two deviations; 12 of 20 x 9 beyond have a chance below 0.2 %.
    assert 1 <= int((np.abs(off) > 2).sum()) <= 18
    assert 0.7 < np.mean(off**2) < 1.4


def test_a_flight_tells_which_numbers_of_the_lens_it_determines():
    made = make(SCENES["rtk, lens wrong"], 0)
    bundle = refine(made.measurements, made.start, made.floor_z_m)
    assert bundle.lens is not None
    assert bundle.lens.is_estimated.all()
    assert np.abs(bundle.lens.calibration - made.lens).max() < 5.0, "3 %, 20 px and 0.1 put in"
    (_, bundle), *_ = solved("gps, camera unknown")
    assert bundle.lens is not None
    assert bundle.lens.is_estimated[[0, 4]].all()
    assert not bundle.lens.is_estimated[[2, 3, 6, 7]].any(), "they are held"


def test_a_lens_that_is_known_is_held():
    assert all(bundle.lens is None for bundle in some("gps")[:4])


def test_attitudes_observe_the_slope_of_the_ground():
    """Gravity is the world's, not the floor's: with attitudes the slope is found several times as well."""
    off = {
        name: np.std([np.subtract(b.floor_slope_rad, (0.04, -0.03)) for b in some(name)])
        for name in ("gps over a slope", "gps and attitude over a slope")
    }
    assert 0.001 < off["gps and attitude over a slope"] < 0.005 < off["gps over a slope"]


def test_the_same_input_gives_the_same_bits():
    made = make(SONAR, 3)
    one, again = (refine(made.measurements, made.start) for _ in range(2))
    assert one.w_T_b.tobytes() == again.w_T_b.tobytes()
    assert one.covariances.tobytes() == again.covariances.tobytes()
    assert one.noise.pixel_scale == again.noise.pixel_scale


def test_the_slope_of_the_floor_is_no_error_over_the_floor():
    """Without positions the slope is fixed, and tilt errors are the same in the world and over the floor."""
    for scene, same in ((SONAR, True), (SCENES["gps over a slope"], False)):
        made = make(scene, 0)
        bundle = refine(made.measurements, made.start, made.floor_z_m)
        tilt, over_floor = bundle.covariances[:, :2, :2], bundle.over_floor_covariances[:, :2, :2]
        assert np.allclose(tilt, over_floor, rtol=1e-3, atol=1e-12) == same


def test_a_refinement_that_is_stopped_early_says_so(monkeypatch: pytest.MonkeyPatch):
    made = make(SONAR, 0)
    assert refine(made.measurements, made.start).not_converged == ""

    def one_step(cost: BundleCost, at: Variables, limit: int, *rest: object) -> BundleMinimum:
        return minimise_bundle(cost, at, 1, 0.0)

    monkeypatch.setattr("backend.bundle.rounds.minimise_bundle", one_step)
    assert refine(made.measurements, made.start).not_converged == "1 iteration done"


def test_a_keyframe_without_a_sensor_of_its_own_is_as_far_off_as_stated():
    """Nothing but floor points ties every second camera."""
    made = make(SURVEY, 0)
    half = replace(made.measurements, positions=made.measurements.positions[1::2])
    bundle = refine(half, made.start, made.floor_z_m)
    assert errors_squared(made, bundle)[len(made.start) // 2] < chi2.ppf(0.9999, 6)

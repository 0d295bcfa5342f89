"""The refinement with attitudes and positions that are wrong, missing or noisier than stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.noise import same_noise
from backend.bundle.refinement import refine
from backend.measurements import Measurements, Position
from tests.backend.bundle.made_scenes import SEEDS, SONAR, SURVEY, errors_squared, position_rms
from tests.backend.made_floor import Made, aligned, make


def test_sensor_noise_above_the_nominal_one_is_estimated():
    """Attitudes and ranges with three times their nominal noise."""
    scene, found = replace(SONAR, attitude_std_rad=0.03, range_std_m=0.03, keyframes=24), []
    for seed in SEEDS[:10]:
        made = make(scene, seed)
        nominal = replace(
            made.measurements,
            attitudes=tuple(replace(a, std_rad=a.std_rad / 3) for a in made.measurements.attitudes),
            ranges=tuple(replace(r, std_m=r.std_m / 3) for r in made.measurements.ranges),
        )
        found.append(refine(nominal, made.start).noise)
    assert np.mean([level.roll_pitch_rad for level in found]) == pytest.approx(0.03, rel=0.2)
    assert np.mean([level.range_m for level in found]) == pytest.approx(0.03, rel=0.2)


def misled(made: Made, nominal_std_rad: float) -> Measurements:
    """Roll 7 degrees wrong over the second half, as a side wind does to a small drone's own attitude."""
    half = made.measurements.count // 2
    wrong = tuple(
        replace(
            a,
            roll_pitch_yaw_rad=a.roll_pitch_yaw_rad + [np.radians(7.0) * (a.k >= half), 0, 0],
            std_rad=np.full(3, nominal_std_rad),
        )
        for a in made.measurements.attitudes
    )
    return replace(made.measurements, attitudes=wrong)


def test_noise_levels_converge():
    """Attitude errors of degrees look like relief until attitudes have less weight, which takes rounds."""
    scene = replace(SONAR, attitude_std_rad=0.005)
    for seed in range(3):
        made = make(scene, seed)
        measured = misled(made, 0.005)
        found = refine(measured, made.start)
        again = refine(measured, made.start, noise=found.noise)
        assert same_noise(found.noise, again.noise)


@pytest.mark.slow
def test_attitude_errors_of_degrees_do_not_distort_the_map():
    scene, outcome = replace(SONAR, attitude_std_rad=0.005), []
    for seed in SEEDS:
        made = make(scene, seed)
        with_wrong = refine(misled(made, 0.005), made.start)
        without = refine(replace(made.measurements, attitudes=()), made.start)
        hat = aligned(with_wrong.w_T_b, made.w_T_b)
        cosine = np.sum(hat[:, 2, :3] * made.w_T_b[:, 2, :3], axis=1)
        outcome.append(
            [
                position_rms(made, with_wrong.w_T_b),
                position_rms(made, without.w_T_b),
                np.degrees(np.arccos(np.clip(cosine, -1, 1))).max(),
                errors_squared(made, with_wrong).mean(),
                with_wrong.noise.roll_pitch_rad,
            ]
        )
    wrong_rms, without_rms, tilt_deg, consistency, level_rad = np.mean(outcome, axis=0)
    assert wrong_rms < 1.1 * without_rms
    assert tilt_deg < 1.0
    assert 4.6 < consistency < 7.4
    assert 0.06 < level_rad < 0.5


def test_one_position_far_off_leaves_scale_and_noise_as_they_are():
    """The noise of GPS was the root mean square of its residuals: one outlier made every fix worthless."""
    made = make(replace(SURVEY, points_in_view=15), 0)
    clean = refine(made.measurements, made.start, made.floor_z_m)
    first, *others = made.measurements.positions
    moved = replace(first, w_p_antenna_m=first.w_p_antenna_m + [400.0, 0.0, 0.0])
    with_outlier = refine(replace(made.measurements, positions=(moved, *others)), made.start, made.floor_z_m)
    assert with_outlier.noise.position_m[0] < 2.5 * clean.noise.position_m[0]
    assert with_outlier.scale_std < 2.5 * clean.scale_std
    lengths = [
        np.linalg.norm(np.diff(b.w_T_b[:, :3, 3], axis=0), axis=1).sum() for b in (clean, with_outlier)
    ]
    assert lengths[1] == pytest.approx(lengths[0], rel=3 * clean.scale_std)


@pytest.mark.parametrize("along", [0, 1])
def test_a_receiver_may_know_one_axis_better_than_the_other(along):
    """The level of both had been that of east, however the receiver stated them."""
    std_m, found = np.array([1.0, 1.0, 2.0]), []
    std_m[along] = 0.2
    for seed in SEEDS[:4]:
        made, rng = make(replace(SURVEY, points_in_view=15, keyframes=24), seed), np.random.default_rng(seed)
        read = [Position(k, T[:3, 3] + rng.normal(0, std_m), std_m) for k, T in enumerate(made.w_T_b)]
        found.append(refine(replace(made.measurements, positions=tuple(read)), made.start, made.floor_z_m))
    level_m = np.mean([bundle.noise.position_m for bundle in found], axis=0)
    np.testing.assert_allclose(level_m[:2], std_m[:2], rtol=0.2)


def test_positions_good_to_millimetres_keep_their_noise():
    """A millimetre had been added, whatever the receiver was."""
    made, std_m = make(replace(SURVEY, points_in_view=15, keyframes=24), 0), np.full(3, 5e-4)
    rng = np.random.default_rng(0)
    read = [Position(k, T[:3, 3] + rng.normal(0, std_m), std_m) for k, T in enumerate(made.w_T_b)]
    found = refine(replace(made.measurements, positions=tuple(read)), made.start, made.floor_z_m)
    np.testing.assert_allclose(found.noise.position_m, std_m, rtol=0.3)


def test_a_missing_altitude_has_no_influence():
    """Half of the positions have none: their values are those of the origin, far below the others."""
    made = make(replace(SURVEY, position_std_m=(0.5, 0.5), points_in_view=15), 1)
    flat = [
        replace(
            p,
            w_p_antenna_m=p.w_p_antenna_m * [1, 1, 0] - [0, 0, 500.0 * k],
            std_m=np.array([*p.std_m[:2], np.inf]),
        )
        if p.k % 2
        else p
        for k, p in enumerate(made.measurements.positions)
    ]
    found = refine(replace(made.measurements, positions=tuple(flat)), made.start, made.floor_z_m)
    assert found.noise.position_m[2] < 1.5
    off = found.w_T_b[:, :3, 3] - made.w_T_b[:, :3, 3]
    assert np.abs(off[:, 2]).max() < 2.0
    nowhere = tuple(replace(p, std_m=np.array([*p.std_m[:2], np.inf])) for p in made.measurements.positions)
    without = refine(replace(made.measurements, positions=nowhere), made.start, made.floor_z_m)
    assert without.floor_z_m == pytest.approx(made.floor_z_m, abs=1e-3)
    assert np.isfinite(without.covariances).all()
    assert np.sqrt(without.covariances[:, 5, 5].max()) < 20.0


@pytest.mark.slow
def test_exact_positions_count_more_than_coarse_ones():
    """All had counted with the median, so that half of coarse ones moved the map by decimetres."""
    made = make(replace(SURVEY, position_std_m=(0.02, 0.02), points_in_view=15), 2)
    rng = np.random.default_rng(0)
    mixed = [
        replace(p, w_p_antenna_m=p.w_p_antenna_m + rng.normal(0.5, 1.0, 3), std_m=np.array([2.0, 2.0, 2.0]))
        if p.k % 2
        else replace(p, std_m=np.full(3, 0.02))
        for p in made.measurements.positions
    ]
    found = refine(replace(made.measurements, positions=tuple(mixed)), made.start, made.floor_z_m)
    off = found.w_T_b[:, :3, 3] - made.w_T_b[:, :3, 3]
    exact = [p.k for p in mixed if p.std_m[0] < 1]
    assert np.sqrt(np.mean(off[exact] ** 2)) < 0.05

"""The place of the GPS antenna on the body: told, or estimated where the vehicle turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.refinement import Bundle, refine
from slam.core.messages import Kind
from slam.mapping.calibration.antenna import antenna_height_note
from tests.backend.bundle.made_scenes import SURVEY, position_rms, turned
from tests.backend.made_floor import Made, Scene, make, nees

ARM_M = np.array([0.3, -0.5, 0.2])
RTK = replace(SURVEY, position_std_m=(0.02, 0.03))


def flown(seed: int, scene: Scene = RTK) -> Made:
    """A survey by RTK whose antenna is away from the body's origin, over all headings."""
    headings = np.random.default_rng(100 + seed).integers(0, 4, scene.keyframes)
    made = turned(make(scene, seed), headings)
    positions = tuple(
        replace(p, w_p_antenna_m=p.w_p_antenna_m + made.w_T_b[p.k, :3, :3] @ ARM_M)
        for p in made.measurements.positions
    )
    return replace(made, measurements=replace(made.measurements, positions=positions))


def refined(made: Made, antenna_m: np.ndarray, std_m: float) -> Bundle:
    measured = replace(made.measurements, antenna_m=antenna_m, antenna_std_m=std_m)
    return refine(measured, made.start, made.floor_z_m)


def antennas(w_T_b: np.ndarray, antenna_m: np.ndarray) -> np.ndarray:
    return w_T_b[:, :3, 3] + w_T_b[:, :3, :3] @ antenna_m


def test_a_told_antenna_leaves_no_error() -> None:
    made = flown(0)
    told, ignored = refined(made, ARM_M, 0.0), refined(made, np.zeros(3), 0.0)
    assert position_rms(made, told.w_T_b) < 0.2 < position_rms(made, ignored.w_T_b)
    np.testing.assert_allclose(told.antenna_m, ARM_M, atol=1e-3)


def test_an_untold_height_of_the_antenna_counts_in_all_heights() -> None:
    """No residual shows it, so that heights were told to the centimetres of the fixes."""
    made = flown(0)
    level = np.array([*ARM_M[:2], 0.0])
    measured = replace(made.measurements, antenna_m=level, antenna_up_std_m=0.2)
    held, free = refined(made, level, 0.0), refine(measured, made.start, made.floor_z_m)
    off_m = np.abs(np.median(free.w_T_b[:, 2, 3] - made.w_T_b[:, 2, 3]))
    std_m = [float(np.median(np.sqrt(bundle.covariances[:, 5, 5]))) for bundle in (held, free)]
    assert std_m[0] < 0.05 < 0.12 < std_m[1] < 0.25
    assert 3 * std_m[0] < off_m < 3 * std_m[1]
    np.testing.assert_allclose(free.antenna_m[:2], level[:2], atol=1e-3)
    assert antenna_height_note(held) is None
    note = antenna_height_note(free)
    assert note is not None
    assert "count it as 0 ± 0.2 m" in note.text
    assert note.kind is Kind.NOTE


@pytest.mark.slow
def test_an_unknown_antenna_is_found_where_the_vehicle_turns() -> None:
    squares, of_poses = [], []
    for seed in range(12):
        made = flown(seed)
        bundle = refined(made, np.zeros(3), 0.5)
        squares.append(((bundle.antenna_m - ARM_M) / bundle.antenna_std_m)[:2])
        of_poses.append(nees(bundle.w_T_b, made.w_T_b, bundle.covariances)[6])
        assert (bundle.antenna_std_m[:2] < 0.25).all()
        # Upward it is one with the height of the ground.
        assert bundle.antenna_std_m[2] > 0.4
    assert 0.3 < np.mean(np.square(squares)) < 2.0
    assert 2.5 < np.mean(of_poses) < 10.5


@pytest.mark.slow
def test_the_antenna_s_positions_are_as_certain_as_is_told() -> None:
    """Where its place is a variable, they are more certain than those of the body: positions measure them."""
    squares = []
    for seed in range(12):
        made = flown(seed, replace(RTK, pixel_std=0.02, told_pixel_std=0.02))
        bundle = refined(made, np.zeros(3), 0.5)
        off_m = antennas(bundle.w_T_b, bundle.antenna_m) - antennas(made.w_T_b, ARM_M)
        weighted = np.linalg.solve(bundle.antenna_covariances, off_m[..., None])[..., 0]
        squares.append(np.mean(np.sum(off_m * weighted, axis=1)))
        body = np.trace(bundle.covariances[:, 3:, 3:], axis1=1, axis2=2)
        assert (np.trace(bundle.antenna_covariances, axis1=1, axis2=2) < body).all()
    assert 2.0 < np.mean(squares) < 4.5

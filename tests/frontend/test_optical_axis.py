"""The optical axis of a camera of unknown mount, from turns of its pictures and of the body."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from frontend.camera import NADIR_B_T_C
from frontend.optical_axis import TurnedPair, axis_evidence, quarter_turns, top_evidence
from frontend.ray_pairs import RayPair

DOWN, MOST_RAD = np.array([0.0, 0.0, -1.0]), np.radians(30.0)
HALF_VIEW, NOISE_RAD = 0.7, 5e-4


def tilted(degrees: float) -> np.ndarray:
    """Mount of a camera that looks down, tilted forward; 90 degrees: it looks ahead."""
    return Rotation.from_rotvec([0.0, -np.radians(degrees), 0.0]).as_matrix() @ NADIR_B_T_C[:3, :3]


def made_pair(mount: np.ndarray, turn: np.ndarray, way_m: np.ndarray, rng: np.random.Generator) -> RayPair:
    """Points of a floor 2 m below and of a wall 6 m ahead, seen from two places."""
    i_ray = np.column_stack([rng.uniform(-HALF_VIEW, HALF_VIEW, (200, 2)), np.ones(200)])
    ray = i_ray @ mount.T
    with np.errstate(divide="ignore"):
        reach = np.minimum(
            np.where(ray[:, 2] < 0, -2 / ray[:, 2], 60), np.where(ray[:, 0] > 0, 6 / ray[:, 0], 60)
        )
    seen = (reach[:, None] * ray - way_m) @ Rotation.from_rotvec(turn).as_matrix() @ mount
    j_ray = seen / seen[:, 2:]
    visible = (seen[:, 2] > 0) & (np.abs(j_ray[:, :2]) < HALF_VIEW).all(axis=1)
    i_ray, j_ray = i_ray[visible], j_ray[visible]
    for ray in (i_ray, j_ray):
        ray[:, :2] += rng.normal(0.0, NOISE_RAD, (len(ray), 2))
    wrong = rng.random(len(j_ray)) < 0.05
    j_ray[wrong, :2] = rng.uniform(-HALF_VIEW, HALF_VIEW, (int(wrong.sum()), 2))
    return RayPair(i_ray, j_ray).consistent(3e-3)


def made_pairs(mount: np.ndarray, turn_std_rad: tuple, seed: int, count: int = 10) -> list[TurnedPair]:
    rng = np.random.default_rng(seed)
    pairs = []
    for block in range(count):
        turn, way_m = rng.normal(0.0, turn_std_rad), rng.normal(0.0, (0.3, 0.3, 0.1))
        rays = made_pair(mount, turn, way_m, rng)
        pairs.append(TurnedPair(rays, Rotation.from_rotvec(-turn).as_matrix(), block))
    return pairs


@pytest.mark.parametrize("tilt_deg", [0.0, 15.0, 50.0, 90.0, 180.0])
def test_the_axis_is_found_from_turns(tilt_deg):
    pairs = made_pairs(tilted(tilt_deg), (0.05, 0.05, 0.1), seed=2)
    found = axis_evidence(pairs, DOWN, MOST_RAD, len(pairs))
    assert np.degrees(found.tilt_rad) == pytest.approx(tilt_deg, abs=3.0)
    sign = 1.0 if tilt_deg < 30 else -1.0
    assert sign * found.by_block.sum() > 100
    assert (sign * found.by_block > 0).mean() > 0.8, "the stretches agree"


def test_turns_about_the_vertical_alone_are_enough():
    pairs = made_pairs(tilted(0.0), (0.0, 0.0, 0.1), seed=3)
    found = axis_evidence(pairs, DOWN, MOST_RAD, len(pairs))
    assert np.degrees(found.tilt_rad) < 5.0
    assert found.by_block.sum() > 100


def test_axes_of_the_instrument_may_be_any():
    """The same flight, told in axes of an instrument that is mounted askew."""
    turned = Rotation.random(random_state=4).as_matrix()
    pairs = [
        TurnedPair(p.rays, turned @ p.j_R_i @ turned.T, p.block)
        for p in made_pairs(tilted(60.0), (0.05, 0.05, 0.1), seed=5)
    ]
    found = axis_evidence(pairs, turned @ DOWN, MOST_RAD, len(pairs))
    assert np.degrees(found.tilt_rad) == pytest.approx(60.0, abs=3.0)
    assert found.by_block.sum() < -100


def test_without_turns_nothing_is_told():
    pairs = made_pairs(tilted(90.0), (0.0, 0.0, 0.0), seed=6)
    assert abs(axis_evidence(pairs, DOWN, MOST_RAD, len(pairs)).by_block.sum()) < 1.0


@pytest.mark.parametrize("turns", [-1, 0, 1, 2])
def test_the_top_of_the_picture_is_found_to_a_quarter_turn(turns):
    mount = Rotation.from_euler("z", 90 * turns + 15, degrees=True).as_matrix() @ tilted(10.0)
    assert quarter_turns(mount) == turns
    pairs = made_pairs(mount, (0.05, 0.05, 0.1), seed=7)
    better = top_evidence(pairs, mount, len(pairs))
    assert (better == 0).all() if turns == 0 else better.sum() > 100


def test_turns_about_the_vertical_alone_do_not_tell_the_top():
    mount = Rotation.from_euler("z", 90, degrees=True).as_matrix() @ tilted(0.0)
    pairs = made_pairs(mount, (0.0, 0.0, 0.1), seed=8)
    assert abs(top_evidence(pairs, mount, len(pairs)).sum()) < 1.0

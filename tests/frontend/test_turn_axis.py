"""The vertical in the axes of a camera, from its pictures alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from frontend.camera import NADIR_B_T_C
from frontend.ray_pairs import RayPair
from frontend.turn_axis import step_turns, vertical_evidence

NADIR = NADIR_B_T_C[:3, :3]
MOST_RAD = np.radians(30.0)


def chains(mount: np.ndarray, yaw_std_rad: float, seed: int) -> list[list[list[np.ndarray]]]:
    """Chains of known turns of a camera on a vehicle that tilts a little, and yaws."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(12):
        angles = np.column_stack([np.cumsum(rng.normal(0, yaw_std_rad, 6)), rng.normal(0, 0.08, (6, 2))])
        attitude = Rotation.from_euler("ZYX", angles).as_matrix() @ mount
        made.append([[attitude[k + 1].T @ attitude[k]] for k in range(5)])
    return made


@pytest.mark.parametrize("tilt_deg", [0.0, 60.0, 90.0])
def test_the_vertical_is_the_axis_of_far_turns(tilt_deg):
    mount = Rotation.from_rotvec([0.0, -np.radians(tilt_deg), 0.0]).as_matrix() @ NADIR
    by_chain, angle_rad = vertical_evidence(chains(mount, 0.4, seed=1), MOST_RAD)
    assert np.degrees(angle_rad) == pytest.approx(tilt_deg, abs=8.0)
    assert (by_chain.sum() > 10) if tilt_deg < 30 else (by_chain.sum() < -10)


def test_small_turns_tell_nothing():
    assert abs(vertical_evidence(chains(NADIR, 0.02, seed=2), MOST_RAD)[0].sum()) < 5.0


def test_a_wrong_turn_beside_the_right_one_does_no_harm():
    """Over a plane two turns are possible; the other one tilts the camera as fast as it travels."""
    rng, right = np.random.default_rng(3), chains(NADIR, 0.4, seed=1)
    both = [
        [[Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix() @ turn, turn] for (turn,) in chain]
        for chain in right
    ]
    assert vertical_evidence(both, MOST_RAD)[0].sum() > 10


@pytest.mark.parametrize("depth", [(2.0, 2.0), (1.5, 6.0)])
def test_turns_over_a_plane_and_in_a_scene(depth):
    rng = np.random.default_rng(4)
    turn = Rotation.from_rotvec([0.02, -0.03, 0.2])
    i_ray = np.column_stack([rng.uniform(-0.7, 0.7, (150, 2)), np.ones(150)])
    seen = turn.apply(i_ray * rng.uniform(*depth, (150, 1)) - [0.4, 0.1, 0.05])
    j_ray = seen / seen[:, 2:]
    j_ray[:, :2] += rng.normal(0, 3e-4, (150, 2))
    found = step_turns(RayPair(i_ray, j_ray), 3e-3)
    off = [(turn.inv() * Rotation.from_matrix(each)).magnitude() for each in found]
    assert min(off) < 0.01

"""Shares of the instruments: the dense system, and scenes in which one instrument measures alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.accuracy.ground_covariances import SeenGround, ground_jacobians
from backend.bundle.accuracy.ground_size import gradients
from backend.bundle.accuracy.information_shares import DIRECTIONS, information_shares
from backend.bundle.factors import WORLD
from backend.bundle.refinement import refine
from tests.backend.bundle.inertial.made_inertial import InertialScene
from tests.backend.bundle.inertial.made_inertial import make as make_inertial
from tests.backend.made_floor import Scene, make

SCENE = Scene(keyframes=8, points_in_view=20, range_gain_std=0.05)


def shares_of(scene: Scene):
    made = make(scene, 0)
    return information_shares(refine(made.measurements, made.start).optimum)


def test_shares_add_up_to_one():
    found = shares_of(SCENE)
    assert list(found) == list(DIRECTIONS)
    for direction, shares in found.items():
        assert sum(shares.values()) == pytest.approx(1.0), direction
        assert min(shares.values()) >= 0.0


def test_the_scale_is_that_of_the_one_instrument_that_measures_it():
    assert shares_of(SCENE)["scale"]["range"] > 0.99
    assert shares_of(replace(SCENE, range_std_m=None))["scale"]["assumed"] > 0.99


def test_positions_determine_where_the_map_is():
    found = shares_of(replace(SCENE, position_std_m=(0.5, 0.5)))
    assert found["x"]["position"] > 0.9
    assert found["roll"].get("position", 0.0) < found["x"]["position"]


@pytest.mark.slow
def test_readings_weigh_more_where_a_gap_has_no_pictures():
    whole, torn = (make_inertial(InertialScene(seconds=6.0, gap_s=gap_s), 0) for gap_s in (None, (2.5, 4.0)))
    seen, unseen = (
        information_shares(refine(made.measurements, made.start).optimum) for made in (whole, torn)
    )
    for direction in ("x", "y", "yaw"):
        assert unseen[direction]["imu"] > 1.2 * seen[direction]["imu"] > 0.0


def test_the_share_of_the_pictures_is_that_of_the_dense_system():
    made = make(SCENE, 0)
    optimum = refine(made.measurements, made.start).optimum
    linear = optimum.linearise()
    A = linear.jacobian()[0].toarray()
    gradient = np.concatenate([each[:, 0] for each in gradients(optimum, linear.eliminate())])
    row = A @ np.linalg.solve(A.T @ A, gradient)
    pictures = np.sum(row[: linear.seen.right.size] ** 2) / np.sum(row**2)
    assert information_shares(optimum)["scale"]["pictures"] == pytest.approx(pictures, rel=1e-4)


def test_the_place_of_the_ground_hangs_on_the_tilt_of_the_camera_too():
    """Exact positions leave the camera's tilt to the pictures, and with it the ground below."""
    found = shares_of(replace(SCENE, position_std_m=(0.001, 0.001)))
    assert found["ground"]["pictures"] > found["x"]["pictures"]


def test_the_height_over_the_ground_is_that_of_the_range():
    assert shares_of(SCENE)["height"]["range"] > 0.9


def test_the_share_of_the_ground_is_that_of_its_variance_in_the_dense_system():
    made = make(SCENE, 0)
    optimum = refine(made.measurements, made.start).optimum
    found = information_shares(optimum)["ground"]
    linear = optimum.linearise()
    A, columns = linear.jacobian()[0].toarray(), linear.eliminate().structure.columns
    # Without positions the keyframe farthest from the first one is found by the result.
    k = int(np.argmax(np.linalg.norm(made.w_T_b[:, :3, 3] - made.w_T_b[0, :3, 3], axis=1)))
    J = SeenGround.of(optimum).jacobian(k) @ ground_jacobians(optimum)[k]
    gradient = np.zeros((A.shape[1], len(J)))
    gradient[np.r_[columns(POSE(k)), columns(WORLD)]] = J.T
    rows = A @ np.linalg.solve(A.T @ A, gradient)
    pictures = np.sum(rows[: linear.seen.right.size] ** 2) / np.sum(rows**2)
    assert found["pictures"] == pytest.approx(pictures, rel=1e-4)

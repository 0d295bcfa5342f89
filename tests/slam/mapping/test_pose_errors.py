"""Errors of all poses together: they are part of the covariances, and the mount is one of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from slam import optimize
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.pose_errors import REFINED
from tests.slam.evaluation.scene import estimate_of, exponential, flight_of, smooth_poses
from tests.slam.mapping.calibration.test_attitude_floor_tilt import askew
from tests.slam.small_flight import flown


@pytest.fixture(scope="module")
def flight() -> Flight:
    made = flown()
    assert made.camera is not None
    return askew(replace(made, camera=replace(made.camera, mount_std_rad=None)))


@pytest.fixture(scope="module")
def estimate(flight: Flight) -> Estimate:
    return optimize(flight)


def own(joint: NDArray[np.float64]) -> NDArray[np.float64]:
    return joint @ joint.transpose(0, 2, 1)


def test_they_are_no_more_than_the_covariances(estimate: Estimate) -> None:
    assert estimate.joint_errors is not None
    std = np.sqrt(np.diagonal(estimate.covariances, axis1=1, axis2=2)) + 1e-12
    left = (estimate.covariances - own(estimate.joint_errors)) / (std[:, :, None] * std[:, None, :])
    assert np.linalg.eigvalsh(left).min() > -1e-3


def test_a_mount_of_which_nothing_is_told_is_an_error_of_all_poses(
    flight: Flight, estimate: Estimate
) -> None:
    assert estimate.joint_errors is not None
    assert flight.camera is not None
    of_mount = estimate.joint_errors[:, :, REFINED : REFINED + 2]
    assert of_mount.shape[2] == 2
    np.testing.assert_array_equal(of_mount, of_mount[:1].repeat(len(of_mount), axis=0))
    assert np.degrees(np.sqrt(own(of_mount)[0, :2, :2].trace())) > 0.5
    nees = evaluate(estimate, flight).nees
    assert nees is not None
    assert nees.rotation.n_eff < 2, "most of the tilt is one error"


@pytest.mark.parametrize("told", [True, False])
def test_the_band_allows_for_a_mount_that_errs_as_stated(told: bool) -> None:
    inside = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        hat, mount_rad, own_rad = smooth_poses(rng, 60), 0.02, 0.005
        hat[:, :3, :3] = hat[0, :3, :3]  # a vehicle that does not turn
        shared = np.zeros((60, 6, 2))
        shared[:, [0, 1], [0, 1]] = mount_rad
        xi = own_rad * rng.normal(size=(60, 6)) + shared @ rng.normal(size=2)
        truth = hat @ exponential(xi)
        truth[0] = hat[0]
        P = own_rad**2 * np.eye(6) + own(shared)
        estimate = estimate_of(hat, covariances=P, joint_errors=shared if told else None)
        nees = evaluate(estimate, flight_of(truth)).nees
        assert nees is not None
        inside.append(nees.rotation.consistent)
    assert np.mean(inside) >= 0.88 if told else np.mean(inside) < 0.8

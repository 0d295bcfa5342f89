import gtsam
import numpy as np
import pytest

from backend import se3
from backend.gauge import format_directions, format_keys, unobserved_directions
from backend.pose_graph.linear import jacobian
from backend.pose_graph.observability import null_space, unobserved

UNIT = gtsam.noiseModel.Unit.Create(6)


def _walk(n: int, seed: int = 0) -> np.ndarray:
    step = np.random.default_rng(seed).normal(size=(n, 6)) * [0.1, 0.1, 0.3, 1, 1, 0.3]
    T = se3.exp(step)
    for k in range(1, n):
        T[k] = T[k - 1] @ T[k]
    return T


def _edges(T: np.ndarray, keys: range) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in keys:
        values.insert(k, gtsam.Pose3(T[k]))
    for k in keys[:-1]:
        between = gtsam.Pose3(se3.inverse(T[k]) @ T[k + 1])
        factors.add(gtsam.BetweenFactorPose3(k, k + 1, between, UNIT))
    return factors, values


@pytest.mark.parametrize("n", [5, 250])
def test_names_exactly_what_is_open(n: int):
    """Dense below 1200 unknowns, Lanczos above: the same sentences."""
    T = _walk(n)
    factors, values = _edges(T, range(n))
    assert unobserved(factors, values) == [
        f"roll, pitch, heading, x, y, height of keyframes 0-{n - 1} not observed"
    ]
    level = gtsam.noiseModel.Gaussian.SqrtInformation(np.diag([0, 0, 1.0]), False)
    up = gtsam.Unit3(np.array([0, 0, 1.0]))
    for k in range(0, n, 2):
        tilt = gtsam.noiseModel.Isotropic.Sigma(2, 0.1)
        factors.add(gtsam.AttitudeFactorPose3(k, up, tilt, gtsam.Unit3(T[k, 2, :3])))
        factors.add(gtsam.GPSFactor(k, T[k, :3, 3], level))
    assert unobserved(factors, values) == [f"heading, x, y of keyframes 0-{n - 1} not observed"]
    factors.add(gtsam.PriorFactorPose3(0, values.atPose3(0), UNIT))
    assert unobserved(factors, values) == []


def test_parts_are_told_apart():
    T = _walk(8)
    factors, values = _edges(T, range(3))
    more, rest = _edges(T, range(3, 8))
    factors.push_back(more)
    values.insert(rest)
    factors.add(gtsam.PriorFactorPose3(4, values.atPose3(4), UNIT))
    (sentence,) = unobserved(factors, values)
    assert "keyframes 0-2 " in sentence


def test_scale_is_named():
    """Directions between points and the distance of none: the scale stays open."""
    T = _walk(6)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    lax = gtsam.noiseModel.Gaussian.SqrtInformation
    for k in range(6):
        values.insert(k, gtsam.Pose3(T[k]))
    for i in range(6):
        for j in range(i + 1, 6):
            between = se3.inverse(T[i]) @ T[j]
            # The error of a between factor stands in the axes of its second pose.
            ahead = between[:3, :3].T @ between[:3, 3] / np.linalg.norm(between[:3, 3])
            root = np.eye(6)
            root[3:, 3:] = np.eye(3) - np.outer(ahead, ahead)
            factors.add(gtsam.BetweenFactorPose3(i, j, gtsam.Pose3(between), lax(root, False)))
    factors.add(gtsam.PriorFactorPose3(0, values.atPose3(0), UNIT))
    null = null_space(jacobian(factors, values))
    assert null.shape[1] == 1
    assert unobserved(factors, values) == ["scale of keyframes 0-5 not observed"]


def _jacobians(T: np.ndarray, rows: list[int]) -> list[np.ndarray]:
    """Roll, pitch, heading, x, y, z measured at each place, by a motion about the first."""
    place = np.tile(np.eye(4), (len(T), 1, 1))
    place[:, :3, 3] = T[0, :3, 3] - T[:, :3, 3]
    return [100 * se3.adjoint(move)[rows] for move in place]


def test_open_directions_by_what_is_measured():
    T = _walk(5)
    assert format_directions(unobserved_directions([])) == "x, y, height, roll, pitch and heading"
    assert len(unobserved_directions(_jacobians(T, [0, 1, 2, 3, 4, 5]))) == 0
    assert format_directions(unobserved_directions(_jacobians(T[:1], [0, 1, 5]))) == "heading, x and y"
    assert format_directions(unobserved_directions(_jacobians(T[:1], [3, 4, 5]))) == "roll, pitch and heading"
    assert len(unobserved_directions(_jacobians(T[:2], [3, 4, 5]))) == 1
    assert len(unobserved_directions(_jacobians(T, [3, 4, 5]))) == 0


def test_key_runs():
    assert format_keys([4, 5, 6, 9]) == "keyframes 4-6, 9"
    assert format_keys([3]) == "keyframe 3"
    assert format_keys([gtsam.symbol("x", 2), gtsam.symbol("x", 3)]) == "keyframes 2-3"
    assert format_keys([1, 2, 3], lambda k: f"vertex {k + 10}") == "vertices 11-13"

"""The largest errors of all poses together: the leading part of their joint covariance, built whole."""

from __future__ import annotations

import numpy as np
import pytest
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.accuracy.joint_errors import joint_errors
from backend.bundle.factors import WORLD
from backend.bundle.metric_poses import metric_jacobians
from backend.bundle.refinement import refine
from tests.backend.bundle.optimum_at_truth import at_the_truth, peak_bytes
from tests.backend.made_floor import Scene, make


def refined(**changes):
    made = make(Scene(points_in_view=20, range_gain_std=0.05, **changes), seed=0)
    return refine(made.measurements, made.start)


def joint_covariance(bundle):
    """(n, 6, n, 6) of all metric poses, by the inverse of all normal equations."""
    optimum, n = bundle.optimum, len(bundle.w_T_b)
    linear = optimum.linearise()
    jacobian = linear.jacobian()[0].toarray()
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    columns, size = linear.structure.columns, len(covariance)
    J = metric_jacobians(optimum.problem, optimum.values)
    of_all = np.zeros((n, 6, size))
    for k in range(n):
        of_all[k][:, columns(POSE(k))] = J[k, :, :6]
        of_all[k][:, columns(WORLD)] = J[k, :, 6:]
    return np.einsum("kap,pq,lbq->kalb", of_all, covariance, of_all, optimize=True)


def whitener(P):
    """Inverse root of a covariance (6, 6), zero along what the gauge fixes."""
    value, V = np.linalg.eigh(P)
    free = value > 1e-9 * value.max()
    return (V * np.where(free, 1 / np.sqrt(np.where(free, value, 1.0)), 0.0)) @ V.T


def test_they_are_the_joint_covariance_where_all_are_kept():
    bundle = refined(keyframes=5)
    found = joint_errors(bundle.optimum, bundle.covariances, 40)
    joint = joint_covariance(bundle)
    std = np.sqrt(np.maximum(np.einsum("kaka->ka", joint), 1e-30))
    off = (np.einsum("kam,lbm->kalb", found, found) - joint) / (std[:, :, None, None] * std)
    assert np.abs(off[1:, :, 1:]).max() < 2e-3
    assert not found[:, :, 29:].any(), "there are no more errors than numbers"


@pytest.mark.parametrize("changes", [{}, {"position_std_m": (0.5, 0.5)}])
def test_the_largest_come_first_and_none_larger_is_missing(changes):
    bundle = refined(keyframes=10, **changes)
    found = joint_errors(bundle.optimum, bundle.covariances, 6)
    assert found.shape == (10, 6, 6)
    joint = joint_covariance(bundle)
    whiten = np.array([whitener(joint[k, :, k]) for k in range(10)])
    W = np.einsum("kab,kblc,ldc->kald", whiten, joint, whiten, optimize=True)
    expected = np.linalg.eigvalsh(W.reshape(60, 60))[::-1][:6]
    whitened = np.einsum("kab,kbm->kam", whiten, found)
    np.testing.assert_allclose(np.sum(whitened**2, axis=(0, 1)), expected, rtol=5e-3)
    gram = np.einsum("kam,kal->ml", whitened, whitened)
    np.testing.assert_allclose(gram - np.diag(np.diag(gram)), 0.0, atol=0.02 * expected[0])


def test_a_pose_without_covariance_shares_nothing():
    bundle = refined(keyframes=5)
    covariances = bundle.covariances.copy()
    covariances[2] = np.nan
    found = joint_errors(bundle.optimum, covariances, 4)
    assert np.isfinite(found).all()
    assert not found[2].any()
    assert found[3].any()


def test_their_memory_grows_as_the_number_of_poses_does():
    def peak_of(keyframes):
        optimum, covariances = at_the_truth(keyframes), np.tile(1e-4 * np.eye(6), (keyframes, 1, 1))
        return peak_bytes(lambda: joint_errors(optimum, covariances, 4))

    assert peak_of(240) < 6 * peak_of(40)

"""Relative poses with fields of a wrong shape, type or figure are refused in one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import BackendError, Incremental, Measurements, RelativePose, solve

EDGE = RelativePose(0, 1, np.eye(4), 0.01 * np.eye(6), "odometry")
WRONG = [
    (replace(EDGE, covariance=np.eye(3)), r"relative pose 0-1: covariance has shape \(3, 3\); expected"),
    (replace(EDGE, i_T_j=np.eye(3)), r"relative pose 0-1: i_T_j has shape \(3, 3\); expected \(4, 4\)"),
    (replace(EDGE, kind="visual"), "relative pose 0-1: kind is 'visual'; expected one of odometry, loop"),
    (replace(EDGE, covariance=np.full((6, 6), np.nan)), "covariance that is not"),
]


@pytest.mark.parametrize(("edge", "message"), WRONG)
def test_a_wrong_edge_is_refused(edge, message):
    with pytest.raises(BackendError, match=message) as refusal:
        solve(Measurements(np.arange(2.0), (edge,)))
    assert "\n" not in str(refusal.value)


def test_four_wrong_covariances_do_not_pass_as_one_right_one():
    edges = tuple(replace(EDGE, covariance=np.eye(3), j=k) for k in range(1, 5))
    with pytest.raises(BackendError, match=r"expected \(6, 6\)"):
        solve(Measurements(np.arange(5.0), edges))


def test_the_incremental_solver_refuses_the_same():
    graph = Incremental()
    graph.add(w_T_b=np.eye(4))
    with pytest.raises(BackendError, match="kind is 'visual'"):
        graph.add((replace(EDGE, kind="visual"),))


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_stamp_that_is_no_number_is_refused(wrong):
    step = RelativePose(0, 1, np.eye(4), np.eye(6), "odometry")
    with pytest.raises(BackendError, match="stamps_s: keyframe 1 has the time"):
        solve(Measurements(np.array([0.0, wrong]), (step,)))

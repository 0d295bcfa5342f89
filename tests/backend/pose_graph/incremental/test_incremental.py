from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.errors import BackendError
from backend.measurements import RelativePose
from backend.pose_graph.incremental.estimation import Incremental, IncrementalUpdate
from backend.pose_graph.solve import solve
from tests.backend.synthetic import LOOP_STD, Made, falsified, flight


def _flown(made: Made, **options) -> tuple[Incremental, list[IncrementalUpdate]]:
    live, steps = Incremental(**options), []
    m = made.measurements
    for k in range(m.count):
        edges = tuple(e for e in m.relative_poses if max(e.i, e.j) == k)
        own = [tuple(s for s in kind if s.k == k) for kind in (m.attitudes, m.ranges, m.positions)]
        steps.append(live.add(edges, *own))
    return live, steps


def _from_first(w_T: np.ndarray) -> np.ndarray:
    return np.linalg.inv(w_T[0]) @ w_T


@pytest.mark.parametrize("kind", ["plain", "attitude", "positions"])
def test_the_same_answer_as_the_batch(kind: str):
    made = {
        "plain": flight(1, attitude_std=None, range_std=None),
        "attitude": flight(1),
        "positions": flight(1, position_std=0.1),
    }[kind]
    live, steps = _flown(made)
    live.settle()
    batch = solve(made.measurements, covariances=False, loops_robust=False)
    assert live.error() == pytest.approx(batch.error, rel=1e-3)
    np.testing.assert_allclose(_from_first(live.trajectory()), _from_first(batch.w_T_b), atol=3e-3)
    assert all(step.rebuild_reason == "" for step in steps)


def test_each_update_returns_the_newest_pose():
    made = flight(2)
    live, steps = _flown(made)
    for k, step in enumerate(steps):
        assert np.isfinite(step.w_T_b).all()
        # Loops and drift move it by little here; a wrong frame or order would by metres.
        assert np.linalg.norm(step.w_T_b[:3, 3] - live.pose(k)[:3, 3]) < 0.6
    np.testing.assert_array_equal(steps[-1].w_T_b, live.pose(59))


def test_loops_are_queued_beyond_the_budget_and_added_at_the_end():
    made = flight(3, n=80, loops=20)
    live, steps = _flown(made, budget_s=0.0)
    pending = [step.pending for step in steps]
    assert max(pending) > 5
    assert live.settle().pending == 0
    batch = solve(made.measurements, covariances=False, loops_robust=False)
    assert live.error() == pytest.approx(batch.error, rel=1e-3)
    _, free = _flown(made, budget_s=np.inf)
    assert max(step.pending for step in free) == 0


def test_false_loops_are_rejected_in_flight_as_by_the_batch():
    """Every third loop is false; the flight is bent neither before the end nor after it."""
    made, false = falsified(flight(6, n=40, loops=12), 4, seed=1)
    live, steps = _flown(made, budget_s=np.inf)
    before = live.trajectory()
    live.settle()
    batch = solve(made.measurements, covariances=False)
    edges = made.measurements.relative_poses
    wrong = {(edges[k].i, edges[k].j) for k in np.flatnonzero(~batch.edge_kept)}
    assert wrong >= {(edges[k].i, edges[k].j) for k in np.flatnonzero(false)}
    assert {(e.i, e.j) for e in live.rejected} == wrong
    np.testing.assert_allclose(_from_first(live.trajectory()), _from_first(batch.w_T_b), atol=3e-3)
    # Until the end at most the last loops are judged by fewer others.
    off = _from_first(before)[:, :3, 3] - _from_first(batch.w_T_b)[:, :3, 3]
    assert np.linalg.norm(off, axis=1).max() < 0.1
    messages = [line for step in steps for line in step.rejected]
    assert any("is rejected: disagrees by" in line for line in messages)
    bent, _ = _flown(made, budget_s=np.inf, loops_robust=False)
    off = _from_first(bent.trajectory())[:, :3, 3] - _from_first(batch.w_T_b)[:, :3, 3]
    assert np.linalg.norm(off, axis=1).max() > 0.3


def test_a_loop_that_was_rejected_comes_back_when_others_speak_for_it():
    """Odometry has a step that is wrong: the first loop over it stands alone, and the next ones agree."""
    made = flight(7, n=60, loops=0)
    edges = list(made.measurements.relative_poses)
    shift = se3.exp(np.array([[0, 0, 0, 5.0, 0, 0]]))[0]
    edges[20] = replace(edges[20], i_T_j=edges[20].i_T_j @ shift)
    for k in (2, 4, 6, 10, 12, 14, 22, 25, 28):
        T = se3.inverse(made.truth[k]) @ made.truth[k + 30]
        edges.append(RelativePose(k, k + 30, T, np.diag(LOOP_STD**2), "loop"))
    made = Made(replace(made.measurements, relative_poses=tuple(edges)), made.truth)
    live, steps = _flown(made, budget_s=np.inf)
    assert any("the loop 2-32 is rejected" in line for step in steps for line in step.rejected)
    live.settle()
    # No loop tells the steps from 14 to 22 apart.
    (rejected,) = live.rejected
    assert rejected.kind == "odometry"
    assert 14 <= rejected.i < 22


class _Poisoned:
    """An ISAM2 after an exception."""

    def __init__(self, healthy) -> None:
        self._healthy = healthy

    def update(self, *_args, **_options):
        raise RuntimeError("Indeterminate linear system detected while working near variable\n7")

    def __getattr__(self, name: str):
        return getattr(self._healthy, name)


def test_an_exception_leads_to_a_rebuild():
    made = flight(4)
    m = made.measurements
    live = Incremental()
    rebuild_reason = []
    for k in range(m.count):
        if k in (20, 45):
            live._isam = _Poisoned(live._isam)
        edges = tuple(e for e in m.relative_poses if max(e.i, e.j) == k)
        own = [tuple(s for s in kind if s.k == k) for kind in (m.attitudes, m.ranges, m.positions)]
        step = live.add(edges, *own)
        if step.rebuild_reason:
            rebuild_reason.append(k)
            assert "Indeterminate" in step.rebuild_reason
            assert "\n" not in step.rebuild_reason
    assert rebuild_reason == [20, 45]
    live.settle()
    batch = solve(m, covariances=False, loops_robust=False)
    assert live.error() == pytest.approx(batch.error, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda e: (replace(e, i_T_j=e.i_T_j * np.nan),), "not a finite rigid"),
        (lambda e: (replace(e, covariance=e.covariance * 0),), "not symmetric positive definite"),
        (lambda e: (replace(e, i=0, j=1),), "no relative pose joins keyframe 5"),
        (lambda e: (e, replace(e, j=9)), "after the newest, 5"),
        (lambda e: (e, replace(e, i=-1, kind="loop")), "names keyframe -1"),
        (lambda e: (e, replace(e, i=2, kind="loop", covariance=-e.covariance)), "not symmetric positive"),
        (lambda _: (), "no relative pose joins keyframe 5"),
    ],
)
def test_invalid_values_raise_and_change_nothing(change, expected: str):
    made = flight(5)
    edges = made.measurements.relative_poses
    live = Incremental()
    live.add()
    for k in range(1, 5):
        live.add((edges[k - 1],))
    before = live.trajectory()
    with pytest.raises(BackendError, match=expected):
        live.add(change(edges[4]))
    np.testing.assert_array_equal(live.trajectory(), before)
    live.add((edges[4],))
    assert live.count == 6


def test_settle_raises_before_the_first_keyframe():
    with pytest.raises(BackendError, match="no keyframe"):
        Incremental().settle()


@pytest.mark.slow
def test_a_long_chain():
    """gtsam's Cholesky calls such a chain singular in batch."""
    made = flight(6, n=3000, loops=0, attitude_std=None, range_std=None)
    live, _ = _flown(made)
    assert np.isfinite(live.trajectory()).all()

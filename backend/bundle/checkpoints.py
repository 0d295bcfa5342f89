"""Checkpoints of a refinement: the minima of its rounds, as plain data.

A minimum is a function of its round's problem, noise and start, so one that is known is the same to the bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.minimise import BundleCost, BundleMinimum
from backend.bundle.problem import Variables
from backend.pose_graph.descent import OnStep

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlainValues:
    """Poses and vectors of a graph by their keys."""

    pose_key: tuple[int, ...]
    w_T_b: Array
    """(p, 4, 4)."""
    vector_key: tuple[int, ...]
    vectors: tuple[Array, ...]

    @staticmethod
    def of(values: gtsam.Values) -> PlainValues | None:
        """Return the values as plain data; None where there are others than poses and vectors."""
        poses: dict[int, Array] = {}
        vectors: dict[int, Array] = {}
        for key in values.keys():  # noqa: SIM118  gtsam's values are no dictionary
            try:
                poses[int(key)] = values.atPose3(key).matrix()
            except RuntimeError:
                try:
                    vectors[int(key)] = np.array(values.atVector(key))
                except RuntimeError:
                    return None
        stacked = np.array(list(poses.values())).reshape(-1, 4, 4)
        return PlainValues(tuple(poses), stacked, tuple(vectors), tuple(vectors.values()))

    def put_into(self, start: gtsam.Values) -> gtsam.Values | None:
        """Return these values in the place of those at a start; None where that has other variables."""
        values = gtsam.Values(start)
        if values.size() != len(self.pose_key) + len(self.vector_key):
            return None
        try:
            for key, w_T_b in zip(self.pose_key, self.w_T_b, strict=True):
                values.update(key, gtsam.Pose3(w_T_b))
            for key, vector in zip(self.vector_key, self.vectors, strict=True):
                values.update(key, vector)
        except RuntimeError:
            return None
        return values


@dataclass(frozen=True)
class PlainMinimum:
    """A minimum as plain data."""

    values: PlainValues
    point: Array
    error: float
    initial_error: float
    iterations: int
    converged: bool
    reason: str


class MinimumCheckpoints(Protocol):
    """Minima by what they are made of, which is plain data."""

    def recall(self, made_of: object) -> PlainMinimum | None:
        """Return a minimum; None where it is not known."""

    def keep(self, made_of: object, found: PlainMinimum) -> None:
        """Keep a minimum."""


_in_use: ContextVar[MinimumCheckpoints | None] = ContextVar("minimum checkpoints", default=None)


@contextmanager
def use_checkpoints(checkpoints: MinimumCheckpoints) -> Iterator[None]:
    """Let the refinements of this thread use checkpoints until the block ends."""
    before = _in_use.set(checkpoints)
    try:
        yield
    finally:
        _in_use.reset(before)


def minimum_of(
    cost: BundleCost,
    unobserved: gtsam.Values,
    start: Variables,
    limits: tuple[int, float],
    work: Callable[[BundleCost, Variables, int, float, OnStep | None], BundleMinimum],
    on_step: OnStep | None,
) -> BundleMinimum:
    """Return the minimum of a round; ``work``, such as `minimise_bundle`, finds what is not known.

    ``unobserved`` holds what nothing observes in the ``cost``. ``limits``: those of ``work``.
    """
    checkpoints = _in_use.get()
    held, at = (PlainValues.of(values) if checkpoints else None for values in (unobserved, start.values))
    if checkpoints is None or held is None or at is None:
        return work(cost, start, *limits, on_step)
    made_of = cost.problem, cost.noise, cost.used, held, at, start.point, limits
    known = checkpoints.recall(made_of)
    values = known.values.put_into(start.values) if known is not None else None
    if known is not None and values is not None:
        return BundleMinimum(
            error=known.error,
            initial_error=known.initial_error,
            iterations=known.iterations,
            converged=known.converged,
            reason=known.reason,
            at=Variables(values, known.point),
            structure=cost.structure(start),
        )
    found = work(cost, start, *limits, on_step)
    plain = PlainValues.of(found.at.values)
    if plain is not None:
        outcome = found.error, found.initial_error, found.iterations, found.converged, found.reason
        checkpoints.keep(made_of, PlainMinimum(plain, found.at.point, *outcome))
    return found

"""Minimisation of a refinement's cost: pose-side graph and floor points, the points eliminated."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray
from scipy.sparse import csc_array

from backend.bundle.graph import pose_side_factors
from backend.bundle.observations import Cameras, FloorObservations
from backend.bundle.pose_side_factors import PoseSideFactors
from backend.bundle.problem import BundleProblem, NoiseLevels, Variables
from backend.bundle.reduced_system import LinearSystem, ReducedSystem
from backend.bundle.structure import Structure
from backend.bundle.world import WorldTransform
from backend.errors import BackendError
from backend.gauge import key_name
from backend.pose_graph.descent import (
    MAX_DAMPING,
    Limits,
    OnStep,
    Outcome,
    descend,
    descend_damped,
)
from backend.pose_graph.minimise import not_finite
from backend.pose_graph.observability import null_space, open_directions
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]

COARSE, FINE = (30, 1e-3), (300, 1e-5)
"""Most iterations, and the change of the error at which they end, relative to it: of a minimum that others
follow, and of the last one. The error is half of a chi-square variable, and few observations make it flat,
because of its robust losses: two pictures of trees took up to 117 small steps, while maps of a block converge
within 30."""
_FIRST_DAMPING, _DAMPING_FACTOR, _LEAST_FIDELITY = 1e-5, 10.0, 1e-3
"""Levenberg and Marquardt's damping as in gtsam: its start, its factor, and the least ratio of the actual to
the predicted decrease of a step that is taken."""


@dataclass(frozen=True)
class BundleCost:
    """Cost of a round: the factors of the pose side, and the observations of floor points."""

    problem: BundleProblem
    noise: NoiseLevels
    used: NDArray[np.bool_]
    """(m,) observations of the tracks that count."""
    pose_side: PoseSideFactors
    observations: FloorObservations

    @staticmethod
    def of(
        problem: BundleProblem, noise: NoiseLevels, used: NDArray[np.bool_], start: gtsam.Values
    ) -> BundleCost:
        """Build the cost at the given noise levels; ``start`` holds what nothing observes."""
        pose_side = pose_side_factors(problem, noise, start)
        return BundleCost(problem, noise, used, pose_side, FloorObservations.of(problem, noise, used))

    def error(self, at: Variables) -> float:
        """Return half the sum of squared whitened residuals, with the robust losses."""
        cameras = Cameras.of(self.problem, at.values)
        return float(self.pose_side.graph.error(at.values)) + self.observations.error(cameras, at.point)

    def not_finite(self, at: Variables) -> str:
        """Name the measurement that makes the error at the variables infinite or NaN."""
        seen = self.observations
        found = seen.whitened(Cameras.of(self.problem, at.values), at.point)
        wrong = seen.keyframe[~np.isfinite(found).all(axis=1)]
        if len(wrong):
            where = key_name(POSE(wrong[0]))
            return f"an observation of a floor point from {where} has no finite error: look for NaN in it"
        return not_finite(self.pose_side.graph, at.values)

    def structure(self, at: Variables) -> Structure:
        """Return the order of elimination and the pattern of the linear systems."""
        return Structure.of(
            self.pose_side.graph, at.values, self.problem.measurements.count, self.observations
        )

    def linearise(self, at: Variables, structure: Structure) -> LinearSystem:
        """Return the linear system at the variables."""
        cameras = Cameras.of(self.problem, at.values)
        seen = self.observations.linearise(cameras, at.point, self.problem.self_calibrates)
        return LinearSystem.at(self.pose_side.graph, at.values, structure, seen)


@dataclass(frozen=True)
class BundleOptimum:
    """The solved problem of a round."""

    cost: BundleCost
    at: Variables
    structure: Structure

    @property
    def problem(self) -> BundleProblem:
        """Inputs of the round."""
        return self.cost.problem

    @property
    def noise(self) -> NoiseLevels:
        """Noise levels of the round."""
        return self.cost.noise

    @property
    def used(self) -> NDArray[np.bool_]:
        """Observations (m,) of the tracks that were used."""
        return self.cost.used

    @property
    def values(self) -> gtsam.Values:
        """Variables of the pose side."""
        return self.at.values

    @property
    def transform(self) -> WorldTransform:
        """Transform from camera poses in mean heights to metric poses of the body."""
        return self.problem.transform(self.values)

    def linearise(self) -> LinearSystem:
        """Return the linear system at the optimum."""
        return self.cost.linearise(self.at, self.structure)

    def eliminated(self) -> tuple[LinearSystem, ReducedSystem]:
        """Return the linear system at the optimum, and the same without the points.

        Products with the first need no Jacobian as a whole, which would be twice as large as its blocks.
        """
        linear = self.linearise()
        return linear, linear.eliminate()

    def standard_deviations(self, key: int) -> Array:
        """Return those of the numbers (d,) of a vector among the variables of the pose side.

        Raises ``SingularMatrixError`` if a direction is open.
        """
        reduced = self.linearise().eliminate()
        columns = reduced.structure.columns(key)
        right = np.zeros((reduced.size, columns.stop - columns.start))
        right[columns] = np.eye(right.shape[1])
        return np.sqrt(np.diag(reduced.factor.solve(right)[columns]))


@dataclass(frozen=True)
class BundleMinimum(Outcome):
    """The minimum of a round."""

    at: Variables
    structure: Structure


def minimise_bundle(
    cost: BundleCost,
    start: Variables,
    max_iterations: int,
    relative_tolerance: float,
    on_step: OnStep | None = None,
) -> BundleMinimum:
    """Minimise with Gauss-Newton; if the error rises, continue with Levenberg-Marquardt.

    Raises ``BackendError`` if the start is not finite or a variable is not determined.
    """
    limits = Limits(max_iterations, relative_tolerance, on_step, math.inf)
    steps = _Steps(cost, start)
    if not math.isfinite(steps.error):
        raise BackendError(f"bundle adjustment: {cost.not_finite(start)}")
    outcome = descend(steps, limits)
    if not outcome.converged and outcome.iterations < max_iterations:
        damped = _DampedSteps(cost, steps.at, steps.structure)
        outcome = descend_damped(damped, limits, outcome)
        return BundleMinimum(**vars(outcome), at=damped.at, structure=steps.structure)
    return BundleMinimum(**vars(outcome), at=steps.at, structure=steps.structure)


class _Steps:
    """Undamped steps."""

    def __init__(self, cost: BundleCost, start: Variables) -> None:
        self._cost, self.structure = cost, cost.structure(start)
        self._before = self.at = start
        self.error = cost.error(start)

    def step(self) -> Callable[[], float]:
        self._before = self.at
        linear = self._cost.linearise(self.at, self.structure)
        try:
            step = _solve(linear, 0.0)
        except SingularMatrixError as singular:
            message = _open_message(linear, self.at.values, singular.variable)
            raise BackendError(message) from singular
        self.at = _moved(self.at, self.structure, *step)
        self.error = self._cost.error(self.at)
        predicted = linear.error_after(step, 0.0)
        return lambda: predicted

    def revert(self) -> None:
        self.at = self._before


class _DampedSteps:
    """Steps of Levenberg and Marquardt, with the damping of gtsam: a multiple of the identity."""

    def __init__(self, cost: BundleCost, start: Variables, structure: Structure) -> None:
        self._cost, self._structure = cost, structure
        self.at, self.damping = start, _FIRST_DAMPING
        self.error = cost.error(start)

    def step(self) -> None:
        linear = self._cost.linearise(self.at, self._structure)
        while self.damping < MAX_DAMPING:
            try:
                step = _solve(linear, self.damping)
            except SingularMatrixError:
                self.damping *= _DAMPING_FACTOR
                continue
            at = _moved(self.at, self._structure, *step)
            error, predicted = self._cost.error(at), linear.error - linear.error_after(step, self.damping)
            if self.error - error >= _LEAST_FIDELITY * predicted:
                self.at, self.error = at, error
                self.damping /= _DAMPING_FACTOR
                return
            self.damping *= _DAMPING_FACTOR


def _open_message(linear: LinearSystem, values: gtsam.Values, variable: int) -> str:
    """Describe the directions that the measurements leave open, at least one of them in the ``variable``."""
    structure = linear.structure
    keys = list(structure.variable)
    null = null_space(csc_array(linear.jacobian()[0]))
    null = null[structure.elimination.columns(np.arange(len(keys)))]
    sentences = open_directions(null, values, [keys])
    around = f"the measurements around {key_name(keys[variable])} leave a direction open"
    return "under-determined: " + ("; ".join(sentences) or around)


def _solve(linear: LinearSystem, damping: float) -> tuple[Array, Array]:
    return linear.eliminate(damping).solve(*linear.gradient)


def _moved(at: Variables, structure: Structure, by_pose: Array, by_point: Array) -> Variables:
    """Return the variables after a step by the pose side (size,) and by the points (3t,)."""
    delta = gtsam.VectorValues()
    for key in structure.variable:
        delta.insert(key, by_pose[structure.columns(key)])
    return Variables(at.values.retract(delta), at.point + by_point.reshape(-1, 3))

"""Fisher information of measurements at given poses, and Cramer-Rao bounds of functions of the poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.factors import WORLD
from backend.bundle.graph import start_variables
from backend.bundle.metric_poses import metric_jacobians
from backend.bundle.minimise import BundleCost, BundleOptimum
from backend.bundle.noise import start_noise
from backend.bundle.problem import BundleConfig, BundleProblem
from backend.bundle.reduced_system import ReducedSystem
from backend.errors import BackendError
from backend.measurements import Measurements
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Information:
    """Fisher information of measurements over a floor at z = 0, at given poses."""

    reduced: ReducedSystem
    """Factorised normal equations of poses and world, with the floor points eliminated."""
    to_metres: Array
    """(n, 6, 6 + w) Jacobian of metric body poses by pose and world."""

    @staticmethod
    def of(optimum: BundleOptimum) -> Information:
        """Return the information at a solution. Raises ``BackendError`` if a direction is unobserved."""
        try:
            reduced = optimum.linearise().eliminate()
        except SingularMatrixError:
            raise BackendError("information: a direction is unobserved; add measurements") from None
        return Information(reduced, metric_jacobians(optimum.problem, optimum.values, np.zeros(3)))

    def covariance(self, gradient: Array) -> Array:
        """Return the bound (k, k) on the covariance of k quantities.

        ``gradient`` (k, n, 6) is by right perturbations of the body poses.

        Source: Kay 1993, section 3.6 (bound on functions of the parameters).
        """
        of_all = np.einsum("kna,nab->nbk", gradient, self.to_metres)
        right = np.zeros((self.reduced.size, len(gradient)))
        right[self.reduced.structure.columns(WORLD)] = of_all[:, 6:].sum(axis=0)
        for k, of_pose in enumerate(of_all[:, :6]):
            right[self.reduced.structure.columns(POSE(k))] = of_pose
        return np.asarray(right.T @ self.reduced.factor.solve(right))


def information(measurements: Measurements, w_T_b: Array, config: BundleConfig) -> Information:
    """Return the information at poses (n, 4, 4) over the floor z = 0, with the measurements' stated noise.

    Raises ``BackendError`` if a direction is unobserved.
    """
    tracks, camera = measurements.tracks, measurements.camera
    if tracks is None or camera is None:
        raise BackendError("information: no tracks of floor points, or no camera")
    problem = BundleProblem(measurements, tracks, camera, config, self_calibrates=False)
    at = start_variables(problem, w_T_b, 0.0)
    used, noise = np.ones(len(tracks.track), dtype=bool), start_noise(measurements, config)
    cost = BundleCost.of(problem, noise, used, at.values)
    return Information.of(BundleOptimum(cost, at, cost.structure(at)))

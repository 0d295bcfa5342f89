"""Fisher information of measurements at given poses, and Cramer-Rao bounds of functions of the poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU

from backend.bundle.factors import WORLD_SIZE
from backend.bundle.graph import BundleConfig, BundleProblem, start_values
from backend.bundle.noise import start_noise
from backend.bundle.observations import build_graph
from backend.bundle.refinement import metric_jacobians
from backend.errors import BackendError
from backend.measurements import Measurements
from backend.pose_graph.linear import cholesky, jacobian

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Information:
    """Fisher information of measurements over a floor at z = 0, at given poses."""

    factor: SuperLU
    """Cholesky factor of J'J in points (3 each), world, poses (6 each)."""
    to_metres: Array
    """(n, 6, 6 + w) Jacobian of metric body poses by pose and world."""

    def covariance(self, gradient: Array) -> Array:
        """Return the bound (k, k) on the covariance of k quantities.

        ``gradient`` (k, n, 6) is by right perturbations of the body poses.

        Source: Kay 1993, section 3.6 (bound on functions of the parameters).
        """
        n = self.to_metres.shape[0]
        of_all = np.einsum("kna,nab->knb", gradient, self.to_metres)
        right = np.zeros((self.factor.shape[0], len(gradient)))
        right[-6 * n - WORLD_SIZE : -6 * n] = of_all[:, :, 6:].sum(axis=1).T
        right[-6 * n :] = of_all[:, :, :6].reshape(len(gradient), -1).T
        return np.asarray(right.T @ self.factor.solve(right))


def information(measurements: Measurements, w_T_b: Array, config: BundleConfig) -> Information:
    """Return the information at poses (n, 4, 4) over the floor z = 0, with the measurements' stated noise.

    Raises ``BackendError`` if a direction is unobserved.
    """
    tracks, camera = measurements.tracks, measurements.camera
    if tracks is None or camera is None:
        raise BackendError("information: no tracks of floor points, or no camera")
    problem = BundleProblem(measurements, tracks, camera, config, self_calibrates=False)
    values = start_values(problem, w_T_b, 0.0)
    used = np.ones(len(tracks.track), dtype=bool)
    graph = build_graph(problem, start_noise(measurements, config), used, values)
    # By key: points (l), world (w), poses (x).
    J = jacobian(graph, values)
    try:
        factor = cholesky(csc_array(J.T @ J))
    except RuntimeError:
        raise BackendError("information: a direction is unobserved; add measurements") from None
    return Information(factor, metric_jacobians(problem, values, np.zeros(3)))

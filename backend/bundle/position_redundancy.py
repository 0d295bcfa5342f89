"""How many of the measured positions the fit of a refinement absorbs.

A fit follows its measurements: the residuals of n values with the hat matrix H have the variance of n - tr(H)
values. With pictures that are more exact than positions, the positions only place the map, and tr(H) is the
number of its degrees of freedom on Earth. Positions as exact as the pictures hold each pose, and without this
correction their residuals, and then their noise, would shrink to nothing from round to round.

Source: Förstner and Wrobel 2016, section 4.2.4 (redundancy numbers in the estimation of variances).
"""

from __future__ import annotations

import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.factors import ANTENNA, OFFSET, WORLD
from backend.bundle.metric_poses import metric_jacobians, metric_poses
from backend.bundle.minimise import BundleOptimum
from backend.bundle.noise_level import positions_over_typical
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]

_RIGID = np.array([2.0, 2.0, 1.0])
"""Degrees of freedom that place a rigid map: a similarity in the plane, and a height."""


def absorbed_positions(optimum: BundleOptimum) -> Array:
    """Return (3,) how many positions east, north and up are absorbed: the sums of their leverages.

    Where the equations are singular, it is what a rigid map absorbs.
    """
    problem, values = optimum.problem, optimum.values
    positions = problem.measurements.positions
    if not positions:
        return _RIGID
    poses, place = np.unique([p.k for p in positions], return_inverse=True)
    try:
        joint = optimum.linearise().eliminate().joint_covariances([POSE(k) for k in poses.tolist()], WORLD)
    except SingularMatrixError:
        return _RIGID
    w_R_b = metric_poses(problem, values)[poses, :3, :3]
    J = w_R_b @ metric_jacobians(problem, values, np.zeros(3))[poses, 3:]
    J[:, :, 6:][:, :, OFFSET], J[:, :, 6:][:, :, ANTENNA] = np.eye(3), w_R_b
    variance = np.einsum("nij,njk,nik->ni", J, joint, J)[place]
    measured, over = np.isfinite([p.std_m for p in positions]), positions_over_typical(positions)
    # A fix that the robust loss holds off still counts as absorbed, but never more than itself.
    leverage = np.minimum(variance / (optimum.noise.position_m * over) ** 2, 1.0)
    return np.asarray(np.sum(leverage, axis=0, where=measured))

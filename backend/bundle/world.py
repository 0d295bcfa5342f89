"""Transform of camera poses in mean heights to body poses in metres, with its Jacobians."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.factors import (
    FLOOR_Z,
    LOG_SCALE,
    MOUNT,
    SLOPE,
    WORLD,
    WORLD_SIZE,
    rotation_jacobian,
    rotation_of,
)
from backend.se3 import cross_matrix

Array = NDArray[np.float64]


class WorldTransform:
    """The transform by one value of the world variable (`backend.bundle.factors`)."""

    def __init__(self, world: Array, b_T_c: Array) -> None:
        """Prepare the transform for a world variable (14,) and the nominal mount ``b_T_c`` (4, 4)."""
        self.scale = float(np.exp(world[LOG_SCALE]))
        self.slope, self.slope_jacobian = rotation_of(world, SLOPE), rotation_jacobian(world, SLOPE)
        self.mount_jacobian = rotation_jacobian(world, MOUNT)
        self.w_T_f = gtsam.Pose3(gtsam.Rot3(self.slope), np.array([0.0, 0.0, world[FLOOR_Z]]))
        turned = gtsam.Pose3(gtsam.Rot3(rotation_of(world, MOUNT)), np.zeros(3))
        self.b_T_c = gtsam.Pose3(b_T_c).compose(turned)
        self.c_T_b = self.b_T_c.inverse()
        self.adjoint = self.b_T_c.AdjointMap()

    @staticmethod
    def of(values: gtsam.Values, b_T_c: Array) -> WorldTransform:
        """Return the transform by the variables of a graph."""
        return WorldTransform(values.atVector(WORLD), b_T_c)

    def body_pose(self, f_T_c: gtsam.Pose3) -> gtsam.Pose3:
        """Return the metric pose of the body for a camera pose over the floor in mean heights."""
        metric = gtsam.Pose3(f_T_c.rotation(), self.scale * f_T_c.translation())
        return self.w_T_f.compose(metric).compose(self.c_T_b)

    def jacobian(self, f_T_c: gtsam.Pose3, origin: Array = np.zeros(3)) -> Array:
        """Return the Jacobian (6, 6 + w) of the body's pose by perturbations of camera pose and world.

        ``origin`` (3,), in mean heights, is the fixed point of a change of scale. Source: derived.
        """
        R, p = f_T_c.rotation().matrix(), f_T_c.translation() - origin
        J = np.zeros((6, 6 + WORLD_SIZE))
        of_world = J[:, 6:]
        J[:3, :3] = np.eye(3)
        J[3:, 3:6] = self.scale * np.eye(3)
        of_world[3:, LOG_SCALE] = self.scale * R.T @ p
        of_world[3:, FLOOR_Z] = (self.slope @ R)[2]
        # A right perturbation of the slope rotates the whole map about the floor under the origin.
        of_world[:3, SLOPE] = R.T @ self.slope_jacobian
        of_world[3:, SLOPE] = -self.scale * R.T @ cross_matrix(p) @ self.slope_jacobian
        # The camera stays in place; the body rotates about it in the opposite sense.
        of_world[:3, MOUNT] = -self.mount_jacobian
        return np.asarray(self.adjoint @ J)

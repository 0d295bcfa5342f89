"""Registrations as metric edges of the pose graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.measurements import EdgeKind, RelativePose
from backend.pose_graph.heights import HeightEstimate, adjust_heights
from frontend.lift import LiftedPoses, level_T_body, lift
from frontend.registration import Registration
from slam.io.down_looking import LEAST_FALL
from slam.mapping.setup import Setup

Array = NDArray[np.float64]

_LOWEST = 0.05
"""Minimum body height as a fraction of the camera height: lengths scale with the body height."""
LEAST_HEIGHT_STD = 0.01
"""Least relative standard deviation of a height by the rangefinder: ranges wander by about a percent."""


@dataclass(frozen=True)
class Edges:
    """Relative poses lifted from registrations, and the heights that scale them."""

    registrations: tuple[Registration, ...]
    relative_poses: tuple[RelativePose, ...]
    heights: HeightEstimate
    b_p_c_m: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) position of the camera on the body."""
    camera_above_body_m: Array = field(default_factory=lambda: np.zeros(1))
    """(n,) the same along the vertical, at each keyframe."""

    def at_heights(self, height_m: Array) -> tuple[RelativePose, ...]:
        """Rescale the relative poses to the final heights (n,).

        Pictures tell the motion of the camera, so that the place of the camera on the body is not scaled.
        """
        if not self.relative_poses:
            return ()
        i = np.array([edge.i for edge in self.relative_poses])
        above_m, b_p_c_m = self.camera_above_body_m, self.b_p_c_m
        factor = ((height_m + above_m) / (self.heights.height_m + above_m))[i]
        i_T_j = np.array([edge.i_T_j for edge in self.relative_poses])
        of_lever = b_p_c_m - i_T_j[:, :3, :3] @ b_p_c_m
        i_T_j[:, :3, 3] = factor[:, None] * (i_T_j[:, :3, 3] - of_lever) + of_lever
        growth = error_growth(factor, b_p_c_m)
        covariance = growth @ [edge.covariance for edge in self.relative_poses] @ growth.transpose(0, 2, 1)
        return tuple(
            replace(edge, i_T_j=i_T_j[m], covariance=covariance[m])
            for m, edge in enumerate(self.relative_poses)
        )


def error_growth(factor: Array, b_p_c_m: Array) -> Array:
    """Return (n, 6, 6) by what errors of body poses grow where the cameras' lengths grow by ``factor`` (n,).

    Errors have rotation first, and are right perturbations.
    """
    b_T_c = np.eye(4)[None].copy()
    b_T_c[0, :3, 3] = b_p_c_m
    unit = np.ones((len(factor), 6))
    unit[:, 3:] = factor[:, None]
    return se3.adjoint(b_T_c) @ (unit[:, :, None] * se3.adjoint(se3.inverse(b_T_c)))


def lift_edges(registrations: Sequence[Registration], setup: Setup) -> Edges:
    """Lift homographies to relative poses in metres, or in mean heights where no range was measured."""
    i = np.array([r.i for r in registrations], dtype=np.int64)
    j = np.array([r.j for r in registrations], dtype=np.int64)
    H = np.array([r.i_H_j for r in registrations]).reshape(-1, 3, 3)
    covariance = np.array([r.corner_covariance for r in registrations]).reshape(-1, 8, 8)
    readings = setup.readings
    lifted = lift(H, covariance, setup.camera, readings.roll_pitch_rad[i], readings.roll_pitch_std_rad[i])
    good = lifted.usable
    above_m = level_T_body(readings.roll_pitch_rad)[:, 2, :3] @ lifted.b_p_c_m
    heights = _heights(i[good], j[good], lifted, good, setup, above_m)
    i_T_j, covariance = lifted.scale(heights.height_m[i], heights.height_m[i] * heights.log_std[i])
    apart = np.abs(readings.stamps_s[j] - readings.stamps_s[i]) >= setup.config.loops.min_separation_s
    kept = np.flatnonzero(good).tolist()
    kind: list[EdgeKind] = ["loop" if apart[m] else "odometry" for m in kept]
    poses = tuple(
        RelativePose(int(i[m]), int(j[m]), i_T_j[m], covariance[m], k)
        for m, k in zip(kept, kind, strict=True)
    )
    return Edges(tuple(registrations[m] for m in kept), poses, heights, lifted.b_p_c_m, above_m)


def _heights(
    i: NDArray[np.int64],
    j: NDArray[np.int64],
    lifted: LiftedPoses,
    good: NDArray[np.bool_],
    setup: Setup,
    above_m: Array,
) -> HeightEstimate:
    """Estimate the body heights from the camera heights, whose ratios the pictures determine.

    ``above_m`` (n,): height of the camera above the body.
    """
    level_up = level_T_body(setup.readings.roll_pitch_rad)[:, 2, :3]
    b_p_c = setup.camera.b_T_c[:3, 3]
    ranges = [r for r in setup.readings.ranges if level_up[r.k] @ r.b_T_s[:3, 2] > LEAST_FALL]
    k = np.array([r.k for r in ranges], dtype=np.int64)
    b_p_floor = np.array([r.b_T_s[:3] @ [0, 0, -r.range_m, 1] for r in ranges]).reshape(-1, 3)
    camera_m = np.einsum("ma,ma->m", level_up[k], b_p_c - b_p_floor)
    std = np.array([r.std_m for r in ranges])
    above = camera_m > 0
    agreed = adjust_heights(
        len(level_up),
        i,
        j,
        np.log(lifted.height_ratio[good]),
        np.maximum(lifted.log_ratio_std[good], 1e-3),
        k[above],
        np.log(camera_m[above]),
        np.maximum(std[above] / camera_m[above], LEAST_HEIGHT_STD),
    )
    return replace(agreed, height_m=np.maximum(agreed.height_m - above_m, _LOWEST * agreed.height_m))

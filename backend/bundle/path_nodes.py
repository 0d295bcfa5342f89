"""Nodes of the path between which motion is measured: the keyframes, and pictures between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.frame_poses import FramePoses
from backend.bundle.world import WorldTransform
from backend.measurements import Measurements, PinholeModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PathNodes:
    """Keys of the poses in order of time, and the pictures between the keyframes."""

    keys: tuple[int, ...]
    stamps_s: Array
    """(m,) times of the nodes."""
    frames: FramePoses

    @staticmethod
    def of(measurements: Measurements, camera: PinholeModel) -> PathNodes:
        """Return the nodes of a refinement."""
        frames = FramePoses.of(measurements.frames, camera)
        stamps_s = np.array([*measurements.stamps_s, *(frame.stamp_s for frame in frames.frames)])
        order = np.argsort(stamps_s, kind="stable")
        keys = [*(POSE(k) for k in range(measurements.count)), *frames.keys]
        return PathNodes(tuple(keys[k] for k in order.tolist()), stamps_s[order], frames)

    def placed(self, values: gtsam.Values) -> gtsam.Values:
        """Return the variables with a pose of each picture; those that have one keep it."""
        if all(values.exists(key) for key in self.keys):
            return gtsam.Values(values)
        return self.frames.placed(values)

    def calibrated(self, values: gtsam.Values) -> PathNodes:
        """Return the same with the focal lengths of the variables, where these are estimated."""
        return replace(self, frames=self.frames.calibrated(values))

    def metric_poses(self, values: gtsam.Values, transform: WorldTransform) -> Array:
        """Return metric poses (m, 4, 4) of the body."""
        return np.array([transform.body_pose(values.atPose3(key)).matrix() for key in self.keys])


class _Interval(Protocol):
    @property
    def i(self) -> int: ...
    @property
    def j(self) -> int: ...


def ends(intervals: Iterable[_Interval]) -> list[int]:
    """Return the nodes at the ends of intervals, in order."""
    return sorted({k for interval in intervals for k in (interval.i, interval.j)})

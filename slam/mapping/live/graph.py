"""The pose graph of a flight that still goes on: registrations become edges as the keyframes arrive.

The heights that scale the edges are those of the live poses, where the batch adjusts them all at once. In
metres, the readings of an IMU between two keyframes take part, and join those that no picture joins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.measurements import EdgeKind, Inertial, RelativePose, SlantRange
from backend.pose_graph.incremental.estimation import Incremental
from backend.preintegration.intervals import InertialInterval, preintegrate
from frontend.camera import Camera
from frontend.lift import level_T_body, lift
from frontend.registration import Registration
from frontend.tracked import IntermediateFrame
from slam.io.down_looking import LEAST_FALL
from slam.mapping.config import PipelineConfig
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.lift_edges import LEAST_HEIGHT_STD
from slam.mapping.solve_pose_graph import tilt_of

Array = NDArray[np.float64]

_LOWEST = 1e-3
"""Least height, in metres or heights: lengths scale with it."""


@dataclass(frozen=True)
class LiveLink:
    """An edge of the pose graph."""

    i: int
    j: int
    """Keyframe numbers."""
    kind: EdgeKind
    is_kept: bool
    """Whether the solver keeps it at present."""


class LiveGraph:
    """Keyframes in the order of time, each placed as soon as a registration, or readings of an IMU since the
    keyframe before, join it to placed ones.

    The first keyframe that is placed is the origin. Without a range its height is 1, so that all lengths are
    in heights of the camera.
    """

    def __init__(self, camera: Camera, config: PipelineConfig) -> None:
        self._camera, self._config = camera, config
        self._solver = Incremental()
        self._readings: list[KeyframeReadings] = []
        self._number: dict[int, int] = {}
        """Keyframe -> its number in the solver, which counts in the order of placing."""
        self._waiting: list[Registration] = []
        """Registrations that are not yet edges: no more than one of their keyframes is placed."""
        self._intervals: dict[int, InertialInterval] = {}
        """Keyframe -> readings of the IMU since the one before."""
        self._metric = False
        self.loops = 0
        """Loops that were given to the solver."""

    def __len__(self) -> int:
        return len(self._readings)

    @property
    def rejected(self) -> int:
        """Number of edges that the solver rejects at present."""
        return len(self._solver.rejected)

    @property
    def bridged(self) -> int:
        """Number of keyframes that readings of the IMU alone joined to the one before."""
        return self._solver.bridged

    @property
    def newest_s(self) -> float:
        """Time of the newest keyframe, placed or not; minus infinity before the first."""
        return float(self._readings[-1].stamps_s[0]) if self._readings else -np.inf

    def add(
        self, readings: KeyframeReadings, registrations: list[Registration], inertial: Inertial | None = None
    ) -> None:
        """Add the next keyframe with its ``readings`` (of this one keyframe) and its registrations to earlier
        ones; ``inertial`` has the readings of an IMU since the keyframe before. Raises ``BackendError`` where
        the solver refuses them."""
        k, begin_s = len(self), self.newest_s
        self._readings.append(readings)
        self._waiting += registrations
        if k == 0:
            self._place(0, [])
        elif inertial is not None and self._metric:
            stamps_s = np.array([begin_s, *readings.stamps_s])
            for interval in preintegrate(inertial, stamps_s, of_body=True):
                self._intervals[k] = interval
        self._place_joined()
        since_last = self._interval(k)
        if k not in self._number and since_last is not None and self._solver.bridges_by(since_last):
            self._place(k, [])
            self._place_joined()

    def poses(self) -> Array:
        """Return the current poses (n, 4, 4) of all keyframes over the floor at 0; NaN where not placed."""
        poses = np.full((len(self), 4, 4), np.nan)
        if self._number:
            poses[list(self._number)] = self._solver.trajectory()
        return poses

    def links(self) -> tuple[LiveLink, ...]:
        """Return the edges between placed keyframes."""
        keyframe = {number: k for k, number in self._number.items()}
        return tuple(
            LiveLink(keyframe[e.i], keyframe[e.j], e.kind, is_kept) for e, is_kept in self._solver.edges
        )

    def pose(self, k: int) -> Array | None:
        """Return the current pose (4, 4) of keyframe ``k``; None where it is not placed."""
        return self._solver.pose(self._number[k]) if k in self._number else None

    def frame_pose(self, frame: IntermediateFrame) -> Array | None:
        """Return the pose (4, 4) of a frame between keyframes; None where its keyframe is not placed."""
        w_T_i = self.pose(frame.keyframe)
        if w_T_i is None:
            return None
        lifted = self._lifted(frame.keyframe, frame.i_H_j, frame.corner_covariance)
        return None if lifted is None else w_T_i @ lifted[0]

    def _height(self, k: int) -> float:
        """Return the height of keyframe ``k`` over the floor: as solved, by its range, or the last one's."""
        placed, ranges = self.pose(k), self._readings[k].ranges
        if placed is not None:
            return max(float(placed[2, 3]), _LOWEST)
        if ranges:
            return max(self._fall(k) * ranges[0].range_m, _LOWEST)
        return self._height(max(self._number))

    def _fall(self, k: int) -> float:
        return float(level_T_body(self._readings[k].roll_pitch_rad)[0, 2, 2])

    def _place_joined(self) -> None:
        while joined := self._next_joined():
            k, edges = joined
            self._place(k, edges)
            self._waiting = [r for r in self._waiting if not (r.i in self._number and r.j in self._number)]

    def _interval(self, k: int) -> InertialInterval | None:
        """Return the readings since the keyframe before, if that is placed."""
        interval = self._intervals.get(k)
        if interval is None or k - 1 not in self._number:
            return None
        return replace(interval, i=self._number[k - 1])

    def _next_joined(self) -> tuple[int, list[RelativePose]] | None:
        """Return a keyframe that registrations join to placed ones, with their edges."""
        for r in self._waiting:
            ends = [k for k in (r.i, r.j) if k not in self._number]
            if len(ends) != 1:
                continue
            k = ends[0]
            here = [
                o for o in self._waiting if k in (o.i, o.j) and (o.i in self._number or o.j in self._number)
            ]
            if edges := [edge for o in here if (edge := self._edge(o)) is not None]:
                return k, edges
        return None

    def _edge(self, r: Registration) -> RelativePose | None:
        lifted = self._lifted(r.i, r.i_H_j, r.corner_covariance)
        if lifted is None:
            return None
        apart_s = abs(self._readings[r.j].stamps_s[0] - self._readings[r.i].stamps_s[0])
        kind: EdgeKind = "loop" if apart_s >= self._config.loops.min_separation_s else "odometry"
        return RelativePose(r.i, r.j, lifted[0], lifted[1], kind)

    def _lifted(self, i: int, i_H_j: Array, corner_covariance: Array) -> tuple[Array, Array] | None:
        readings = self._readings[i]
        lifted = lift(
            i_H_j[None], corner_covariance[None], self._camera,
            readings.roll_pitch_rad, readings.roll_pitch_std_rad,
        )  # fmt: skip
        if not lifted.usable[0]:
            return None
        height = np.array([self._height(i)])
        poses, covariances = lifted.scale(height, LEAST_HEIGHT_STD * height)
        return poses[0], covariances[0]

    def _place(self, k: int, edges: list[RelativePose]) -> None:
        number, readings, interval = len(self._number), self._readings[k], self._interval(k)
        self._number[k] = number
        renumbered = tuple(
            RelativePose(self._number[e.i], self._number[e.j], e.i_T_j, e.covariance, e.kind) for e in edges
        )
        self.loops += sum(e.kind == "loop" for e in edges)
        ranges = tuple(
            SlantRange(number, r.range_m, max(r.std_m, LEAST_HEIGHT_STD * r.range_m), r.b_T_s)
            for r in readings.ranges
            if self._fall(k) > LEAST_FALL
        )
        if number == 0:
            self._metric = len(ranges) > 0
        if number == 0 and not ranges:
            ranges = (SlantRange(0, 1.0 / max(LEAST_FALL, self._fall(k)), LEAST_HEIGHT_STD),)
        self._solver.add(renumbered, (tilt_of(readings, 0, number),), ranges, inertial=interval)

"""From registrations and sensors to poses: heights, pose graph, refinement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from backend.bundle.graph import NoiseLevels, ScalePrior
from backend.bundle.refinement import Bundle, refine
from backend.errors import BackendError
from backend.measurements import (
    Attitude,
    EdgeKind,
    FloorTracks,
    Measurements,
    PinholeModel,
    Position,
    RelativePose,
    SlantRange,
)
from backend.pose_graph.heights import HeightEstimate, adjust_heights
from backend.pose_graph.solution import Solution
from backend.pose_graph.solve import solve
from frontend.camera import Camera
from frontend.lift import LiftedPoses, level_T_body, lift
from frontend.points import Points
from frontend.registration import Registration
from frontend.tracks import join_tracks
from slam.core.flight import Flight, GeoOrigin
from slam.core.heap import trim_heap
from slam.core.rotations import roll_pitch_yaw_of
from slam.mapping.config import PipelineConfig
from slam.mapping.horizon import LEAST_FALL
from slam.mapping.reach import Reach
from slam.mapping.synchronize import attitudes_at, positions_at, ranges_at

Array = NDArray[np.float64]

_LOWEST = 0.05
"""Of the camera's height: a body far below its camera still has a height, for lengths scale with it."""
LEAST_SEEN = 4
"""Floor points that a keyframe must share with others to be refined: they determine a homography."""
WIDENED_BY_TILT = 1.5
"""A corner of a tilted picture sees farther: a wide lens leaning by 15 degrees."""


@dataclass(frozen=True)
class Sensors:
    """What the sensors say at the keyframes."""

    stamps_s: Array
    attitudes: tuple[Attitude, ...]
    ranges: tuple[SlantRange, ...]
    positions: tuple[Position, ...]
    range_gain_std: float
    range_datum_std_m: float
    roll_pitch_rad: Array
    """(n, 2); level where nothing was measured."""
    roll_pitch_std_rad: Array
    """(n, 2) for the pose graph."""

    @staticmethod
    def at(flight: Flight, stamps_s: Array, origin: GeoOrigin | None, config: PipelineConfig) -> Sensors:
        """Read all streams at the times of the keyframes."""
        trust = config.trust
        attitudes = attitudes_at(flight.attitude, stamps_s, trust.attitude_floor_rad)
        roll_pitch = np.zeros((len(stamps_s), 2))
        std = np.full((len(stamps_s), 2), trust.level_std_rad)
        for a in attitudes:
            roll_pitch[a.k] = a.roll_pitch_yaw_rad[:2]
            std[a.k] = np.hypot(a.std_rad[:2], trust.attitude_graph_rad)
        return Sensors(
            stamps_s,
            attitudes,
            ranges_at(flight.sonar, stamps_s, trust.range_floor_m),
            positions_at(flight, stamps_s, origin),
            flight.sonar.scale_std if flight.sonar else 0.0,
            flight.sonar.datum_std_m if flight.sonar else 0.0,
            roll_pitch,
            std,
        )


@dataclass(frozen=True)
class Edges:
    """Registrations as metric edges of the pose graph."""

    registrations: tuple[Registration, ...]
    relative_poses: tuple[RelativePose, ...]
    heights: HeightEstimate

    def at_heights(self, height_m: Array) -> tuple[RelativePose, ...]:
        """The relative poses in metres of the heights (n,) that were found in the end."""
        return tuple(
            _scaled(r, float(height_m[r.i] / self.heights.height_m[r.i])) for r in self.relative_poses
        )


def _scaled(edge: RelativePose, factor: float) -> RelativePose:
    """The same edge with lengths multiplied."""
    unit = np.array([1.0] * 3 + [factor] * 3)
    i_T_j = edge.i_T_j.copy()
    i_T_j[:3, 3] *= factor
    return replace(edge, i_T_j=i_T_j, covariance=edge.covariance * np.outer(unit, unit))


class Mapper:
    """The back end with its settings for one flight."""

    def __init__(self, camera: Camera, sensors: Sensors, config: PipelineConfig) -> None:
        self.camera, self.sensors, self.config = camera, sensors, config

    def knowing(self, w_T_b: Array, covariances: Array) -> Mapper:
        """The same with roll and pitch as a refinement (n, 4, 4), (n, 6, 6) has found them, where it has."""
        known = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(w_T_b).all(axis=(1, 2))
        roll_pitch, std = self.sensors.roll_pitch_rad.copy(), self.sensors.roll_pitch_std_rad.copy()
        if known.any():
            roll_pitch[known] = roll_pitch_yaw_of(w_T_b[known, :3, :3])[:, :2]
            variance = np.maximum(covariances[known][:, [0, 1], [0, 1]], 0.0)
            std[known] = np.hypot(np.sqrt(variance), self.config.trust.attitude_floor_rad)
        sensors = replace(self.sensors, roll_pitch_rad=roll_pitch, roll_pitch_std_rad=std)
        return Mapper(self.camera, sensors, self.config)

    def without_positions(self) -> Mapper:
        """The same without GPS."""
        return Mapper(self.camera, replace(self.sensors, positions=()), self.config)

    def edges(self, registrations: Sequence[Registration]) -> Edges:
        """Lift homographies to relative poses in metres (in mean heights where no metres were measured)."""
        i = np.array([r.i for r in registrations], dtype=np.int64)
        j = np.array([r.j for r in registrations], dtype=np.int64)
        H = np.array([r.i_H_j for r in registrations]).reshape(-1, 3, 3)
        covariance = np.array([r.corner_covariance for r in registrations]).reshape(-1, 8, 8)
        sensors = self.sensors
        lifted = lift(H, covariance, self.camera, sensors.roll_pitch_rad[i], sensors.roll_pitch_std_rad[i])
        good = lifted.usable
        heights = self._heights(i[good], j[good], lifted, good)
        i_T_j, covariance = lifted.scale(heights.height_m[i], heights.height_m[i] * heights.log_std[i])
        apart = np.abs(sensors.stamps_s[j] - sensors.stamps_s[i]) >= self.config.loops.min_separation_s
        kept = np.flatnonzero(good).tolist()
        kind: list[EdgeKind] = ["loop" if apart[m] else "odometry" for m in kept]
        poses = tuple(
            RelativePose(int(i[m]), int(j[m]), i_T_j[m], covariance[m], k)
            for m, k in zip(kept, kind, strict=True)
        )
        return Edges(tuple(registrations[m] for m in kept), poses, heights)

    def _heights(
        self, i: NDArray[np.int64], j: NDArray[np.int64], lifted: LiftedPoses, good: NDArray[np.bool_]
    ) -> HeightEstimate:
        """Heights of the bodies, agreed on as heights of the cameras, whose ratios the pictures tell."""
        level_up = level_T_body(self.sensors.roll_pitch_rad)[:, 2, :3]
        b_p_c = self.camera.b_T_c[:3, 3]
        ranges = [r for r in self.sensors.ranges if level_up[r.k] @ r.b_T_s[:3, 2] > LEAST_FALL]
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
            np.maximum(std[above] / camera_m[above], 0.01),
        )
        body_m = agreed.height_m - level_up @ b_p_c
        return replace(agreed, height_m=np.maximum(body_m, _LOWEST * agreed.height_m))

    def reach(self, heights: HeightEstimate, known: Solution) -> Reach:
        """How far from where the poses known so far have it each keyframe's view may be."""
        height_m = heights.height_m
        covariances = known.covariances
        if covariances is None:
            covariances = np.full((len(height_m), 6, 6), np.nan)
        corner = self.camera.rays(self.camera.undistort(self.camera.corners_px))
        view_m = WIDENED_BY_TILT * float(np.linalg.norm(corner[:, :2], axis=1).max()) * height_m
        std_m = np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2))
        return Reach(
            known.w_T_b[:, :3, 3], view_m + self.config.loops.plausible_sigmas * std_m, known.component
        )

    def solve(
        self,
        edges: Edges,
        on_step: Callable[[int, float], None] | None = None,
        covariances: bool = False,
    ) -> Solution:
        """The pose graph: relative poses, attitudes, heights."""
        trim_heap()  # what lifting all pairs has left
        sensors, heights = self.sensors, edges.heights
        tied = sorted({k for r in edges.relative_poses for k in (r.i, r.j)})
        attitudes, ranges = [], []
        for k in tied:
            std = np.append(sensors.roll_pitch_std_rad[k], np.inf)
            attitudes.append(Attitude(k, np.append(sensors.roll_pitch_rad[k], 0.0), std))
            fall = max(LEAST_FALL, float(np.cos(sensors.roll_pitch_rad[k]).prod()))
            height = float(heights.height_m[k])
            ranges.append(SlantRange(k, height / fall, height * max(0.01, float(heights.log_std[k]))))
        measurements = Measurements(sensors.stamps_s, edges.relative_poses, tuple(attitudes), tuple(ranges))
        plain = solve(measurements, loops_robust=False, covariances=False, on_step=on_step)
        if not edges.relative_poses:
            return plain
        # Attitudes that lean together make all edges disagree a little: that is no reason to reject any.
        typical = float(np.median(plain.edge_residual**2)) / float(chi2.median(6))
        if typical > 1.0:
            widened = (replace(r, covariance=typical * r.covariance) for r in edges.relative_poses)
            measurements = replace(measurements, relative_poses=tuple(widened))
        return solve(measurements, initial=plain.w_T_b, covariances=covariances, on_step=on_step)

    def refine(
        self,
        members: NDArray[np.int64],
        w_T_b: Array,
        floor_z_m: float,
        tracks: FloorTracks,
        on_step: Callable[[int, float], None] | None = None,
        lengths: ScalePrior | None = None,
        noise: NoiseLevels | None = None,
    ) -> Bundle:
        """Planar bundle adjustment of one connected set of keyframes (sorted numbers)."""
        measured = self.measured(members, tracks)
        return refine(measured, w_T_b[members], floor_z_m, self.config.bundle, on_step, lengths, noise)

    def measured(self, members: NDArray[np.int64], tracks: FloorTracks) -> Measurements:
        """All that was measured of one connected set of keyframes, renumbered from 0."""
        number = np.full(len(self.sensors.stamps_s), -1, dtype=np.int64)
        number[members] = np.arange(len(members))
        mine = number[tracks.keyframe] >= 0
        _, track = np.unique(tracks.track[mine], return_inverse=True)
        tracks = FloorTracks(number[tracks.keyframe[mine]], track, tracks.pixel[mine], tracks.std_px[mine])
        seen = np.bincount(tracks.keyframe, minlength=len(members))
        if len(members) < 2 or (seen < LEAST_SEEN).any():
            raise BackendError("some keyframes share too few floor points with others")
        sensors, camera = self.sensors, self.camera
        level = np.array([self.config.trust.level_std_rad] * 2 + [np.inf])
        attitudes = sensors.attitudes or tuple(Attitude(k, np.zeros(3), level) for k in members.tolist())
        return Measurements(
            sensors.stamps_s[members],
            attitudes=tuple(replace(a, k=int(number[a.k])) for a in attitudes if number[a.k] >= 0),
            ranges=tuple(replace(r, k=int(number[r.k])) for r in sensors.ranges if number[r.k] >= 0),
            positions=tuple(replace(p, k=int(number[p.k])) for p in sensors.positions if number[p.k] >= 0),
            tracks=tracks,
            range_gain_std=sensors.range_gain_std,
            range_datum_std_m=sensors.range_datum_std_m,
            camera=PinholeModel(
                camera.focal_px,
                camera.center_px,
                camera.b_T_c,
                camera.focal_std_ratio,
                0.0 if camera.is_distorted else camera.radial_std,
                camera.mount_std_rad,
            ),
        )

    def tracks(self, points: Sequence[Points], registrations: Sequence[Registration]) -> FloorTracks:
        """Floor points followed through the registrations."""
        return join_tracks(points, registrations, self.camera, self.config.tracks)

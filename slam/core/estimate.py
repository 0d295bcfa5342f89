"""The result of an optimization: keyframe poses with covariances, edges, loops and figures of quality."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.measurements import Rejection, RelativePose
from frontend.camera import Camera
from frontend.elevation import Elevation
from frontend.obstacles import ObstacleList
from slam.core.control_points import ControlReport
from slam.core.errors import InputError
from slam.core.floor_points import FloorPoints
from slam.core.geodesy import GeoOrigin
from slam.core.instrument_errors import NOTHING_KNOWN, InstrumentErrors
from slam.core.messages import Message, by_kind
from slam.core.notebook import table_html, trajectory_svg
from slam.core.units import length, percent, unit

if TYPE_CHECKING:
    from backend.pose_graph.certificate import Certificate
    from backend.pose_graph.solution import RangeErrors, RowMistake

Array = NDArray[np.float64]


MAP_TRAJECTORIES = ("chain of homographies", "without loops", "with loops")
"""Names of the three trajectories of a map: the plain chain, the odometry, and the result."""


@dataclass(frozen=True)
class LoopVerdict:
    """The decision about one loop candidate."""

    i: int
    j: int
    """Keyframe numbers, i < j."""
    rejection: Rejection | None
    """Why a rejected loop was rejected; None for a kept one."""

    @property
    def verdict(self) -> Literal["kept", "rejected"]:
        """Whether the map uses it."""
        return "rejected" if self.rejection else "kept"

    @property
    def reason(self) -> str:
        """Why a rejected loop was rejected, in words with figures; empty for a kept one."""
        return str(self.rejection or "")

    @property
    def finding(self) -> str:
        """The verdict, in which a rejected loop is contradicted or unproven."""
        return self.rejection.check.finding if self.rejection else "kept"


@dataclass(frozen=True, kw_only=True)
class GroundFacts:
    """How well the pictures of a mosaic agree on the ground, and what was measured of its surface."""

    misregistration_px: tuple[float, ...]
    """50th and 95th percentiles of the displacement between two pictures of one piece of ground, over the
    surface, in pixels of the mosaic."""
    over_floor_px: tuple[float, ...]
    """The same over a flat floor."""
    relief_share: float = 0.0
    """Share of the map where the ground is not the floor."""
    filled_share: float = 0.0
    """Share of that ground whose height was not measured."""
    level_share: float = 0.0
    """Share of the map that no two pictures show, and that is taken as level."""
    lowest_m: float = 0.0
    highest_m: float = 0.0
    """Lowest and highest ground over the floor."""
    doubted_share: float = 0.0
    """Share of the measured heights that are doubted: they lie in pits deeper than wide."""
    doubted_at_m: tuple[float, float, float] | None = None
    """Place of the lowest of them, x, y and height over the floor; None without any."""
    height_std_m: float | None = None
    """Median standard deviation of the measured heights; None on a flat floor, or where no two pairs of
    pictures show one height."""
    unmatched_share: float = 0.0
    """Share of the ground that two pictures show, on which they do not agree: it moves, or has no texture."""
    unmatched_at_m: tuple[float, float] | None = None
    """Middle of the largest piece of it, x and y; None without any."""

    @property
    def is_measured(self) -> bool:
        """Whether the ground is not flat and pictures or the sonar show its height."""
        return self.relief_share > 0 and self.filled_share < 1

    @property
    def is_measured_in_part(self) -> bool:
        """Whether some of that ground has no measured height, or a doubted one."""
        return self.is_measured and bool(self.untrusted)

    @property
    def trusted_share(self) -> float:
        """Share of the map whose heights were measured and are not doubted, or that was found flat."""
        return 1.0 - sum(share for share, _ in self._untrusted)

    @property
    def untrusted(self) -> str:
        """Shares of the map whose heights are not to be trusted, each with its reason; empty without any."""
        lines = [f"{percent(share)} {why}" for share, why in self._untrusted if share]
        return ", ".join(lines[:-1]) + ", and " * (len(lines) > 1) + "".join(lines[-1:])

    @property
    def _untrusted(self) -> tuple[tuple[float, str], ...]:
        return (
            (self.level_share, "is taken as level, because no two pictures show it"),
            (self.relief_share * self.filled_share, "is filled in from the ground around it"),
            (self._doubted_of_map, "is doubted, because it lies in deep pits"),
        )

    @property
    def doubt(self) -> str:
        """On which share of the map measured heights are doubted; empty without any."""
        share = self._doubted_of_map
        return f"Heights of {percent(share)} of the ground are doubted" if share else ""

    @property
    def _doubted_of_map(self) -> float:
        return self.doubted_share * self.relief_share * (1.0 - self.filled_share)


@dataclass(frozen=True, kw_only=True, repr=False)
class Estimate:
    """Optimized keyframe poses with covariances, the measurements behind them, and figures of quality."""

    name: str
    epoch_ns: int
    stamps_s: Array
    """(n,) keyframe times, seconds since epoch_ns; the instruments' clock where the camera's is off."""
    frame_names: tuple[str, ...]
    frame_index: NDArray[np.int64]
    """(n,) number of each keyframe among the frames of the flight."""
    w_T_b: Array
    """(n, 4, 4) optimized poses; NaN where a keyframe could not be placed."""
    covariances: Array
    """(n, 6, 6), rotation first, right perturbation; NaN where unknown."""
    over_floor_covariances: Array
    """(n, 6, 6) covariances of ``over_floor_T_b`` without the errors that pictures and floor share. They say
    how accurately the floor in a picture is placed. NaN where unknown."""
    component: NDArray[np.int64]
    """(n,) connected part of the graph each keyframe belongs to; 0 is the largest, -1 not placed."""
    camera: Camera | None
    """The camera; its focal length, distortion and mount are estimates where they were estimated."""
    floor_z_m: float
    """Height of the floor at the world's origin."""
    origin: GeoOrigin | None
    """Place of the world's origin on Earth; None where the world is not east-north-up."""
    relative_poses: tuple[RelativePose, ...]
    loops: tuple[LoopVerdict, ...]
    chain_w_T_b: Array
    """(n, 4, 4) poses from composed homographies of consecutive frames alone, as in the paper."""
    odometry_w_T_b: Array
    """(n, 4, 4) poses optimized without loops."""
    frames: int = 0
    """Number of frames read."""
    rejected: dict[str, int] = field(default_factory=dict)
    """Number of dropped frames, edges and values by reason."""
    not_placed: dict[str, str] = field(default_factory=dict)
    """Name of each keyframe without a pose -> reason; of photographs also those that are no keyframe."""
    not_drawn: dict[str, str] = field(default_factory=dict)
    """Name of each keyframe that the mosaic does not show -> reason."""
    partly_drawn: dict[str, str] = field(default_factory=dict)
    """Name of each keyframe of which the mosaic lacks ground -> how much of it, and why."""
    timing_s: dict[str, float] = field(default_factory=dict)
    messages: tuple[Message, ...] = ()
    graph_error: float = float("nan")
    """Half the sum of squared whitened residuals over all kept factors."""
    iterations: int = 0
    floor_slope_rad: tuple[float, float] = (0.0, 0.0)
    """Rotation vector (x, y) from level to the ground; zero where no measurement shows a slope."""
    ground_covariances: Array | None = None
    """(n, 6, 6) those over the floor with the errors of an estimated lens, as equal motions of the camera;
    None where the lens was fixed: then ``over_floor_covariances`` are those of the ground."""
    joint_errors: Array | None = None
    """(n, 6, s) right perturbation of all poses, rotation first, by one standard deviation of each of their
    largest independent errors (`slam.mapping.pose_errors`). None without a refinement, where instruments have
    joined parts to the refined one, and in files of earlier versions."""
    row_motion_m: Array | None = None
    """(n, 3) motion of each camera in body axes from the exposure of the first row of its picture to that of
    the last, NaN where unknown; None for a global shutter."""
    row_turn_rad: Array | None = None
    """(n, 3) how each camera turns meanwhile, as a rotation vector; 0 of photographs, of which it is not
    known, and None for a global shutter and in files of earlier versions."""
    scale_std: float | None = None
    """Relative standard deviation that all lengths share; None where the scale is not observed."""
    middle_std_m: float | None = None
    """Standard deviation of the place of the whole map on Earth, x and y together: all places share it, and
    distances do not have it. None without a place on Earth."""
    length_stds: tuple[tuple[float, float, float], ...] = ()
    """Distances between two places in pictures, in metres and growing, each with the standard deviation of a
    typical and of a badly known one (`backend.bundle.accuracy.length_stds`); empty without a refinement."""
    metric: bool = True
    """Whether lengths are metres. Otherwise the scale is not observed, and lengths are multiples of the
    camera's mean height over the floor."""
    range_errors: RangeErrors | None = None
    """Estimated gain and zero of the height sensor; None without such a sensor."""
    instruments: InstrumentErrors = NOTHING_KNOWN
    """Errors of attitude, accelerometer and mount, as the map determines them."""
    antenna_m: tuple[float, float, float] | None = None
    """Place of the GPS antenna on the body, forward, left and up, as told or as estimated; None where the map
    has no positions."""
    antenna_covariances: Array | None = None
    """(n, 3, 3) covariances of the antenna's positions, east, north and up, where its place was estimated;
    None where they are those of the body, and in an estimate that was read."""
    accuracy_basis: str = ""
    """The one instrument or the assumed values on which the stated accuracy rests, in one sentence; empty
    where two instruments check each other."""
    information_shares: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Direction -> instrument -> its share in the variance; empty without a refinement."""
    row_mistakes: tuple[RowMistake, ...] = ()
    """Rejected edges of a pose graph that one typical mistake of their rows explains."""
    certificate: Certificate | None = None
    """Whether the solution is the global optimum; of a flight, for its pairs of pictures alone."""
    elevation: Elevation | None = None
    """Elevation of the ground over a level floor, as the sonar measured it; None without a sonar."""
    obstacles: ObstacleList | None = None
    """Things that stand on the ground; None where nothing would show them."""
    floor_points: FloorPoints | None = None
    """Points of the ground that the refinement has placed; None without one."""
    ground: GroundFacts | None = None
    """The ground of the mosaic; None without a mosaic."""
    control: ControlReport | None = None
    """Control points and check points; None without any."""
    trajectory_names: tuple[str, str, str] = MAP_TRAJECTORIES
    """Names of ``chain_w_T_b``, ``odometry_w_T_b`` and ``w_T_b`` for tables and pictures."""
    folder: Path | None = field(default=None, compare=False)
    """Output folder that the estimate was read from; None where it was not read."""

    @property
    def status(self) -> str:
        """``ok``, or the reasons why the map may be wrong, in one line."""
        return by_kind(self.messages).status

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of all messages."""
        return tuple(map(str, self.messages))

    def __repr__(self) -> str:
        kept = sum(loop.verdict == "kept" for loop in self.loops)
        return (
            f"Estimate({self.name!r}, status={self.status!r}, keyframes={len(self.stamps_s)}, "
            f"placed={int(self.placed.sum())}, loops={kept})"
        )

    def _repr_html_(self) -> str:
        positions = self.w_T_b[self.placed, :3, 3]
        path_m = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
        loops = [(loop.i, loop.j) for loop in self.loops if loop.verdict == "kept"]
        rows = [
            ("status", self.status),
            ("keyframes", f"{len(positions)} of {len(self.stamps_s)} placed, from {self.frames} frames"),
            ("loops", f"{len(loops)} of {len(self.loops)} candidates kept"),
            ("path length", length(path_m, self.metric)),
            ("warnings", str(len(self.messages))),
        ]
        ends = np.array(loops, dtype=np.int64).reshape(-1, 2)
        return table_html(f"Estimate {self.name}", rows) + trajectory_svg(self.w_T_b[:, :2, 3], ends)

    def to_dataframe(self) -> Any:
        """Return the keyframes as a ``pandas.DataFrame`` (`slam.core.data_frame`).

        Raises ``InputError`` without pandas.
        """
        from slam.core.data_frame import keyframe_table

        return keyframe_table(
            stamps_ns=self.stamps_ns,
            names=self.frame_names,
            w_T_b=self.w_T_b,
            covariances=self.covariances,
            component=self.component,
            metric=self.metric,
        )

    def to_xarray(self, folder: str | Path | None = None, cell_m: float | None = None) -> Any:
        """Return the rasters of an output folder as an ``xarray.Dataset`` (`slam.core.raster_dataset`).

        ``folder``: what `slam optimize` or `write_mosaic` wrote, by default where the estimate was read.
        ``cell_m``: size of a cell, by default a pixel of the mosaic, if there are no more than 4 million.
        Raises ``InputError`` without xarray, and where there are no rasters.
        """
        from slam.core.raster_dataset import raster_dataset

        where = self.folder if folder is None else Path(folder)
        if where is None:
            raise InputError("to_xarray: name the folder of the rasters, as to_xarray(folder)")
        return raster_dataset(where, unit(self.metric), cell_m)

    @property
    def follows_control_points(self) -> bool:
        """Whether control points place the map."""
        return self.control is not None and self.control.is_followed

    @property
    def altitude_known(self) -> bool:
        """Whether an altitude is known on Earth, by fixes or by control points that the map follows."""
        if self.origin is None or self.origin.altitude_known:
            return self.origin is not None
        return self.control is not None and self.control.has_heights

    @property
    def height_system(self) -> str:
        """The level of altitudes, as `slam.core.height_systems` names it; empty if not known."""
        if self.control is not None and self.control.has_heights:
            return self.control.height_system
        return "" if self.origin is None or not self.origin.altitude_known else self.origin.height_system

    @property
    def placed(self) -> NDArray[np.bool_]:
        """(n,) whether each keyframe has a pose."""
        return np.asarray(np.isfinite(self.w_T_b).all(axis=(1, 2)))

    @property
    def over_floor_T_b(self) -> Array:
        """(n, 4, 4) poses without the slope of the ground: the floor is the plane z = floor_z_m."""
        return over_floor(self.w_T_b, self.floor_slope_rad, self.floor_z_m)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(n,) keyframe times on the recorder's clock."""
        return self.epoch_ns + np.round(self.stamps_s * 1e9).astype(np.int64)


def over_floor(w_T_b: Array, slope_rad: tuple[float, float], floor_z_m: float) -> Array:
    """Return the poses (n, 4, 4) rotated about the floor at the origin so that the floor is level."""
    turn = Rotation.from_rotvec([*slope_rad, 0.0]).inv().as_matrix()
    under = np.array([0.0, 0.0, floor_z_m])
    poses = w_T_b.copy()
    poses[:, :3, :3] = turn @ w_T_b[:, :3, :3]
    poses[:, :3, 3] = (w_T_b[:, :3, 3] - under) @ turn.T + under
    return poses

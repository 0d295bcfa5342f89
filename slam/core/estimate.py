"""What the pipeline gives back: the optimized flight."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.measurements import RelativePose
from frontend.camera import Camera
from frontend.elevation import Elevation
from slam.core.flight import GeoOrigin

if TYPE_CHECKING:
    from backend.pose_graph.certificate import Certificate
    from backend.pose_graph.solution import RangeErrors

Array = NDArray[np.float64]


MAP_TRAJECTORIES = ("chain of homographies", "without loops", "with loops")
"""The three ways in which a map places its keyframes."""


@dataclass(frozen=True)
class LoopVerdict:
    """What became of one loop candidate."""

    i: int
    j: int
    """Keyframe numbers, i < j."""
    verdict: Literal["kept", "rejected"]
    reason: str
    """Empty for a kept loop; else what spoke against it, in words with figures."""


@dataclass(frozen=True)
class AttitudeErrors:
    """The attitude stream against the map's attitude; the floor is taken for level."""

    offset_rad: tuple[float, float]
    """Of roll and pitch, on average."""
    offset_std_rad: tuple[float, float]
    spread_rad: float
    """Standard deviation of roll and pitch about that."""
    largest_rad: float
    """Of roll or pitch at any keyframe."""
    heading_wander_rad: float | None
    """Largest less smallest error of the heading; None where no heading was measured."""


@dataclass(frozen=True)
class AccelerometerErrors:
    """The accelerometer against the map's path (`backend.inertial_scale`); body axes (forward, left, up)."""

    offset_m_s2: tuple[float, float, float]
    offset_std_m_s2: tuple[float, float, float]
    arm_m: tuple[float, float, float]
    """From the body's origin to the accelerometer."""
    arm_std_m: tuple[float, float, float]
    delay_s: float
    """The pictures' stamps are so much later than the accelerometer's for the same moment."""
    scale: float
    """True lengths, as it has them, over the map's before it was heard."""
    scale_std: float
    """The uncertainty of its own gain included."""
    used: bool
    """Whether the map's lengths rest on it too."""
    delay_std_s: float = float("nan")
    """Infinite where the flight does not show the delay."""
    delay_taken_out_s: float = 0.0
    """So much of the delay the map has taken out of the instruments' stamps; 0 where it is held at none."""


@dataclass(frozen=True)
class MountTilt:
    """How the camera sits on the body, against what was told."""

    tilt_rad: tuple[float, float]
    """Rotation about the body's x and y that takes the told mount to the found one."""
    std_rad: float
    """Of either."""
    b_T_c: tuple[tuple[float, ...], ...]
    """The found mount, four rows of four: ``T_BS`` of ``cam0/sensor.yaml``."""


@dataclass(frozen=True)
class InstrumentErrors:
    """What the map shows of the instruments' own errors; None where it shows nothing."""

    attitude: AttitudeErrors | None
    accelerometer: AccelerometerErrors | None
    mount: MountTilt | None = None
    """None where the camera's mount was held as told."""


@dataclass(frozen=True)
class Estimate:
    """Optimized keyframe poses with covariances, and how they came about."""

    name: str
    status: str
    """``ok``, or in one sentence what is not observed or could not be placed."""
    epoch_ns: int
    stamps_s: Array
    """(n,) keyframe times, seconds since epoch_ns, on the instruments' clock where the camera's is off."""
    frame_names: tuple[str, ...]
    frame_index: NDArray[np.int64]
    """(n,) which frame of the flight each keyframe is."""
    w_T_b: Array
    """(n, 4, 4) optimized poses; NaN where a keyframe could not be placed."""
    covariances: Array
    """(n, 6, 6), rotation first, right perturbation; NaN where unknown."""
    over_floor_covariances: Array
    """(n, 6, 6) of ``over_floor_T_b``, without what pictures and floor are off together: how well the place
    of what a picture shows of the floor is known. NaN where unknown."""
    component: NDArray[np.int64]
    """(n,) connected part of the graph each keyframe belongs to; 0 is the largest, -1 not placed."""
    camera: Camera | None
    """As estimated, where focal length, distortion or mount were."""
    floor_z_m: float
    """Height of the floor under the world's origin."""
    origin: GeoOrigin | None
    """Set where the world is east-north-up on Earth."""
    relative_poses: tuple[RelativePose, ...]
    loops: tuple[LoopVerdict, ...]
    chain_w_T_b: Array
    """(n, 4, 4) the paper's way: homographies of consecutive frames composed, nothing else."""
    odometry_w_T_b: Array
    """(n, 4, 4) optimized without loops."""
    frames: int = 0
    """Frames read."""
    rejected: dict[str, int] = field(default_factory=dict)
    """Frames, edges and values dropped, counted by reason."""
    timing_s: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    graph_error: float = float("nan")
    """Half the squared whitened residuals over all kept factors."""
    iterations: int = 0
    floor_slope_rad: tuple[float, float] = (0.0, 0.0)
    """Rotation vector (x, y) that takes the level to the ground; zero where nothing told of a slope."""
    scale_std: float | None = None
    """Relative standard deviation that all lengths share; None where nothing told the scale."""
    metric: bool = True
    """Whether lengths are metres; else they are multiples of the camera's mean height over the floor, for
    nothing told the scale."""
    range_errors: RangeErrors | None = None
    """What the height sensor's readings turned out to have in common; None where there is none."""
    instruments: InstrumentErrors = InstrumentErrors(None, None)
    """Errors of attitude, accelerometer and mount, as the map shows them."""
    certificate: Certificate | None = None
    """Graphs alone: whether the solution is the global optimum."""
    elevation: Elevation | None = None
    """What the sonar heard of the ground, over a level floor in the world's x and y; None without one."""
    trajectory_names: tuple[str, str, str] = MAP_TRAJECTORIES
    """What ``chain_w_T_b``, ``odometry_w_T_b`` and ``w_T_b`` are, in words."""

    @property
    def over_floor_T_b(self) -> Array:
        """(n, 4, 4) poses with the slope of the ground taken out: the floor is the plane z = floor_z_m."""
        return over_floor(self.w_T_b, self.floor_slope_rad, self.floor_z_m)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(n,) keyframe times on the recorder's clock."""
        return self.epoch_ns + np.round(self.stamps_s * 1e9).astype(np.int64)


def over_floor(w_T_b: Array, slope_rad: tuple[float, float], floor_z_m: float) -> Array:
    """Poses (n, 4, 4) turned about the floor under the origin until the floor is level."""
    turn = Rotation.from_rotvec([*slope_rad, 0.0]).inv().as_matrix()
    under = np.array([0.0, 0.0, floor_z_m])
    poses = w_T_b.copy()
    poses[:, :3, :3] = turn @ w_T_b[:, :3, :3]
    poses[:, :3, 3] = (w_T_b[:, :3, 3] - under) @ turn.T + under
    return poses

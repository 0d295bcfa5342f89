"""The map of a flight, from odometry to the final refinement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.bundle.refinement import Bundle
from backend.clocks.picture_clock import PictureClock
from backend.pose_graph.solution import Solution
from frontend.camera import Camera
from frontend.registration import Registration
from slam.core.control_points import ControlReport
from slam.core.estimate import over_floor
from slam.core.floor_points import FloorPoints
from slam.core.messages import Message
from slam.mapping.calibration.inertial_scale import AccelerometerScale
from slam.mapping.front_end import Observations
from slam.mapping.gps.stated_accuracy import Contradiction
from slam.mapping.inertial.bridge import Bridge
from slam.mapping.lift_edges import Edges
from slam.mapping.search_radius import KnownPoses
from slam.mapping.setup import Setup

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Map:
    """Poses of the keyframes with everything that they rest on. Each stage returns a new one."""

    observations: Observations
    """Features, links and registrations of the keyframes."""
    edges: Edges
    """The registrations that hold, lifted to relative poses, with the heights of the keyframes."""
    graph: Solution
    """Solution of the pose graph of ``edges``."""
    odometry: Map | None = None
    """The map without loops, kept for comparison; None in that map itself."""
    w_T_b: Array
    """(n, 4, 4) poses; NaN for a keyframe that is not placed."""
    covariances: Array
    over_floor_covariances: Array
    """(n, 6, 6), both as in `slam.core.estimate.Estimate`."""
    component: NDArray[np.int64]
    """(n,) connected part, 0 the largest; -1 for a keyframe that is not placed."""
    floor_z_m: float = 0.0
    camera: Camera
    """The camera as estimated from the largest part."""
    bundle: Bundle | None = None
    """Refinement of the largest part; None before the refinement, or if it failed."""
    georeferenced: bool = False
    setups: tuple[Setup, ...] = ()
    """Inputs of the refinement of each part, with the fixes and control points that it uses."""
    warnings: tuple[Message, ...] = ()
    """Each makes the status other than ok; surveyed points and bridges have further ones of their own."""
    remarks: tuple[Message, ...] = ()
    """Measurements that were left out without harm to the result."""
    no_scale: tuple[Message, ...] = ()
    """Why no instrument determined the lengths of a part in metres; the status is not ok."""
    velocity_left_out: bool = False
    """Whether the accelerometer contradicts the velocity in a part; then it tells no lengths of the whole."""
    fixes_left_out: tuple[str, ...] = ()
    """Names of the GPS fixes that contradict the pictures and the other fixes, and are not used."""
    stated_accuracy: tuple[Contradiction, ...] = ()
    """Parts whose GPS fixes differ by far more than the receiver states; the status is not ok."""
    control: ControlReport | None = None
    """Surveyed points on the largest part; None without any."""
    height_std_m: tuple[float, ...] = ()
    """Standard deviation of the height of each part's first keyframe over the floor, without the common
    error of all parts; 0 if unknown. The part's own covariances treat that height as certain."""
    inertial: AccelerometerScale | None = None
    """Scale and bias from the accelerometer, for the largest part."""
    clock: PictureClock | None = None
    """Delay of the pictures' stamps behind the gyro's, from the largest part."""
    metric: bool = True
    """Whether lengths of the largest part are metres; otherwise the unit is the camera's mean height."""
    bridges: tuple[Bridge, ...] = ()
    """Joins of parts by instruments (`slam.mapping.inertial.bridges`)."""
    floor_points: FloorPoints | None = None
    """Points of the ground that each part's refinement has placed; None before it."""

    @property
    def slope_rad(self) -> tuple[float, float]:
        """Slope of the ground, as in `slam.core.estimate.Estimate`."""
        return self.bundle.floor_slope_rad if self.bundle else (0.0, 0.0)

    @property
    def kept_registrations(self) -> list[Registration]:
        """Registrations that the pose graph did not reject."""
        return [r for r, ok in zip(self.edges.registrations, self.graph.edge_kept, strict=True) if ok]

    @property
    def main_share(self) -> float:
        """Share of the keyframes in the largest part."""
        return float(np.mean(self.component == 0))

    def of_main(self, poses: Array) -> Array:
        """Return poses (n, 4, 4) of the largest part, NaN for the others, which have their own worlds."""
        return np.where((self.component == 0)[:, None, None], poses, np.nan)

    @property
    def world(self) -> NDArray[np.int64]:
        """(n,) number of the world that each pose is in: positions on Earth put all parts into one."""
        return np.zeros_like(self.component) if self.georeferenced else self.component

    @property
    def over_floor_T_b(self) -> Array:
        """(n, 4, 4) poses over a floor that is made level at ``floor_z_m``."""
        return over_floor(self.w_T_b, self.slope_rad, self.floor_z_m)

    @property
    def height_m(self) -> Array:
        """(n,) heights over the floor."""
        return np.asarray(self.over_floor_T_b[:, 2, 3] - self.floor_z_m)

    def known_poses(self) -> KnownPoses:
        """Return poses and covariances over the floor, for checks of new edges."""
        return KnownPoses(
            w_T_b=self.over_floor_T_b,
            covariances=self.over_floor_covariances,
            component=self.component,
            height_m=self.height_m,
            metric=self.metric,
        )


def largest_first(component: NDArray[np.int64]) -> NDArray[np.int64]:
    """Renumber parts (n,) without gaps, 0 the largest; -1 stays."""
    label, size = np.unique(component[component >= 0], return_counts=True)
    out = np.full_like(component, -1)
    for number, k in enumerate(np.lexsort((label, -size))):
        out[component == label[k]] = number
    return out

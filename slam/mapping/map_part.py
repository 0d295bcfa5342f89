"""One connected part of a map, placed and refined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.bundle.refinement import Bundle
from backend.clocks.picture_clock import PictureClock
from slam.core.control_points import ControlReport
from slam.core.messages import Message
from slam.mapping.calibration.inertial_scale import AccelerometerScale
from slam.mapping.gps.comparison import FixComparison
from slam.mapping.gps.stated_accuracy import Contradiction
from slam.mapping.setup import Setup

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MapPart:
    """One connected part of the map."""

    members: NDArray[np.int64]
    """(m,) its keyframes, sorted."""
    w_T_b: Array
    """(m, 4, 4) refined; placed at least."""
    floor_z_m: float
    georeferenced: bool
    """Whether positions have placed it; else it stands in coordinates of its own."""
    ranged: bool
    """Whether its heights were measured in metres."""
    setup: Setup
    """Inputs of its last refinement, with the fixes and control points that agree with it alone."""
    bundle: Bundle | None = None
    """None where it could not be refined."""
    inertial: AccelerometerScale | None = None
    clock: PictureClock | None = None
    control: ControlReport | None = None
    warnings: tuple[Message, ...] = ()
    remarks: tuple[Message, ...] = ()
    no_scale: tuple[Message, ...] = ()
    """Why no instrument determined its lengths in metres."""
    velocity_left_out: bool = False
    """Whether the accelerometer contradicts the velocity, which tells no lengths then."""
    fixes_left_out: tuple[str, ...] = ()
    """Names of the GPS fixes that contradict the pictures and the other fixes, and are not used."""
    stated_accuracy: tuple[Contradiction, ...] = ()

    def refined_fixes(self, fixes: FixComparison) -> FixComparison:
        """Return the fixes in the datum of the control points, for the estimated antenna."""
        refined = self.bundle
        return fixes if refined is None else fixes.refined(refined.position_offset_m, refined.antenna_m)

    @property
    def metric(self) -> bool:
        """Whether its lengths are metres."""
        refined = self.bundle is not None and self.bundle.scale_std is not None
        return self.ranged or self.georeferenced or refined

    @property
    def height_std_m(self) -> float:
        """Standard deviation of the first keyframe's height over the floor; 0 if unknown."""
        if self.bundle is None:
            return 0.0
        return self.bundle.conditional_scale_std * float(self.bundle.w_T_b[0, 2, 3] - self.bundle.floor_z_m)

"""Motion of the cameras while the rows of their pictures are exposed one after the other.

A row is exposed later than the middle one by a share of the read-out time, and the camera has moved on by
then. It counts as a motion along a straight line at constant velocity, with a constant turn rate. How the
camera of photographs turns is not known. Poses are those of the middle row.

Source: Vautherin et al. 2016, Photogrammetric accuracy and modeling of rolling shutter cameras (ISPRS Annals
III-3): their linear model.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.pose_side_factors import PoseSideFactors
from backend.bundle.projections import residuals

Array = NDArray[np.float64]

READOUT = gtsam.symbol("q", 0)
"""Correction of the read-out time that the pixels have been corrected by: one number in seconds."""
PRIOR_STD_S = 0.04
"""Standard deviation of a read-out time about 0, where nobody states it. The 19 times that OpenDroneMap lists
(``opendm/rollingshutter.py``) are 17 to 74 ms, and 39 ms in the mean of squares. The last row may be exposed
first, as in a picture that the camera has turned."""


@dataclass(frozen=True)
class ExposureMotion:
    """Motion of the cameras, and the read-out time by which pixels of floor points are corrected."""

    f_v: Array
    """(n, 3) velocities in the frame of the pictures, in mean heights per second."""
    f_turn: Array
    """(n, 3) angular velocities in the frame of the pictures, in rad/s; 0 of photographs."""
    is_known: NDArray[np.bool_]
    """(n,) whether the velocity comes from the vehicle, the neighbours, or the frames of a video."""
    own_motion: Array
    """(n, 3) motion from the first row to the last of pictures of unknown velocity, in mean heights, as each
    shows it; 0 of the others. It is no velocity times the read-out time: near a time of 0, such a velocity
    would have no bound, and it tells nothing of the time."""
    rows: int
    """Height of a picture in pixels."""
    readout_s: float
    """Time from the exposure of the first row to that of the last; negative where the last one is first."""
    is_free: bool
    """Whether a correction of this time is a variable."""
    recorded_px: Array
    """(m, 2) pixels of the floor points before this correction."""
    corrected_s: Array
    """(n,) read-out time by which the front end has corrected them already."""
    by_second: Array
    """(m, 3) how far each camera has moved on at the row of a floor point, as that point sees it, for each
    second of the read-out time; 0 for pictures of unknown velocity."""

    def over_rows(self, readout_s: float) -> Array:
        """Return the motion (n, 3) of the cameras from the first row to the last, in mean heights."""
        return np.where(self.is_known[:, None], readout_s * self.f_v, self.own_motion)

    def as_at_once(
        self, keyframe: NDArray[np.int64], track: NDArray[np.int64], f_T_c: Array, point: Array, lens: Array
    ) -> Array:
        """Return the pixels (m, 2) of floor points that a simultaneous exposure would have recorded.

        ``point`` (t, 3) and the poses ``f_T_c`` (n, 4, 4) give the depths, ``lens`` (q,) the calibration.
        """
        pixel = np.ascontiguousarray(self.recorded_px)
        left_s = (self.readout_s - self.corrected_s)[keyframe]
        own = since_middle(pixel, self.rows)[:, None] * self.own_motion[keyframe]
        moved = point[track] - left_s[:, None] * self.by_second - own
        each = np.arange(len(track))
        late = residuals(f_T_c, moved, lens, keyframe, each, pixel)
        return np.asarray(pixel + residuals(f_T_c, point, lens, keyframe, track, pixel) - late)


@dataclass(frozen=True)
class RowShift:
    """How a camera had moved on from its pose when the row of a mark was exposed."""

    moved: Array
    """(3,)."""
    turned: Array
    """(3,) rotation vector."""

    def point_at_once(self, point: Array, place: Array) -> Array:
        """Return the point that looks from the pose, at ``place`` (3,), as ``point`` (3,) looks from the
        row."""
        return np.asarray(point - self.moved - np.cross(self.turned, point - place))


NO_SHIFT = RowShift(np.zeros(3), np.zeros(3))


def row_shifts(
    motion: ExposureMotion | None, keyframe: NDArray[np.int64], pixel: Array
) -> tuple[RowShift, ...]:
    """Return how cameras had moved on from their poses at the rows of recorded pixels (m, 2)."""
    if motion is None:
        return (NO_SHIFT,) * len(keyframe)
    late, moved = since_middle(pixel, motion.rows), motion.over_rows(motion.readout_s)
    turned = motion.readout_s * motion.f_turn
    return tuple(RowShift(t * moved[k], t * turned[k]) for k, t in zip(keyframe.tolist(), late, strict=True))


def since_middle(pixel: Array, rows: int) -> Array:
    """Return the time (m,) from the middle one of the ``rows`` to that of each pixel, over the read-out
    time."""
    return np.asarray(pixel[:, 1] / (rows - 1) - 0.5)


def add_readout(pose_side: PoseSideFactors, motion: ExposureMotion) -> None:
    """Add the prior on a free read-out time: the variable is what corrects that of ``motion``."""
    if motion.is_free:
        model = gtsam.noiseModel.Isotropic.Sigma(1, PRIOR_STD_S)
        prior = gtsam.PriorFactorVector(READOUT, np.array([-motion.readout_s]), model)
        pose_side.add("readout prior", prior)

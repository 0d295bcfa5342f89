"""Scale of a map from barometer or reported velocity, where neither ranges nor positions tell it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.barometer import height_gain, read_and_mapped
from backend.bundle.problem import BundleConfig, ScalePrior
from backend.bundle.refinement import Bundle, refine
from backend.errors import BackendError
from backend.measurements import AlignedPair, BarometerHeight, FloorTracks, Measurements, ReportedMotion
from backend.significance import SIGMAS_OF_SEVERAL
from slam.mapping.front_end import Observations
from slam.mapping.inertial.measurements import tracked_frames
from slam.mapping.part_measurements import part_measurements
from slam.mapping.setup import Setup

Array = NDArray[np.float64]

_MOST_SCALE_STD = 0.3
"""Largest relative deviation of a scale that is worth stating: lengths may else be wrong by two times."""

WRONG_SIGN = ("it falls where the camera climbs", "check its sign (altitude grows upwards)")
"""Cause of heights that contradict the pictures, and what to do."""
_NOT_COVERED = "its readings do not cover the pictures"

OnStep = Callable[[int, float], None]


def scaled_by_heights(
    bundle: Bundle,
    setup: Setup,
    members: NDArray[np.int64],
    tracks: FloorTracks,
    aligned: tuple[AlignedPair, ...],
    on_step: OnStep | None = None,
) -> tuple[Bundle, str]:
    """Refine keyframes ``members`` (m,) again with heights by the barometer, from a ``bundle`` without them.

    ``aligned``: pairs of all keyframes that lines register. Returns the bundle as it was, and the reason, if
    the heights do not tell the scale.
    """

    def measured() -> Measurements:
        return part_measurements(setup, members, tracks, aligned)

    def fault(found: Bundle) -> str:
        if not found.uses_barometer:
            return _NOT_COVERED
        if falls_where_the_camera_climbs(found.optimum.problem.measurements.heights, bundle.w_T_b):
            return "; ".join(WRONG_SIGN)
        return "" if _tells_lengths(found) else "the flight climbs and descends too little for its noise"

    return _scaled(bundle, measured, setup.config.bundle, fault, on_step)


def scaled_by_velocity(
    bundle: Bundle,
    setup: Setup,
    members: NDArray[np.int64],
    tracks: FloorTracks,
    observations: Observations,
    reported: ReportedMotion,
    aligned: tuple[AlignedPair, ...],
    on_step: OnStep | None = None,
    lengths: ScalePrior | None = None,
) -> tuple[Bundle, str]:
    """Refine keyframes ``members`` (m,) again with the reported motion, from the scale of a ``bundle``.

    ``aligned``: pairs of all keyframes that lines register. ``lengths`` by another instrument count beside
    the motion, each by its accuracy. Returns the bundle as it was, and the reason, if the velocity does not
    tell the scale.
    """

    def measured() -> Measurements:
        return replace(
            part_measurements(setup, members, tracks, aligned),
            reported=reported,
            frames=tracked_frames(observations, members, setup.camera),
        )

    def fault(found: Bundle) -> str:
        if not found.uses_reported_motion:
            return _NOT_COVERED
        if damage := found.reported_damage:
            return damage
        return "" if _tells_lengths(found) else "the flight is too short or too slow for its noise"

    return _scaled(bundle, measured, setup.config.bundle, fault, on_step, lengths)


def _scaled(
    bundle: Bundle,
    measured: Callable[[], Measurements],
    config: BundleConfig,
    fault: Callable[[Bundle], str],
    on_step: OnStep | None,
    lengths: ScalePrior | None = None,
) -> tuple[Bundle, str]:
    """Refine again with what an instrument measured, unless it has a ``fault`` or the refinement fails.

    Returns the bundle as it was, and the reason, in these cases.
    """
    try:
        w_T_b, floor_z_m, noise = bundle.w_T_b, bundle.floor_z_m, bundle.noise
        found = refine(measured(), w_T_b, floor_z_m, config, on_step, lengths, noise)
        reason = fault(found)
    except BackendError as error:
        return bundle, f"no solution ({error})"
    return (bundle if reason else found), reason


def _tells_lengths(bundle: Bundle) -> bool:
    return bundle.scale_std is not None and bundle.scale_std < _MOST_SCALE_STD


def falls_where_the_camera_climbs(heights: Sequence[BarometerHeight], w_T_b: Array) -> bool:
    """Return whether heights and those of poses (m, 4, 4) change in opposite senses, not only by chance.

    Source: Fisher 1915, the transformed correlation of n pairs has the variance 1 / (n - 3).
    """
    if len(heights) < 4:
        return False
    read, z = read_and_mapped(heights, w_T_b)
    correlation = height_gain(read, z) * float(z.std()) / max(float(read.std()), 1e-12)
    return bool(np.arctanh(np.clip(correlation, -0.999, 0.999)) * np.sqrt(len(z) - 3) < -SIGMAS_OF_SEVERAL)

"""Scale of a map from barometer or reported velocity, where neither ranges nor positions tell it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.refinement import Bundle, refine
from backend.bundle.reported.verdict import reported_damage
from backend.errors import BackendError
from backend.measurements import FloorTracks, ReportedMotion
from slam.mapping.front_end import Observations
from slam.mapping.inertial.measurements import tracked_frames
from slam.mapping.refine_part import part_measurements
from slam.mapping.setup import Setup

MOST_SCALE_STD = 0.3
"""Largest relative deviation of a scale that is worth stating: lengths may else be wrong by two times."""


def scaled_by_heights(
    bundle: Bundle,
    setup: Setup,
    members: NDArray[np.int64],
    tracks: FloorTracks,
    on_step: Callable[[int, float], None] | None = None,
) -> tuple[Bundle, str]:
    """Refine keyframes ``members`` (m,) again with heights by the barometer, from a ``bundle`` without them.

    Returns the bundle as it was, and the reason, if the heights do not tell the scale.
    """
    try:
        measured = part_measurements(setup, members, tracks)
        config = setup.config.bundle
        found = refine(measured, bundle.w_T_b, bundle.floor_z_m, config, on_step, noise=bundle.noise)
    except BackendError as error:
        return bundle, f"the refinement with barometer0 failed ({error})"
    if not found.uses_barometer:
        return bundle, "its readings do not cover the pictures"
    if found.scale_std is None or not found.scale_std < MOST_SCALE_STD:
        return bundle, "the flight climbs and descends too little for its noise"
    return found, ""


def scaled_by_velocity(
    bundle: Bundle,
    setup: Setup,
    members: NDArray[np.int64],
    tracks: FloorTracks,
    observations: Observations,
    reported: ReportedMotion,
    on_step: Callable[[int, float], None] | None = None,
) -> tuple[Bundle, str]:
    """Refine keyframes ``members`` (m,) again with the reported motion, from a ``bundle`` without it.

    Returns the bundle as it was, and the reason, if the velocity does not tell the scale.
    """
    try:
        measured = replace(
            part_measurements(setup, members, tracks),
            reported=reported,
            frames=tracked_frames(observations, members, setup.camera),
        )
        config = setup.config.bundle
        start, floor_z_m = bundle.w_T_b, bundle.floor_z_m
        found = refine(measured, start, floor_z_m, config, on_step, noise=bundle.noise)
    except BackendError as error:
        return bundle, f"the refinement with velocity0 failed ({error})"
    if found.optimum.problem.reported is None:
        return bundle, "its readings do not cover the pictures"
    if damage := reported_damage(found.optimum):
        return bundle, damage
    if found.scale_std is None or not found.scale_std < MOST_SCALE_STD:
        return bundle, "the flight is too short or too slow for its noise"
    return found, ""

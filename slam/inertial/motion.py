"""Filtered and smoothed motion of a vehicle from its instruments, with the uncertainty of fixed scales."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.ekf.inputs import CloneMode, InitialState, VisualStep
from slam.core.progress import Progress, silent
from slam.inertial.filter_input import FilterInput
from slam.inertial.start_height import START_ROUNDS

if TYPE_CHECKING:
    from backend.ekf.results import States, Track

Array = NDArray[np.float64]


def filter_motion(
    inputs: FilterInput,
    at_s: Array,
    *,
    steps: tuple[VisualStep, ...] = (),
    keep: CloneMode = "none",
    smooth: bool = True,
    progress: Progress = silent,
) -> Track:
    """Return filtered (and smoothed) states at increasing times ``at_s`` (n,).

    The scales of range and velocity are fixed at 1. A further run with each scale one standard deviation
    larger gives an error that the whole flight shares. Its square enters the covariances. Raises
    ``BackendError``.
    """
    from backend.ekf.track import track

    readings = replace(inputs.readings, steps=steps)
    rounds = _rounds(inputs) if smooth else 0
    scaled = _scaled_starts(inputs)

    def run(start: InitialState, number: int) -> Track:
        progress("filter", number, len(scaled) + 1)
        return track(readings, at_s, start, inputs.model, rounds=rounds, clone=keep)

    found = run(inputs.start, 0)
    filtered, smoothed = found.filtered, found.smoothed
    for number, start in enumerate(scaled, start=1):
        other = run(start, number)
        filtered = _with_shared_error(filtered, found.filtered, other.filtered)
        if smoothed is not None and found.smoothed is not None and other.smoothed is not None:
            smoothed = _with_shared_error(smoothed, found.smoothed, other.smoothed)
    return replace(found, filtered=filtered, smoothed=smoothed)


def _rounds(inputs: FilterInput) -> int:
    """Return the number of rounds of the smoother: more where a state is a factor of what is measured."""
    if inputs.adjustments.start or inputs.adjustments.heading:
        return START_ROUNDS
    # A heading by a compass that positions correct is right after the first round.
    return 2 if inputs.readings.w_p_antenna_m is not None else 1


def _scaled_starts(inputs: FilterInput) -> list[InitialState]:
    """Return initial states with one scale each one standard deviation larger."""
    starts = []
    if inputs.range_scale_std > 1e-6:
        starts.append(replace(inputs.start, range_scale=inputs.range_scale_std))
    if inputs.velocity_scale_std > 1e-6:
        std = inputs.velocity_scale_std
        starts += [replace(inputs.start, velocity_scale=scale) for scale in ((std, 0.0), (0.0, std))]
    return starts


def _with_shared_error(states: States, base: States, other: States) -> States:
    """Add the outer product of the difference between two runs to every covariance of ``states``."""
    pose = se3.log(se3.inverse(base.w_T_b) @ other.w_T_b)
    motion = np.column_stack(
        [
            other.w_T_b[:, :3, 3] - base.w_T_b[:, :3, 3],
            other.w_v_m_s - base.w_v_m_s,
            other.w_a_m_s2 - base.w_a_m_s2,
            pose[:, :3],
        ]
    )
    known = np.isfinite(base.clone_T_b + other.clone_T_b).all(axis=(1, 2))
    clone = np.zeros((len(base.clone_T_b), 6))
    clone[known] = se3.log(se3.inverse(base.clone_T_b[known]) @ other.clone_T_b[known])
    return replace(
        states,
        covariances=states.covariances + _outer(pose),
        motion_covariances=states.motion_covariances + _outer(motion),
        clone_T_b_covariances=states.clone_T_b_covariances + _outer(clone),
        fixed_clone_covariances=states.fixed_clone_covariances + _outer(_since_first(base, other)),
    )


def _since_first(base: States, other: States) -> Array:
    """Return the pose error (n, 6) of one run against another with the same first position."""
    aligned = other.w_T_b.copy()
    aligned[:, :3, 3] += base.w_T_b[0, :3, 3] - other.w_T_b[0, :3, 3]
    return se3.log(se3.inverse(base.w_T_b) @ aligned)


def _outer(e: Array) -> Array:
    return np.asarray(np.einsum("na,nb->nab", e, e))

"""Gross disagreement of an instrument with the map: rotations, tilts and displacements are compared.

It finds pictures in another order and a wrong sign, axis or unit, not noise, gains or small delays. The map
of such a flight is consistent in itself, so that only another instrument can reveal the error.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slam.core.messages import Message, about, warning
from slam.mapping.warnings.motions import GYRO, KeyframeSteps, StepMotion

Array = NDArray[np.float64]

LEAST_STEPS = 6
"""Over fewer steps, healthy recorded flights (AR.Drone 2, stretches of its truth) show other lengths too."""
ENOUGH_STEPS = 15
"""Fewer steps must hold as much evidence: a motion larger by the root of what they lack."""
LEAST_TURN_RAD, LEAST_WAY_M = np.radians(1.0), 0.05
"""Root mean square of what the map does in a step: below it, noise hides the instrument's motion."""
ABOVE_NOISE = 2.0
"""Multiple of an attitude's nominal noise: an attitude three times as noisy still correlates."""
ALIKE, AGAINST = 0.5, -0.5
"""Correlations of one motion, and of one with its sign turned."""
FAR = 1.5
"""Gains of flow and sonar are within a fourth."""


def contradictions(steps: KeyframeSteps) -> list[Message]:
    """Return a line for each instrument whose motion differs from the map's in most steps."""
    if len(steps.keyframe) < LEAST_STEPS:
        return []
    lines = [
        line for motion in steps.motions if motion.is_judged_as_whole for line in _lines(motion, steps.metric)
    ]
    return [*_common_cause(lines), *lines]


def _lines(motion: StepMotion, metric: bool) -> list[Message]:
    least = LEAST_WAY_M if motion.is_way else max(LEAST_TURN_RAD, ABOVE_NOISE * motion.noise)
    found = list(_contradictions(motion, least, motion.is_way and metric))
    found = found or (_gain(motion) if motion.who == GYRO else [])
    return [line.named(motion.who).concerning(motion.stream) for line in found]


def _common_cause(lines: list[Message]) -> list[Message]:
    """Doubt the camera where several instruments contradict it: they hardly fail together."""
    streams = list(dict.fromkeys(line.about for line in lines))
    if len(streams) < 2:
        return []
    return [
        about(
            "cam0",
            f"{' and '.join(streams)} contradict the pictures",
            "check first which way the camera is mounted (T_BS), its intrinsics, and whether its pictures "
            "are mirrored, turned or in another order",
        )
    ]


def _gain(motion: StepMotion) -> list[Message]:
    """Describe turns (n, 3) by a sensor that are in proportion to the map's, but of another size.

    The proportion is by least squares, to which a bias of the sensor adds nothing.
    """
    known = np.isfinite(motion.read).all(axis=1)
    read, made = motion.read[known], motion.made[known]
    if len(read) < ENOUGH_STEPS or np.sqrt(np.mean((made**2).sum(axis=1))) < LEAST_TURN_RAD:
        return []
    times = float((read * made).sum() / (made**2).sum())
    if 1 / FAR < times < FAR:
        return []
    return [
        warning(
            f"turns {times:.2g} times as far as the pictures show",
            "check its unit (rad/s, not deg/s) and focal length and distortion of cam0",
        )
    ]


def _contradictions(motion: StepMotion, least: float, by_length: bool) -> Iterator[Message]:
    """Compare the readings of each step with the map's, both (n, c), and describe a contradiction."""
    known = np.isfinite(motion.read).all(axis=1)
    read, made = motion.read[known], motion.made[known]
    if len(read) < LEAST_STEPS:
        return
    least *= np.sqrt(max(1.0, ENOUGH_STEPS / len(read)))
    if np.sqrt(np.mean((made**2).sum(axis=1))) < least:
        return
    of_read, of_made = float((read**2).sum()), float((made**2).sum())
    if of_read == 0.0:
        yield warning("reads no motion while the pictures show some", "check whether the sensor is stuck")
        return
    alike = float((read * made).sum()) / np.sqrt(of_read * of_made)
    further = np.sqrt(of_made / of_read)
    if alike < AGAINST:
        yield warning(
            f"opposite in sign to the motion seen in the pictures (correlation {alike:.2f})",
            "check the axis signs in docs/flight-format.md",
        )
    elif alike < ALIKE:
        yield warning(
            f"does not match the motion seen in the pictures (correlation {alike:.2f})",
            "check stamps, signs and axes, the order of the pictures, and whether one camera at one "
            "zoom took them all",
        )
    elif by_length and (further > FAR or (further < 1 / FAR and not motion.by_acceleration)):
        yield warning(
            f"the path on the map is {further:.2g} times as long as this sensor says",
            "check its unit, the focal length of cam0 (and its zoom), and whether the height sensor is "
            "stuck or in another unit",
        )

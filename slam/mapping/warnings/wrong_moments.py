"""Pictures that were not taken when their stamps say, or by another camera: two instruments contradict the
map in the same steps.

The map of such pictures is consistent in itself, so that its covariances are small; but at the times of
their stamps the vehicle was elsewhere. Those of another camera or zoom show it at another height. So do those
of a floor that repeats, matched with another place.

One instrument alone may fail for a moment, which is no harm. But where such moments are all that it has
against the map, its other steps show that it is no wrong instrument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.robust import NORMAL
from slam.core.messages import Message, about
from slam.core.names import enumerated
from slam.mapping.warnings.contradictions import contradictions
from slam.mapping.warnings.motions import KeyframeSteps, StepMotion

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GATE_SIGMAS = 6.0
"""Deviations of a step that count, in each of two instruments. Steps of healthy simulated flights reach 1,
those of the recorded ``ardrone2-hybrid`` 2; pictures of another moment make more than 20."""
GAIN_ERROR = 0.25
"""Share of a step that a gain or a tilt may be wrong by: those of flow and sonar are within a fourth."""
MOST_SINGLE = 0.1
"""Largest share of the steps that count as single ones. An instrument that contradicts more is doubted as a
whole."""
LEAST_STEPS = 10
"""Fewer steps do not tell the noise of an instrument."""


def motion_warnings(steps: KeyframeSteps, names: Sequence[str]) -> list[Message]:
    """Report instruments that contradict the map as a whole, or else single steps; ``names`` (k,) are those
    of the keyframes."""
    by_two = WrongMoments.of(steps)
    as_a_whole = contradictions(by_two.others)
    if not as_a_whole:
        return by_two.lines(names)
    by_one = replace(by_two, witnesses=1)
    are_single = by_one.wrong.mean() <= MOST_SINGLE and not contradictions(by_one.others)
    return by_one.lines(names) if are_single else as_a_whole


@dataclass(frozen=True)
class WrongMoments:
    """Steps that instruments contradict."""

    steps: KeyframeSteps
    off: Mapping[str, Mask]
    """(n,) the steps that each instrument contradicts."""
    witnesses: int = 2
    """Number of instruments that must contradict a step."""

    @staticmethod
    def of(steps: KeyframeSteps) -> WrongMoments:
        """Compare each step with the instruments."""
        off: dict[str, Mask] = {}
        for motion in steps.motions:
            beyond = deviations(motion) > GATE_SIGMAS
            if motion.by_acceleration:  # the step before has a part in it
                beyond[:-1] |= beyond[1:]
            off[motion.stream] = off.get(motion.stream, np.zeros_like(beyond)) | beyond
        return WrongMoments(steps, off)

    @property
    def wrong(self) -> Mask:
        """(n,) the steps that enough instruments contradict."""
        count = np.zeros(len(self.steps.keyframe), dtype=np.int64)
        for mask in self.off.values():
            count += mask
        return np.asarray(count >= self.witnesses)

    @property
    def others(self) -> KeyframeSteps:
        """The steps that are not wrong, and not right after a wrong one, which has a part in their
        accelerations."""
        wrong = self.wrong
        wrong[1:] |= wrong[:-1].copy()
        return self.steps.only(~wrong)

    def lines(self, names: Sequence[str]) -> list[Message]:
        """Return a line for each run of wrong steps; ``names`` (k,) are those of the keyframes."""
        wrong = np.flatnonzero(self.wrong)
        # Between two pictures of wrong times, a step may look right by chance.
        runs = np.split(wrong, np.flatnonzero(np.diff(wrong) > 2) + 1) if len(wrong) else []
        return [self._line(names, run) for run in runs]

    def _line(self, names: Sequence[str], run: NDArray[np.int64]) -> Message:
        first, last = self.steps.keyframe[run[0], 0], self.steps.keyframe[run[-1], 1]
        streams = [stream for stream, mask in self.off.items() if mask[run].any()]
        lost = "the instruments lost readings together" if len(streams) > 1 else f"{streams[0]} fails there"
        return about(
            "cam0",
            f"from {names[first]} to {names[last]} the map moves otherwise than {enumerated(streams)}: "
            "pictures there are in another order, were not taken when their stamps say, are of another "
            f"camera or zoom, or match another place of a floor that repeats, unless {lost}",
            "such pictures may bend the whole map: correct their stamps or leave them out, and run again",
        )


def deviations(motion: StepMotion) -> Array:
    """Return (n,) by how many standard deviations each step differs from the map's; 0 without a reading.

    The noise is that of most steps. It is larger in longer ones, in proportion at most: errors of a velocity
    last, and an attitude drifts. A common gain and a bias are taken out.
    """
    known: Mask = np.asarray(np.isfinite(motion.read).all(axis=1))
    found = np.zeros(len(known))
    read, made = motion.read[known], motion.made[known]
    if len(read) < LEAST_STEPS:
        return found
    gain = _gain(read, made) if motion.gain is None else motion.gain
    off = read - gain * made
    off -= np.median(off, axis=0)
    longer = np.maximum(motion.lasts_s[known] / np.median(motion.lasts_s[known]), 1.0)
    spread = NORMAL * np.median(np.abs(off), axis=0) * longer[:, None]
    spread = np.maximum(spread, max(motion.noise, 1e-9))
    allowed = GAIN_ERROR * np.linalg.norm(read, axis=1, keepdims=True)
    found[known] = (np.maximum(np.abs(off) - allowed, 0.0) / spread).max(axis=1)
    return found


def _gain(read: Array, made: Array) -> float:
    """Return the factor of a reading (n, c) on the map's motion: the median over the steps, by their size.

    No single step counts more than many others do.
    """
    size = np.linalg.norm(made, axis=1)
    ratio = (read * made).sum(axis=1) / np.maximum(size**2, 1e-300)
    order = np.argsort(ratio)
    weight = np.cumsum(np.minimum(size, np.quantile(size, 1 - MOST_SINGLE))[order])
    return float(ratio[order][np.searchsorted(weight, 0.5 * weight[-1])])

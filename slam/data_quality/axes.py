"""Wrong axes: readings that are another axis than their own, or have a turned sign.

A whitened comparison takes its noise from its own scatter, and readings of a wrong axis scatter. Here every
assignment of axes and signs is tried. The changes of the reading over half a second, with the assignment
undone, are correlated with those of the imu's integral.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.data_quality.finding import Remark, flights_to_name
from slam.data_quality.inertial_comparison import (
    FEWEST,
    IntegralComparison,
    comparisons,
    into_world,
    moments_of,
    near_floor,
)

Array = NDArray[np.float64]

CERTAIN_Z = 5.0
"""Standard deviations by which another assignment must agree better than the right one."""
WAYS = {
    "attitude": ("roll", "pitch", "yaw"),
    "velocity": ("velocity ahead", "velocity to the left"),
    "height": ("height",),
}
INTEGRAL = {"attitude": "gyro", "velocity": "accelerometer", "height": "accelerometer"}

IN_WORLD = "velocity has axes that do not turn with the vehicle, as the accelerometer shows"


@dataclass(frozen=True)
class Assignment:
    """Axes and signs of a reading: component k of the motion is ``sign[k]`` times component ``axis[k]`` of
    it."""

    axis: tuple[int, ...]
    sign: tuple[float, ...]
    in_world: bool = False
    """Whether the axes of a horizontal reading stay where they are when the vehicle turns."""


def wrong_axes(flight: Flight, kinds: Collection[str] = tuple(WAYS)) -> tuple[list[Remark], list[str]]:
    """Return the readings that are another axis than their own, and describe those of which the flight cannot
    show whether they are."""
    wrong, unknown = [], []
    for kind, seen in comparisons(flight):
        if kind not in kinds:
            continue
        ways = WAYS[kind]
        scores = _scores(seen, near_floor(flight), len(ways))
        if not scores:
            continue
        right = Assignment(tuple(range(len(ways))), (1.0,) * len(ways))
        best = max(scores, key=lambda a: scores[a])
        if scores[best] - max(scores[right], 0.0) > CERTAIN_Z:
            words = [_words(kind, k, best) for k in range(len(ways)) if _differs(best, k)]
            words = [IN_WORLD] if best.in_world else words
            wrong += [Remark(text, channel=kind) for text in words]
            if kind == "attitude":
                break  # the other integrals go by the attitude
            continue
        for k, way in enumerate(ways):
            turned = Assignment(right.axis, tuple(-1.0 if j == k else 1.0 for j in range(len(ways))))
            if scores[right] - scores[turned] < CERTAIN_Z:
                unknown.append(f"whether {way} measures along its own axis")
    return wrong, unknown


def axes_of_all(flights: Sequence[Flight]) -> tuple[list[Remark], list[str]]:
    """Return the wrong axes of all flights, and descriptions of axes that none of them shows."""
    each = [wrong_axes(flight) for flight in flights]
    names = flights_to_name([flight.name for flight in flights])
    wrong = [replace(found, flight=n) for n, (faults, _) in zip(names, each, strict=True) for found in faults]
    hidden = [set(unknown) for _, unknown in each]
    return wrong, sorted(set.intersection(*hidden)) if hidden else []


def _differs(assignment: Assignment, k: int) -> bool:
    return assignment.axis[k] != k or assignment.sign[k] < 0.0


def _words(kind: str, k: int, found: Assignment) -> str:
    """Describe what component k of the motion reads as."""
    read, turned = WAYS[kind][found.axis[k]], " with its sign turned over" if found.sign[k] < 0.0 else ""
    if found.axis[k] == k:
        return f"{read} disagrees with the {INTEGRAL[kind]}, but agrees{turned}"
    return f"{read} reads the {WAYS[kind][k]} that the {INTEGRAL[kind]} gives{turned}"


def _scores(seen: IntegralComparison, low_s: Array, count: int) -> dict[Assignment, float]:
    """Return the agreement of every assignment with the integral, in standard deviations of no agreement."""
    moments = moments_of(seen.stamps_s, low_s)
    kept = moments.together(seen.order)
    if kept.sum() < FEWEST:
        return {}

    def changes(signal: Array) -> Array:
        step = np.diff(moments.means(signal), n=seen.order, axis=0)[kept]
        # Single jumps of a reading are no motion.
        return np.asarray(np.clip(step, *np.quantile(step, [0.01, 0.99], axis=0)))

    moved, own = changes(seen.integral), _rotated(seen.read, -seen.yaw)
    # Neighbouring changes share a moment: they count as half.
    rows = float(np.sqrt(kept.sum() / 2.0 / count))
    scores = {}
    for assignment in _assignments(count):
        read = own[:, list(assignment.axis)] * np.array(assignment.sign)
        turned = read if assignment.in_world else _rotated(read, seen.yaw)
        correlation = _correlation(changes(turned), moved)
        scores[assignment] = rows * float(np.sum(np.arctanh(np.clip(correlation, -0.99999, 0.99999))))
    return scores


def _assignments(count: int) -> Iterator[Assignment]:
    for axis in permutations(range(count)):
        for sign in product((1.0, -1.0), repeat=count):
            yield Assignment(axis, sign)
            if count == 2:
                yield Assignment(axis, sign, in_world=True)


def _rotated(values: Array, yaw: Array) -> Array:
    """Return horizontal values (n, 2) rotated by yaw angles (n,); others as they are."""
    return into_world(yaw, values) if values.shape[1] == 2 else values


def _correlation(a: Array, b: Array) -> Array:
    """Return (components,) correlations of the columns of two tables."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    norms = np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    return np.asarray((a * b).sum(axis=0) / np.maximum(norms, 1e-12))

"""Velocity, range or barometer in another unit, or with another zero from some time on.

The filter accepts both where nothing else measures the same: it attributes the difference to tilt and
accelerometer. Within a second or two, gyro and accelerometer alone determine how velocity and height change.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.clocks.delay_residuals import turn_costs
from backend.clocks.gap_steps import LONGEST_LAG_S
from backend.significance import SURE_SIGMAS
from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.core.stream_anomalies import stuck_ranges
from slam.core.streams import STREAMS
from slam.inertial.imu_motion import (
    COMPARED,
    STEP_S,
    ImuMotion,
    changes_against,
    delay_grid,
    readings_in_world,
)
from slam.inertial.velocity_check import LARGEST_GAIN
from slam.inertial.zero_velocity import still_times

Array = NDArray[np.float64]

_SIDE_S, _EVERY_S, _LEAST_READINGS = 1.0, 0.1, 4
"""Time on each side of a step over which a level is fitted, distance of the times tried, and fewest readings
of a side. A parabola follows what the IMU's own errors add up to meanwhile."""
_MOST_LEFT = 0.4
"""Largest share of the squared misfit that a step may leave of a window's parabola."""
_FAR: Mapping[str, float] = {"velocity": 8.0, "sonar": 20.0}
"""Stream -> size of a step in median steps. Steps that explain as much of their window have up to 5 in the
velocity of healthy measured flights, and up to 13 in their ranges; one of 0.5 m/s has 12, one of 0.4 m 33. A
barometer is left out: gusts look like steps, and its zero is free to walk."""
_UNIT_OF = {"velocity": "m/s", "sonar": "m"}


def level_contradictions(flight: Flight, motion: ImuMotion) -> list[Message]:
    """Return a line for each stream whose level steps, or whose changes have another size, while the motion
    by its IMU shows otherwise."""
    streams = [name for name in COMPARED if getattr(flight, name) is not None]
    lines = [line for name in streams for line in _lines(flight, name, motion)]
    stuck = _stuck_in_flight(flight)
    return [*lines, stuck] if stuck else lines


def _stuck_in_flight(flight: Flight) -> Message | None:
    """Describe ranges that repeat while the vehicle does not stand; None where they do not."""
    sonar, rest_s = flight.sonar, still_times(flight)
    if sonar is None:
        return None
    edges_s = np.concatenate([[-np.inf], rest_s, [np.inf]])
    after = np.searchsorted(edges_s, sonar.stamps_s, side="right").clip(1, len(edges_s) - 1)
    from_rest_s = np.minimum(sonar.stamps_s - edges_s[after - 1], edges_s[after] - sonar.stamps_s)
    flies = from_rest_s > _SIDE_S
    return stuck_ranges(replace(sonar, stamps_s=sonar.stamps_s[flies], range_m=sonar.range_m[flies]))


def _lines(flight: Flight, name: str, motion: ImuMotion) -> Iterator[Message]:
    folder = STREAMS[name].folder
    stepped = _step(*_beside(flight, name, motion), _FAR[name]) if name in _FAR else None
    if stepped is not None:
        at_s, size = stepped
        yield warning(
            f"{folder} steps by {size:.2g} {_UNIT_OF[name]} at {at_s:.1f} s and stays there, while imu0 "
            "shows no such motion: the readings before or after it are wrong",
            "check its zero and unit",
        )
    ratio = None if name == "velocity" else _ratio(flight, name, motion)  # `velocity_contradiction` does it
    if ratio is not None and not 1 / LARGEST_GAIN < ratio < LARGEST_GAIN:
        yield warning(
            f"{folder} changes by {ratio:.2g} times what imu0 shows (unit?): heights are not to be trusted",
            f"check the unit and sign of {folder}",
        )


def _beside(flight: Flight, name: str, motion: ImuMotion) -> tuple[Array, Array]:
    """Return stamps (n,), and by how much readings (n, c) differ from the motion by the IMU."""
    stamps_s, values, axes = readings_in_world(flight, name, motion)
    moved = motion.w_v_m_s[:, axes]
    if name != "velocity":
        # What it moves within a gap of the IMU is unknown.
        moved = np.cumsum(moved * np.minimum(np.gradient(motion.at_s), STEP_S)[:, None], axis=0)
    inside = (stamps_s >= motion.at_s[0]) & (stamps_s <= motion.at_s[-1])
    stamps_s, values = stamps_s[inside], values[inside]
    return stamps_s, values - np.column_stack([np.interp(stamps_s, motion.at_s, m) for m in moved.T])


def _step(stamps_s: Array, values: Array, far: float) -> tuple[float, float] | None:
    """Return time and size of the largest step that lasts; None without one.

    Steps that cancel each other, as over an obstacle, are none.
    """
    tried = _tried_steps(stamps_s, values)
    if len(tried) == 0:
        return None
    at_s, left, steps = tried[:, 0], tried[:, 1], tried[:, 2:]
    size = np.linalg.norm(steps, axis=1)
    shown = (left < _MOST_LEFT) & (size > far * np.median(size))
    total, largest = np.zeros(steps.shape[1]), None
    while shown.any():
        best = int(np.where(shown, size, 0.0).argmax())
        largest = best if largest is None else largest
        total += steps[best]
        shown &= np.abs(at_s - at_s[best]) > 2 * _SIDE_S
    if largest is None or np.linalg.norm(total) < 0.5 * size[largest]:
        return None
    return float(at_s[largest]), float(size[largest])


def _tried_steps(stamps_s: Array, values: Array) -> Array:
    """Return for each time tried itself, the share of the squared misfit that a step leaves, and the step."""
    if len(stamps_s) < 2 * _LEAST_READINGS:
        return np.empty((0, 3))
    rows = []
    for at_s in np.arange(stamps_s[0] + _SIDE_S, stamps_s[-1] - _SIDE_S, _EVERY_S).tolist():
        first, middle, last = np.searchsorted(stamps_s, [at_s - _SIDE_S, at_s, at_s + _SIDE_S]).tolist()
        if min(middle - first, last - middle) < _LEAST_READINGS:
            continue
        since_s, read = stamps_s[first:last] - at_s, values[first:last]
        terms = np.column_stack([np.ones(last - first), since_s, since_s**2, since_s >= 0])
        misfit = []
        for some in (terms[:, :3], terms):
            fitted = np.linalg.lstsq(some, read, rcond=None)[0]
            misfit.append(float(((read - some @ fitted) ** 2).sum()))
        rows.append([at_s, misfit[1] / max(misfit[0], 1e-300), *fitted[3].tolist()])
    return np.array(rows) if rows else np.empty((0, 3))


def _ratio(flight: Flight, name: str, motion: ImuMotion) -> float | None:
    """Return how many times as large the changes of a stream are as those by the IMU; None where chance
    explains what they have in common."""
    residuals = changes_against(flight, name, motion, delay_grid(LONGEST_LAG_S))
    if residuals is None:
        return None
    best = int(turn_costs(residuals.squares).sum(axis=0).argmin())
    read = residuals.change
    made = read - residuals.difference[:, best]
    size, of_made = float((read**2).sum()), float((made**2).sum())
    product = float((read * made).sum())
    if product**2 < SURE_SIGMAS**2 * size * of_made * 2 / len(read):
        return None
    # Noise of either makes one of the two ratios too far from 1.
    ratios = sorted((product / of_made, float(np.sqrt(size / of_made)) * float(np.sign(product))), key=abs)
    return ratios[0] if abs(ratios[0]) > 1 else ratios[1]

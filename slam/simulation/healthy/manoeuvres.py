"""Safe manoeuvres of some seconds each, for the next flight and for simulated healthy flights.

Each is a list of sticks held for a time: (seconds, forward, left, up, yaw). Every one comes back to a hover.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slam.simulation.stick import Stick

Array = NDArray[np.float64]
StickSegment = tuple[float, float, float, float, float]

REST: StickSegment = (1.0, 0.0, 0.0, 0.0, 0.0)


def _pulse(size: float, time: float, coast: float, axis: int = 1) -> tuple[StickSegment, ...]:
    out, back = [0.0] * 5, [0.0] * 5
    out[0], out[axis] = time, size
    back[0], back[axis] = time, -size
    rest = (coast, 0.0, 0.0, 0.0, 0.0)
    return ((*out,), rest, (*back,), rest)  # type: ignore[return-value]


def _turned(legs: Sequence[StickSegment], turn_s: float) -> tuple[StickSegment, ...]:
    """Return the legs, a turn on the spot at half stick, and the legs again."""
    return (*legs, (turn_s, 0.0, 0.0, 0.0, 0.5), REST, *legs)


MANOEUVRES: dict[str, tuple[StickSegment, ...]] = {
    "hover for 8 s": ((8.0, 0.0, 0.0, 0.0, 0.0),),
    "short pulses of 0.2 s forward at half stick": _pulse(0.5, 0.2, 1.0) * 3,
    "short pulses of 0.2 s to the side at half stick": _pulse(0.5, 0.2, 1.0, 2) * 3,
    "pulse of 1 s forward at 0.25 and coast": _pulse(0.25, 1.0, 3.0),
    "pulse of 1 s to the side at 0.25 and coast": _pulse(0.25, 1.0, 3.0, 2),
    "pulse of 2 s forward at 0.1 and coast": _pulse(0.1, 2.0, 3.0),
    "steps of 0.25 to 0.10 and 0.25 to -0.15": (
        (1.5, 0.25, 0.0, 0.0, 0.0),
        (1.5, 0.10, 0.0, 0.0, 0.0),
        (1.0, 0.25, 0.0, 0.0, 0.0),
        (2.0, -0.15, 0.0, 0.0, 0.0),
        (1.0, -0.3, 0.0, 0.0, 0.0),
        (1.5, 0.05, 0.0, 0.0, 0.0),
        REST,
    ),
    "the same steps to the side": (
        (1.5, 0.0, 0.25, 0.0, 0.0),
        (1.5, 0.0, 0.10, 0.0, 0.0),
        (1.0, 0.0, 0.25, 0.0, 0.0),
        (2.0, 0.0, -0.15, 0.0, 0.0),
        (1.0, 0.0, -0.3, 0.0, 0.0),
        (1.5, 0.0, 0.05, 0.0, 0.0),
        REST,
    ),
    "reversing forward at 0.2": (
        (1.5, 0.2, 0.0, 0.0, 0.0),
        (3.0, -0.2, 0.0, 0.0, 0.0),
        (1.5, 0.2, 0.0, 0.0, 0.0),
    ),
    "reversing to the side at 0.2": (
        (1.5, 0.0, 0.2, 0.0, 0.0),
        (3.0, 0.0, -0.2, 0.0, 0.0),
        (1.5, 0.0, 0.2, 0.0, 0.0),
    ),
    "three speeds forward: 0.1, 0.2, 0.4": (
        *_pulse(0.1, 2.0, 0.5),
        *_pulse(0.2, 2.0, 0.5),
        *_pulse(0.4, 2.0, 0.5),
    ),
    "three speeds to the side: 0.1, 0.2, 0.4": (
        *_pulse(0.1, 2.0, 0.5, 2),
        *_pulse(0.2, 2.0, 0.5, 2),
        *_pulse(0.4, 2.0, 0.5, 2),
    ),
    "full stick forward for 0.5 s": _pulse(1.0, 0.5, 2.0),
    "0.6 and 0.9 of the stick forward for 0.6 s": (*_pulse(0.6, 0.6, 1.5), *_pulse(0.9, 0.6, 1.5)),
    "turn by 180 deg and hover": ((4.19, 0.0, 0.0, 0.0, 0.5), (6.0, 0.0, 0.0, 0.0, 0.0)),
    "turn by 180 deg between pulses forward": _turned(_pulse(0.2, 1.0, 1.0), 4.19),
    "turn by 90 deg between pulses forward": _turned(_pulse(0.2, 1.0, 1.0), 2.09),
    "full turn at half stick and back": ((8.38, 0.0, 0.0, 0.0, 0.5), REST, (8.38, 0.0, 0.0, 0.0, -0.5)),
    "yaw steps at 0.3, 0.6 and 1": (
        *_pulse(0.3, 1.5, 0.7, 4),
        *_pulse(0.6, 1.5, 0.7, 4),
        *_pulse(1.0, 1.5, 0.7, 4),
    ),
    "yaw on the spot while climbing": ((2.0, 0.0, 0.0, 0.3, 0.5), (2.0, 0.0, 0.0, -0.3, 0.5), REST),
    "climb and descend by 0.6 m": _pulse(0.6, 1.0, 1.0, 3),
    "brisk climb steps at full stick": _pulse(1.0, 0.5, 0.5, 3) * 2,
    "up to 2 m, hover, and back": (
        (2.0, 0.0, 0.0, 0.5, 0.0),
        (4.0, 0.0, 0.0, 0.0, 0.0),
        (2.0, 0.0, 0.0, -0.5, 0.0),
    ),
    "pulses forward at two heights": (
        *_pulse(0.25, 0.8, 0.8),
        (2.0, 0.0, 0.0, 0.5, 0.0),
        *_pulse(0.25, 0.8, 0.8),
        (2.0, 0.0, 0.0, -0.5, 0.0),
    ),
    "slow descent to 0.3 m and back": (
        (3.5, 0.0, 0.0, -0.2, 0.0),
        (2.0, 0.0, 0.0, 0.0, 0.0),
        (3.5, 0.0, 0.0, 0.2, 0.0),
    ),
    "touch the floor, stand for 3 s and rise again": (
        (2.5, 0.0, 0.0, -0.6, 0.0),
        (3.0, 0.0, 0.0, -0.1, 0.0),
        (1.6, 0.0, 0.0, 0.6, 0.0),
        REST,
    ),
    "tilts of 15 deg to all four sides": (*_pulse(0.5, 0.4, 1.0), *_pulse(0.5, 0.4, 1.0, 2)),
    "the same track there and back": (
        (1.5, 0.25, 0.0, 0.0, 0.0),
        (1.0, -0.25, 0.0, 0.0, 0.0),
        (1.5, -0.25, 0.0, 0.0, 0.0),
        (1.0, 0.25, 0.0, 0.0, 0.0),
        REST,
    ),
    "square of four sides": (
        *_pulse(0.2, 1.0, 0.8)[:3],
        *_pulse(0.2, 1.0, 0.8, 2)[:3],
        *_pulse(-0.2, 1.0, 0.8)[:3],
        *_pulse(-0.2, 1.0, 0.8, 2)[:3],
    ),
    "the same pulses early and late, half a minute apart": (
        *_pulse(0.3, 0.8, 1.0),
        (30.0, 0.0, 0.0, 0.0, 0.0),
        *_pulse(0.3, 0.8, 1.0),
    ),
}
"""Name -> stick segments."""


def stick_for(names: Sequence[str], rest_s: float = 1.0) -> Stick:
    """Return the manoeuvres one after the other, with a rest of ``rest_s`` seconds before and of 1 s
    after."""
    rows = [(rest_s, 0.0, 0.0, 0.0, 0.0), *(row for name in names for row in MANOEUVRES[name]), REST]
    table = np.array(rows)
    begin = np.concatenate([[0.0], np.cumsum(table[:, 0])])
    return Stick(begin[:-1], table[:, 1:], float(begin[-1]))

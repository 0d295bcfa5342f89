"""Handheld motions, without a pilot: a person carries the vehicle over a floor that its flow can see.

Each is a list of places, level or tilted, with a rest at each: (seconds on the way; roll, pitch, yaw in
degrees; x, y, height in m). None is lower than half a metre: nearer the floor no instrument is judged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly

from slam.simulation.motion import State

Array = NDArray[np.float64]
Place = tuple[float, float, float, float, float, float, float]

REST_S = 2.0
_LEVEL: Place = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def _tilted(roll: float, pitch: float) -> Place:
    return (1.5, roll, pitch, 0.0, 0.0, 0.0, 1.0)


def _turned(yaw: float) -> Place:
    return (2.0, 0.0, 0.0, yaw, 0.0, 0.0, 1.0)


def _at(seconds: float, x: float, y: float, height: float) -> Place:
    return (seconds, 0.0, 0.0, 0.0, x, y, height)


HANDHELD_MOTIONS: dict[str, tuple[Place, ...]] = {
    "hold it in the hand 1 m over the floor, level and tilted by 40 deg to all four sides": (
        _tilted(40.0, 0.0), _LEVEL, _tilted(-40.0, 0.0), _LEVEL, _tilted(0.0, 40.0), _LEVEL,
        _tilted(0.0, -40.0), _LEVEL,
    ),
    "hold it level in the hand and turn it by 90 deg four times and back": tuple(
        _turned(yaw) for yaw in (90.0, 180.0, 270.0, 360.0, 270.0, 180.0, 90.0, 0.0)
    ),
    "lift it in the hand from 0.6 to 2 m and lower it again, briskly": (
        _at(1.0, 0.0, 0.0, 0.6), *(_at(0.8, 0.0, 0.0, z) for z in (2.0, 0.6, 2.0, 0.6)), _LEVEL,
    ),
    "move it level in the hand by 1.5 m to and fro, ahead and to the side, at 0.6 and 1.8 m": (
        _at(1.0, 0.0, 0.0, 0.6), _at(1.0, 1.5, 0.0, 0.6), _at(1.0, 0.0, 0.0, 0.6), _at(1.0, 0.0, 1.5, 0.6),
        _at(1.0, 0.0, 0.0, 0.6), _at(2.0, 0.0, 0.0, 1.8), _at(1.0, 1.5, 0.0, 1.8), _at(1.0, 0.0, 0.0, 1.8),
        _at(1.0, 0.0, 1.5, 1.8), _at(1.0, 0.0, 0.0, 1.8),
    ),
}  # fmt: skip
"""Instruction to a person -> places."""


@dataclass(frozen=True)
class HandheldMotion:
    """One of these motions, once or several times over, with continuous acceleration."""

    path: BPoly
    """Polynomial of (roll, pitch, yaw, x, y, z) in rad and m."""
    duration_s: float

    def at(self, stamps_s: Array) -> State:
        """Return the state at any times (n,)."""
        t = np.clip(stamps_s, 0.0, self.duration_s)
        (angles, place), (rates, speed) = (np.split(self.path(t, order), [3], axis=1) for order in range(2))
        (sr, cr), (sp, cp) = ((np.sin(a), np.cos(a)) for a in angles[:, :2].T)
        roll, pitch, yaw = rates.T
        body = np.column_stack([roll - yaw * sp, pitch * cr + yaw * sr * cp, -pitch * sr + yaw * cr * cp])
        return State(np.asarray(stamps_s), place, speed, self.path(t, 2)[:, 3:], angles, body)


def handheld_motion(name: str, times: int = 1) -> HandheldMotion:
    """Return the motion of a name, ``times`` over, with a rest before."""
    table = np.array([_LEVEL, *HANDHELD_MOTIONS[name] * times])
    table[:, 1:4] = np.radians(table[:, 1:4])
    arrived = np.cumsum(table[:, 0] + REST_S)
    nodes = np.column_stack([arrived - REST_S, arrived]).ravel()
    still = np.zeros((2 * len(table), 3, 6))
    still[:, 0] = np.repeat(table[:, 1:], 2, axis=0)
    return HandheldMotion(BPoly.from_derivatives(nodes - nodes[0], still), float(nodes[-1] - nodes[0]))

"""Objects that move over the floor: low drums on straight tracks that turn back at its border."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.simulation.place.obstacles import COS, SIN, Pylon, X, Y, prisms

Array = NDArray[np.float64]

RADIUS_M = (0.16, 0.26)
"""Seen from 0.8 m height, such a drum fills a tenth to a quarter of the picture."""
HEIGHT_M = (0.05, 0.15)
SPEED_M_S = (0.1, 0.6)


class MovingObjects:
    """Drums and their tracks, drawn at random from ``rng``."""

    def __init__(
        self, count: int, extent_m: tuple[float, float, float, float], rng: np.random.Generator
    ) -> None:
        low, high = np.array(extent_m[:2]), np.array(extent_m[2:])
        drums = [Pylon((0.0, 0.0), rng.uniform(*RADIUS_M), rng.uniform(*HEIGHT_M)) for _ in range(count)]
        course, speed = rng.uniform(0, 2 * np.pi, count), rng.uniform(*SPEED_M_S, count)
        self.prisms = prisms(drums)
        """(count, 11) prisms of the drums, all at the origin."""
        self.prisms[:, COS], self.prisms[:, SIN] = np.cos(course), np.sin(course)
        self._low, self._side = low, high - low
        self._start = rng.uniform(0, self._side, (count, 2))
        self._velocity = (speed * [np.cos(course), np.sin(course)]).T

    def at(self, time_s: float) -> Array:
        """Return the prisms (count, 11) of the drums at one time."""
        distance = (self._start + time_s * self._velocity) % (2 * self._side)
        moved = self.prisms.copy()
        moved[:, [X, Y]] = self._low + np.where(distance < self._side, distance, 2 * self._side - distance)
        return moved

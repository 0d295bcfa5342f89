"""Drift of the motion that instruments tell, from the displacements that pictures show.

Integrated readings depart from the true motion by a velocity and by an acceleration that change slowly. A
Kalman filter estimates both while lines are followed. It knows how far the next picture may lie from its
prediction, also behind pictures that show no motion along their lines or cannot be used.

Source: Bar-Shalom, Li and Kirubarajan 2001, section 6.2.3 (discretised Wiener process acceleration);
Roumeliotis and Burdick 2002 (stochastic cloning, for displacements relative to an earlier picture).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_AXES = 2
_KEYFRAME, _BEFORE, _NOW, _SPEED, _ACCELERATION = range(5)
"""Blocks of the state along each axis: departures of the last keyframe, of the picture before and of this
picture, and their rates."""
_SIZE = 5


@dataclass(frozen=True)
class DriftModel:
    """How the motion by instruments departs from the true one, along each axis of the floor."""

    speed_std_m_s: float
    """Standard deviation of the velocity's error at the start."""
    acceleration_std_m_s2: float
    """Standard deviation of the acceleration's error."""
    acceleration_walk: float
    """Random walk of that error [m/s² per root second]."""
    place_std_m: float
    """Standard deviation of the place of a picture on the floor by errors of tilt and height that change from
    one picture to the next."""


@dataclass(frozen=True)
class Displacement:
    """A displacement over the floor with its covariance."""

    moved_m: Array
    """(2,)."""
    covariance: Array
    """(2, 2)."""


@dataclass(frozen=True)
class Drift:
    """State of the filter at one picture."""

    model: DriftModel
    keyframe: int
    """Frame that `from_keyframe` is relative to."""
    stamp_s: float
    mean: Array
    """(5, 2) departures, their velocity and their acceleration, in metres and seconds."""
    covariance: Array
    """(5, 2, 5, 2)."""

    @staticmethod
    def begin(model: DriftModel, keyframe: int, stamp_s: float) -> Drift:
        """Start at a keyframe without a history."""
        std = np.zeros(_SIZE)
        std[_SPEED], std[_ACCELERATION] = model.speed_std_m_s, model.acceleration_std_m_s2
        covariance = np.einsum("ik,ab->iakb", np.diag(std**2), np.eye(_AXES))
        return Drift(model, keyframe, stamp_s, np.zeros((_SIZE, _AXES)), covariance)

    def at(self, stamp_s: float) -> Drift:
        """Predict the state at a later time."""
        t, q = max(stamp_s - self.stamp_s, 0.0), self.model.acceleration_walk**2
        F, Q = np.eye(_SIZE), np.zeros((_SIZE, _SIZE))
        F[_BEFORE, _BEFORE], F[_BEFORE, _NOW] = 0.0, 1.0
        F[_NOW, _SPEED], F[_NOW, _ACCELERATION], F[_SPEED, _ACCELERATION] = t, t * t / 2, t
        moved = np.array([t * t / 2, t, 1.0])  # by an acceleration that sets in at the beginning
        orders = np.array([3, 2, 1])
        sums = orders[:, None] + orders - 1
        Q[_NOW:, _NOW:] = q * t * np.outer(moved, moved) / sums
        covariance = np.einsum("ij,jakb,lk->ialb", F, self.covariance, F)
        covariance += np.einsum("ik,ab->iakb", Q, np.eye(_AXES))
        return replace(self, stamp_s=stamp_s, mean=F @ self.mean, covariance=covariance)

    @property
    def speed_std_m_s(self) -> float:
        """Larger standard deviation of the velocity's error along an axis."""
        return float(np.sqrt(np.diagonal(self.covariance[_SPEED, :, _SPEED]).max()))

    @property
    def from_keyframe(self) -> Displacement:
        """Departure of this picture from the keyframe."""
        return self._between(_KEYFRAME)

    @property
    def from_before(self) -> Displacement:
        """Departure of this picture from the one before."""
        return self._between(_BEFORE)

    def _between(self, since: int) -> Displacement:
        h = self._row(since)
        wobble = 2 * self.model.place_std_m**2 * np.eye(_AXES)
        return Displacement(h @ self.mean, np.einsum("i,iakb,k->ab", h, self.covariance, h) + wobble)

    @staticmethod
    def _row(since: int) -> Array:
        h = np.zeros(_SIZE)
        h[_NOW], h[since] = 1.0, -1.0
        return h

    def seen_from_keyframe(self, seen: Displacement) -> Drift:
        """Return the state after the departure from the keyframe was seen."""
        return self._updated(_KEYFRAME, seen)

    def seen_from_before(self, seen: Displacement) -> Drift:
        """Return the state after the departure from the picture before was seen."""
        return self._updated(_BEFORE, seen)

    def _updated(self, since: int, seen: Displacement) -> Drift:
        h, predicted = self._row(since), self._between(since)
        by_seen = np.einsum("iakb,k->iab", self.covariance, h)
        gain = by_seen @ np.linalg.inv(predicted.covariance + seen.covariance)
        mean = self.mean + gain @ (seen.moved_m - predicted.moved_m)
        covariance = self.covariance - np.einsum("iab,kcb->iakc", gain, by_seen)
        return replace(self, mean=mean, covariance=0.5 * (covariance + covariance.transpose(2, 3, 0, 1)))

    def at_keyframe(self, frame: int) -> Drift:
        """Return the state of this picture where it becomes the keyframe ``frame``."""
        F = np.eye(_SIZE)
        F[_KEYFRAME, _KEYFRAME], F[_KEYFRAME, _NOW] = 0.0, 1.0
        covariance = np.einsum("ij,jakb,lk->ialb", F, self.covariance, F)
        return replace(self, keyframe=frame, mean=F @ self.mean, covariance=covariance)

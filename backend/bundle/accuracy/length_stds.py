"""How accurately a refined map knows the distance of two places that its pictures show.

Both places share errors: the scale, the heading, and what moves neighbouring pictures alike. The standard
deviations of the two places alone do not tell how much of them a distance has. It follows from their joint
covariance. With g the derivative of a distance by all variables, its variance is g'Sg.

Source: Förstner and Wrobel 2016, section 4.2.3 (propagation of covariance).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.accuracy.ground_covariances import INNER_RAYS, SeenGround, ground_jacobians
from backend.bundle.factors import WORLD
from backend.bundle.minimise import BundleOptimum

Array = NDArray[np.float64]

_MOST_PLACES = 64
"""Places whose joint covariance is computed: 2016 pairs, which tell a 95th percentile in each class."""
_CLASSES = 6
"""Classes of distances, with equal numbers of pairs."""
_WORST = 0.95
"""Share of the pairs that are known at least as well as what is called the worst."""


@dataclass(frozen=True)
class ShownPlaces:
    """Places on the floor, each as one picture shows it."""

    keyframe: NDArray[np.int64]
    place_m: Array
    """(m, 2) places, x and y over the level floor."""
    covariance: Array
    """(2m, 2m) their joint covariance, in square metres."""

    def lengths(self) -> tuple[Array, Array]:
        """Return the distances of all pairs from two pictures, and their standard deviations."""
        i, j = np.triu_indices(len(self.place_m), 1)
        between = self.place_m[j] - self.place_m[i]
        length_m = np.linalg.norm(between, axis=1)
        kept = (self.keyframe[i] != self.keyframe[j]) & (length_m > 0)
        i, j, length_m = i[kept], j[kept], length_m[kept]
        along = between[kept] / length_m[:, None]
        C = self.covariance.reshape(len(self.place_m), 2, len(self.place_m), 2).swapaxes(1, 2)
        of_difference = C[i, i] + C[j, j] - C[i, j] - C[j, i]
        variance = np.einsum("pa,pab,pb->p", along, of_difference, along)
        return length_m, np.sqrt(np.maximum(variance, 0.0))


def length_stds(optimum: BundleOptimum) -> tuple[tuple[float, float, float], ...]:
    """Return for growing distances (m) the standard deviation of a typical one and of a badly known one.

    Raises ``SingularMatrixError`` if a direction is open.
    """
    length_m, std_m = shown_places(optimum).lengths()
    order = np.argsort(length_m)
    return tuple(
        (
            float(np.median(length_m[own])),
            float(np.median(std_m[own])),
            float(np.quantile(std_m[own], _WORST)),
        )
        for own in np.array_split(order, _CLASSES)
        if len(own)
    )


def shown_places(optimum: BundleOptimum) -> ShownPlaces:
    """Return a place in each of some pictures along the whole path, in turn in the middle and around it.

    Raises ``SingularMatrixError`` if a direction is open.
    """
    problem = optimum.problem
    reduced = optimum.linearise().eliminate()
    columns = reduced.structure.columns
    count = problem.measurements.count
    keyframe = np.unique(np.linspace(0, count - 1, min(count, _MOST_PLACES)).round().astype(np.int64))
    lens = (CALIBRATION(0),) if problem.self_calibrates else ()
    seen, of_body = SeenGround.of(optimum), ground_jacobians(optimum)
    places = np.empty((len(keyframe), 2))
    gradient = np.zeros((reduced.size, 2 * len(keyframe)))
    for number, k in enumerate(keyframe.tolist()):
        ray = INNER_RAYS[number % len(INNER_RAYS)]
        J = seen.height_m * seen.jacobian(k)[2 * ray : 2 * ray + 2] @ of_body[k]
        at = np.r_[tuple(columns(key) for key in (POSE(k), WORLD, *lens))]
        gradient[at, 2 * number : 2 * number + 2] = J.T
        places[number] = seen.place_m(k)[ray]
    return ShownPlaces(keyframe, places, gradient.T @ reduced.factor.solve(gradient))

"""Distances between landmarks on the map: the paper's measure of drift.

The true camera gives the pixel of a landmark. Its mount is the one that the map has estimated, where the
reported mount was wrong (`slam.evaluation.association.seeing_camera`). The estimated pose projects that pixel
to the floor. The plain mean over all keyframes that see it is the landmark's position on the map. (IMAV 2011
paper, section 4.1.)

That mean runs over all visits, so it shows at most half of the drift between two visits. A **gap** therefore
compares single visits: the first landmark at its first visit, and the second at the first visit that begins
at least 10 s after that one has ended. The error is the length of the difference between the estimated and
the true vector from one to the other, with the first keyframe's position and yaw on the truth's. Unlike a
difference of lengths, it cannot be small by chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation.aligned_maps import AlignedMap, AlignedMaps, chain_on_result
from slam.evaluation.association import Association, seeing_camera

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_VISIT_BREAK_S = 10.0
"""A landmark that was out of sight for this long begins a new visit; true loops are as far apart."""


@dataclass(frozen=True)
class PerMap:
    """One figure for each of the three maps."""

    chain: float
    """Composed homographies of neighbouring frames: the paper's map stitching."""
    odometry: float
    """Optimized without loops."""
    loops: float
    """Optimized with loops: the estimate."""


@dataclass(frozen=True)
class LandmarkDistance:
    """True distance between two landmarks on the floor, and the distance on each of the three maps."""

    name: str
    """Name of the pair, such as "A-B"."""
    truth_m: float
    measured_m: PerMap
    """Distance on each map, in metres; NaN where one of the two was not seen."""

    @property
    def error_m(self) -> PerMap:
        """Absolute errors, in metres, as in the paper."""
        m = self.measured_m
        return PerMap(*(abs(way - self.truth_m) for way in (m.chain, m.odometry, m.loops)))

    @property
    def error_percent(self) -> PerMap:
        """Absolute errors in percent of the true distance; NaN where that is zero."""
        error, share = self.error_m, 100 / self.truth_m if self.truth_m > 0 else float("nan")
        return PerMap(error.chain * share, error.odometry * share, error.loops * share)


PAPER_DISTANCES_M = {
    "A-B": 2.1, "B-C": 4.5, "C-D": 2.1, "D-E": 4.5, "E-F": 2.1,
    "F-G": 4.5, "G-H": 2.1, "H-A": 4.5, "B-G": 6.36,
}  # fmt: skip
"""True distances of the paper's figure eight, from its errors in metres and in percent."""
_SAME_GROUND = 0.01
"""Relative difference. The eight's D-E and H-A connect the two bars and are 4.51 m."""


@dataclass(frozen=True)
class LoopGap:
    """Vector between two landmarks that are close together but far apart along the flight."""

    name: str
    truth_m: float
    error_m: PerMap
    """Error of the vector; NaN where the second landmark was not visited 10 s after the first."""


@dataclass(frozen=True)
class _Sightings:
    """Positions of one landmark on each map, keyframe by keyframe."""

    stamps_s: Array
    """(m,) times of the keyframes that see it, in seconds."""
    chain_m: Array
    """(m, 3) world points; NaN where this map did not place the keyframe."""
    odometry_m: Array
    loops_m: Array


class LandmarkPlace(NamedTuple):
    """The place of a landmark on a map."""

    name: str
    x_m: float
    y_m: float


def over_papers_ground(distances: tuple[LandmarkDistance, ...]) -> bool:
    """Return whether these are the distances of the paper's figure eight, so that its figures are
    comparable."""
    return len(distances) > 0 and all(
        abs(row.truth_m / PAPER_DISTANCES_M.get(row.name, float("inf")) - 1) <= _SAME_GROUND
        for row in distances
    )


def landmark_table(
    estimate: Estimate, flight: Flight, association: Association, maps: AlignedMaps, unit_m: float = 1.0
) -> tuple[tuple[LandmarkDistance, ...], tuple[LoopGap, ...]]:
    """Compute the distances of the flight's named pairs, and its gaps, on the three maps.

    Without named pairs, neighbours in the list of landmarks are compared. ``unit_m`` is the length of the
    maps' unit. The result is empty without landmarks, truth or a camera.
    """
    names = tuple(flight.landmarks)
    sightings = _sightings(estimate, flight, association, maps)
    if not sightings:
        return (), ()
    pairs = flight.landmark_pairs or tuple(pairwise(names))
    distances = tuple(_distance(a, b, flight, sightings, unit_m) for a, b in pairs if {a, b} <= set(names))
    gaps = tuple(_gap(a, b, flight, sightings, unit_m) for a, b in flight.gaps if {a, b} <= set(names))
    return distances, gaps


def landmark_places(
    estimate: Estimate, flight: Flight, association: Association, maps: AlignedMaps
) -> dict[str, Array]:
    """Return the position (3,) of each landmark on the estimate's map; NaN for one that was not seen.

    The result is empty without landmarks, truth or a camera.
    """
    found = _sightings(estimate, flight, association, maps)
    return {name: _mean(sightings.loops_m) for name, sightings in found.items()}


def landmarks_on_map(
    estimate: Estimate, flight: Flight, association: Association
) -> tuple[LandmarkPlace, ...]:
    """Return each landmark where the estimate's own map has it, without alignment.

    The result is empty without landmarks, truth or a camera, and has no landmark that was not seen.
    """
    own = AlignedMap(estimate.over_floor_T_b[association.keyframe], estimate.floor_z_m)
    places = landmark_places(estimate, flight, association, AlignedMaps(own, own, own))
    return tuple(LandmarkPlace(name, *w[:2].tolist()) for name, w in places.items() if np.isfinite(w).all())


def landmarks_on_chain(
    estimate: Estimate, flight: Flight, association: Association
) -> tuple[LandmarkPlace, ...]:
    """Return each landmark where the plain chain has it, once for each visit, as `landmarks_on_map` does."""
    own = AlignedMap(chain_on_result(estimate)[association.keyframe], estimate.floor_z_m)
    found = _sightings(estimate, flight, association, AlignedMaps(own, own, own))
    places = [
        (name, _mean(seen.chain_m[visit])) for name, seen in found.items() for visit in _visits(seen.stamps_s)
    ]
    return tuple(LandmarkPlace(name, *w[:2].tolist()) for name, w in places if np.isfinite(w).all())


def _sightings(
    estimate: Estimate, flight: Flight, association: Association, maps: AlignedMaps
) -> dict[str, _Sightings]:
    """Positions of all landmarks on each map; empty without truth or a camera."""
    true_camera = seeing_camera(estimate, flight)
    if association.w_T_b is None or true_camera is None:
        return {}
    sightings = {}
    for name, w_p in flight.landmarks.items():
        pixel, seen = seen_at(true_camera, association.w_T_b, w_p)
        k = np.flatnonzero(seen)
        stamps_s = estimate.stamps_s[association.keyframe[k]]
        sightings[name] = _carried(estimate.camera or true_camera, pixel[k], k, stamps_s, float(w_p[2]), maps)
    return sightings


def seen_at(camera: Camera, w_T_b: Array, w_p: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Project one world point into (n, 4, 4) poses: distorted pixels (n, 2), and which are inside the
    picture."""
    c_T_w = np.linalg.inv(w_T_b @ camera.b_T_c)
    c_p = c_T_w[:, :3, :3] @ w_p + c_T_w[:, :3, 3]
    pixel = camera.project(c_p)
    width, height = camera.size_px
    with np.errstate(invalid="ignore"):
        inside = (pixel >= -0.5).all(axis=1) & (pixel[:, 0] < width - 0.5) & (pixel[:, 1] < height - 0.5)
    # A distortion polynomial folds back far outside the picture; such a pixel does not undistort to the ray.
    ray = c_p[inside, :2] / c_p[inside, 2:]
    inside[inside] = np.linalg.norm(camera.rays(camera.undistort(pixel[inside]))[:, :2] - ray, axis=1) < 1e-2
    return pixel, inside


def _carried(
    camera: Camera, pixel: Array, k: Indices, stamps_s: Array, height_m: float, maps: AlignedMaps
) -> _Sightings:
    ideal = camera.undistort(pixel)

    def on(made: AlignedMap) -> Array:
        points = np.full((len(k), 3), np.nan)
        points[:, 2] = made.floor_z_m + height_m
        for row, pose in enumerate(made.w_T_b[k]):
            points[row, :2] = camera.floor_points(pose, ideal[row : row + 1], made.floor_z_m + height_m)[0]
        return points

    return _Sightings(stamps_s, on(maps.chain), on(maps.odometry), on(maps.loops))


def _between(a: _Sightings, b: _Sightings, of_a: Indices, of_b: Indices) -> tuple[Array, Array, Array]:
    """Vectors between two landmarks on the chain's map, on that without loops and on that with loops."""
    return (
        _mean(b.chain_m[of_b]) - _mean(a.chain_m[of_a]),
        _mean(b.odometry_m[of_b]) - _mean(a.odometry_m[of_a]),
        _mean(b.loops_m[of_b]) - _mean(a.loops_m[of_a]),
    )


def _mean(points: Array) -> Array:
    known = points[np.isfinite(points).all(axis=1)]
    return known.mean(axis=0) if len(known) else np.full(3, np.nan)


def _distance(
    a: str, b: str, flight: Flight, sightings: dict[str, _Sightings], unit_m: float
) -> LandmarkDistance:
    truth_m = float(np.linalg.norm(flight.landmarks[b] - flight.landmarks[a]))
    one, other = sightings[a], sightings[b]
    vectors = _between(one, other, np.arange(len(one.stamps_s)), np.arange(len(other.stamps_s)))
    return LandmarkDistance(
        f"{a}-{b}", truth_m, PerMap(*(unit_m * float(np.linalg.norm(v)) for v in vectors))
    )


def _gap(a: str, b: str, flight: Flight, sightings: dict[str, _Sightings], unit_m: float) -> LoopGap:
    truth = flight.landmarks[b] - flight.landmarks[a]
    one, other = sightings[a], sightings[b]
    first = _visits(one.stamps_s)[0]
    end_s = one.stamps_s[first[-1]] if len(first) else np.inf
    later = _visit_after(other.stamps_s, end_s + _VISIT_BREAK_S)
    errors = (float(np.linalg.norm(unit_m * vector - truth)) for vector in _between(one, other, first, later))
    return LoopGap(f"{a}-{b}", float(np.linalg.norm(truth)), PerMap(*errors))


def _visits(stamps_s: Array) -> list[Indices]:
    """Return the indices of the sightings of each visit."""
    breaks = np.flatnonzero(np.diff(stamps_s) >= _VISIT_BREAK_S) + 1
    return np.split(np.arange(len(stamps_s)), breaks)


def _visit_after(stamps_s: Array, from_s: float) -> Indices:
    """Indices of the sightings of the first visit that begins after a moment."""
    later = (visit for visit in _visits(stamps_s) if len(visit) and stamps_s[visit[0]] >= from_s)
    return next(later, np.zeros(0, dtype=np.int64))

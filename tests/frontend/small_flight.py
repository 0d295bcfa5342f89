"""A short simulated flight that passes each place twice, with truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig, FeatureKind, Features
from slam.simulation import Recipe, simulate
from slam.simulation.camera.optics import CameraModel
from slam.simulation.manoeuvre import Manoeuvre
from slam.simulation.place.world import World

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class SmallFlight:
    """Pictures in memory, the camera, and true poses at the exposures."""

    images: tuple[Image, ...]
    camera: Camera
    stamps_s: Array
    w_T_b: Array


@lru_cache(maxsize=1)
def small_flight(seed: int = 0) -> SmallFlight:
    """Two laps of a triangle of 6 m at 0.8 m, in 240x180."""
    recipe = Recipe(
        "small",
        Manoeuvre(((0.5, 0.5), (2.5, 0.5), (1.5, 2.2), (0.5, 0.5)), cruise_m_s=0.7, laps=2),
        world=World(extent_m=(0.0, 0.0, 3.0, 2.7), margin_m=0.6, metres_per_px=0.004, seed=3),
        camera=CameraModel((240, 180), rate_hz=8.0),
    )
    flight = simulate(recipe, seed)
    assert flight.frames is not None
    assert flight.camera is not None
    film = flight.frames.load
    images = tuple(film(k) for k in range(len(flight.frames)))
    w_T_b = film.w_T_b[:, 0]  # type: ignore[attr-defined]  # one pose a picture: a global shutter
    return SmallFlight(images, flight.camera, flight.frames.stamps_s, w_T_b)  # type: ignore[arg-type]


@lru_cache(maxsize=4)
def features_of(kind: FeatureKind, step: int) -> tuple[Features, ...]:
    """Features of every ``step``-th picture."""
    flight = small_flight()
    extract = Extractor(FeatureConfig(kind, 300))
    return tuple(extract(image, flight.camera) for image in flight.images[::step])


def shared_area(one: Array, other: Array) -> float:
    """Area that two convex polygons (n, 2) share: Sutherland and Hodgman's clipping, in double precision."""
    clip = other if signed_area(other) > 0 else other[::-1]
    polygon = one
    for a, b in zip(clip, np.roll(clip, -1, axis=0), strict=True):
        u = polygon - a
        side = (b - a)[0] * u[:, 1] - (b - a)[1] * u[:, 0]
        kept = []
        for k in range(len(polygon)):
            n = (k + 1) % len(polygon)
            if side[k] >= 0:
                kept.append(polygon[k])
            if side[k] * side[n] < 0:
                kept.append(polygon[k] + side[k] / (side[k] - side[n]) * (polygon[n] - polygon[k]))
        if len(kept) < 3:
            return 0.0
        polygon = np.array(kept)
    return abs(signed_area(polygon))


def signed_area(polygon: Array) -> float:
    x, y = polygon.T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def true_overlap(camera: Camera, w_T_i: Array, w_T_j: Array) -> float:
    """Shared floor over the smaller piece of floor."""
    i, j = camera.footprint(w_T_i), camera.footprint(w_T_j)
    return shared_area(i, j) / min(abs(signed_area(i)), abs(signed_area(j)))


@lru_cache(maxsize=1)
def true_overlaps(step: int) -> Array:
    """(n, n) shares of all pairs i < j of every ``step``-th picture."""
    flight = small_flight()
    poses = flight.w_T_b[::step]
    share = np.zeros((len(poses), len(poses)))
    for i, j in zip(*np.triu_indices(len(poses), 1), strict=True):
        if np.linalg.norm(poses[i, :2, 3] - poses[j, :2, 3]) < 1.6:  # a footprint's diagonal is 1.25 m
            share[i, j] = true_overlap(flight.camera, poses[i], poses[j])
    return share

"""Short simulated flights of small pictures, and what may go wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from slam import simulate
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, geodetic_from_enu
from slam.core.streams import Frames, Gps, Image
from slam.simulation.recipe import Recipe, recipe_from

ORIGIN = GeoOrigin(47.0, 8.0, 400.0)


def recipe(**tables: dict[str, Any]) -> Recipe:
    """There and back on two lines and over the first again: 12 s, about 100 pictures."""
    small: dict[str, Any] = {
        "name": "small",
        "landmarks": {"A": [0.3, 0.3], "B": [1.5, 0.3]},
        "landmark_pairs": [["A", "B"]],
        "maneuver": {"way_points": ["A", "B", [1.5, 0.7], [0.3, 0.7], "A", "B"], "cruise_m_s": 0.4},
        "world": {"extent_m": [0, 0, 1.8, 1.0], "margin_m": 0.6, "metres_per_px": 0.004, "seed": 3},
        "camera": {"size_px": [176, 144], "rate_hz": 8.0},
    }
    for name, table in tables.items():
        small[name] = {**small.get(name, {}), **table}
    return recipe_from(small, "test")


def flown(seed: int = 0, **tables: dict[str, Any]) -> Flight:
    """The small flight, or one with other settings."""
    return simulate(recipe(**tables), seed)


def elsewhere(seed: int = 5) -> Flight:
    """The same way over another floor."""
    return flown(seed, world={"seed": 77})


def seeing(flight: Flight, load: Callable[[int], Image | None]) -> Flight:
    """The flight with other pictures."""
    assert flight.frames is not None
    return replace(flight, frames=replace(flight.frames, load=load))


def only(flight: Flight, chosen: Sequence[int]) -> Flight:
    """The flight with some of its pictures alone."""
    frames, chosen = flight.frames, np.asarray(chosen, dtype=int)
    assert frames is not None
    names = tuple(frames.names[k] for k in chosen)
    return replace(
        flight, frames=Frames(frames.stamps_s[chosen], names, lambda k: frames.load(int(chosen[k])))
    )


def photographs(chosen: Sequence[tuple[Flight, int]]) -> Flight:
    """Single pictures of flights, two seconds apart, with nothing else recorded."""
    first = chosen[0][0]
    load = [(flight.frames, k) for flight, k in chosen]
    names = tuple(f"photo_{k:02}.jpg" for k in range(len(chosen)))
    frames = Frames(2.0 * np.arange(len(chosen)), names, lambda q: load[q][0].load(load[q][1]))
    return Flight("photographs", camera=first.camera, frames=frames, all_keyframes=True)


def gps_of(flight: Flight, std_m: float, seed: int = 0) -> Gps:
    """Fixes of the true way, five a second."""
    truth = flight.truth
    assert truth is not None
    stamps_s = truth.stamps_s[::20]
    w_p_b = truth.w_T_b[::20, :3, 3] + np.random.default_rng(seed).normal(0, std_m, (len(stamps_s), 3))
    return Gps(stamps_s, *geodetic_from_enu(w_p_b, ORIGIN), noise_std_m=(std_m, std_m, std_m))

"""The simulator: a recipe and a seed become a flight with truth.

``simulate`` plans the path, flies it, and lets each instrument read the motion. Pictures are rendered when
they are read.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.errors import InputError
from slam.flight import Flight, Frames, Truth
from slam.simulation import sensors
from slam.simulation.effects import CameraEffects
from slam.simulation.film import Film, shoot
from slam.simulation.maneuver import plan
from slam.simulation.recipe import Recipe, check, load_recipe
from slam.simulation.vehicle import Motion, fly

Array = NDArray[np.float64]

__all__ = ["Recipe", "simulate"]

EPOCH_NS = 1_315_785_600_000_000_000
"""Second 0 of every simulated flight, 2011-09-12: a constant, so that the same seed gives the same bytes."""
TRUTH_RATE_HZ = 100.0


def simulate(recipe: Recipe | str | Path, seed: int = 0) -> Flight:
    """Fly a recipe: a ``Recipe``, the name of a shipped one, or the path of a .toml file.

    The same recipe and seed give the same flight to the last bit, whatever order its pictures are read in.
    Raises ``InputError`` where the recipe or the seed (0 or greater) is refused.
    """
    if seed < 0:
        raise InputError(f"seed {seed}: give a whole number from 0 on")
    if isinstance(recipe, Recipe):
        check(recipe, f"recipe {recipe.name!r}")
    else:
        recipe = load_recipe(recipe)
    path = plan(recipe.maneuver, recipe.landmarks, recipe.world.extent_m)
    motion = fly(path, recipe.vehicle, sensors.generator(seed, "motion"))
    film = _film(recipe, motion, seed)
    names = tuple(f"{EPOCH_NS + round(stamp * 1e9)}.png" for stamp in film.stamps_s)
    return Flight(
        name=recipe.name,
        epoch_ns=EPOCH_NS,
        camera=film.told,
        frames=Frames(film.stamps_s, names, film),
        imu=sensors.read_imu(motion, recipe.imu, sensors.generator(seed, "imu")),
        sonar=sensors.read_sonar(motion, recipe.sonar, sensors.generator(seed, "sonar")),
        attitude=sensors.read_attitude(motion, recipe.attitude, sensors.generator(seed, "attitude")),
        truth=_truth(motion),
        landmarks={name: np.array([x, y, 0.0]) for name, (x, y) in recipe.landmarks.items()},
        landmark_pairs=recipe.landmark_pairs,
        gaps=recipe.gaps,
        notes={"vehicle": "simulated quadrotor", "source": f"recipe {recipe.name}, seed {seed}"},
    )


def _film(recipe: Recipe, motion: Motion, seed: int) -> Film:
    stamps_s = sensors.stamps(
        recipe.camera.rate_hz, motion.duration_s, sensors.generator(seed, "camera clock")
    )
    marks = tuple((name, x, y) for name, (x, y) in recipe.landmarks.items())

    def pose_at(times_s: Array) -> Array:
        return motion.at(times_s).w_T_b

    return shoot(
        recipe.world, marks, recipe.camera, CameraEffects(), stamps_s, pose_at, motion.duration_s, seed
    )


def _truth(motion: Motion) -> Truth:
    """The true motion over the whole flight, so that it can be interpolated at any stamp of any stream."""
    count = int(np.ceil(motion.duration_s * TRUTH_RATE_HZ)) + 1
    state = motion.at(np.round(np.linspace(0.0, motion.duration_s, count), 9))
    return Truth(state.stamps_s, state.w_T_b, state.w_v_m_s)

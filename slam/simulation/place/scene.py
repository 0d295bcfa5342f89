"""A place as it is drawn: the floor's texture, what stands on it and what moves over it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from slam.simulation.chance import generator
from slam.simulation.place.movers import Movers
from slam.simulation.place.skins import Skins, paint
from slam.simulation.place.world import Floor, Marks, World, build_floor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """What there is to see."""

    floor: Floor
    slope: tuple[float, float]
    """The floor is z = slope . (x, y)."""
    standing: Array
    """(n, 9) prisms."""
    movers: Movers | None
    skins: Skins
    """Of what stands, then of what moves."""

    def prisms(self, time_s: float) -> Array:
        """(n, 9) everything above the floor at one time, in the order of ``skins``."""
        if self.movers is None:
            return self.standing
        return np.concatenate([self.standing, self.movers.at(time_s)])


@lru_cache(maxsize=2)
def build_scene(world: World, marks: Marks, moving_objects: int = 0, seed: int = 0) -> Scene:
    """The scene of a world; what moves is drawn from the flight's ``seed``. Kept for the next call."""
    standing = world.prisms
    movers = Movers(moving_objects, world.extent_m, generator(seed, "movers")) if moving_objects else None
    drawn = standing if movers is None else np.concatenate([standing, movers.prisms])
    return Scene(build_floor(world, marks), world.slope, standing, movers, paint(drawn, world.seed))

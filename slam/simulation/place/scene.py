"""The scene that a camera sees: the floor's texture, fixed obstacles and moving objects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from slam.simulation.chance import generator
from slam.simulation.place.ground import Ground
from slam.simulation.place.moving_objects import MovingObjects
from slam.simulation.place.textures import ObstacleTextures, draw_textures
from slam.simulation.place.world import Floor, Marks, World, build_floor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """Everything that a camera can see."""

    floor: Floor
    ground: Ground
    fixed_prisms: Array
    """(n, 11) prisms of the fixed obstacles."""
    moving_objects: MovingObjects | None
    textures: ObstacleTextures
    """Textures of the fixed obstacles, then of the moving objects."""

    def prisms(self, time_s: float) -> Array:
        """Return all prisms (n, 11) at one time, in the order of ``textures``."""
        if self.moving_objects is None:
            return self.fixed_prisms
        return np.concatenate([self.fixed_prisms, self.moving_objects.at(time_s)])


@lru_cache(maxsize=2)
def build_scene(world: World, marks: Marks, moving_count: int = 0, seed: int = 0) -> Scene:
    """Return the scene of a world, cached. The flight's ``seed`` determines the moving objects."""
    fixed, moving = world.prisms, None
    if moving_count:
        moving = MovingObjects(moving_count, world.extent_m, generator(seed, "movers"))
    drawn = fixed if moving is None else np.concatenate([fixed, moving.prisms])
    return Scene(build_floor(world, marks), world.ground, fixed, moving, draw_textures(drawn, world.seed))

"""The simulator: it turns a recipe and a seed into a flight with truth.

``simulate`` flies the recipe's manoeuvre with the recipe's model, and each instrument measures the motion.
Pictures are rendered when they are read.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slam.core.errors import InputError

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.simulation.model import Model, load_model, save_model
    from slam.simulation.recipe import Recipe, load_recipe

__all__ = ["Model", "Recipe", "load_model", "load_recipe", "save_model", "simulate"]

_HOME = {
    "Model": "slam.simulation.model",
    "load_model": "slam.simulation.model",
    "save_model": "slam.simulation.model",
    "Recipe": "slam.simulation.recipe",
    "load_recipe": "slam.simulation.recipe",
}


def simulate(recipe: Recipe | str | Path, seed: int = 0) -> Flight:
    """Fly a recipe: a ``Recipe``, the name of a shipped one, or the path of a .toml file.

    The same recipe and seed give the same flight to the last bit, whatever order its pictures are read in.
    Raises ``InputError`` for an invalid recipe or a seed below 0, and where the flight leaves the floor or
    hits it.
    """
    from slam.simulation.recipe import Recipe, check, load_recipe
    from slam.simulation.recording import record

    if seed < 0:
        raise InputError(f"seed {seed}: give a whole number from 0 on")
    if isinstance(recipe, Recipe):
        check(recipe, f"recipe {recipe.name!r}")
        return record(recipe, seed)
    return record(load_recipe(recipe), seed)


def __getattr__(name: str) -> Any:
    """Import a name on first use, because equations and models need no camera."""
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'slam.simulation' has no attribute {name!r}")

"""Recipes: what to simulate, as a TOML file that a person reads and changes.

Each table of the file is the settings dataclass of the part that it is for; what is left out has its default.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from slam.config import load_config, read_toml
from slam.errors import InputError
from slam.simulation.maneuver import Maneuver, plan
from slam.simulation.optics import CameraModel
from slam.simulation.sensors import AttitudeModel, ImuModel, SonarModel
from slam.simulation.vehicle import Vehicle
from slam.simulation.world import FLOORS, World, check_world

LANDMARK_NAME = re.compile(r"[A-Za-z0-9_+-]{1,8}")
"""What can be written into a mark, and into a csv file."""


@dataclass(frozen=True)
class Recipe:
    """A flight to be simulated: the place, the vehicle, its way and its instruments."""

    name: Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[\w .+-]+$")]
    maneuver: Maneuver
    landmarks: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Marks on the floor: name -> (x, y) in metres."""
    landmark_pairs: tuple[tuple[str, str], ...] = ()
    """Pairs whose distance the table of landmarks names."""
    gaps: tuple[tuple[str, str], ...] = ()
    """Short gaps that a loop must close."""
    world: World = field(default_factory=World)
    vehicle: Vehicle = field(default_factory=Vehicle)
    camera: CameraModel = field(default_factory=CameraModel)
    imu: ImuModel = field(default_factory=ImuModel)
    attitude: AttitudeModel = field(default_factory=AttitudeModel)
    sonar: SonarModel = field(default_factory=SonarModel)


def load_recipe(source: str | Path) -> Recipe:
    """The recipe of a .toml file, or the shipped one of that name.

    Raises ``InputError``, one line, for what ``check`` refuses, for an unknown key or name, and for a
    value of the wrong type or out of range.
    """
    path = _recipe_path(source)
    return recipe_from(read_toml(path), str(path), path.parent)


def recipe_from(mapping: Mapping[str, Any], where: str, folder: Path = Path()) -> Recipe:
    """The recipe of a mapping as a TOML file gives it; a relative texture path starts at ``folder``."""
    recipe = load_config(Recipe, mapping, where)
    texture = recipe.world.texture
    if texture not in FLOORS:
        recipe = replace(recipe, world=replace(recipe.world, texture=str(folder / texture)))
    check(recipe, where)
    return recipe


def check(recipe: Recipe, where: str) -> None:
    """Raise ``InputError`` for what is wrong between fields: names, places, the floor, the sonar's limits."""
    try:
        check_world(recipe.world)
        _check_landmarks(recipe)
        plan(recipe.maneuver, recipe.landmarks, recipe.world.extent_m)
        if recipe.sonar.min_range_m >= recipe.sonar.max_range_m:
            raise InputError("sonar: min_range_m must be below max_range_m")
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def shipped_folder() -> Path:
    """Where the shipped recipes are: in the installed package, or beside it in a checkout."""
    package = Path(str(resources.files("slam")))
    installed = package / "datasets"
    return installed if installed.is_dir() else package.parent / "datasets"


def shipped_recipes() -> tuple[str, ...]:
    """Names of the recipes that come with the project."""
    return tuple(sorted(path.stem for path in shipped_folder().glob("*.toml")))


def _recipe_path(source: str | Path) -> Path:
    path = Path(source)
    if path.suffix == ".toml" and (
        path.exists() or path.name not in {f"{n}.toml" for n in shipped_recipes()}
    ):
        return path
    if str(source) in shipped_recipes():
        return shipped_folder() / f"{source}.toml"
    names = shipped_recipes()
    near = get_close_matches(path.stem, names, n=1, cutoff=0.0)
    meant = f"; did you mean {near[0]!r}?" if near else ";"
    raise InputError(f"{source}: no such recipe{meant} give a .toml file or one of: {', '.join(names)}")


def _check_landmarks(recipe: Recipe) -> None:
    x0, y0, x1, y1 = recipe.world.extent_m
    for name, (x, y) in recipe.landmarks.items():
        if not LANDMARK_NAME.fullmatch(name):
            raise InputError(f"landmarks: name {name!r}: use 1 to 8 letters, digits, '_', '+' or '-'")
        if not (x0 <= x <= x1 and y0 <= y <= y1):
            raise InputError(
                f"landmarks.{name} ({x:g}, {y:g}) lies off the floor; move it or enlarge world.extent_m"
            )
    for key, pairs in (("landmark_pairs", recipe.landmark_pairs), ("gaps", recipe.gaps)):
        for k, pair in enumerate(pairs):
            for name in pair:
                if name not in recipe.landmarks:
                    raise InputError(
                        f"{key}[{k}]: no landmark {name!r}; there are: {', '.join(recipe.landmarks)}"
                    )

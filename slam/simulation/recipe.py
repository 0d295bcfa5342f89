"""Recipes: descriptions of simulated flights, as TOML files for people to read and change.

Each table of the file corresponds to one dataclass of settings; keys that are left out have their defaults.
A recipe names its model and may change parts of it: it may contain the tables of a model file too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from slam.core.errors import InputError
from slam.core.toml_config import load_config, read_toml
from slam.simulation.camera.optics import CameraModel
from slam.simulation.manoeuvre import Manoeuvre, plan
from slam.simulation.model import (
    Model,
    Name,
    check_model,
    model_from,
    model_path,
    shipped_folder,
    shipped_models,
)
from slam.simulation.place.world import FLOORS, World, check_world
from slam.simulation.script import read_script, stick_from

LANDMARK_NAME = re.compile(r"[A-Za-z0-9_+-]{1,8}")
"""Names that fit into a mark and into a csv file."""


@dataclass(frozen=True)
class Recipe:
    """A flight to be simulated: the world, the vehicle, its manoeuvre and its instruments."""

    name: Name
    maneuver: Manoeuvre
    """The manoeuvre. The field is spelled as in recipe files."""
    landmarks: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Marks on the floor: name -> (x, y) in metres."""
    landmark_pairs: tuple[tuple[str, str], ...] = ()
    """Pairs of landmarks whose distance the evaluation compares."""
    gaps: tuple[tuple[str, str], ...] = ()
    """Pairs of landmarks with a short gap that a loop must close."""
    world: World = field(default_factory=World)
    camera: CameraModel | None = field(default_factory=CameraModel)
    """Camera; None (in a file: ``camera = "none"``) for a flight without one."""
    model: Model = field(default_factory=Model)
    """Model. A file gives a shipped name or a path, and its own tables change that model."""


def load_recipe(source: str | Path, model: str | Path | None = None) -> Recipe:
    """Load the recipe of a .toml file, or the shipped recipe of that name.

    ``model`` replaces the model that the recipe names; the recipe's own tables still change it. Raises a
    one-line ``InputError`` where ``check`` does, for an unknown key or name, and for a value of the wrong
    type or out of range.
    """
    path = _recipe_path(source)
    mapping = read_toml(path)
    if model is not None:
        model_path(model)  # an unknown model is reported under its own name, not as an error of the recipe
        mapping["model"] = str(Path(model).resolve() if Path(model).suffix == ".toml" else model)
    return recipe_from(mapping, str(path), path.parent)


def recipe_from(mapping: Mapping[str, Any], where: str, folder: Path = Path()) -> Recipe:
    """Build the recipe from the mapping of a TOML file. Raises ``InputError``.

    Relative paths of texture, script and model start at ``folder``.
    """
    parts = [part.name for part in fields(Model) if part.name != "name"]
    _refuse_unknown(mapping, [*(part.name for part in fields(Recipe)), *parts], where)
    changes = {key: value for key, value in mapping.items() if key in parts}
    model = _model(mapping.get("model", "nominal"), changes, where, folder)
    rest = {key: value for key, value in mapping.items() if key not in (*parts, "model")}
    if rest.get("camera") == "none":
        rest["camera"] = None
    recipe = replace(load_config(Recipe, rest, where), model=model)
    if recipe.world.texture not in FLOORS:
        recipe = replace(recipe, world=replace(recipe.world, texture=str(folder / recipe.world.texture)))
    if isinstance(recipe.maneuver.script, str):
        try:
            script = read_script(folder / recipe.maneuver.script)
        except InputError as error:
            raise InputError(f"{where}: maneuver.script: {error}") from None
        recipe = replace(recipe, maneuver=replace(recipe.maneuver, script=script))
    check(recipe, where)
    return recipe


def _refuse_unknown(mapping: Mapping[str, Any], known: list[str], where: str) -> None:
    for key in mapping:
        if key not in known:
            near = get_close_matches(key, known, n=1, cutoff=0.0)
            raise InputError(f"{where}: unknown key {key!r}; did you mean {near[0]!r}?")


def _model(source: object, changes: Mapping[str, Any], where: str, folder: Path) -> Model:
    """Return the named model, with tables of the recipe in place of its own."""
    if not isinstance(source, str):
        raise InputError(f"{where}: model: give the name of a model or the path of a .toml file")
    try:
        path = model_path(source if source in shipped_models() or "." not in source else folder / source)
    except InputError as error:
        raise InputError(f"{where}: model: {error}") from None
    base = read_toml(path)
    model_from(base, str(path))
    for part, table in changes.items():
        known = base.get(part, {})
        if isinstance(table, Mapping) and isinstance(known, Mapping):
            table = {**known, **table}
        base[part] = table
    return model_from(base, where)


def check(recipe: Recipe, where: str) -> None:
    """Raise ``InputError`` for fields that do not fit together: names, places, the floor, the model."""
    try:
        check_world(recipe.world, seen=recipe.camera is not None)
        _check_landmarks(recipe)
        if recipe.maneuver.script and recipe.maneuver.way_points:
            raise InputError("maneuver: way_points and a script; give one of them")
        if recipe.maneuver.script:
            stick_from(recipe.maneuver)
        else:
            plan(recipe.maneuver, recipe.landmarks, recipe.world.extent_m)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    check_model(recipe.model, where)


def shipped_recipes() -> tuple[str, ...]:
    """Return the names of the recipes that come with the project."""
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

"""Models: the vehicle, its hold noise, its instruments and its terms, as a TOML file.

The nominal model and an extended one are the same kind of file: the second has more ``[terms.NAME]`` tables.
Keys that a file leaves out have the values of the nominal model.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from slam.core.errors import InputError
from slam.core.toml_config import load_config, read_toml
from slam.io.atomic import write_whole
from slam.simulation.hold_noise import HoldNoise
from slam.simulation.instruments import (
    AttitudeModel,
    BatteryModel,
    CommandModel,
    ImuModel,
    SonarModel,
    VelocityModel,
)
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]
Time = Annotated[float, Field(ge=0.01, le=10)]


@dataclass(frozen=True)
class Vehicle:
    """Constants of the equations of motion.

    Source: IMAV 2011 paper, section 3.2: P_theta = 0.057 (so k = g P_theta), largest tilt 30 degrees, strong
    yaw drag.
    """

    max_tilt_rad: Annotated[float, Field(ge=0.01, le=1.2)] = 0.5236
    """Value at full stick."""
    gain: Annotated[float, Field(ge=0.05, le=5)] = 1.0
    """Ratio of the tilt that is reached to the commanded tilt."""
    drag_1_s: Annotated[float, Field(ge=0, le=10)] = 0.559
    attitude_time_s: Time = 0.10
    climb_rate_m_s: Annotated[float, Field(ge=0.05, le=20)] = 1.0
    """Value at full stick."""
    climb_time_s: Time = 0.30
    yaw_rate_rad_s: Annotated[float, Field(ge=0.05, le=20)] = 1.5
    """Value at full stick."""
    yaw_time_s: Time = 0.05
    gear_height_m: Annotated[float, Field(ge=0, le=1)] = 0.08
    """Height of the body's origin when the vehicle stands on the floor."""
    small_angle: bool = False
    """Whether the force is g times the tilt, as in the paper, instead of g times its tangent."""
    size_m: tuple[float, float, float] = (0.525, 0.515, 0.115)
    """The paper's dimensions, for the record: length, width, height."""
    inertia_kg_m2: tuple[float, float, float] = (0.0241, 0.0232, 0.0451)
    """The paper's principal moments, for the record; the lag of the attitude represents their effect."""


def _printable(name: str) -> str:
    if not re.fullmatch(r"[\w .+-]+", name):
        raise ValueError(
            f"{name[:40]!r} holds more than letters, digits, spaces and _ . + -; use those alone"
        )
    return name


Name = Annotated[str, Field(min_length=1, max_length=80), AfterValidator(_printable)]
"""Name of a recipe or a model, which can be part of a file name and of a line."""


@dataclass(frozen=True)
class Model:
    """Model of how a vehicle moves and of what its instruments measure, as criticism judges it."""

    name: Name = "nominal"
    vehicle: Vehicle = field(default_factory=Vehicle)
    hold_noise: HoldNoise = field(default_factory=HoldNoise)
    imu: ImuModel = field(default_factory=ImuModel)
    attitude: AttitudeModel = field(default_factory=AttitudeModel)
    velocity: VelocityModel = field(default_factory=VelocityModel)
    sonar: SonarModel = field(default_factory=SonarModel)
    battery: BatteryModel = field(default_factory=BatteryModel)
    command: CommandModel = field(default_factory=CommandModel)
    terms: dict[str, dict[str, float]] = field(default_factory=dict)
    """Term name -> parameter -> value; a parameter that is left out is neutral."""
    std: dict[str, dict[str, Annotated[float, Field(gt=0)]]] = field(default_factory=dict)
    """Term name -> parameter -> standard deviation of an estimated value.

    The correction of a recording uses it (`slam.simulation.inverse`); a simulation does not.
    """

    def value(self, term: str, parameter: str) -> float:
        """Return a parameter of a term, neutral where the model does not hold it. Raises ``KeyError``."""
        neutral = CATALOGUE[term].parameter(parameter).neutral
        return self.terms.get(term, {}).get(parameter, neutral)

    def holds(self, term: str) -> bool:
        """Whether the model has the term with a value that is not neutral."""
        return any(self.value(term, p.name) != p.neutral for p in CATALOGUE[term].parameters)

    def vector(self, term: str, *parameters: str) -> Array:
        """Return several parameters of a term, by default all of them, as (n,)."""
        names = parameters or tuple(p.name for p in CATALOGUE[term].parameters)
        return np.array([self.value(term, name) for name in names])

    def with_term(self, term: str, **values: float) -> Model:
        """Return this model with the given parameters of a term. Raises ``InputError`` as a file would."""
        terms = {**self.terms, term: {**self.terms.get(term, {}), **values}}
        changed = replace(self, terms=terms)
        check_model(changed, f"model {self.name!r}")
        return changed

    def with_sizes(self, term: str, values: Mapping[str, float]) -> Model:
        """Return this model with a term, its parameters kept within what its equation bears."""
        limits = {p.name: p for p in CATALOGUE[term].parameters}
        kept = {k: min(max(v, limits[k].least), limits[k].most) for k, v in values.items()}
        return self.with_term(term, **kept)

    def figures(self, names: Sequence[str]) -> Array:
        """Return numbers (n,) of sections, ``SECTION.KEY``, in radians where the name states degrees."""
        values = [float(getattr(getattr(self, s), key)) for s, key in (name.split(".") for name in names)]
        return np.where(["_deg" in name for name in names], np.radians(values), values)

    def with_figures(self, names: Sequence[str], values: Iterable[float]) -> Model:
        """Return this model with other numbers, as ``figures`` returns them."""
        changed = self
        for name, value in zip(names, values, strict=True):
            section, key = name.split(".")
            own = {key: float(np.degrees(value) if "_deg" in name else value)}
            changed = replace(changed, **{section: replace(getattr(changed, section), **own)})
        return changed

    def known_to(self, term: str) -> float | None:
        """Return the largest standard deviation of a term's parameters, or None without one."""
        return max(self.std.get(term, {}).values(), default=None)

    def with_std(self, term: str, **values: float) -> Model:
        """Return this model with the given standard deviations of a term's parameters."""
        return replace(self, std={**self.std, term: {**self.std.get(term, {}), **values}})

    def parameters(self) -> Array:
        """Return the parameter vector of the equations of motion, (``dynamics.PARAMETERS``,)."""
        from slam.simulation.dynamics import PARAMETERS

        values = {
            **{f"vehicle.{name}": value for name, value in vars(self.vehicle).items()},
            "vehicle.fade_height_m": self.hold_noise.fade_height_m,
        }
        for name, term in CATALOGUE.items():
            for parameter in term.parameters:
                # A term with a slot replaces a constant of the vehicle, but only where the model holds it.
                if not parameter.slot or name in self.terms:
                    slot = parameter.slot or f"{name}.{parameter.name}"
                    values[slot] = self.value(name, parameter.name)
        return np.array([float(values[name]) for name in PARAMETERS])


def load_model(source: str | Path) -> Model:
    """Load the model of a .toml file, or the shipped model of that name.

    Raises a one-line ``InputError`` for an unknown key, term or name, and for a value that is out of range.
    """
    path = model_path(source)
    return model_from(read_toml(path), str(path))


def model_from(mapping: Mapping[str, Any], where: str) -> Model:
    """Build the model from the mapping of a TOML file. Raises ``InputError``."""
    model = load_config(Model, mapping, where)
    check_model(model, where)
    return model


def save_model(model: Model, path: str | Path) -> None:
    """Write a model so that ``load_model`` returns an equal one. Raises ``InputError`` if writing fails."""
    lines = [f"name = {_toml(model.name)}"]
    for part in fields(model):
        value = getattr(model, part.name)
        if is_dataclass(value) and not isinstance(value, type):
            lines += ["", f"[{part.name}]", *(f"{k} = {_toml(v)}" for k, v in asdict(value).items())]
    for table, tables in (("terms", model.terms), ("std", model.std)):
        for name, values in tables.items():
            lines += ["", f"[{table}.{name}]", *(f"{k} = {_toml(v)}" for k, v in values.items())]
    write_whole(path, ("\n".join(lines) + "\n").encode())


def check_model(model: Model, where: str) -> None:
    """Raise ``InputError`` for an unknown term or parameter, a value out of range, and wrong sonar limits."""
    for table, tables in (("terms", model.terms), ("std", model.std)):
        for name, values in tables.items():
            if name not in CATALOGUE:
                near = get_close_matches(name, CATALOGUE, n=1, cutoff=0.0)
                raise InputError(f"{where}: unknown term '{table}.{name}'; did you mean '{table}.{near[0]}'?")
            known = [parameter.name for parameter in CATALOGUE[name].parameters]
            if unknown := [key for key in values if key not in known]:
                raise InputError(
                    f"{where}: unknown key '{table}.{name}.{unknown[0]}'; the term has: {', '.join(known)}"
                )
    for name, values in model.terms.items():
        for key, value in values.items():
            limits = CATALOGUE[name].parameter(key)
            if not limits.least <= value <= limits.most:
                unit = "" if limits.unit == "1" else f" {limits.unit}"
                raise InputError(
                    f"{where}: terms.{name}.{key}: give {limits.least:g} to {limits.most:g}{unit}, "
                    f"got {value:g}"
                )
    if model.sonar.min_range_m >= model.sonar.max_range_m:
        raise InputError(f"{where}: sonar: min_range_m must be below max_range_m")


def shipped_folder() -> Path:
    """Return the folder of recipes and models: in the installed package, or next to it in a checkout."""
    package = Path(str(resources.files("slam")))
    installed = package / "datasets"
    return installed if installed.is_dir() else package.parent / "datasets"


def shipped_models() -> tuple[str, ...]:
    """Return the names of the models that come with the project."""
    return tuple(sorted(path.stem for path in (shipped_folder() / "models").glob("*.toml")))


def model_path(source: str | Path) -> Path:
    """Return the file of a shipped model, or the path of a .toml file itself. Raises ``InputError``."""
    path, names = Path(source), shipped_models()
    if str(source) in names:
        return shipped_folder() / "models" / f"{source}.toml"
    if path.suffix == ".toml":
        return path
    near = get_close_matches(str(source), names, n=1, cutoff=0.0)
    meant = f"did you mean {near[0]!r}? " if near else ""
    raise InputError(f"{source}: no such model; {meant}give a .toml file or one of: {', '.join(names)}")


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(v) for v in value)}]"
    if isinstance(value, str):
        return f'"{value}"'
    return repr(float(value)) if isinstance(value, float) else str(value)

"""Fitted parameters: numbers x that the filter parameters hold, as they are, as a root or as a logarithm.

Some belong to a term of the catalogue. Nuisances differ between healthy vehicles: those of the mean (gain,
drag, attitude time, the sonar's zero) change what is read, the others only the process noise and the noise of
instruments. A nuisance has a healthy range, and is never reported as a cause while it stays there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from math import exp, inf, log, sqrt
from typing import Literal

from slam.criticism.kalman.filter_parameters import FilterParameters, slot
from slam.criticism.kalman.kernel_inputs import Perturbation
from slam.criticism.kalman.readings import INSTRUMENT_CHANNELS, INSTRUMENTS
from slam.criticism.kalman.transition import GUST_STD, GUST_TIME, HOLD
from slam.simulation.terms import CATALOGUE, Parameter

LARGEST_SHARE = 0.4
"""Greatest change of a constant of the vehicle in one step, as a share of it."""
DELAY = Parameter(name="delay_s", unit="s", neutral=0.0, low=-0.15, high=0.15, least=-0.5, most=0.5)
"""Delay of readings that come late or early, which belongs to no term."""
AT = "@"
"""Separator of a term's name and the value that it is tried at."""
FIFTH = 0.225
"""Reach of a factor of 20 % either way: a logarithm reaches further down than up."""
MAX_AR1 = 0.95
TAILS = 0.16
"""Noise with heavy tails looks smaller than it is once its outliers are cut: further reach of a logarithm."""
OUT_OF_MODEL_NOISE = 4.0
"""Upward reach of the logarithms where a vehicle's instruments are not the model's: a factor of 50."""
ATTRIBUTES = {"latency": "latency_s", "drift": "drift"}
"""Kind of a perturbation -> attribute of the filter parameters that is no vector."""


@dataclass(frozen=True)
class FittedParameter:
    """One fitted number x."""

    name: str
    """``term.parameter``, ``term@value``, or a nuisance's name; also that of its column."""
    vector: str = ""
    """Attribute of the filter parameters that holds it; empty where they do not hold it."""
    entries: tuple[int, ...] = ()
    """Entries of the vector; none where the attribute is a number."""
    form: Literal["plain", "square", "log"] = "plain"
    """Whether x is the entry, its square or its logarithm."""
    step: float = 1e-3
    """Step of the difference for its derivative."""
    neutral: float = 0.0
    """Value of x without effect."""
    least: float = -inf
    most: float = inf
    """Limits of x in the equations."""
    longest: float = inf
    """Longest step for which the equations are valid and the quadratic approximation may hold."""
    squared: bool = False
    """Whether x is the square of the catalogue's parameter."""
    factor: float = 1.0
    """Factor from x to the catalogue's unit."""
    grid: float | None = None
    """Value that any step sets it to, for an effect that is tried at some values."""
    beside: tuple[int, float] | None = None
    """Entry of the vector with the value that it has beside this parameter. With another one x is 0."""
    unit: str = "1"
    reach: float | None = None
    """Half the healthy range of a nuisance, about the model's own value; None for a term's parameter."""
    relative: bool = False
    """Whether the reach is a share of the model's own value."""

    @property
    def perturbation(self) -> Perturbation:
        """Its change for which the filter computes the sensitivity of the readings."""
        return Perturbation(self.name, *slot(self.name), self.step, squared=self.form == "square")

    def value_in(self, parameters: FilterParameters) -> float:
        """Return x in filter parameters."""
        if not self.vector:
            return 0.0
        vector = getattr(parameters, self.vector)
        entry = float(vector[self.entries[0]] if self.entries else vector)
        if self.form == "square":
            return entry**2
        return log(entry) if self.form == "log" else entry

    def size_in(self, parameters: FilterParameters) -> float:
        """Return how far x is from no effect; a nuisance's size is the difference from its own value: 0."""
        if self.beside is not None and getattr(parameters, self.vector)[self.beside[0]] != self.beside[1]:
            return 0.0
        return self.value_in(parameters) - self._origin(parameters)

    def in_catalogue_units(self, size: float, parameters: FilterParameters) -> float:
        """Return a size in the catalogue's unit; of a nuisance, x itself."""
        x = self._origin(parameters) + size
        return self.factor * (sqrt(max(x, 0.0)) if self.squared else x)

    def at(self, parameters: FilterParameters, x: float) -> FilterParameters:
        """Return the filter parameters with x, within the limits of the equations."""
        if not self.vector:
            return parameters
        x = min(max(x, self.least), self.most)
        if self.form != "plain":
            x = exp(x) if self.form == "log" else sqrt(max(x, 0.0))
        if not self.entries:
            return replace(parameters, **{self.vector: x})  # type: ignore[arg-type]
        vector = getattr(parameters, self.vector).copy()
        vector[list(self.entries)] = x
        if self.beside is not None:
            vector[self.beside[0]] = self.beside[1]
        return replace(parameters, **{self.vector: vector})

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        """Return the filter parameters after a step of x, within the limits of the equations."""
        return self.at(parameters, self.value_in(parameters) + step if self.grid is None else self.grid)

    def difference(self, parameters: FilterParameters) -> float:
        """Return the step for its derivative, backward where x is at its greatest value."""
        return self.step if self.value_in(parameters) + self.step <= self.most else -self.step

    def without_effect(self, parameters: FilterParameters) -> FilterParameters:
        """Return the filter parameters with x exactly at its neutral value: a step of minus its size would
        leave a rounding error, and the kernels ask whether an effect is there at all."""
        if self.size_in(parameters) == 0.0:
            return parameters
        return self.at(parameters, self._origin(parameters))

    def bounded(self, step: float, parameters: FilterParameters) -> float:
        """Return a step cut to the longest."""
        most = LARGEST_SHARE * abs(self.value_in(parameters)) if self.relative else self.longest
        return min(max(step, -most), most)

    def healthy_range(self, model: FilterParameters) -> tuple[float, float]:
        """Return the healthy range of a nuisance about a model's own value."""
        assert self.reach is not None
        centre = self.value_in(model)
        reach = self.reach * abs(centre) if self.relative else self.reach
        if self.vector != "noise_factor":
            return centre - reach, centre + reach
        # No reading of an out-of-model vehicle is judged finer than the model's own instruments.
        return centre - reach - TAILS, centre + (OUT_OF_MODEL_NOISE if model.out_of_model else reach)

    def is_beyond(self, parameters: FilterParameters, model: FilterParameters, std: float = 0.0) -> bool:
        """Whether a nuisance lies beyond its healthy range by more than two standard deviations ``std``."""
        low, high = self.healthy_range(model)
        value, reach = self.value_in(parameters), 2.0 * std
        return value - reach > high or value + reach < low

    def prior_precision(self, model: FilterParameters) -> float:
        """Return the reciprocal of the variance of a uniform prior over the healthy range of a nuisance."""
        low, high = self.healthy_range(model)
        return 12.0 / (high - low) ** 2

    def _origin(self, parameters: FilterParameters) -> float:
        return self.neutral if self.reach is None else self.value_in(parameters)


def gain_column(name: str) -> str:
    """Return the column of a noise change's effect on the mean alone: the trust that gains express."""
    return f"weight of {name}"


def _of_mean(name: str, unit: str, reach: float, step: float, relative: bool = True) -> FittedParameter:
    vector, entry = slot(name)
    return FittedParameter(name, vector, (entry,), step=step, unit=unit, reach=reach, relative=relative)


def _of_hold(name: str, unit: str, reach: float) -> FittedParameter:
    return FittedParameter(name, "hold", (HOLD.index(name),), "log", step=0.02, unit=unit, reach=reach)


MEAN_NUISANCES = (
    _of_mean("vehicle.gain", "1", reach=0.05, step=1e-3),
    _of_mean("vehicle.drag_1_s", "1/s", reach=0.10, step=1e-3),
    _of_mean("vehicle.attitude_time_s", "s", reach=0.10, step=1e-4),
    _of_mean("sonar.datum_m", "m", reach=0.01, step=1e-3, relative=False),
)
MEAN_PERTURBATIONS = tuple(n.perturbation for n in MEAN_NUISANCES)
NOISE_NUISANCES = (
    _of_hold("tilt_std_rad", "rad", FIFTH),
    _of_hold("tilt_time_s", "s", 0.5),
    _of_hold("yaw_rate_std_rad_s", "rad/s", FIFTH),
    _of_hold("yaw_rate_time_s", "s", 0.56),
    _of_hold("velocity_std_m_s", "m/s", FIFTH),
    _of_hold("velocity_time_s", "s", 0.85),
    _of_hold("velocity_up_std_m_s", "m/s", FIFTH),
    *(
        FittedParameter(f"{name}_noise", "noise_factor", tuple(channels), "log", step=0.02, reach=0.2)
        for name, channels in zip(INSTRUMENTS, INSTRUMENT_CHANNELS, strict=True)
    ),
)
NUISANCES = (*MEAN_NUISANCES, *NOISE_NUISANCES)
_AR1 = FittedParameter("", "noise_correlation", step=0.03, least=0.0, most=MAX_AR1, reach=MAX_AR1)
AR1_COEFFICIENTS = tuple(
    replace(_AR1, name=f"{name}_ar1", entries=(k,)) for k, name in enumerate(INSTRUMENTS)
)
"""AR(1) coefficients of the instruments, which are fitted only where noise is not white."""
GAIN_NUISANCES = tuple(FittedParameter(gain_column(n.name), reach=TAILS) for n in NOISE_NUISANCES)
"""Errors of the filter's gains. One Gaussian standard deviation cannot give both the scatter and the best
gain of noise with heavy tails. A wrong gain leaves residuals that resemble a target proportional to tilt."""
_JITTER = FittedParameter("timestamp_jitter.var", "jitter_s", form="square", step=1e-6, squared=True)
_SPECIAL = {n.name: n for n in (*NUISANCES, *AR1_COEFFICIENTS, *GAIN_NUISANCES, _JITTER)}


def with_steps(
    parameters: FilterParameters, steps: Iterable[tuple[str, float]], bounded: bool = False
) -> FilterParameters:
    """Return the filter parameters after a step of each named column, within the limits of the equations;
    each is cut to the longest step if ``bounded``."""
    for name, step in steps:
        fitted = fitted_parameter(name)
        parameters = fitted.stepped(parameters, fitted.bounded(step, parameters) if bounded else step)
    return parameters


@lru_cache(maxsize=256)
def fitted_parameter(name: str) -> FittedParameter:
    """Return the parameter of that column."""
    if name in _SPECIAL:
        return _SPECIAL[name]
    term, at, value = name.partition(AT)
    if at and term == "gusts":
        return FittedParameter(
            name, "hold", (GUST_STD,), "square", step=4e-4, squared=True, beside=(GUST_TIME, float(value))
        )
    if at:
        free = fitted_parameter(f"{term}.{CATALOGUE[term].parameters[0].name}")
        return replace(free, name=name, grid=float(value))
    kind, entry = slot(name)
    term, _, parameter = name.partition(".")
    limits = DELAY if parameter == DELAY.name else CATALOGUE[term].parameter(parameter)
    factor = 1e6 if name == "clock_drift.ppm" else 1.0
    return FittedParameter(
        name, ATTRIBUTES.get(kind, kind), () if kind in ATTRIBUTES else (entry,),
        "square" if limits.squared and kind != "camera" else "plain",  # the camera's vector holds squares
        step=(limits.step or 1e-3) / factor, neutral=limits.neutral, least=limits.least / factor,
        most=limits.most / factor, longest=(limits.high - limits.low) / factor, squared=limits.squared,
        factor=factor,
    )  # fmt: skip

"""Fitted parameters: the value of each, a step of it, and its value in the catalogue's unit.

Most are plain entries of the equations or of an instrument. The others have a class each: a square whose sign
cannot be observed, a value that is tried on a grid, a clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import inf

import numpy as np

from slam.criticism.kalman.filter_parameters import SQUARES, FilterParameters, catalogued, slot
from slam.criticism.kalman.transition import GUST_STD, GUST_TIME
from slam.criticism.search.nuisances import (
    AR1_COEFFICIENTS,
    GAIN_NUISANCES,
    NUISANCES,
    Nuisance,
    value_of,
    with_value,
)
from slam.simulation.dynamics import PARAMETERS
from slam.simulation.terms import CATALOGUE, Parameter

LARGEST_SHARE = 0.4
"""Greatest change of a constant of the vehicle in one step, as a share of it."""
LARGEST_LATENCY_S = 2.0
DELAY = Parameter(name="delay_s", unit="s", neutral=0.0, low=-0.15, high=0.15, least=-0.5, most=0.5)
"""Delay of readings that come late or early, which belongs to no term."""
AT = "@"
"""Separator of a term's name and the value that it is tried at."""
_BY_NAME = {n.name: n for n in (*NUISANCES, *AR1_COEFFICIENTS)}
_OF_THE_GAINS = {n.name for n in GAIN_NUISANCES}


class FittedParameter:
    """One fitted parameter."""

    def value_in(self, parameters: FilterParameters) -> float:
        """Return its value in the filter parameters; 0 where the term is not there."""
        return 0.0

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        """Return the filter parameters after a step of it, within the limits of the equations."""
        return parameters

    def longest_step(self, parameters: FilterParameters) -> float:
        """Return the longest step for which the equations are valid and the quadratic approximation may
        hold."""
        return inf

    def in_catalogue_units(self, current: float, parameters: FilterParameters) -> float:
        """Return a value in the catalogue's unit."""
        return current


@dataclass(frozen=True)
class _Entry(FittedParameter):
    """A parameter of a term that is an entry of the equations, an instrument or the camera."""

    where: str
    entry: int
    limits: Parameter

    def value_in(self, parameters: FilterParameters) -> float:
        return float(getattr(parameters, self.where)[self.entry]) - self.limits.neutral

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        return self.at(parameters, float(getattr(parameters, self.where)[self.entry]) + step)

    def at(self, parameters: FilterParameters, x: float) -> FilterParameters:
        """Return the filter parameters with an entry of ``x``, within the limits of the equations."""
        return _with(parameters, self.where, self.entry, min(max(x, self.limits.least), self.limits.most))

    def longest_step(self, parameters: FilterParameters) -> float:
        return self.limits.high - self.limits.low

    def in_catalogue_units(self, current: float, parameters: FilterParameters) -> float:
        if self.where == "camera" and self.entry in SQUARES:
            return catalogued(self.entry, current)
        return self.limits.neutral + current


@dataclass(frozen=True)
class _Squared(_Entry):
    """A parameter of the equations that acts by its square."""

    def value_in(self, parameters: FilterParameters) -> float:
        return float(getattr(parameters, self.where)[self.entry]) ** 2

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        return _with(parameters, self.where, self.entry, _root(self.value_in(parameters) + step))

    def in_catalogue_units(self, current: float, parameters: FilterParameters) -> float:
        return _root(current)


@dataclass(frozen=True)
class _Latency(FittedParameter):
    """The command's delay, linearised about its current value."""

    limits: Parameter

    def value_in(self, parameters: FilterParameters) -> float:
        return parameters.latency_s

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        return self.at(parameters, parameters.latency_s + step)

    def at(self, parameters: FilterParameters, x: float) -> FilterParameters:
        """Return the filter parameters with a latency of ``x``, within the limits of the equations."""
        return replace(parameters, latency_s=min(max(x, 0.0), LARGEST_LATENCY_S))

    def longest_step(self, parameters: FilterParameters) -> float:
        return self.limits.high - self.limits.low

    def in_catalogue_units(self, current: float, parameters: FilterParameters) -> float:
        return max(current, 0.0)


@dataclass(frozen=True)
class _At(FittedParameter):
    """Another parameter at a value of the grid."""

    free: _Entry | _Latency
    value: float

    def value_in(self, parameters: FilterParameters) -> float:
        return self.free.value_in(parameters)

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        return self.free.at(parameters, self.value)

    def in_catalogue_units(self, current: float, parameters: FilterParameters) -> float:
        return self.free.in_catalogue_units(current, parameters)


@dataclass(frozen=True)
class _Gusts(FittedParameter):
    """Variance of gusts of one correlation time."""

    time_s: float

    def value_in(self, parameters: FilterParameters) -> float:
        return float(parameters.hold[GUST_STD] ** 2) if parameters.hold[GUST_TIME] == self.time_s else 0.0

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        with_gusts = _with(parameters, "hold", GUST_STD, _root(float(parameters.hold[GUST_STD]) ** 2 + step))
        return _with(with_gusts, "hold", GUST_TIME, self.time_s)

    def in_catalogue_units(self, current: float, parameters: FilterParameters) -> float:
        return _root(current)


class _ClockDrift(FittedParameter):
    """Rate error of the vehicle's clock against the recorder's, as a share; parts per million in the
    catalogue."""

    def value_in(self, parameters: FilterParameters) -> float:
        return parameters.drift

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        return replace(parameters, drift=parameters.drift + step)

    def longest_step(self, parameters: FilterParameters) -> float:
        limits = CATALOGUE["clock_drift"].parameter("ppm")
        return 1e-6 * (limits.high - limits.low)

    def in_catalogue_units(self, current: float, parameters: FilterParameters) -> float:
        return 1e6 * current


class _Jitter(FittedParameter):
    """Variance of the stamps, in square milliseconds; its root in seconds in the catalogue."""

    def value_in(self, parameters: FilterParameters) -> float:
        return 1e6 * parameters.jitter_s**2

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        return replace(parameters, jitter_s=_root(parameters.jitter_s**2 + 1e-6 * step))

    def in_catalogue_units(self, current: float, parameters: FilterParameters) -> float:
        return 1e-3 * _root(current)


@dataclass(frozen=True)
class _OfNuisance(FittedParameter):
    """A nuisance, as the difference from its current value."""

    nuisance: Nuisance

    def stepped(self, parameters: FilterParameters, step: float) -> FilterParameters:
        return with_value(self.nuisance, parameters, value_of(self.nuisance, parameters) + step)

    def longest_step(self, parameters: FilterParameters) -> float:
        if self.nuisance.kind == "mean" and self.nuisance.relative:
            return LARGEST_SHARE * abs(value_of(self.nuisance, parameters))
        return inf

    def in_catalogue_units(self, current: float, parameters: FilterParameters) -> float:
        return value_of(self.nuisance, parameters) + current


class _OfTheGains(FittedParameter):
    """Error of the filter's gains, which the filter parameters do not hold."""


@lru_cache(maxsize=256)
def fitted_parameter(name: str) -> FittedParameter:
    """Return the parameter of that column: ``term.parameter``, ``term@value``, or a nuisance's name."""
    if name in _BY_NAME:
        return _OfNuisance(_BY_NAME[name])
    if name in _OF_THE_GAINS:
        return _OfTheGains()
    term, at, value = name.partition(AT)
    if at and term == "gusts":
        return _Gusts(float(value))
    if at:
        free = fitted_parameter(f"{term}.{CATALOGUE[term].parameters[0].name}")
        assert isinstance(free, _Entry | _Latency)
        return _At(free, float(value))
    if name == "control_latency.T":
        return _Latency(_limits(name))
    if name == "clock_drift.ppm":
        return _ClockDrift()
    if name == "timestamp_jitter.var":
        return _Jitter()
    if name == "ground_effect.radius":
        return _Squared("dynamics", PARAMETERS.index(name), _limits(name))
    return _Entry(*slot(name), _limits(name))


def bounded(name: str, step: float, parameters: FilterParameters) -> float:
    """Return a step of a column cut to its longest."""
    most = fitted_parameter(name).longest_step(parameters)
    return min(max(step, -most), most)


def _limits(name: str) -> Parameter:
    term, _, parameter = name.partition(".")
    return DELAY if parameter == DELAY.name else CATALOGUE[term].parameter(parameter)


def _with(parameters: FilterParameters, where: str, entry: int, x: float) -> FilterParameters:
    vector = getattr(parameters, where).copy()
    vector[entry] = x
    return replace(parameters, **{where: vector})


def _root(square: float) -> float:
    return float(np.sqrt(max(square, 0.0)))

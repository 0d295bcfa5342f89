"""From a step of fitted columns to the belief that has taken it, and what a belief holds of each column."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np

from slam.criticism.kalman.setting import Setting, slot
from slam.criticism.kalman.tangents import Direction
from slam.criticism.kalman.transition import GUST_STD, GUST_TIME
from slam.criticism.search.effects import LATENCY_STEP_S, Effect
from slam.criticism.search.nuisances import COLOURS, NUISANCES, WEIGHTS, value_of, with_value
from slam.simulation.dynamics import PARAMETERS, TILT_LIMIT
from slam.simulation.terms import CATALOGUE

_RADIUS = PARAMETERS.index("ground_effect.radius")
LARGEST_SHARE = 0.4
"""Of a constant of the vehicle in one step."""
_BY_NAME = {n.name: n for n in (*NUISANCES, *COLOURS)}
_OF_THE_GAINS = {n.name for n in WEIGHTS}
"""Nothing that a belief holds."""


def moved(setting: Setting, column: str, step: float) -> Setting:
    """The belief with a column changed, within what the equations bear."""
    if column in _OF_THE_GAINS:
        return setting
    if column in _BY_NAME:
        return with_value(_BY_NAME[column], setting, value_of(_BY_NAME[column], setting) + step)
    if column == "control_latency.T":
        return replace(setting, latency_s=min(max(setting.latency_s + step, 0.0), 2.0))
    if column == "clock_drift.ppm":
        return replace(setting, drift=setting.drift + step)
    if column == "timestamp_jitter.var":
        return replace(setting, jitter_s=float(np.sqrt(max(setting.jitter_s**2 + 1e-6 * step, 0.0))))
    if column.startswith("gusts@"):
        hold = setting.hold.copy()
        hold[GUST_STD] = np.sqrt(max(hold[GUST_STD] ** 2 + step, 0.0))
        hold[GUST_TIME] = float(column.partition("@")[2])
        return replace(setting, hold=hold)
    if column.startswith("control_latency@"):
        return replace(setting, latency_s=float(column.partition("@")[2]))
    parameters = setting.parameters.copy()
    if column.startswith("tilt_limit@"):
        parameters[TILT_LIMIT] = float(column.partition("@")[2])
        return replace(setting, parameters=parameters)
    if column == "ground_effect.radius":
        parameters[_RADIUS] = np.sqrt(max(parameters[_RADIUS] ** 2 + step, 0.0))
        return replace(setting, parameters=parameters)
    where, entry = slot(column)
    vector = getattr(setting, where).copy()
    term, _, name = column.partition(".")
    limits = CATALOGUE[term].parameter(name)
    vector[entry] = min(max(vector[entry] + step, limits.least), limits.most)
    return replace(setting, **{where: vector})


def bounded(column: str, step: float, setting: Setting) -> float:
    """A step cut to where the equations still mean something and a parabola may hold."""
    if column in _BY_NAME and _BY_NAME[column].kind == "mean" and _BY_NAME[column].relative:
        most = LARGEST_SHARE * abs(value_of(_BY_NAME[column], setting))
        return min(max(step, -most), most)
    term, _, name = column.partition(".")
    if term not in CATALOGUE or "@" in column or name not in {p.name for p in CATALOGUE[term].parameters}:
        return step
    parameter = CATALOGUE[term].parameter(name)
    most = parameter.high - parameter.low
    if column == "clock_drift.ppm":
        most *= 1e-6
    return min(max(step, -most), most)


def held_value(setting: Setting, column: str) -> float:
    """How much of a column a belief holds; 0 where the term is not there."""
    if column.startswith("control_latency"):
        return setting.latency_s
    if column == "clock_drift.ppm":
        return setting.drift
    if column == "timestamp_jitter.var":
        return 1e6 * setting.jitter_s**2
    if column.startswith("gusts@"):
        same = setting.hold[GUST_TIME] == float(column.partition("@")[2])
        return float(setting.hold[GUST_STD] ** 2) if same else 0.0
    if column.startswith("tilt_limit"):
        return float(setting.parameters[TILT_LIMIT] - pi / 2)
    if column == "ground_effect.radius":
        return float(setting.parameters[_RADIUS] ** 2)
    where, entry = slot(column)
    term, _, name = column.partition(".")
    return float(getattr(setting, where)[entry] - CATALOGUE[term].parameter(name).neutral)


def settled(effect: Effect) -> Effect:
    """The effect as it is tried about a belief that holds it: a value on a grid becomes free."""
    if effect.name == "control_latency":
        return replace(effect, directions=(Direction("control_latency.T", "latency", 0, LATENCY_STEP_S),))
    if effect.name == "tilt_limit":
        return replace(effect, directions=(Direction("tilt_limit.limit", "parameters", TILT_LIMIT, 1e-3),))
    return effect


def on_grid(effect: Effect) -> bool:
    """Whether an effect is tried at fixed values: it has a size only once it is fitted."""
    return "@" in effect.columns[0] and not effect.changes


def entered(effect: Effect, setting: Setting) -> Setting:
    """The belief that takes an effect at the value of the grid that it was tried at."""
    if on_grid(effect):
        return moved(setting, effect.columns[0], 1.0)
    return setting


def is_wall(effect: Effect) -> bool:
    """Whether an effect cuts what goes beyond a value: no slope at the value tells how it is without."""
    return effect.name == "tilt_limit"


def taken_down(wall: Effect, setting: Setting) -> Setting:
    """The belief without a wall."""
    assert is_wall(wall)
    parameters = setting.parameters.copy()
    parameters[TILT_LIMIT] = pi / 2
    return replace(setting, parameters=parameters)


def taken_out(effect: Effect, setting: Setting) -> Setting:
    """The belief without a term; a nuisance beyond its range stays where it is."""
    if is_wall(effect):
        return taken_down(effect, setting)
    for direction in effect.directions:
        setting = moved(setting, direction.name, -held_value(setting, direction.name))
    return setting

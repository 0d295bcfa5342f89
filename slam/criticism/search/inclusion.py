"""Inclusion of effects in filter parameters and their removal: profiled effects and saturations, which have
no slope."""

from __future__ import annotations

from dataclasses import replace
from math import pi

from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitted_parameters import AT, fitted_parameter
from slam.simulation.dynamics import TILT_LIMIT
from slam.simulation.terms import CATALOGUE


def with_free_value(effect: Effect) -> Effect:
    """Return the effect as tried about parameters that include it: a value of a grid becomes free."""
    if not is_profiled(effect):
        return effect
    free = fitted_parameter(f"{effect.name}.{effect.parameters[0]}")
    return replace(effect, perturbations=(free.perturbation,))


def is_profiled(effect: Effect) -> bool:
    """Whether an effect is tried at the values of a grid: it has a size only once it is fitted."""
    return AT in effect.columns[0] and not effect.changes


def at_profiled_value(effect: Effect, parameters: FilterParameters) -> FilterParameters:
    """Return the parameters with a profiled effect at its value of the grid."""
    if is_profiled(effect):
        return fitted_parameter(effect.columns[0]).stepped(parameters, 1.0)
    return parameters


def is_saturation(effect: Effect) -> bool:
    """Whether an effect saturates: its derivative at the limit does not predict the effect of removing the
    limit."""
    term = CATALOGUE.get(effect.name)
    return term is not None and term.parameters[0].is_limit


def without_saturation(saturation: Effect, parameters: FilterParameters) -> FilterParameters:
    """Return the parameters without a saturation."""
    assert is_saturation(saturation)
    dynamics = parameters.dynamics.copy()
    dynamics[TILT_LIMIT] = pi / 2
    return replace(parameters, dynamics=dynamics)


def without_effect(effect: Effect, parameters: FilterParameters) -> FilterParameters:
    """Return the parameters without a term; a nuisance beyond its range keeps its value."""
    if is_saturation(effect):
        return without_saturation(effect, parameters)
    for name in (*(d.name for d in effect.perturbations), *(c.name for c in effect.changes)):
        column = fitted_parameter(name)
        parameters = column.stepped(parameters, -column.size_in(parameters))
    return parameters

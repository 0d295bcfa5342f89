"""Values that a criticism found: one row for each quantity, with its interval and its usual range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slam.core.names import enumerated
from slam.core.units import everyday, spaced
from slam.report.criticism.left_over import healthy_range, own_value
from slam.report.criticism.plain_names import TWO_SIDED, constant, figure, reading, title_of
from slam.report.criticism.quantities import quantity
from slam.simulation.terms import CATALOGUE, Parameter

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.cause import Cause, Interval

USUAL, MORE, LESS, NO_DIFFERENCE = "usual", "more than usual", "less than usual", "no: may be none"
ABOUT = "more than usual, or usual"
"""A value beyond the usual range, with an interval that reaches into it."""
HEALTHY, UNHEALTHY = "healthy", "outside of healthy"


@dataclass(frozen=True)
class ValueRow:
    """Table row of one quantity."""

    title: str
    """Effect, in the first row of each; else empty."""
    quantity: str
    original: str
    """Value in the original model."""
    value: str
    """Value with its 95 % interval."""
    usual: str
    """Range among vehicles and instruments that are in order."""
    verdict: str
    """How the value compares with none and with the usual range."""


def value_rows(result: Criticism) -> list[ValueRow]:
    """Return the sizes of all causes, and the constants of the vehicle that these flights show."""
    rows = [row for cause in result.causes for row in _rows_of(cause, result)]
    shown = [(name, found) for name, found in _own_constants(result) if is_shown(name, result)]
    for k, (name, found) in enumerate(shown):
        factor, unit = everyday(found.value, found.unit) if found.unit != "1" else (1.0, "1")
        low, high = healthy_range(name, result) or (-np.inf, np.inf)
        outside = _is_outside(found, low, high)
        own = own_value(name, result) if _is_plain(name) else None
        rows.append(
            ValueRow(
                "" if k else "this vehicle itself",
                constant(name),
                "–" if own is None else sized_one(own, factor, unit),
                with_interval(found, factor, unit),
                f"{figure(factor * low)} to {figure(factor * high)}",
                UNHEALTHY if outside else HEALTHY,
            )
        )
    return rows


def unshown_constants(result: Criticism) -> str:
    """Return a sentence on the constants of this vehicle that the flights do not show."""
    hidden = [constant(name) for name, _ in _own_constants(result) if not is_shown(name, result)]
    noise = [f"of the {reading(name)} by {figure(share)}" for name, share in result.noise_correlation.items()]
    told = []
    if hidden:
        told.append(
            f"Not shown by these flights, and kept as healthy vehicles have them: {enumerated(hidden)}."
        )
    if noise:
        told.append(
            f"Noise of a reading is like that of the one before, which is healthy: {enumerated(noise)}."
        )
    return " ".join(told)


def is_shown(name: str, result: Criticism) -> bool:
    """Return whether the flights tell more of a constant than the range of healthy vehicles does, or that it
    lies outside of that range."""
    from slam.criticism.kalman.filter_parameters import filter_parameters_of
    from slam.criticism.search.fitted_parameters import NUISANCES

    found, healthy = result.nuisances[name], healthy_range(name, result)
    nuisance = next(n for n in NUISANCES if n.name == name)
    assert result.model is not None
    if healthy is not None and _is_outside(found, *healthy):
        return True
    ends = np.array([found.low, found.high])
    reach = float(np.ptp(np.log(ends) if nuisance.form == "log" else ends)) / 2.0
    precision = nuisance.prior_precision(filter_parameters_of(result.model))
    return (reach / TWO_SIDED) ** 2 * precision <= 0.5


def _own_constants(result: Criticism) -> list[tuple[str, Interval]]:
    """Return the fitted constants of this vehicle, without those that are a cause's size."""
    taken = {
        p.slot for cause in result.causes if cause.name in CATALOGUE for p in CATALOGUE[cause.name].parameters
    }
    return [(name, found) for name, found in result.nuisances.items() if name not in taken]


def _is_plain(name: str) -> bool:
    return not name.endswith("_noise")


def _is_outside(found: Interval, low: float, high: float) -> bool:
    """Return whether an interval lies outside of a range altogether."""
    return found.low > high or found.high < low


def range_over_time(cause: Cause, name: str, result: Criticism) -> tuple[float, float] | None:
    """Return the least and the greatest size in the parts of the flights; None where it does not change."""
    series = next((s for s in result.changes if s.column == f"{cause.name}.{name}"), None)
    if series is None:
        return None
    limits = CATALOGUE[cause.name].parameter(name)
    # Outside of these the effect hardly acts, and its linear size is no size.
    kept = series.sizes[(series.sizes >= limits.least) & (series.sizes <= limits.most)]
    return (float(kept.min()), float(kept.max())) if len(kept) > 1 else None


def _rows_of(cause: Cause, result: Criticism) -> list[ValueRow]:
    rows = []
    for k, (name, found) in enumerate(cause.parameters.items()):
        parameter = CATALOGUE[cause.name].parameter(name)
        factor, unit = one_unit(found)
        ends = range_over_time(cause, name, result)
        changing = ""
        if ends is not None:
            low, high = (figure(factor * end) for end in ends)
            changing = f"; a mean: it changes from {low} to {high}"
        rows.append(
            ValueRow(
                "" if k else title_of(cause.name),
                quantity(cause.name, name),
                "none"
                if parameter.neutral == 0.0 or parameter.is_limit
                else sized_one(parameter.neutral, factor, unit),
                with_interval(found, factor, unit),
                usual(parameter, factor, unit),
                f"{compared(parameter, found)}{changing}",
            )
        )
    return rows


def one_unit(found: Interval) -> tuple[float, str]:
    """Return the factor and the everyday unit of a value and its interval: that of the farther end."""
    return everyday(max(found.value, found.low, found.high, key=abs), found.unit)


def sized_one(value: float, factor: float, unit: str) -> str:
    """Return a value in a unit that others share."""
    return f"{figure(factor * value)}{spaced(unit)}"


def with_interval(found: Interval, factor: float, unit: str) -> str:
    """Return a value with its interval in brackets, and the unit of both."""
    ends = f"{figure(factor * found.low)} to {figure(factor * found.high)}"
    return f"{figure(factor * found.value)} ({ends}){spaced(unit)}"


def usual(parameter: Parameter, factor: float, unit: str) -> str:
    """Return the range of a parameter that is usual, in a unit that its value shares."""
    low, high = factor * parameter.low, factor * parameter.high
    if low == -high:
        return f"up to ±{figure(high)}{spaced(unit)}"
    return f"{figure(low)} to {figure(high)}{spaced(unit)}"


def compared(parameter: Parameter, found: Interval) -> str:
    """Return how a size compares with none, and with the usual range."""
    if found.low <= parameter.neutral <= found.high:
        return NO_DIFFERENCE
    low, high, away = parameter.low, parameter.high, abs(found.value - parameter.neutral)
    if found.low > high or found.high < low:
        near = min(abs(low - parameter.neutral), abs(high - parameter.neutral))
        return LESS if low * high > 0.0 and away < near else MORE
    far = max(abs(low - parameter.neutral), abs(high - parameter.neutral))
    return ABOUT if away > far else USUAL


def sized_interval_of(found: Interval) -> str:
    """Return a value with its interval in brackets, in everyday units."""
    return with_interval(found, *one_unit(found))

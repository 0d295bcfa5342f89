"""Values that a criticism found: one row for each quantity, with its interval and its usual range."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.names import enumerated
from slam.core.units import everyday, spaced, to_error
from slam.criticism.cause import WIDE, Interval
from slam.criticism.finding import Onset
from slam.report.criticism.plain_names import constant, figure, quantity, title_of
from slam.simulation.terms import CATALOGUE, Parameter

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.cause import Cause
    from slam.criticism.search.fitted_parameters import FittedParameter
    from slam.criticism.verdict.over_time import SizeOverTime
    from slam.simulation.model import Model

USUAL, MORE, LESS, NO_DIFFERENCE = "usual", "more than usual", "less than usual", "no: may be none"
ABOUT = "more than usual, or usual"
"""A value beyond the usual range, with an interval that reaches into it."""
HEALTHY, UNHEALTHY = "healthy", "outside of healthy"
_ONE_SIZE = "one size throughout, as in extended.toml"
ONLY_THE_MEAN = "extended.toml corrects the mean of its size, not the change"
"""Clause on a size that changes during the flights."""


@dataclass(frozen=True)
class SizeChange:
    """Sizes of one parameter on either side of a moment."""

    time_s: float
    before: Interval
    after: Interval

    @property
    def moment(self) -> str:
        """The moment in words."""
        return f"about {self.time_s:.0f} s"


def change_of_size(result: Criticism, effect: str, parameter: str) -> SizeChange | None:
    """Return the moment at which a size changes for certain, with the sizes before and after it; None where
    there is no such moment, or more flights than one."""
    onsets = (finding for finding in result.findings if isinstance(finding, Onset))
    found = next((o for o in onsets if (o.effect, o.parameter) == (effect, parameter)), None)
    series = next((s for s in result.changes if (s.effect, s.parameter) == (effect, parameter)), None)
    if found is None or series is None or len(set(series.flights)) > 1:
        return None
    after = series.begin_s >= found.time_s
    if after.all() or not after.any():
        return None
    return SizeChange(found.time_s, _mean(series, ~after), _mean(series, after))


def _mean(series: SizeOverTime, rows: NDArray[np.bool_]) -> Interval:
    """Return the weighted mean size of some parts; parts that differ by more than their errors widen it."""
    sizes, weight = series.sizes[rows], series.errors[rows] ** -2.0
    mean = float(np.average(sizes, weights=weight))
    spread = float(weight @ (sizes - mean) ** 2) / max(len(sizes) - 1, 1)
    reach = WIDE * float(np.sqrt(max(spread, 1.0) / weight.sum()))
    return Interval(mean, series.unit, mean - reach, mean + reach)


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
        factor, unit = one_unit(found, is_ratio=found.unit == "1")
        low, high = healthy_range(name, result) or (-np.inf, np.inf)
        outside = _is_outside(found, low, high)
        own = own_value(name, result) if _is_plain(name) else None
        rows.append(
            ValueRow(
                "" if k else "this vehicle itself",
                constant(name),
                "–" if own is None else sized_one(own, factor, unit),
                with_interval(found, factor, unit),
                f"{figure(factor * low)} to {figure(factor * high)}{spaced(unit)}",
                UNHEALTHY if outside else HEALTHY,
            )
        )
    return rows


def unshown_constants(result: Criticism) -> str:
    """Return a sentence on the constants of this vehicle that the flights do not show.

    The noise of an instrument shows wherever there is the instrument.
    """
    own = (name for name, _ in _own_constants(result) if _is_plain(name) and not is_shown(name, result))
    hidden = [constant(name) for name in own]
    text = f"Not shown by these flights, and kept as healthy vehicles have them: {enumerated(hidden)}."
    return text if hidden else ""


def is_shown(name: str, result: Criticism) -> bool:
    """Return whether the flights tell more of a constant than the range of healthy vehicles does, or that it
    lies outside of that range."""
    from slam.criticism.kalman.filter_parameters import filter_parameters_of

    found, healthy, nuisance = result.nuisances[name], healthy_range(name, result), _nuisance(name)
    assert result.model is not None
    assert nuisance is not None
    if healthy is not None and _is_outside(found, *healthy):
        return True
    ends = np.array([found.low, found.high])
    reach = float(np.ptp(np.log(ends) if nuisance.form == "log" else ends)) / 2.0
    precision = nuisance.prior_precision(filter_parameters_of(result.model))
    return (reach / WIDE) ** 2 * precision <= 0.5


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


def changes_in_time(effect: str, parameter: str, result: Criticism) -> bool:
    """Return whether a parameter is not the same throughout."""
    return any((s.effect, s.parameter) == (effect, parameter) for s in result.changes)


def _rows_of(cause: Cause, result: Criticism) -> list[ValueRow]:
    rows: list[ValueRow] = []
    for name, found in cause.parameters.items():
        parameter = CATALOGUE[cause.name].parameter(name)
        factor, unit = one_unit(found)
        words, change = quantity(cause.name, name), change_of_size(result, cause.name, name)
        shown = [(words, found, compared(parameter, found))]
        if change is not None:
            each = ((f"before {change.moment}", change.before), (f"after {change.moment}", change.after))
            shown = [
                *((f"{words}: {when}", size, compared(parameter, size)) for when, size in each),
                (f"{words}: {_ONE_SIZE}", found, "a mean of both"),
            ]
        elif changes_in_time(cause.name, name, result):
            mean = "may be none" if shown[0][2] == NO_DIFFERENCE else f"is {shown[0][2]}"
            shown = [(words, found, f"changes; extended.toml has its mean, which {mean}")]
        for of, size, verdict in shown:
            rows.append(
                ValueRow(
                    "" if rows else title_of(cause.name),
                    of,
                    "none"
                    if parameter.neutral == 0.0 or parameter.is_limit
                    else sized_one(parameter.neutral, factor, unit),
                    with_interval(size, factor, unit),
                    usual(parameter, factor, unit),
                    verdict,
                )
            )
    return rows


def one_unit(found: Interval, is_ratio: bool = False) -> tuple[float, str]:
    """Return the factor and the everyday unit of a value and its interval: that of the farther end.

    A ratio near 1 is told as it is, however small an error of it would be.
    """
    return (1.0, "1") if is_ratio else everyday(max(found.value, found.low, found.high, key=abs), found.unit)


def sized_one(value: float, factor: float, unit: str) -> str:
    """Return a value in a unit that others share."""
    return f"{figure(factor * value)}{spaced(unit)}"


def with_interval(found: Interval, factor: float, unit: str) -> str:
    """Return a value with its interval in brackets, and the unit of both."""
    half = 0.5 * factor * (found.high - found.low)
    value, low, high = (to_error(factor * x, half) for x in (found.value, found.low, found.high))
    return f"{value} ({low} to {high}){spaced(unit)}"


def before_and_after(change: SizeChange) -> str:
    """Return the sizes on either side of a moment, each with its interval, in one unit."""
    factor, unit = one_unit(max(change.before, change.after, key=lambda size: abs(size.value)))
    before, after = (with_interval(size, factor, unit) for size in (change.before, change.after))
    return f"{before} before {change.moment} and {after} after"


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


def sized_interval(found: Interval, is_ratio: bool = False) -> str:
    """Return a value with its interval in brackets, in everyday units."""
    return with_interval(found, *one_unit(found, is_ratio))


def healthy_range(name: str, result: Criticism) -> tuple[float, float] | None:
    """Return the range of a constant among healthy vehicles of the model, in its own unit; None for what is
    no such constant."""
    from slam.criticism.kalman.filter_parameters import filter_parameters_of

    nuisance = _nuisance(name)
    if nuisance is None or result.model is None:
        return None
    low, high = nuisance.healthy_range(filter_parameters_of(result.model))
    return (exp(low), exp(high)) if nuisance.form == "log" else (low, high)


def own_value(name: str, result: Criticism, model: Model | None = None) -> float | None:
    """Return the value of a constant in the original or another model; None for what is no such constant."""
    from slam.criticism.kalman.filter_parameters import filter_parameters_of

    nuisance, model = _nuisance(name), model or result.model
    if nuisance is None or model is None:
        return None
    value = nuisance.value_in(filter_parameters_of(model))
    return exp(value) if nuisance.form == "log" else value


def _nuisance(name: str) -> FittedParameter | None:
    from slam.criticism.search.fitted_parameters import NUISANCES

    return next((n for n in NUISANCES if n.name == name), None)

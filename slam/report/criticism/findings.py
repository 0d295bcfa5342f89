"""Findings that no cause explains: the distinct ones, their words, and the instruments that they concern."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from slam.core.units import everyday, spaced, to_error
from slam.criticism.finding import (
    ImplausibleSize,
    Inconsistency,
    NameInDoubt,
    Onset,
    OutOfRange,
    ResidualPattern,
)
from slam.data_quality.finding import Finding, VaryingSize
from slam.data_quality.lag import LateReadings
from slam.report.criticism.plain_names import (
    constant,
    figure,
    in_plain_names,
    quantity,
    reading,
    sized_between,
)
from slam.report.criticism.values import change_of_size, healthy_range, sized_interval
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism

GAIN = "vehicle.gain"
_SENSORS: Mapping[str, str] = {
    "velocity": "speed sensor",
    "range": "height sensor",
    "sonar": "height sensor",
    "height": "height sensor",
    "gyro": "gyro",
    "accel": "accelerometer",
    "roll": "attitude",
    "pitch": "attitude",
    "yaw": "heading",
    "attitude": "attitude",
    "picture": "camera",
    "pictures": "camera",
}
"""Begin of a channel's or a stream's name -> the sensor."""
_SIGNALS: Mapping[str, str] = {
    "one": "a constant",
    "time": "the time in the flight",
    "height": "the height",
    "ahead": "the speed ahead",
    "left": "the speed to the left",
    "up": "the climb rate",
    "speed2": "the square of the speed",
    "pitch": "the pitch",
    "roll": "the roll",
    "turning": "the rate of turn",
    "pitching": "the rate of pitch",
    "rolling": "the rate of roll",
    "tilt2": "the square of the tilt",
    "north": "the heading",
    "east": "the heading",
    "stick_ahead": "the stick ahead",
    "stick_left": "the stick to the left",
    "stick_up": "the stick up",
    "stick_turn": "the stick that turns",
    "ahead when fast": "the speed ahead, where it is high",
    "left when fast": "the speed to the left, where it is high",
    "place": "the place",
}
"""Signal of a residual pattern -> in words."""


def distinct_findings(result: Criticism) -> list[Finding]:
    """Return what is left over, without reservations about causes, which are told with these, and without a
    pattern that is told as an effect of inconstant size already."""
    left = list(result.findings)
    parts = [f for f in left if not (isinstance(f, NameInDoubt) and f.is_cause and not f.others)] or left
    named = {_stands_out(f) for f in parts if isinstance(f, Inconsistency) and not f.is_cause}
    return [f for f in parts if not (isinstance(f, ResidualPattern) and _stands_out(f) in named)]


def findings_in_words(result: Criticism) -> list[str]:
    """Return the distinct findings in words."""
    return [in_words(finding, result) for finding in distinct_findings(result)]


def _stands_out(finding: Finding) -> tuple[str, str]:
    """Return the sensor that a finding concerns, and by how much it stands out."""
    return _sensor(finding), f"{finding.z:.1f}"


def _sensor(finding: Finding) -> str:
    """Return the sensor, clock or constant of the vehicle that a finding concerns; empty for none."""
    if finding.channel == GAIN:
        return "scaling of the sticks in the autopilot"
    if finding.effect in CATALOGUE:
        return CATALOGUE[finding.effect].instrument
    # A delay is no term: its name begins with the stream.
    return _SENSORS.get(re.sub("(_[xyz]| .*)$", "", finding.channel or finding.effect), "")


def concerned(result: Criticism) -> list[str]:
    """Return the sensors, clocks and constants of the vehicle that are concerned by what is left over."""
    return [f"the {sensor}" for sensor in dict.fromkeys(map(_sensor, distinct_findings(result))) if sensor]


def is_of_speed(result: Criticism) -> bool:
    """Return whether an error of the measured speed is left over."""
    return any(
        "flow_scale" in (f.effect, *(f.others if isinstance(f, NameInDoubt) else ()))
        or (isinstance(f, ResidualPattern) and f.channel.startswith("velocity"))
        for f in distinct_findings(result)
    )


def in_words(finding: Finding, result: Criticism) -> str:
    """Return a finding in plain words, as a sentence, with the sizes that the verdict has."""
    words = in_plain_names(_words(replace(finding, flight=""), result))
    return f"{finding.label}{words}."


def _words(finding: Finding, result: Criticism) -> str:
    by = f"by {finding.z:.1f} standard deviations"
    match finding:
        case OutOfRange(value=None):
            return _out_of_range(finding.channel, result)
        case Onset():
            return _change(finding, by, result)
        case VaryingSize():
            return _sizes(finding)
        case Inconsistency(is_cause=True):
            return f"{finding.effect} changes {finding.between} ({by})"
        case Inconsistency():
            what = f"there is something like {finding.effect} whose size changes {finding.between}"
            return f"{what} ({by}): a constant one is not all of it"
        case ResidualPattern() if finding.proportions:
            each = [
                f"{_target(name)} in proportion to {_SIGNALS.get(s, s)}" for name, s in finding.proportions
            ]
            return f"there is {' and '.join(each)}, which no effect explains ({by})"
        case ResidualPattern(z=0.0):
            return finding.name
        case ResidualPattern():
            return f"{finding.name} ({by})"
        case LateReadings(lag=LateReadings.BY_FILTER):
            return f"the readings of {finding.channel} are smoothed over {1e3 * finding.late_s:.1f} ms"
        case LateReadings():
            when = f"{1e3 * abs(finding.late_s):.1f} ms too {'late' if finding.late_s > 0.0 else 'early'}"
            return f"the readings of {finding.channel} come {when} by their stamps"
        case NameInDoubt(is_cause=True, others=()):
            return f"{finding.effect} may be an effect that the catalogue does not hold"
        case NameInDoubt(is_cause=True):
            return f"{finding} instead: both have similar effects in these flights"
        case ImplausibleSize():
            return f"{replace(finding, z=0.0)}: something else has the same effect ({by})"
    return str(finding)


def _target(name: str) -> str:
    kind, _, way = name.partition("force ")
    if way and not kind:
        return f"an unknown push {in_plain_names(way)}"
    return f"an error of the {reading(name)}"


def _sizes(found: VaryingSize) -> str:
    """Describe the sizes that one parameter has in the segments of the flights."""
    factor, unit = everyday(max(found.least, found.most, key=abs), found.unit)
    least, most = (
        to_error(factor * end, factor * (found.most - found.least)) for end in (found.least, found.most)
    )
    stretches = f"in stretches of {found.segment_s:g} s{found.like}, instead of one size"
    return f"{_named(found)} is {least} to {most}{spaced(unit)} {stretches}"


def _change(found: Onset, by: str, result: Criticism) -> str:
    """Describe a change of a size, where known with the sizes before and after it."""
    if (change := change_of_size(result, found.effect, found.parameter)) is not None:
        return f"{_named(found)} changes at {change.moment} ({by}), and why is not known"
    factor, unit = everyday(found.change, found.unit)
    size = f"{figure(factor * found.change)}{spaced(unit)}"
    return f"{_named(found)} changes by {size} at about {found.time_s:.0f} s ({by})"


def _named(found: Finding) -> str:
    if not found.effect:
        return f"an error of the {reading(found.channel)}"
    return f"{CATALOGUE[found.effect].title} ({quantity(found.effect, found.parameter)})"


def _out_of_range(name: str, result: Criticism) -> str:
    words, found, healthy = constant(name), result.nuisances.get(name), healthy_range(name, result)
    if found is None or healthy is None:
        return f"{words}: the best value lies outside of what healthy vehicles have"
    value = sized_interval(found, is_ratio=found.unit == "1")
    return f"{words} is {value}; healthy vehicles have {sized_between(*healthy, found.unit)}"

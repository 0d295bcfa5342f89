"""Findings that no cause explains: the distinct ones, their words, and the instruments that they concern."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from slam.core.units import everyday, spaced, to_error
from slam.report.criticism.onsets import ONSET, change_of_size
from slam.report.criticism.plain_names import (
    constant,
    figure,
    in_plain_names,
    quantity,
    reading,
    sized_between,
)
from slam.report.criticism.values import before_and_after, healthy_range, sized_interval
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism

_CAVEAT = " may be something else"
_LOOKS_LIKE = re.compile(r"^what looks like (\w+) .*\(z = ([\d.]+)\)$")
_PATTERN = re.compile(r"^(\w+?)_?\w? ~ .*\(z = ([\d.]+)\)$")
GAIN = "vehicle.gain"
_SENSORS: Mapping[str, str] = {
    "velocity": "speed sensor",
    "range": "height sensor",
    "gyro": "gyro",
    "accel": "accelerometer",
    "roll": "attitude",
    "pitch": "attitude",
    "yaw": "heading",
}
"""Reading of a residual pattern, without its axis -> the sensor."""
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
_NUMBER = r"(-?[\d.]+(?:e[-+]\d+)?)"
_Z = r" \(z = ([-\d.]+)\)"


def distinct_findings(result: Criticism) -> list[str]:
    """Return what is left over, without reservations about causes, which are told with these, and without a
    pattern that is told as an effect of inconstant size already."""
    left = result.unexplained
    parts = [part for part in left if not part.endswith(_CAVEAT)] or left
    alike = [found.groups() for part in parts if (found := _LOOKS_LIKE.match(part))]
    streams = {(CATALOGUE[name].stream, z) for name, z in alike if name in CATALOGUE}
    return [p for p in parts if not ((found := _PATTERN.match(p)) and found.groups() in streams)]


def findings_in_words(result: Criticism) -> list[str]:
    """Return the distinct findings in words; a pattern that belongs to one of them is told behind it."""
    kept = distinct_findings(result)
    told = []
    for part in kept:
        looks = _LOOKS_LIKE.match(part)
        same = [p for p in result.unexplained if looks and p not in kept and f"(z = {looks[2]})" in p]
        words = unexplained_in_words(part, result)
        told.append(
            f"{words} The same finding as a pattern: {unexplained_in_words(same[0])}" if same else words
        )
    return told


def concerned(result: Criticism) -> list[str]:
    """Return the sensors, clocks and constants of the vehicle that are concerned by what is left over."""
    told: dict[str, None] = {}
    for part in result.unexplained:
        effect = next((name for name in re.findall(r"\w+", part) if name in CATALOGUE), "")
        axis_free = re.sub("_[xyz]$", "", part.partition(" ~ ")[0])
        sensor = CATALOGUE[effect].instrument if effect else _SENSORS.get(axis_free, "")
        if part.startswith(GAIN):
            sensor = "scaling of the sticks in the autopilot"
        if sensor:
            told[f"the {sensor}"] = None
    return list(told)


def is_of_speed(result: Criticism) -> bool:
    """Return whether an error of the measured speed is left over."""
    return any(
        "flow_scale" in part or (part.startswith("velocity") and " ~ " in part)
        for part in distinct_findings(result)
    )


def _pattern(found: re.Match[str]) -> str:
    """Describe a residual pattern: the error of a reading, or a force, that is proportional to a signal."""
    told = [part.partition(" ~ ")[::2] for part in found[1].split(", ")]
    each = [(_target(name), _SIGNALS.get(signal, signal)) for name, signal in told]
    what = " and ".join(f"{name} in proportion to {signal}" for name, signal in each)
    return f"there is {what}, which no effect explains (by {found[2]} standard deviations)"


def _target(name: str) -> str:
    kind, _, way = name.partition("force ")
    if way and not kind:
        return f"an unknown push {in_plain_names(way)}"
    return f"an error of the {reading(name)}"


def _size_changes(found: re.Match[str]) -> str:
    """Describe the sizes that one parameter has in the segments of the flights."""
    effect, parameter, low, high, segments_s, more = found.groups()
    ends = float(low), float(high)
    factor, unit = everyday(max(ends, key=abs), CATALOGUE[effect].parameter(parameter).unit)
    least, most = (to_error(factor * end, factor * (ends[1] - ends[0])) for end in ends)
    sizes = f"{least} to {most}{spaced(unit)}"
    return f"{_named(effect, parameter)} is {sizes} in stretches of {segments_s} s{more}, instead of one size"


def _onset(found: re.Match[str]) -> str:
    effect, parameter, change, time_s, z = found.groups()
    factor, unit = everyday(float(change), CATALOGUE[effect].parameter(parameter).unit)
    by = f"{figure(factor * float(change))}{spaced(unit)}"
    return f"{_named(effect, parameter)} changes by {by} at about {time_s} s (by {z} standard deviations)"


def _named(effect: str, parameter: str) -> str:
    return f"{CATALOGUE[effect].title} ({quantity(effect, parameter)})"


_EFFECT = rf"({'|'.join(CATALOGUE)})"
_IN_WORDS: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (rf"^{_EFFECT}\.(\w+) is {_NUMBER} to {_NUMBER}[^b]*by segments of ([\d.]+) s(.*)$", _size_changes),
    (ONSET, _onset),
    (
        rf"^what looks like (.*) changes (.*){_Z}$",
        r"a part looks like \1, but its size would change \2 (by \3 standard deviations): it is something "
        "else",
    ),
    (rf"^(.* ~ .*){_Z}$", _pattern),
    (rf"^(.*){_Z}$", r"\1 (by \2 standard deviations)"),
    (r"^(.*) (early|late) by ([-\d.]+) ms$", r"the readings of \1 come \3 ms too \2 by their stamps"),
    (r"^(.*) may be something else$", r"\1 may be an effect that the catalogue does not hold"),
    (r"^(.*) may be (?!that)(.*)$", r"\1 may be \2 instead: both have similar effects in these flights"),
)
"""Pattern of what is left over in verdict.json -> in words."""


def unexplained_in_words(part: str, result: Criticism | None = None) -> str:
    """Return what is left over as `slam.criticism.verdict.decision` describes it, in plain words.

    With a ``result``, a constant out of range is told with its value and its healthy range.
    """
    bare = part.removesuffix(".")
    name = bare.removesuffix(" out of range")
    if name != bare:
        return f"{_out_of_range(name, result)}."
    onset = re.match(ONSET, bare)
    if onset and result is not None and (change := change_of_size(result, onset[1], onset[2])):
        named, sizes = _named(onset[1], onset[2]), before_and_after(change)
        return f"{named} is {sizes} (a change by {change.z} standard deviations)."
    for pattern, words in _IN_WORDS:
        if re.match(pattern, bare):
            bare = re.sub(pattern, words, bare)
            break
    return f"{in_plain_names(bare)}."


def _out_of_range(name: str, result: Criticism | None) -> str:
    words = constant(name)
    found = result.nuisances.get(name) if result is not None else None
    healthy = healthy_range(name, result) if result is not None else None
    if found is None or healthy is None:
        return f"{words}: the best value lies outside of what healthy vehicles have"
    value = sized_interval(found, is_ratio=found.unit == "1")
    return f"{words} is {value}; healthy vehicles have {sized_between(*healthy, found.unit)}"

"""Distinct findings that no cause explains, and the instruments that they concern."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from slam.core.names import enumerated
from slam.report.criticism.instrument_names import SENSOR_OF_READING, instrument_of
from slam.report.criticism.judged_data import missing_streams
from slam.report.criticism.left_over import own_value, unexplained_in_words
from slam.report.criticism.plain_names import constant, figure
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism

_CAVEAT = " may be something else"
_LOOKS_LIKE = re.compile(r"^what looks like (\w+) .*\(z = ([\d.]+)\)$")
_PATTERN = re.compile(r"^(\w+?)_?\w? ~ .*\(z = ([\d.]+)\)$")
_GAIN = "vehicle.gain"


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
        reading = part.partition(" ~ ")[0] if " ~ " in part else ""
        sensor = (
            instrument_of(effect) if effect else SENSOR_OF_READING.get(re.sub("_[xyz]$", "", reading), "")
        )
        if part.startswith(_GAIN):
            sensor = "scaling of the sticks in the autopilot"
        if sensor:
            told[f"the {sensor}"] = None
    return list(told)


def whose_is_it(result: Criticism, flights: Sequence[Flight]) -> list[str]:
    """Return whether what is left over is an instrument's or the vehicle's, or which log decides."""
    found = distinct_findings(result)
    told = []
    if any(part.startswith(_GAIN) for part in found) and (size := result.nuisances.get(_GAIN)):
        begin = f"{constant(_GAIN)} is {figure(size.value)}{_in_the_file(_GAIN, result)}"
        judged = [flight for flight in flights if flight.name in result.flights]
        if {"attitude", "imu"} <= {*missing_streams(judged)}:
            told.append(
                f"{begin}: the vehicle tilts otherwise than the model, or the speed sensor is wrong "
                "by a factor. Without an attitude these flights cannot tell. A log with the attitude "
                "decides: then scale the sticks otherwise, or calibrate the sensor."
            )
        else:
            told.append(f"{begin}: of the vehicle, whose sticks are scaled otherwise than the model's.")
    if sensors := concerned(result):
        whose = "" if result.limits else ", or a motion of the vehicle that is not modelled"
        told.append(f"What is not explained concerns {enumerated(sensors)}{whose}.")
    elif found:
        told.append("What is not explained may still be an instrument's.")
    if is_of_speed(result):
        told.append(
            "Whether the error of the speed is the speed sensor's or a motion that is not modelled is "
            f"decided by {CATALOGUE['flow_scale'].excitation}."
        )
    return told


def is_of_speed(result: Criticism) -> bool:
    """Return whether an error of the measured speed is left over."""
    return any(
        "flow_scale" in part or (part.startswith("velocity") and " ~ " in part)
        for part in distinct_findings(result)
    )


def _in_the_file(name: str, result: Criticism) -> str:
    """Return whether extended.toml has the value that was found for a constant."""
    if result.extended is None or (size := result.nuisances.get(name)) is None:
        return ""
    value = own_value(name, result, result.extended)
    if value is None:
        return ""
    has = "has that value" if size.low <= value <= size.high else f"keeps {figure(value)}"
    return f" (extended.toml {has})"

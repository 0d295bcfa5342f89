"""Messages of ArduPilot with what other messages and parameters of the log state about their sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from slam.io.recordings.logs.field_rules import FieldSeries
from slam.io.recordings.logs.field_values import Fields, column
from slam.io.recordings.range_limits import limits_entries, stated_limits
from slam.io.sensor_yaml import Value

_LIMITS = ("MinRange", "MaxRange")
ACCURACY = ("HAcc", "VAcc")
_CENTIMETRE = 0.01


def completed(series: Mapping[str, FieldSeries], parameters: Mapping[str, float]) -> dict[str, FieldSeries]:
    """Return the channels: those of ``RFND`` with the limits of the parameters [m], and those of ``GPS`` with
    the accuracy of the ``GPA`` of the same receiver [m]."""
    found = dict(series)
    for channel, each in series.items():
        more: dict[str, np.ndarray] = {}
        if each.kind == "RFND" and (limits := _limits(parameters, _instance(channel))) is not None:
            more = {name: np.full(len(each.stamps_ns), v) for name, v in zip(_LIMITS, limits, strict=True)}
        accuracy = series.get(channel.replace("GPS", "GPA")) if each.kind == "GPS" else None
        if accuracy is not None and all(name in accuracy.fields for name in ACCURACY):
            more = {
                name: np.interp(each.stamps_ns, accuracy.stamps_ns, column(accuracy.fields, name))
                for name in ACCURACY
            }
        found[channel] = replace(each, fields={**each.fields, **more})
    return found


def _instance(channel: str) -> int:
    """Return the number in a channel's name, ``RFND[1]``; 0 without."""
    number = channel.partition("[")[2].rstrip("]")
    return int(number) if number.isdigit() else 0


def _limits(parameters: Mapping[str, float], instance: int) -> tuple[float, float] | None:
    """Return the limits of a range sensor [m]; None where the log does not have them.

    Sensors count from 1. Before ArduPilot 4.6 the limits are in centimetres, and the oldest versions do not
    number the first sensor.
    """
    prefixes = [f"RNGFND{instance + 1}", *["RNGFND"] * (instance == 0)]
    for prefix in prefixes:
        for unit_m, suffix in ((1.0, ""), (_CENTIMETRE, "_CM")):
            names = f"{prefix}_MIN{suffix}", f"{prefix}_MAX{suffix}"
            if all(name in parameters for name in names):
                return unit_m * parameters[names[0]], unit_m * parameters[names[1]]
    return None


def range_entries(fields: Fields) -> dict[str, Value]:
    """Return the keys of ``sensor.yaml`` that the parameters state about a range sensor."""
    if any(name not in fields for name in _LIMITS):
        return {}
    return limits_entries(stated_limits(*(column(fields, name) for name in _LIMITS)))

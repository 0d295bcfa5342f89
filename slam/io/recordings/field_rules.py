"""Logs whose messages are numbers in named fields: a table of rules turns them into streams of a flight."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.io.body_axes import body_from_frd
from slam.io.recordings.recording import Offer, StreamReadings
from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]
Fields = Mapping[str, NDArray[np.generic]]
"""Name of a field -> its values (n,)."""
Converted = tuple[Array, tuple[str, ...]]
"""Values (n, c) in the columns of the flight format, and notes."""


def _nothing(fields: Fields) -> dict[str, Value]:
    return {}


@dataclass(frozen=True)
class FieldSeries:
    """All messages of one channel."""

    kind: str
    stamps_ns: NDArray[np.int64]
    fields: Fields


@dataclass(frozen=True)
class FieldRule:
    """One message type that can fill one stream."""

    stream: str
    kind: str
    needs: tuple[str, ...]
    """Fields that must be there; they tell the versions of a message apart."""
    values: Callable[[Fields], Converted]
    reading: str
    """Units and axes of the log, and how they are converted."""
    nominal: Callable[[Fields], dict[str, Value]] = _nothing
    """Return keys of ``sensor.yaml`` that the messages state."""


def offers_of(series: Mapping[str, FieldSeries], rules: Sequence[FieldRule]) -> tuple[Offer, ...]:
    """Return the streams that the channels can fill; ``rank`` is the number of the rule."""
    return tuple(
        Offer(
            stream=rule.stream,
            channel=channel,
            kind=rule.kind,
            rows=len(each.stamps_ns),
            reading=rule.reading,
            rank=rank,
        )
        for rank, rule in enumerate(rules)
        for channel, each in series.items()
        if each.kind == rule.kind and all(name in each.fields for name in rule.needs)
    )


def other_channels(
    series: Mapping[str, FieldSeries], offers: Iterable[Offer]
) -> tuple[tuple[str, str, int], ...]:
    """Return name, type and number of rows of the channels that no rule takes."""
    offered = {offer.channel for offer in offers}
    return tuple(
        (channel, each.kind, len(each.stamps_ns))
        for channel, each in sorted(series.items())
        if channel not in offered
    )


def readings_of(
    series: Mapping[str, FieldSeries], rules: Sequence[FieldRule], chosen: Iterable[Offer]
) -> dict[str, StreamReadings]:
    """Return the folder of each chosen stream -> its readings."""
    readings = {}
    for offer in chosen:
        each, rule = series[offer.channel], rules[offer.rank]
        values, notes = rule.values(each.fields)
        readings[offer.stream] = StreamReadings(each.stamps_ns, values, rule.nominal(each.fields), notes)
    return readings


def column(fields: Fields, name: str) -> Array:
    """Return one field as float64 (n,)."""
    return np.asarray(fields[name], float)


def columns(fields: Fields, *names: str) -> Array:
    """Return fields as float64 (n, c)."""
    return np.column_stack([column(fields, name) for name in names])


def frd_vectors(fields: Fields, *names: str) -> Array:
    """Return fields (n, 3 k), vectors in forward-right-down axes, in forward-left-up axes."""
    values = columns(fields, *names)
    return np.hstack([body_from_frd(values[:, k : k + 3]) for k in range(0, len(names), 3)])


def single(name: str) -> Callable[[Fields], Converted]:
    """Return the conversion of one field that is taken as it is."""
    return lambda fields: (column(fields, name)[:, None], ())


def only_down(range_m: Array, is_down: NDArray[np.bool_], is_valid: NDArray[np.bool_]) -> Converted:
    """Return ranges (n, 1) of sensors that look down; NaN for others and for invalid readings."""
    aside = int((~is_down).sum())
    notes = (f"{aside} readings of sensors that do not look down left out",)
    return np.where(is_down & is_valid, range_m, np.nan)[:, None], notes * bool(aside)


def flow_velocity(flow_rad_s: Array, range_m: Array, is_valid: NDArray[np.bool_]) -> Converted:
    """Return velocities (n, 2), forward and left, from flow (n, 2) without turns, and range (n,).

    The flow is positive where it looks like a right-handed turn of the sensor about the body's x and y in
    forward-right-down axes. In such a turn, the point that the sensor sees moves to the left over the ground
    about x, and forward about y.
    """
    rate = flow_rad_s * range_m[:, None]
    values = np.column_stack([rate[:, 1], rate[:, 0]])
    values[~is_valid | ~np.isfinite(values).all(axis=1)] = np.nan
    return values, ("from flow times distance; body axes taken as level",)

"""Logs whose messages are numbers in named fields: a table of rules turns them into streams of a flight."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.io.recordings.field_values import Converted, Fields
from slam.io.recordings.recording import Offer, StreamReadings
from slam.io.sensor_yaml import Value


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
    """Fields that must be there; they distinguish the versions of a message."""
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

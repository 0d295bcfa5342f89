"""Logs whose messages are numbers in named fields: a table of rules turns them into streams of a flight."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from slam.core.height_systems import SEA_LEVEL
from slam.core.messages import Message
from slam.core.progress import Progress
from slam.io.recordings.logs.field_values import Converted, Fields
from slam.io.recordings.recording import Content, Offer, Recording, StreamReadings
from slam.io.sensor_yaml import Value


def _nothing(fields: Fields) -> dict[str, Value]:
    return {}


def above_sea_level(fields: Fields) -> dict[str, Value]:
    """Return the entry of ``gps0`` for altitudes over sea level, by the model that the receiver holds."""
    return {"height_system": SEA_LEVEL}


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
    doubt: Callable[[FieldSeries], str] = lambda series: ""
    """Return the reason not to take a channel without a request; empty for none."""


def field_recording(
    path: Path,
    description: str,
    series: Mapping[str, FieldSeries],
    rules: Sequence[FieldRule],
    warnings: tuple[Message, ...] = (),
    metadata: Mapping[str, str] = MappingProxyType({}),
    unread: Iterable[tuple[str, str, int]] = (),
) -> Recording:
    """Return the recording of a log: what the rules make of its channels, by name.

    ``unread`` are name, type and number of messages of channels whose fields were not read.
    """
    offers = _offers(series, rules)

    def read(chosen: Sequence[Offer], progress: Progress) -> Content:
        return Content(_readings(series, rules, chosen), None, warnings, metadata)

    return Recording(
        path=path,
        name=path.stem,
        description=description,
        offers=offers,
        others=(*_other_channels(series, offers), *unread),
        read=read,
    )


def _offers(series: Mapping[str, FieldSeries], rules: Sequence[FieldRule]) -> tuple[Offer, ...]:
    """Return the streams that the channels can fill; ``rank`` is the number of the rule."""
    return tuple(
        Offer(
            stream=rule.stream,
            channel=channel,
            kind=rule.kind,
            rows=len(each.stamps_ns),
            reading=rule.reading,
            rank=rank,
            doubt=rule.doubt(each),
        )
        for rank, rule in enumerate(rules)
        for channel, each in series.items()
        if each.kind == rule.kind and all(name in each.fields for name in rule.needs)
    )


def _other_channels(
    series: Mapping[str, FieldSeries], offers: Iterable[Offer]
) -> tuple[tuple[str, str, int], ...]:
    """Return name, type and number of rows of the channels that no rule takes."""
    offered = {offer.channel for offer in offers}
    return tuple(
        (channel, each.kind, len(each.stamps_ns))
        for channel, each in sorted(series.items())
        if channel not in offered
    )


def _readings(
    series: Mapping[str, FieldSeries], rules: Sequence[FieldRule], chosen: Iterable[Offer]
) -> dict[str, StreamReadings]:
    """Return the folder of each chosen stream -> its readings."""
    readings = {}
    for offer in chosen:
        each, rule = series[offer.channel], rules[offer.rank]
        values, notes = rule.values(each.fields)
        readings[offer.stream] = StreamReadings(each.stamps_ns, values, rule.nominal(each.fields), notes)
    return readings

"""A flight from a recording: the chosen channels, sorted on one clock and checked as a flight folder is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from slam.core.flight import Flight
from slam.core.messages import Message, unread, warning
from slam.core.progress import Progress, silent
from slam.core.stream_source import NO_STREAM, StreamSource
from slam.core.streams import Frames
from slam.io.clock import sort_by_time
from slam.io.csv_table import CsvTable, check_limits
from slam.io.files import brief, brief_message
from slam.io.plausibility import check_stamp_unit, check_stamps_agree
from slam.io.recorded_pictures import RecordedPictures
from slam.io.recordings.camera_views import judged
from slam.io.recordings.choice import Request, choose, next_best
from slam.io.recordings.recording import Content, Offer, PictureChannel, Recording, StreamReadings
from slam.io.sensor_yaml import YamlFile
from slam.io.series_fields import build_fields
from slam.io.streams import COLUMNS

_EVERYTHING = Request()


def flight_of(recording: Recording, request: Request = _EVERYTHING, progress: Progress = silent) -> Flight:
    """Return the flight of a recording; its pictures stay there until they are requested.

    Raises ``InputError`` where no stream is found, or where the meaning of the readings is uncertain.
    """
    known = judged(recording, request.topics, progress)
    recording, chosen, content = _with_values(known.recording, request.topics, progress)
    camera = next((offer.channel for offer in chosen if offer.stream == "cam0"), None)
    content = replace(content, pictures=known.mounted(camera, content.pictures))
    warnings = [*content.warnings, *known.remarks(camera)]

    def note(folder: str, notes: Iterable[Message]) -> None:
        warnings.extend(line.named(folder) for line in notes)

    tables = _tables(recording, chosen, content)
    sensors = {name: _sensor(recording, name, content) for name in tables}
    for name, table in tables.items():
        notes = list(table.notes)
        check_stamp_unit(table, sensors[name], notes)
        note(name, notes)
    for name in [name for name, table in tables.items() if _is_empty(table)]:
        note(name, [unread("no message has a value", "treated as not recorded", "check that it was on")])
        del tables[name]
    check_stamps_agree(tables)
    recorded = dict(tables)
    if "cam0" in tables and request.picture_rate_hz is not None:
        tables["cam0"] = _thinned(tables["cam0"], request.picture_rate_hz, note)
    tables, remarks = sort_by_time(tables)
    warnings += remarks
    epoch_ns = min((int(t.stamps_ns[0]) for t in tables.values() if len(t.stamps_ns)), default=0)
    fields = build_fields(tables, sensors, epoch_ns, note)
    if content.pictures is not None and len(tables["cam0"].stamps_ns):
        fields["camera"] = content.pictures.camera
        fields["frames"] = _frames(content.pictures, tables["cam0"], epoch_ns)
    return Flight(
        name=brief(recording.name, 120),
        epoch_ns=epoch_ns,
        notes=dict(content.metadata),
        messages=tuple(map(brief_message, warnings)),
        sources=(*_taken(chosen, recorded), *_left(recording, chosen)),
        **fields,
    )


def _with_values(
    recording: Recording, topics: Mapping[str, str], progress: Progress
) -> tuple[Recording, tuple[Offer, ...], Content]:
    """Return the chosen offers and their content, and the recording with the doubts that arose.

    A channel without a value leaves its place to the next one, unless a user named it.
    """
    while True:
        chosen = choose(recording, topics)
        content = recording.read(chosen, progress)
        empty = {
            offer: "; ".join(map(str, ("no message has a value", *content.readings[offer.stream].notes)))
            for offer in chosen
            if offer.stream not in topics
            and offer.stream in content.readings
            and not np.isfinite(content.readings[offer.stream].values).any()
            and next_best(recording, offer)
        }
        if not empty:
            return recording, chosen, content
        # A velocity that is turned by an attitude without a value has none either.
        attitudes = {offer: why for offer, why in empty.items() if offer.stream == "attitude0"}
        empty = attitudes or empty
        offers = tuple(
            replace(offer, doubt=empty[offer]) if offer in empty else offer for offer in recording.offers
        )
        recording = replace(recording, offers=offers)


def _thinned(table: CsvTable, rate_hz: float, note: Callable[[str, list[Message]], None]) -> CsvTable:
    """Return the pictures that come first after each multiple of 1 / ``rate_hz``."""
    slots = np.floor((table.stamps_ns - table.stamps_ns.min()) * (rate_hz * 1e-9) + 1e-6)
    keep = np.sort(np.unique(slots, return_index=True)[1])
    if len(keep) < len(slots):
        note(
            "cam0", [warning(f"{len(keep)} of {len(slots)} pictures are used, at most {rate_hz:g} a second")]
        )
    return table.rows(keep, table.stamps_ns[keep])


def _is_empty(table: CsvTable) -> bool:
    return not table.names and not np.isfinite(table.values).any()


def _tables(recording: Recording, chosen: tuple[Offer, ...], content: Content) -> dict[str, CsvTable]:
    tables = {}
    for offer in chosen:
        if offer.stream == "cam0" and content.pictures is not None:
            pictures = content.pictures
            readings = StreamReadings(
                pictures.stamps_ns, np.empty((len(pictures.names), 0)), notes=pictures.notes
            )
            names = pictures.names
        elif offer.stream in content.readings:
            readings, names = content.readings[offer.stream], ()
        else:
            continue
        tables[offer.stream] = CsvTable(
            path=Path(f"{recording.path}: {brief(offer.channel, 80)}"),
            stamps_ns=readings.stamps_ns,
            values=np.array(readings.values, dtype=float),
            names=names,
            lines=np.arange(1, len(readings.stamps_ns) + 1),
            notes=readings.notes,
            row_word="message",
        )
        if not names:
            columns = COLUMNS[offer.stream][: readings.values.shape[1]]
            tables[offer.stream] = check_limits(tables[offer.stream], columns)
    return tables


def _sensor(recording: Recording, name: str, content: Content) -> YamlFile:
    readings = content.readings.get(name)
    return YamlFile(recording.path, dict(readings.nominal) if readings is not None else {})


def _frames(pictures: PictureChannel, table: CsvTable, epoch_ns: int) -> Frames:
    """Return the pictures in the order of the sorted table."""
    load = RecordedPictures(pictures.fetch, table.lines - 1, pictures.camera.size_px, pictures.picture_format)
    stamps_s = ((table.stamps_ns - epoch_ns) * 1e-9).astype(float)
    return Frames(stamps_s, table.names, load, load.failures)


def _rate_hz(table: CsvTable) -> float:
    stamps = table.stamps_ns
    span_s = float(stamps.max() - stamps.min()) * 1e-9 if len(stamps) else 0.0
    return (len(stamps) - 1) / span_s if span_s > 0 else math.nan


def _taken(chosen: tuple[Offer, ...], tables: Mapping[str, CsvTable]) -> list[StreamSource]:
    return [
        StreamSource(
            stream=offer.stream,
            channel=offer.channel,
            kind=offer.kind,
            rows=len(tables[offer.stream].stamps_ns),
            rate_hz=_rate_hz(tables[offer.stream]),
            reading=", ".join(filter(None, (offer.reading, offer.view))),
        )
        for offer in chosen
        if offer.stream in tables
    ]


def _reason(offer: Offer, rival: str | None) -> str:
    why = offer.doubt or (f"{rival} taken as {offer.stream}" if rival else "left out on request")
    why = "; ".join(filter(None, (offer.view, why)))
    return f"{why}; take it by --topic {offer.stream}={offer.channel}"


def _left(recording: Recording, chosen: tuple[Offer, ...]) -> list[StreamSource]:
    """Return the channels that were not taken, each once, with the reason.

    A channel that was taken for one stream, and would do for another, is a candidate for that one.
    """
    taken = {offer.channel: offer for offer in chosen}
    rivals = {offer.stream: offer.channel for offer in chosen}
    left: dict[str, tuple[str, int, str]] = {}
    for offer in recording.offers:
        is_rival = rivals.get(offer.stream, offer.channel) != offer.channel
        is_candidate = is_rival and not offer.doubt
        if (offer.channel not in taken or is_candidate) and offer.channel not in left:
            reason = _reason(offer, rivals.get(offer.stream)) if offer.rows else "no rows"
            left[offer.channel] = (offer.kind, offer.rows, reason)
    for channel, kind, rows in recording.others:
        left.setdefault(channel, (kind, rows, recording.unread.get(channel, NO_STREAM)))
    return [
        StreamSource(stream="", channel=channel, kind=kind, rows=rows, rate_hz=math.nan, reading=reason)
        for channel, (kind, rows, reason) in left.items()
    ]

"""Anomalies of whole streams: readings that freeze, that are rounded, or that oscillate at one frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.data_quality.channels import streams_of
from slam.data_quality.frozen import Frozen, frozen
from slam.data_quality.lines import strongest_line
from slam.data_quality.rounding import rounding


@dataclass(frozen=True)
class StreamAnomaly:
    """One anomaly of a stream."""

    stream: str
    kind: str
    """``frozen``, ``rounded`` or ``oscillating``."""
    words: str
    """Channel, shape, time and size, as a part of a sentence."""
    repeated: NDArray[np.bool_] | None = None
    """(n,) readings of a frozen stream that repeat the one before."""


def stream_anomalies(flight: Flight) -> list[StreamAnomaly]:
    """Return the anomalies of each stream of a flight."""
    found = []
    for stream in streams_of(flight):
        for kind, look in (("frozen", frozen), ("rounded", rounding), ("oscillating", strongest_line)):
            if (seen := look(stream)) is not None:
                repeated = seen.repeated if isinstance(seen, Frozen) else None
                found.append(StreamAnomaly(stream.name, kind, str(seen), repeated))
    return found


def without_frozen(flight: Flight) -> tuple[Flight, list[str]]:
    """Return the flight without repeated ranges and speeds of frozen instruments, and descriptions of all
    anomalies of its streams."""
    anomalies = stream_anomalies(flight)
    for anomaly in anomalies:
        if anomaly.repeated is None:
            continue
        if anomaly.stream == "sonar" and flight.sonar is not None:
            range_m = np.where(anomaly.repeated, np.nan, flight.sonar.range_m)
            flight = replace(flight, sonar=replace(flight.sonar, range_m=range_m))
        elif anomaly.stream == "velocity" and flight.velocity is not None:
            v_m_s = np.where(anomaly.repeated[:, None], np.nan, flight.velocity.v_m_s)
            flight = replace(flight, velocity=replace(flight.velocity, v_m_s=v_m_s))
    return flight, [anomaly.words for anomaly in anomalies]

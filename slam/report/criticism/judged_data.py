"""Flights that a criticism judged: their lengths, their streams with their rates, and what they lack."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted
from slam.core.names import enumerated, listed
from slam.report.criticism.plain_names import figure

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism

_STREAMS = {
    "command": "sticks",
    "imu": "gyro and accelerometer",
    "attitude": "attitude",
    "velocity": "speed",
    "sonar": "height",
    "frames": "pictures",
}
"""Fields of a flight that criticism compares -> in words."""
_NO_SPEED_TO_THE_LEFT = "speed ahead alone"
SAME_RATE = 0.005
"""Difference of two rates that three significant figures show at most."""
MOST_FLIGHTS = 2
"""Greatest number of flights that are told one by one."""
MOST_NAMES = 4


def judged_data(result: Criticism, flights: Sequence[Flight]) -> list[str]:
    """Return the flights with their lengths and streams, what none of them has, and how parts were held
    out."""
    judged = judged_of(result, flights)
    if not judged:
        return [f"{enumerated(list(result.flights))}."] if result.flights else []
    if len(judged) > MOST_FLIGHTS:
        lengths = np.array([_duration_s(flight) for flight in judged])
        least, most = (f"{end:.0f}" for end in (lengths.min(), lengths.max()))
        each = f"{least} s" if least == most else f"{least} to {most} s"
        names = listed([flight.name for flight in judged], MOST_NAMES)
        lines = [
            f"{counted(len(judged), 'flight')} ({names}), each {each} long, together {lengths.sum():.0f} s.",
            f"Readings of all together: {enumerated(_streams(judged))}.",
        ]
    else:
        lines = [f"{f.name}: {_duration_s(f):.0f} s with {enumerated(_streams([f]))}." for f in judged]
    return [part for part in (*lines, _lacking(judged), _held_out(result)) if part]


def judged_of(result: Criticism, flights: Sequence[Flight]) -> list[Flight]:
    """Return the flights that were judged."""
    return [flight for flight in flights if flight.name in result.flights]


def missing_streams(flights: Sequence[Flight]) -> list[str]:
    """Return the compared streams that no flight has."""
    return [name for name in _STREAMS if all(getattr(flight, name) is None for flight in flights)]


def _held_out(result: Criticism) -> str:
    from slam.criticism.search.information import SEGMENT_S

    gain = next((cause.gain for cause in result.causes if cause.gain.by), None)
    if gain is None:
        return ""
    if gain.by == "flight":
        return "Each flight in turn was held out: the sizes were fitted on the others."
    count = len(gain.parts)
    return (
        f"With so few flights, {count} parts were held out in turn, each of them every "
        f"{count}th stretch of {SEGMENT_S:g} s: the sizes were fitted on the others."
    )


def _duration_s(flight: Flight) -> float:
    ends = [
        s.stamps_s[[0, -1]]
        for name in _STREAMS
        if (s := getattr(flight, name)) is not None and len(s.stamps_s)
    ]
    return float(max(e[1] for e in ends) - min(e[0] for e in ends)) if ends else 0.0


def _streams(flights: Sequence[Flight]) -> list[str]:
    """Return each stream with the count of its readings and its rate."""
    lines = []
    for name, words in _STREAMS.items():
        stamps = [s.stamps_s for f in flights if (s := getattr(f, name)) is not None and len(s.stamps_s) > 1]
        if not stamps:
            continue
        count = sum(map(len, stamps))
        if name == "command":
            lines.append(f"{words} ({count} entries)")
            continue
        lines.append(f"{_axes(name, words, flights)} ({count} readings{_rate(stamps)})")
    return lines


def _rate(stamps: Sequence[NDArray[np.float64]]) -> str:
    """Return the mean rate, and the usual spacing where it is another, with what makes the difference."""
    gaps_s = np.concatenate([np.diff(t) for t in stamps])
    usual_s, mean_s = float(np.median(gaps_s)), float(np.mean(gaps_s))
    if not (usual_s > 0.0 and mean_s > 0.0):
        return ""
    mean, usual = figure(1.0 / mean_s), figure(1.0 / usual_s)
    if abs(mean_s / usual_s - 1.0) < SAME_RATE:
        return f" at {usual} Hz"
    if mean_s > usual_s:
        why = f"longest gap {figure(float(gaps_s.max()))} s"
    else:
        close = 100.0 * float(np.mean(gaps_s < 0.5 * usual_s))
        why = f"{figure(close)} % of the gaps are shorter than half of the usual one"
    return f" at {mean} Hz on average, mostly {usual} Hz; {why}"


def _axes(name: str, words: str, flights: Sequence[Flight]) -> str:
    """Return the words of a stream; of a speed that is known along one axis alone, that axis."""
    if name != "velocity":
        return words
    known = [np.isfinite(f.velocity.v_m_s).any(axis=0) for f in flights if f.velocity is not None]
    ahead, left = np.any(known, axis=0).tolist()
    if ahead and left:
        return words
    return _NO_SPEED_TO_THE_LEFT if ahead else "speed to the left alone"


def as_seen(manoeuvre: str, flights: Sequence[Flight]) -> str:
    """Return a manoeuvre without its part to the side where nothing measures that."""
    tilt = {"attitude", "imu"} - {*missing_streams(flights)}
    alone = flights and not tilt and _axes("velocity", "", flights) == _NO_SPEED_TO_THE_LEFT
    return manoeuvre.replace(", ahead and to the side", ", ahead") if alone else manoeuvre


def _lacking(flights: Sequence[Flight]) -> str:
    missing = [_STREAMS[name] for name in missing_streams(flights)]
    if not missing:
        return ""
    if len(flights) > 1:
        return (
            f"No flight has {' or '.join(part for part in (', '.join(missing[:-1]), missing[-1]) if part)}."
        )
    return f"The flight has {enumerated([f'no {name}' for name in missing])}."

"""Pictures that arrive at the pace of a recording, or as another program writes them."""

from __future__ import annotations

import time
from collections.abc import Callable

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.mapping.live.mapper import LiveMapper

_POLL_S = 0.1
"""Least time between two looks at a flight that grows."""


def replay_flight(
    mapper: LiveMapper, flight: Flight, speed: float = 1.0, progress: Progress = silent
) -> None:
    """Give the pictures at ``speed`` times their pace; those that cannot be read in time are dropped."""
    if flight.frames is None:
        return
    stamps_s, begin = flight.frames.stamps_s.tolist(), time.perf_counter()
    due_s = [(stamp_s - stamps_s[0]) / speed for stamp_s in stamps_s]
    for k, stamp_s in enumerate(stamps_s):
        now_s = time.perf_counter() - begin
        if k + 1 < len(due_s) and now_s > due_s[k + 1]:
            mapper.skip(stamp_s)
        else:
            time.sleep(max(0.0, due_s[k] - now_s))
            mapper.add(flight.frames.load(k), stamp_s)
        progress("live", k + 1, len(stamps_s))


def first_state(read: Callable[[], Flight], idle_s: float) -> Flight:
    """Read a growing flight until it has a camera, or for ``idle_s``. Raises ``InputError`` where it cannot
    be read then."""
    begin = time.perf_counter()
    while True:
        in_time = time.perf_counter() - begin < idle_s
        try:
            flight = read()
            if flight.camera is not None or not in_time:
                return flight
        except InputError:
            if not in_time:
                raise
        time.sleep(_POLL_S)


def follow_flight(
    mapper: LiveMapper, read: Callable[[], Flight], idle_s: float, progress: Progress = silent
) -> Flight:
    """Give the pictures of a growing flight as they appear, until none came for ``idle_s``.

    ``read`` reads the flight as it is now. Returns its last state.
    """
    given, newest_s, behind = 0, time.perf_counter(), True
    while True:
        begin = time.perf_counter()
        flight = read()
        mapper.refresh(flight)
        frames = flight.frames
        count = 0 if frames is None else len(frames)
        while frames is not None and given < count:
            image = frames.load(given)
            if image is None and given + 1 == count and begin - newest_s < idle_s:
                break  # it may still be written
            # What was there at the beginning is no reason to drop pictures.
            mapper.add(image, float(frames.stamps_s[given]), wait=behind)
            given, newest_s = given + 1, time.perf_counter()
            progress("live", given, 0)
        behind = False
        if time.perf_counter() - newest_s > idle_s:
            return flight
        time.sleep(max(_POLL_S, time.perf_counter() - begin))

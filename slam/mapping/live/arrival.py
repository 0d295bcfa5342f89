"""Pictures that arrive at the pace of a recording, or as another program writes them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted, either
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.messages import about, parsed
from slam.core.progress import Progress, silent
from slam.core.streams import STREAMS, Image
from slam.mapping.live.mapper import LiveMapper

_POLL_S = 0.1
"""Least time between two looks at a flight that grows."""


def replay_flight(
    mapper: LiveMapper,
    flight: Flight,
    speed: float = 1.0,
    progress: Progress = silent,
    is_ended: Callable[[], bool] = lambda: False,
) -> None:
    """Give the pictures at ``speed`` times their pace, to the last one or until the flight is ended.

    Those that cannot be read in time are dropped.
    """
    if flight.frames is None:
        return
    stamps_s, begin = flight.frames.stamps_s.tolist(), time.perf_counter()
    due_s = [(stamp_s - stamps_s[0]) / speed for stamp_s in stamps_s]
    for k, stamp_s in enumerate(stamps_s):
        now_s = time.perf_counter() - begin
        if k + 1 < len(due_s) and now_s > due_s[k + 1]:
            mapper.skip(stamp_s)
        else:
            _wait_until(begin + due_s[k], is_ended)
            if is_ended():
                return
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
    mapper: LiveMapper,
    read: Callable[[], Flight],
    idle_s: float,
    progress: Progress = silent,
    is_ended: Callable[[], bool] = lambda: False,
) -> None:
    """Give the pictures of a growing flight as they appear, until none came for ``idle_s`` or it is ended.

    ``read`` reads the flight as it is now. Pictures are told apart by their stamps, as rows may come late or
    the table may be started anew. A state that cannot be read is waited for, and the one before is kept.
    """
    followed, newest_s, behind = _Followed(), time.perf_counter(), True
    while not is_ended():
        begin = time.perf_counter()
        flight = followed.state(read)
        pause_s = max(_POLL_S, time.perf_counter() - begin)
        if flight is not None:
            mapper.refresh(flight)
            for stamp_s, image in followed.new_pictures(flight, begin - newest_s < idle_s, is_ended):
                # What was there at the beginning is no reason to drop pictures.
                mapper.add(image, stamp_s, wait=behind)
                newest_s = time.perf_counter()
                progress("live", len(followed.given_ns), 0)
        behind = False
        if time.perf_counter() - newest_s > idle_s:
            break
        _wait_until(time.perf_counter() + pause_s, is_ended)
    if followed.newest is not None:
        mapper.refresh(followed.with_warnings())


@dataclass
class _Followed:
    """A flight that grows, on the clock of its first state, and its pictures so far."""

    newest: Flight | None = None
    """The last state that could be read."""
    given_ns: list[int] = field(default_factory=list)
    """Stamps of the pictures that were mapped, increasing."""
    late_ns: set[int] = field(default_factory=set)
    """Stamps of the pictures that came after one of a later time."""
    error: str = ""
    """Why the present state cannot be read; empty where it can."""

    def state(self, read: Callable[[], Flight]) -> Flight | None:
        """Return the present state with the epoch of the first one; None where it cannot be read."""
        try:
            flight = read()
        except InputError as error:
            self.error = str(error)
            return None
        self.error = ""
        if self.newest is not None and flight.epoch_ns != self.newest.epoch_ns:
            epoch_ns = self.newest.epoch_ns
            later_s = (flight.epoch_ns - epoch_ns) * 1e-9
            flight = replace(
                flight.restamped(STREAMS, lambda stamps_s: stamps_s + later_s), epoch_ns=epoch_ns
            )
        self.newest = flight
        return flight

    def new_pictures(
        self, flight: Flight, is_growing: bool, is_ended: Callable[[], bool]
    ) -> Iterator[tuple[float, Image | None]]:
        """Yield time and picture of the rows after the last one that was mapped, until the flight is ended.

        Where the picture of the last row cannot be read and the flight ``is_growing``, it may still be
        written, and waits for the next state.
        """
        if flight.frames is None:
            return
        rows, stamps_ns = self._new_rows(flight), _stamps_ns(flight)
        for row in rows:
            if is_ended():
                return
            image = flight.frames.load(row)
            if image is None and row == rows[-1] and is_growing:
                return
            self.given_ns.append(int(stamps_ns[row]))
            yield float(flight.frames.stamps_s[row]), image

    def _new_rows(self, flight: Flight) -> list[int]:
        """Return the rows of pictures after the last one that was mapped, and count those that came late."""
        stamps_ns, given = _stamps_ns(flight), np.array(self.given_ns, dtype=np.int64)
        if not len(given):
            return list(range(len(stamps_ns)))
        is_new = stamps_ns > given[-1]
        self.late_ns |= set(stamps_ns[~is_new & ~np.isin(stamps_ns, given)].tolist())
        return np.flatnonzero(is_new).tolist()

    def with_warnings(self) -> Flight:
        """Return the last state, with warnings of what was left out or is no longer there."""
        assert self.newest is not None
        lines = []
        if late := len(self.late_ns):
            lines.append(
                about(
                    "cam0",
                    f"{counted(late, 'picture')} came after one of a later time and "
                    f"{either(late, 'was', 'were')} left out in flight",
                    "write rows in the order of their times",
                )
            )
        gone = len(set(self.given_ns) - set(_stamps_ns(self.newest).tolist()))
        if gone:
            lines.append(
                about(
                    "cam0",
                    f"data.csv was changed in flight: {counted(gone, 'picture')} that "
                    f"{either(gone, 'was', 'were')} mapped {either(gone, 'is', 'are')} no longer in it",
                    "the map keeps them, but readings of other sensors may be lost with them: append rows "
                    "only",
                )
            )
        if self.error:
            said = f"the flight could not be read at its end, and an earlier state is used: {self.error}"
            lines.append(parsed(said))
        return self.newest.with_warning(*lines)


def _stamps_ns(flight: Flight) -> NDArray[np.int64]:
    """Return the stamps of the pictures in nanoseconds since the epoch of the recorder's clock."""
    if flight.frames is None:
        return np.empty(0, np.int64)
    return flight.epoch_ns + np.round(flight.frames.stamps_s * 1e9).astype(np.int64)


def _wait_until(due_s: float, is_ended: Callable[[], bool]) -> None:
    """Wait until a time of `time.perf_counter`, or until the flight is ended."""
    while (left_s := due_s - time.perf_counter()) > 0 and not is_ended():
        time.sleep(min(left_s, _POLL_S))

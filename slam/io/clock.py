"""Sorting of the rows of all streams by time on one clock.

A recorder's clock may be set while it runs, rows may be written out of order or twice, and a bit may flip in
a stamp. One or two rows far from all others are dropped. A lasting jump back is removed, by the same amount
in every stream that shows it.

A jump ahead looks like a pause of the recorder. A sensor that pauses alone keeps its pause. Where no stream
has rows for longer than ``JUMP_NS``, a clock that was set interrupts no sensor: every stream then goes on
after its usual step. If they do, or after half a day, later rows of all streams are moved by the same
amount; if one does not, time has passed. Both are assumptions, and a remark names the one that is made. The
remaining rows are sorted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted
from slam.core.messages import Message, about
from slam.io.csv_table import CsvTable

JUMP_NS = 600 * 10**9
"""A shorter forward step is a pause of the sensor."""
LONGEST_PAUSE_NS = 12 * 3600 * 10**9
"""A longer silence of all streams is a clock that was set: no recorder waits in one file for a day."""
_ROWS_AT_CHANGES = frozenset({"command0"})
"""Streams that may have rows at changes alone: between these they are silent, and not interrupted."""
MIN_ROWS = 3
"""Least number of rows of a valid time segment; fewer rows are damage."""
UNSORTED_SHARE = 0.05
"""Share of backward steps above which the file is unsorted and the clock is correct."""


@dataclass(frozen=True)
class _Jump:
    """From file row ``row`` on, stamps are ``ahead_ns`` later than they should be."""

    row: int
    ahead_ns: int


def sort_by_time(
    tables: dict[str, CsvTable], trust_clock: bool = False
) -> tuple[dict[str, CsvTable], list[Message]]:
    """Return tables with strictly increasing stamps on one clock, and remarks on the repairs, one line each.

    ``trust_clock`` sorts only: long steps are then pauses, as between photographs.
    """
    remarks: list[Message] = []
    tables = {name: _without_twins(name, t, remarks) for name, t in tables.items()}
    if not trust_clock:
        jumps: dict[str, list[_Jump]] = {}
        recorded = {name: _recorded_ns(table) for name, table in tables.items()}
        for name, table in tables.items():
            others_ns = [stamps_ns for other, stamps_ns in recorded.items() if other != name]
            others = np.sort(np.concatenate([np.empty(0, np.int64), *others_ns]))
            tables[name], jumps[name] = _find_jumps(name, table, others, remarks)
        _agree(tables, jumps)
        tables = {name: _unjumped(name, t, jumps[name], remarks) for name, t in tables.items()}
        tables = _without_common_jumps(tables, remarks)
    return {name: _sorted(name, table, remarks) for name, table in tables.items()}, remarks


def _without_twins(name: str, table: CsvTable, remarks: list[Message]) -> CsvTable:
    """Drop rows that repeat another row's stamp and content."""
    if not len(table.stamps_ns) or len(np.unique(table.stamps_ns)) == len(table.stamps_ns):
        return table
    seen: set[object] = set()
    keep = []
    for k, stamp in enumerate(table.stamps_ns.tolist()):
        key = (stamp, table.values[k].tobytes(), table.names[k] if table.names else "")
        if key not in seen:
            seen.add(key)
            keep.append(k)
    if dropped := len(table.stamps_ns) - len(keep):
        remarks.append(
            about(name, f"{counted(dropped, 'repeated row')} dropped, one of each is kept").as_note()
        )
    rows = np.array(keep)
    return table.rows(rows, table.stamps_ns[rows])


def _interval_ns(stamps_ns: NDArray[np.int64]) -> float:
    steps = np.diff(stamps_ns)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 1e9


def _recorded_ns(table: CsvTable) -> NDArray[np.int64]:
    """Return the sorted stamps of a stream without one or two that lie far from all others."""
    ordered = np.sort(table.stamps_ns)
    runs = np.split(ordered, np.flatnonzero(np.diff(ordered) > JUMP_NS) + 1)
    return np.concatenate([np.empty(0, np.int64), *(run for run in runs if len(run) >= MIN_ROWS)])


def _count_between(ordered_ns: NDArray[np.int64], first: int, last: int) -> int:
    """Return the number of sorted stamps between two, without these."""
    return int(np.searchsorted(ordered_ns, last) - np.searchsorted(ordered_ns, first, "right"))


def _is_pause(ordered_ns: NDArray[np.int64], others_ns: NDArray[np.int64], first: int, last: int) -> bool:
    """Return whether a stream has no row between two of its stamps, while the other streams go on."""
    if _count_between(ordered_ns, first, last):
        return False
    inside = others_ns[np.searchsorted(others_ns, first) : np.searchsorted(others_ns, last, "right")]
    return bool(np.diff(np.concatenate(([first], inside, [last]))).max() <= JUMP_NS)


def _breaks(stamps_ns: NDArray[np.int64], others_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the file rows at which the clock may have jumped.

    A backward step is a clock jump where the runs before and after it overlap in time (rows are denser than
    the sensor's rate), or where it is long and almost empty, or where it ends or begins a run of one or two
    rows far ahead or back. Otherwise rows are out of order. A long forward step is none where the other
    streams, with the sorted stamps ``others_ns``, go on.
    """
    steps = np.diff(stamps_ns)
    back = np.flatnonzero(steps < 0) + 1
    if len(back) > UNSORTED_SHARE * len(stamps_ns) + 2:
        return np.empty(0, np.int64)
    interval, ordered = _interval_ns(stamps_ns), np.sort(stamps_ns)
    far_ahead = (np.flatnonzero(steps > max(JUMP_NS, 100 * interval)) + 1).tolist()
    ends = {row: (int(stamps_ns[row - 1]), int(stamps_ns[row])) for row in far_ahead}
    ahead = {row for row, (first, last) in ends.items() if not _is_pause(ordered, others_ns, first, last)}
    rows = list(ahead)
    edges = sorted([0, *back.tolist(), *ahead, len(stamps_ns)])
    for start, row, end in zip(edges, edges[1:], edges[2:], strict=False):
        if row in ahead:
            continue
        strays = (row - start < MIN_ROWS and start in ahead) or (end - row < MIN_ROWS and end in ahead)
        shared_from = max(stamps_ns[start], stamps_ns[row])
        shared_to = min(stamps_ns[row - 1], stamps_ns[end - 1])
        twice = _rows_per_expected(ordered, shared_from, shared_to, interval) > 1.5
        far = int(stamps_ns[row - 1]) - int(stamps_ns[row]) > JUMP_NS
        empty = _rows_per_expected(ordered, stamps_ns[row], stamps_ns[row - 1], interval) < 0.5
        if strays or twice or (far and empty):
            rows.append(row)
    return np.unique(np.array(rows, dtype=np.int64))


def _rows_per_expected(ordered_ns: NDArray[np.int64], first: int, last: int, interval_ns: float) -> float:
    """Return the row count between two stamps over the expected count; 0 with too few rows to decide."""
    inside = int(np.searchsorted(ordered_ns, last, "right") - np.searchsorted(ordered_ns, first))
    return max(inside - MIN_ROWS, 0) / max((int(last) - int(first)) / interval_ns, 1.0)


def _find_jumps(
    name: str, table: CsvTable, others_ns: NDArray[np.int64], remarks: list[Message]
) -> tuple[CsvTable, list[_Jump]]:
    """Find the jumps back of one stream, and those ahead that it undoes, and drop rows with isolated stamps.

    After a jump ahead that is undone, the stream itself has rows between the ends of the step.
    """
    starts = _breaks(table.stamps_ns, others_ns)
    if not len(starts):
        return table, []
    pieces = np.split(np.arange(len(table.stamps_ns)), starts)
    kept = _without_strays(table.stamps_ns, pieces)
    rows = np.concatenate(kept)
    if dropped := len(table.stamps_ns) - len(rows):
        remarks.append(
            about(
                name,
                f"{counted(dropped, 'row')} dropped whose stamps lie far from all others",
                "correct the stamps if they belong to the flight",
            )
        )
    stamps = table.stamps_ns[rows]
    interval, ordered = round(_interval_ns(stamps)), np.sort(stamps)
    jumps = []
    for row in np.cumsum([len(piece) for piece in kept])[:-1]:
        first, last = int(stamps[row - 1]), int(stamps[row])
        step = last - first
        if step < 0 or (step > JUMP_NS and _count_between(ordered, first, last)):
            jumps.append(_Jump(int(row), step - interval))
    return table.rows(rows, stamps), jumps


def _without_strays(stamps_ns: NDArray[np.int64], pieces: list[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
    """Return the long pieces and tiny ones that fit between them; all where every piece is tiny."""
    long = [k for k, piece in enumerate(pieces) if len(piece) >= MIN_ROWS]
    kept = []
    for k, piece in enumerate(pieces):
        first, last = stamps_ns[piece[0]], stamps_ns[piece[-1]]
        before = [stamps_ns[pieces[j][-1]] for j in long if j < k][-1:]
        after = [stamps_ns[pieces[j][0]] for j in long if j > k][:1]
        distances = [*(first - b for b in before), *(a - last for a in after)]
        if k in long or not long or (min(distances) > 0 and min(distances) <= JUMP_NS):
            kept.append(piece)
    return kept


def _agree(tables: dict[str, CsvTable], jumps: dict[str, list[_Jump]]) -> None:
    """Set one amount for a jump seen in several streams: that of the stream with the shortest interval.

    Each stream determines a jump to within its own interval only; different amounts would break the
    alignment.
    """
    interval = {name: _interval_ns(t.stamps_ns) for name, t in tables.items()}
    done: list[tuple[int, float]] = []
    for name in sorted(jumps, key=lambda n: interval[n]):
        for k, jump in enumerate(jumps[name]):
            known = [a for a, wide in done if abs(a - jump.ahead_ns) < 2 * (wide + interval[name]) + 1e9]
            if known:
                jumps[name][k] = _Jump(jump.row, known[0])
            else:
                done.append((jump.ahead_ns, interval[name]))


def _unjumped(name: str, table: CsvTable, jumps: list[_Jump], remarks: list[Message]) -> CsvTable:
    if not jumps:
        return table
    stamps = table.stamps_ns.copy()
    for jump in jumps:
        stamps[jump.row :] -= jump.ahead_ns
        remarks.append(_jump_remark(name, table, jump))
    return table.rows(np.arange(len(stamps)), stamps)


def _jump_remark(name: str, table: CsvTable, jump: _Jump) -> Message:
    way = "ahead" if jump.ahead_ns > 0 else "back"
    return about(
        name,
        f"the clock jumps {way} by {abs(jump.ahead_ns) * 1e-9:.3f} s at {table.row_word} "
        f"{table.lines[jump.row]}",
        "later stamps were moved to continue, assuming that no time was lost",
        "if the recorder paused there, map the parts before and after as two flights",
    )


@dataclass(frozen=True)
class _Silence:
    """A time in which no stream has a row. Times are in ns on the recorder's clock."""

    last_ns: int
    """Last stamp before it of the streams that have rows on both sides."""
    next_ns: int
    """First stamp after it."""
    interval_ns: float
    """Shortest usual step of the streams on both sides."""
    broken: str
    """A stream that goes on after a longer step than a clock that is set would make; else empty."""

    @property
    def ahead_ns(self) -> int:
        """Amount by which a clock that is set here jumps ahead."""
        return self.next_ns - self.last_ns - round(self.interval_ns)

    @staticmethod
    def between(stamps_ns: dict[str, NDArray[np.int64]], next_ns: int) -> _Silence | None:
        """Return the silence before ``next_ns``; None where no stream shows a long step."""
        both = {name: s for name, s in stamps_ns.items() if len(s) and s[0] < next_ns <= s[-1]}
        if not both:  # some streams begin after the others have ended
            return None
        after = {name: int(np.searchsorted(s, next_ns)) for name, s in both.items()}
        last_ns = max(int(both[name][row - 1]) for name, row in after.items())
        interval_ns = min(_interval_ns(s) for s in both.values())
        found = _Silence(last_ns, next_ns, interval_ns, "")
        if next_ns - last_ns <= max(JUMP_NS, 100 * interval_ns):
            return None
        for name, row in after.items() if found.ahead_ns <= LONGEST_PAUSE_NS else ():
            if name in _ROWS_AT_CHANGES:
                continue
            steps = np.diff(both[name])
            usual = steps[steps <= JUMP_NS].max(initial=round(2 * _interval_ns(both[name])))
            if len(both[name]) >= MIN_ROWS and steps[row - 1] - found.ahead_ns > usual:
                return replace(found, broken=name)
        return found


def _without_common_jumps(tables: dict[str, CsvTable], remarks: list[Message]) -> dict[str, CsvTable]:
    """Remove the jumps ahead, in every stream that has rows after them.

    The amount is that of the stream that shows it best; none overlaps its own rows after it. A stream that
    begins later is moved too.
    """
    ordered = {name: np.sort(table.stamps_ns) for name, table in tables.items()}
    union = np.unique(np.concatenate([np.empty(0, np.int64), *ordered.values()]))
    lost = {name: np.zeros(len(table.stamps_ns), np.int64) for name, table in tables.items()}
    for next_ns in union[1:][np.diff(union) > JUMP_NS].tolist():
        silence = _Silence.between(ordered, next_ns)
        if silence is None:
            continue
        if silence.broken:
            remarks.append(_pause_remark(tables, silence))
            continue
        for name, table in tables.items():
            if (later := table.stamps_ns >= next_ns).any():
                lost[name][later] += silence.ahead_ns
                jump = _Jump(int(np.argmax(later)), silence.ahead_ns)
                remarks.append(_jump_remark(name, table, jump))
    return {
        name: table.rows(np.arange(len(table.stamps_ns)), table.stamps_ns - lost[name])
        if lost[name].any()
        else table
        for name, table in tables.items()
    }


def _pause_remark(tables: dict[str, CsvTable], silence: _Silence) -> Message:
    name = next(name for name, table in tables.items() if silence.next_ns in table.stamps_ns)
    row = int(np.argmax(tables[name].stamps_ns == silence.next_ns))
    return about(
        name,
        f"no stream has rows for {(silence.next_ns - silence.last_ns) * 1e-9:.0f} s before "
        f"{tables[name].row_word} {tables[name].lines[row]}",
        f"taken as time that passed, because {silence.broken} is interrupted for longer than the others",
        "if the clock was set there, correct the stamps",
    )


def _sorted(name: str, table: CsvTable, remarks: list[Message]) -> CsvTable:
    """Make stamps strictly increasing: sort the rows and keep the first of equal stamps."""
    stamps = table.stamps_ns
    late = int((np.diff(stamps) < 0).sum())
    if late:
        remarks.append(about(name, f"rows out of order in {counted(late, 'place')}, sorted by their stamps"))
    order = np.argsort(stamps, kind="stable")
    first = np.ones(len(stamps), dtype=bool)
    first[1:] = np.diff(stamps[order]) > 0
    if not first.all():
        remarks.append(
            about(
                name,
                f"{counted(int((~first).sum()), 'row')} with the stamp of another row dropped",
                "check the recorder if they are many",
            )
        )
    if not late and first.all():
        return table
    return table.rows(order[first], stamps[order[first]])

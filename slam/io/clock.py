"""Sorting of the rows of all streams by time on one clock.

A recorder's clock may be set while it runs, rows may be written out of order or twice, and a bit may flip in
a stamp. One or two rows far from all others are dropped. A lasting jump is removed, by the same amount in
every stream that shows it. The remaining rows are sorted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted
from slam.core.messages import Note
from slam.io.csv_stream import CsvTable

JUMP_NS = 600 * 10**9
"""A longer forward step is a clock jump, not a pause of the sensor."""
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
) -> tuple[dict[str, CsvTable], list[str]]:
    """Return tables with strictly increasing stamps on one clock, and remarks on the repairs, one line each.

    ``trust_clock`` sorts only: long steps are then pauses, as between photographs.
    """
    remarks: list[str] = []
    tables = {name: _without_twins(name, t, remarks) for name, t in tables.items()}
    jumps: dict[str, list[_Jump]] = {}
    for name, table in tables.items():
        found = (table, []) if trust_clock else _find_jumps(name, table, remarks)
        tables[name], jumps[name] = found
    _agree(tables, jumps)
    return {
        name: _sorted(name, _unjumped(name, t, jumps[name], remarks), remarks) for name, t in tables.items()
    }, remarks


def _without_twins(name: str, table: CsvTable, remarks: list[str]) -> CsvTable:
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
        remarks.append(Note(f"{name}: {counted(dropped, 'repeated row')} dropped, one of each is kept"))
    rows = np.array(keep)
    return table.rows(rows, table.stamps_ns[rows])


def _interval_ns(stamps_ns: NDArray[np.int64]) -> float:
    steps = np.diff(stamps_ns)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 1e9


def _breaks(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the file rows at which the clock jumped.

    A backward step is a clock jump where the runs before and after it overlap in time (rows are denser than
    the sensor's rate), or where it is long and almost empty. Otherwise rows are out of order.
    """
    steps = np.diff(stamps_ns)
    back = np.flatnonzero(steps < 0) + 1
    if len(back) > UNSORTED_SHARE * len(stamps_ns) + 2:
        return np.empty(0, np.int64)
    interval = _interval_ns(stamps_ns)
    rows = (np.flatnonzero(steps > max(JUMP_NS, 100 * interval)) + 1).tolist()
    ordered = np.sort(stamps_ns)
    edges = [0, *back.tolist(), len(stamps_ns)]
    for start, row, end in zip(edges, edges[1:], edges[2:], strict=False):
        shared_from = max(stamps_ns[start], stamps_ns[row])
        shared_to = min(stamps_ns[row - 1], stamps_ns[end - 1])
        twice = _rows_per_expected(ordered, shared_from, shared_to, interval) > 1.5
        far = int(stamps_ns[row - 1]) - int(stamps_ns[row]) > JUMP_NS
        if twice or (far and _rows_per_expected(ordered, stamps_ns[row], stamps_ns[row - 1], interval) < 0.5):
            rows.append(row)
    return np.unique(np.array(rows, dtype=np.int64))


def _rows_per_expected(ordered_ns: NDArray[np.int64], first: int, last: int, interval_ns: float) -> float:
    """Return the row count between two stamps over the expected count; 0 with too few rows to decide."""
    inside = int(np.searchsorted(ordered_ns, last, "right") - np.searchsorted(ordered_ns, first))
    return max(inside - MIN_ROWS, 0) / max((int(last) - int(first)) / interval_ns, 1.0)


def _find_jumps(name: str, table: CsvTable, remarks: list[str]) -> tuple[CsvTable, list[_Jump]]:
    """Find lasting jumps of one stream and drop rows with isolated stamps."""
    starts = _breaks(table.stamps_ns)
    if not len(starts):
        return table, []
    pieces = np.split(np.arange(len(table.stamps_ns)), starts)
    kept = _without_strays(table.stamps_ns, pieces)
    rows = np.concatenate(kept)
    if dropped := len(table.stamps_ns) - len(rows):
        remarks.append(
            f"{name}: {counted(dropped, 'row')} dropped whose stamps lie far from all others; correct the "
            "stamps if "
            "they belong to the flight"
        )
    stamps = table.stamps_ns[rows]
    interval = round(_interval_ns(stamps))
    jumps = []
    for row in np.cumsum([len(piece) for piece in kept])[:-1]:
        step = int(stamps[row] - stamps[row - 1])
        if step < 0 or step > JUMP_NS:
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


def _unjumped(name: str, table: CsvTable, jumps: list[_Jump], remarks: list[str]) -> CsvTable:
    if not jumps:
        return table
    stamps = table.stamps_ns.copy()
    for jump in jumps:
        stamps[jump.row :] -= jump.ahead_ns
        way = "ahead" if jump.ahead_ns > 0 else "back"
        remarks.append(
            f"{name}: the clock jumps {way} by {abs(jump.ahead_ns) * 1e-9:.3f} s at {table.row_word} "
            f"{table.lines[jump.row]}; later stamps were moved to continue, assuming that no time was "
            "lost; compare the map with the ground there"
        )
    return table.rows(np.arange(len(stamps)), stamps)


def _sorted(name: str, table: CsvTable, remarks: list[str]) -> CsvTable:
    """Make stamps strictly increasing: sort the rows and keep the first of equal stamps."""
    stamps = table.stamps_ns
    late = int((np.diff(stamps) < 0).sum())
    if late:
        remarks.append(f"{name}: rows out of order in {counted(late, 'place')}, sorted by their stamps")
    order = np.argsort(stamps, kind="stable")
    first = np.ones(len(stamps), dtype=bool)
    first[1:] = np.diff(stamps[order]) > 0
    if not first.all():
        remarks.append(
            f"{name}: {counted(int((~first).sum()), 'row')} with the stamp of another row dropped; check "
            "the recorder "
            "if they are many"
        )
    if not late and first.all():
        return table
    return table.rows(order[first], stamps[order[first]])

"""Putting the rows of all streams in order of one clock.

A recorder's clock may be set while it runs, rows may be written out of order or twice, a bit may flip in a
stamp. Each leaves its mark in the stamps as the file has them: a row or two far from all others are dropped,
a lasting jump is taken back, by the same amount in every stream that shows it, and the rest is sorted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.io.csv_stream import CsvTable

JUMP_NS = 600 * 10**9
"""A step ahead longer than this is the clock's, not a pause of the sensor."""
MIN_ROWS = 3
"""Fewer rows than this on their own stretch of time are damage, not a stretch."""
UNSORTED_SHARE = 0.05
"""Where more of the steps go back than this, the file is unsorted, its clock sound."""


@dataclass(frozen=True)
class _Jump:
    """From file row ``row`` on, stamps are ``ahead_ns`` later than they should be."""

    row: int
    ahead_ns: int


def sort_by_time(
    tables: dict[str, CsvTable], trust_clock: bool = False
) -> tuple[dict[str, CsvTable], list[str]]:
    """Tables with strictly increasing stamps on one clock, and what was done to them, one line each.

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
        remarks.append(f"{name}: {dropped} repeated rows dropped")
    rows = np.array(keep)
    return table.rows(rows, table.stamps_ns[rows])


def _interval_ns(stamps_ns: NDArray[np.int64]) -> float:
    steps = np.diff(stamps_ns)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 1e9


def _breaks(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """File rows where the clock, not the sensor, made the step.

    A step back is the clock's where the runs before and after it share a stretch of time (rows stand denser
    there than the sensor gives them), or where it is long and almost empty; else rows are out of order.
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
        far = stamps_ns[row - 1] - stamps_ns[row] > JUMP_NS
        if twice or (far and _rows_per_expected(ordered, stamps_ns[row], stamps_ns[row - 1], interval) < 0.5):
            rows.append(row)
    return np.unique(np.array(rows, dtype=np.int64))


def _rows_per_expected(ordered_ns: NDArray[np.int64], first: int, last: int, interval_ns: float) -> float:
    """How much denser rows stand between two stamps than the sensor gives them; 0 where too few to tell."""
    inside = int(np.searchsorted(ordered_ns, last, "right") - np.searchsorted(ordered_ns, first))
    return max(inside - MIN_ROWS, 0) / max((last - first) / interval_ns, 1.0)


def _find_jumps(name: str, table: CsvTable, remarks: list[str]) -> tuple[CsvTable, list[_Jump]]:
    """Lasting jumps of one stream; rows whose stamps stand alone are dropped on the way."""
    starts = _breaks(table.stamps_ns)
    if not len(starts):
        return table, []
    pieces = np.split(np.arange(len(table.stamps_ns)), starts)
    kept = _without_strays(table.stamps_ns, pieces)
    rows = np.concatenate(kept)
    if dropped := len(table.stamps_ns) - len(rows):
        remarks.append(f"{name}: {dropped} rows dropped whose stamps lie far from all others")
    stamps = table.stamps_ns[rows]
    interval = round(_interval_ns(stamps))
    jumps = []
    for row in np.cumsum([len(piece) for piece in kept])[:-1]:
        step = int(stamps[row] - stamps[row - 1])
        if step < 0 or step > JUMP_NS:
            jumps.append(_Jump(int(row), step - interval))
    return table.rows(rows, stamps), jumps


def _without_strays(stamps_ns: NDArray[np.int64], pieces: list[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
    """Pieces of some rows, and tiny ones that fit in between; all where every one is tiny."""
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
    """One amount for a jump that several streams show: that of the stream with the shortest interval.

    Each stream knows a jump only to within its own interval; apart, they would lose their alignment.
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
            f"{name}: the clock jumps {way} by {abs(jump.ahead_ns) * 1e-9:.3f} s at line "
            f"{table.lines[jump.row]}; later stamps were moved to continue, assuming that no time was lost"
        )
    return table.rows(np.arange(len(stamps)), stamps)


def _sorted(name: str, table: CsvTable, remarks: list[str]) -> CsvTable:
    """Strictly increasing stamps: out-of-order rows sorted in, of equal stamps the first kept."""
    stamps = table.stamps_ns
    late = int((np.diff(stamps) < 0).sum())
    if late:
        remarks.append(f"{name}: rows out of order in {late} places, sorted")
    order = np.argsort(stamps, kind="stable")
    first = np.ones(len(stamps), dtype=bool)
    first[1:] = np.diff(stamps[order]) > 0
    if not first.all():
        remarks.append(f"{name}: {int((~first).sum())} rows with the stamp of another row dropped")
    if not late and first.all():
        return table
    return table.rows(order[first], stamps[order[first]])

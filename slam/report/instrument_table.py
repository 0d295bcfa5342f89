"""Table of the instruments of a flight: which were recorded, and the share of each in the error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from slam.core.estimate import Estimate
from slam.core.figure_table import FigureTable
from slam.report.advice import WORDS

if TYPE_CHECKING:
    from slam.core.flight import Flight

_TITLE = (
    "Instruments, and the share of each in the squared error that is left at the place farthest from the "
    "start. An estimate follows its instruments the more, the more accurate they are: the one with the "
    "largest share carries that direction, and limits it. Not used: the others tell more, or a warning "
    "says why"
)
_COLUMNS = ("instrument", "readings", "place (x, y)", "height (z)", "heading", "scale of lengths")
_STREAMS: Mapping[str, tuple[str, ...]] = {
    "pictures": ("frames",),
    "range": ("sonar",),
    "position": ("gps",),
    "imu": ("imu",),
    "attitude": ("attitude",),
    "velocity": ("velocity",),
    "barometer": ("barometer",),
}
"""Name of a share -> fields of the flight that hold the readings."""
_DIRECTIONS = (("x", "y"), ("z",), ("yaw",), ("scale",))
NOT_USED = "not used"
_NOTABLE = 0.005
"""Share that is rounded to 1 %: without readings, a smaller one is not listed."""


def instrument_table(estimate: Estimate, flight: Flight | None) -> tuple[FigureTable, ...]:
    """Return the table; none without a refinement, which alone knows the shares."""
    shares = estimate.information_shares
    if flight is None or not shares:
        return ()
    names = [*_STREAMS, *(name for row in shares.values() for name in row if name not in _STREAMS)]
    rows = []
    for name in dict.fromkeys(names):
        count = _readings(flight, name)
        if not count and max((row.get(name, 0.0) for row in shares.values()), default=0.0) < _NOTABLE:
            continue
        rows.append((WORDS.get(name, name.replace("_", " ")), count or "", *_cells(shares, name)))
    return (FigureTable(_TITLE, _COLUMNS, tuple(rows)),)


def _readings(flight: Flight, name: str) -> str:
    series = [getattr(flight, field) for field in _STREAMS.get(name, ())]
    return ", ".join(str(len(one.stamps_s)) for one in series if one is not None)


def _cells(shares: Mapping[str, Mapping[str, float]], name: str) -> tuple[str, ...]:
    if not any(name in row for row in shares.values()):
        return (NOT_USED, "", "", "")
    cells = []
    for axes in _DIRECTIONS:
        known = [shares[axis].get(name, 0.0) for axis in axes if axis in shares]
        cells.append(f"{100 * sum(known) / len(known):.0f} %" if known else "")
    return tuple(cells)

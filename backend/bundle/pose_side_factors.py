"""The factors of everything but the floor points, each with what it measures.

Where a factor is made, it is known what it measures and which keyframe. From its keys and its size nobody can
tell: a measured position and a reported motion both have three rows, a pose and the world.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

Kind = Literal[
    "attitude",
    "range",
    "position",
    "barometer height",
    "barometer prior",
    "mark",
    "survey",
    "lens prior",
    "readout prior",
    "world prior",
    "gauge",
    "aligned pair",
    "frame homography",
    "inertial interval",
    "inertial prior",
    "reported interval",
    "reported prior",
]
"""Quantity that a factor measures or holds."""
_INSTRUMENT: Mapping[Kind, str] = {
    "attitude": "attitude",
    "range": "range",
    "position": "position",
    "barometer height": "barometer",
    "barometer prior": "barometer",
    "mark": "control",
    "survey": "control",
    "lens prior": "pictures",
    "readout prior": "pictures",
    "gauge": "assumed",
    "aligned pair": "pictures",
    "frame homography": "pictures",
    "inertial interval": "imu",
    "inertial prior": "imu",
}
"""Instrument of all rows of a factor; those of other kinds differ from row to row."""
_KEYFRAME = gtsam.Symbol(POSE(0)).chr()


class _Rows(NamedTuple):
    """The rows of one factor."""

    kind: Kind
    instruments: tuple[str, ...]
    """Instrument of each row."""
    keyframe: int
    """The first keyframe that the factor concerns; -1 without any."""


class PoseSideFactors:
    """Sensors, priors and gauge: a factor graph whose rows are known by kind, instrument and keyframe."""

    def __init__(self) -> None:
        self._graph = gtsam.NonlinearFactorGraph()
        self._rows: list[_Rows] = []

    def add(
        self, kind: Kind, factor: gtsam.NonlinearFactor, instruments: Sequence[str] | None = None
    ) -> None:
        """Add a factor. ``instruments`` are those of its rows, where they differ."""
        self._graph.push_back(factor)
        named = (_INSTRUMENT[kind],) * factor.dim() if instruments is None else tuple(instruments)
        symbols = map(gtsam.Symbol, factor.keys())
        keyframe = next((symbol.index() for symbol in symbols if symbol.chr() == _KEYFRAME), -1)
        self._rows.append(_Rows(kind, named, keyframe))

    @property
    def graph(self) -> gtsam.NonlinearFactorGraph:
        """All factors, in a graph of their own: what is added to that has no kind, and does not count."""
        return gtsam.NonlinearFactorGraph(self._graph)

    def of_kind(self, kind: Kind) -> Iterator[gtsam.NonlinearFactor]:
        """Yield the factors of a kind, in the order in which they were added."""
        return (self._graph.at(number) for number, rows in enumerate(self._rows) if rows.kind == kind)

    def rows_of(self, kind: Kind) -> NDArray[np.bool_]:
        """Return (rows,) which rows of the Jacobian belong to factors of a kind."""
        return np.repeat([rows.kind == kind for rows in self._rows], self._sizes)

    @property
    def instruments(self) -> list[str]:
        """Instrument of each row."""
        return [name for rows in self._rows for name in rows.instruments]

    @property
    def keyframes(self) -> NDArray[np.int64]:
        """(rows,) first keyframe that the factor of each row concerns, -1 without any."""
        return np.repeat(np.array([rows.keyframe for rows in self._rows], dtype=np.int64), self._sizes)

    @property
    def _sizes(self) -> list[int]:
        return [len(rows.instruments) for rows in self._rows]

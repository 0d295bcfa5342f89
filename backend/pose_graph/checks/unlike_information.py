"""Edges whose information is orders of magnitude unlike that of the other edges of a file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted

Array = NDArray[np.float64]

_LEAST = 3.0
"""Decades of a difference that no two sensors of a vehicle explain; measured graphs have 2 within a kind."""
_WIDE = 3.0
"""Multiples of the range of the middle 80 % beyond which a whole matrix is unlike the others."""
_TAIL = 0.1
"""Largest share of the edges that a gap separates: more are another kind of edge, not a mistake."""
_NONE = 1e-12
"""Share of the median to which smaller values are raised: rounding cannot tell them from zero."""


def unlike_information(lines: NDArray[np.int64], information: Array) -> list[str]:
    """Return a warning about unlike information (n, d, d), rotation first, of edges in these lines.

    The others set the scale. A trace is unlike them beyond three times the range of their middle 80 %, or a
    factor of a thousand if that is more. One direction alone, which the trace hides, may differ by as much in
    a healthy graph, with all sizes between. There a gap counts, of a factor of a thousand or of that range.
    """
    if len(information) == 0:
        return []
    trace = np.trace(information, axis1=1, axis2=2)
    decades = np.zeros(len(information))
    _extend(decades, _far(_log10(trace)))
    turns = 1 if information.shape[1] == 3 else 3
    for block in (slice(None, turns), slice(turns, None)):
        for values in np.linalg.eigvalsh(information[:, block, block]).T:
            _extend(decades, _beyond_gap(_log10(values)))
    unlike = np.flatnonzero(decades)
    if len(unlike) == 0:
        return []
    first = unlike[0]
    return [
        f"the information of {counted(len(unlike), 'edge')} is unlike that of the others by a factor of a "
        f"thousand or more (the first is in line {lines[first]}, {10 ** decades[first]:.2g} times the "
        "median); check it"
    ]


def _extend(decades: Array, found: Array) -> None:
    """Keep the larger differences in place."""
    larger = np.abs(found) > np.abs(decades)
    decades[larger] = found[larger]


def _log10(values: Array) -> Array:
    positive = values[values > 0]
    if len(positive) == 0:
        return np.zeros(len(values))
    return np.log10(np.maximum(values, _NONE * float(np.median(positive))))


def _far(size: Array) -> Array:
    """Return the differences (n,) from the median where they are beyond the range of the others, else 0."""
    low, middle, high = np.quantile(size, (0.1, 0.5, 0.9))
    off = size - middle
    return np.where(np.abs(off) > _WIDE * max(high - low, _LEAST / _WIDE), off, 0.0)


def _beyond_gap(size: Array) -> Array:
    """Return the differences (n,) from the median of those that a gap separates from the others, else 0."""
    low, middle, high = np.quantile(size, (_TAIL, 0.5, 1 - _TAIL))
    least, most = max(_LEAST, high - low), int(_TAIL * len(size))
    order = np.argsort(size)
    wide = np.flatnonzero(np.diff(size[order]) > least) + 1  # numbers of edges below the gaps
    below = order[: max(wide[wide <= most], default=0)]
    above = order[min(wide[wide >= len(size) - most], default=len(size)) :]
    found = np.zeros(len(size))
    for separated in (below, above):
        found[separated] = size[separated] - middle
    return found

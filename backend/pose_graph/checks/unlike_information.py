"""Edges whose information is orders of magnitude unlike that of the other edges of a file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted

Array = NDArray[np.float64]

_LEAST_DECADES = 3.0
"""Decades of a difference that no two sensors of a vehicle explain; measured graphs have 2 within a kind."""
_RANGES = 3.0
"""Multiples of the range of the middle 80 % beyond which a whole matrix is unlike the others: 7.7 standard
deviations of normal ones."""
_TAIL = 0.1
"""Largest share of the edges that a gap separates: more are another kind of edge, not a mistake."""
_ROUNDING = 1e-12
"""Share of the median to which smaller values are raised: rounding cannot tell them from zero."""


def unlike_information(lines: NDArray[np.int64], information: Array) -> list[str]:
    """Return a warning about unlike information (n, d, d), rotation first, of edges in these lines.

    The others set the scale. A trace is unlike them beyond three times the range of their middle 80 %, or a
    factor of a thousand if that is more. The trace hides a single direction, in which edges of a healthy
    graph may differ by as much, with all sizes between. There a gap counts, of a factor of a thousand or of
    that range.
    """
    if len(information) == 0:
        return []
    found = [_far(_log10(np.trace(information, axis1=1, axis2=2)))]
    turns = 1 if information.shape[1] == 3 else 3
    for block in (slice(None, turns), slice(turns, None)):
        found += [
            _beyond_gap(_log10(values)) for values in np.linalg.eigvalsh(information[:, block, block]).T
        ]
    largest = np.abs(found).argmax(axis=0)
    decades = np.array(found)[largest, np.arange(len(information))]
    unlike = np.flatnonzero(decades)
    if len(unlike) == 0:
        return []
    first = unlike[0]
    return [
        f"the information of {counted(len(unlike), 'edge')} is unlike that of the others by a factor of a "
        f"thousand or more (the first is in line {lines[first]}, {10 ** decades[first]:.2g} times the "
        "median); check it"
    ]


def _log10(values: Array) -> Array:
    positive = values[values > 0]
    if len(positive) == 0:
        return np.zeros(len(values))
    return np.log10(np.maximum(values, _ROUNDING * float(np.median(positive))))


def _far(size: Array) -> Array:
    """Return the differences (n,) from the median where they are beyond the range of the others, else 0."""
    low, middle, high = np.quantile(size, (0.1, 0.5, 0.9))
    off = size - middle
    return np.where(np.abs(off) > max(_RANGES * (high - low), _LEAST_DECADES), off, 0.0)


def _beyond_gap(size: Array) -> Array:
    """Return the differences (n,) from the median of those that a gap separates from the others, else 0."""
    low, high = np.quantile(size, (0.1, 0.9))
    gap, most = max(_LEAST_DECADES, high - low), int(_TAIL * len(size))
    order = np.argsort(size)
    wide = np.flatnonzero(np.diff(size[order]) > gap) + 1  # numbers of edges below the gaps
    below, above = max(wide[wide <= most], default=0), min(wide[wide >= len(size) - most], default=len(size))
    found = size - np.median(size)
    found[order[below:above]] = 0.0
    return found

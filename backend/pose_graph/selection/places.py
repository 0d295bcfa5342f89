"""Pairs of places that loops join: loops between the same two places are true or false together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Index = NDArray[np.int64]

_PLACE_RADIUS = 3
"""Difference in pose numbers up to which the ends of two loops count as the same place."""
ROW_LENGTH = 20
"""Poses over which loops in a row count as one vote: where a floor repeats, false loops come in such rows.

`tests.benchmarks.selection_matrix` and `false_loops` check it: shorter rows vote for themselves, and a longer
one makes a whole lap of true loops a single vote.
"""


def place_pairs(i: Index, j: Index, length: int | None = None) -> Index:
    """Return (k,) labels of loops that join the same two places: chains of neighbours share a label.

    With ``length``, chains are cut into pieces of so many poses at either end: a whole lap of loops is no
    single place.
    """
    ends = np.column_stack([np.minimum(i, j), np.maximum(i, j)])
    pairs = cKDTree(ends).query_pairs(_PLACE_RADIUS, p=np.inf, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(i), len(i)))
    label = np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)
    if length is None or len(label) == 0:
        return label
    first = np.full((label.max() + 1, 2), ends.max() + 1)
    np.minimum.at(first, label, ends)
    pieces = np.column_stack([label, (ends - first[label]) // length])
    return np.asarray(np.unique(pieces, axis=0, return_inverse=True)[1], dtype=np.int64).ravel()

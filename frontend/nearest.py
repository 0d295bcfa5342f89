"""Nearest neighbours among many unit vectors, in time that grows with the square root of their number.

An inverted file: vectors are sorted into cells by their nearest of some 2 sqrt(n) centres, and a query looks
into the cells whose centres lie nearest. Up to some thousand vectors there is one cell: the answer is exact.
Source: Jégou, Douze, Schmid 2011 (product quantization for nearest neighbor search), section IV.

OpenCV's own indices were tried on 100 000 made signatures (``tests/benchmarks/retrieval.py``): its kd-forest
(FLANN) answers differently each time, and Annoy finds fewer places again in more time.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]

EXACT_UP_TO = 4000
PROBES = 16
"""Cells that a query looks into."""
SAMPLE_A_CELL = 20
"""Vectors that centres are found from."""
_BLOCK = 4096


class InvertedFile:
    """An index over unit vectors (n, d); the same for the same vectors and seed."""

    def __init__(self, vectors: Float, seed: int = 0) -> None:
        n = len(vectors)
        self._centres = vectors[:0] if n <= EXACT_UP_TO else _centres(vectors, int(2 * np.sqrt(n)), seed)
        self._half_norm = 0.5 * np.sum(self._centres**2, axis=1)
        cells = max(1, len(self._centres))
        cell = self._cell_of(vectors) if len(self._centres) else np.zeros(n, np.int64)
        self._order = np.argsort(cell, kind="stable")
        self._start = np.searchsorted(cell[self._order], np.arange(cells + 1))
        self._sorted = np.ascontiguousarray(vectors[self._order])

    def likely(self, vector: Float) -> tuple[NDArray[np.int64], Float]:
        """Rows of the cells nearest to a unit vector (d,), and their inner products with it."""
        if len(self._centres) == 0:
            return self._order, self._sorted @ vector
        score = self._centres @ vector - self._half_norm
        probed = np.argpartition(-score, PROBES)[:PROBES]
        spans = [slice(self._start[c], self._start[c + 1]) for c in probed]
        rows = np.concatenate([self._order[span] for span in spans])
        return rows, np.concatenate([self._sorted[span] @ vector for span in spans])

    def _cell_of(self, vectors: Float) -> NDArray[np.int64]:
        blocks = (vectors[k : k + _BLOCK] for k in range(0, len(vectors), _BLOCK))
        return np.concatenate(
            [np.argmax(block @ self._centres.T - self._half_norm, axis=1) for block in blocks]
        )


def _centres(vectors: Float, count: int, seed: int) -> Float:
    rng = np.random.default_rng(seed)
    sample = vectors[rng.choice(len(vectors), min(len(vectors), SAMPLE_A_CELL * count), replace=False)]
    cv2.setRNGSeed(seed)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 6, 1e-3)
    _, _, centres = cv2.kmeans(sample, count, None, stop, 1, cv2.KMEANS_RANDOM_CENTERS)
    return np.ascontiguousarray(centres, dtype=np.float32)

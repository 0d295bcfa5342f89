"""Approximate nearest neighbours among n unit vectors, in O(sqrt(n)) time for each query.

An inverted file assigns each vector to the nearest of about 2 sqrt(n) centres. A query searches the cells of
the nearest centres. Up to ``MAX_EXHAUSTIVE`` vectors there is one cell, and the result is exact.
Source: Jégou, Douze, Schmid 2011 (product quantization for nearest neighbor search), section IV.

OpenCV's indices were compared on 100 000 synthetic signatures (``tests/benchmarks/retrieval.py``). Results of
its kd-forest (FLANN) are not repeatable. Annoy recalls fewer places and takes more time.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]

MAX_EXHAUSTIVE = 4000
PROBES = 16
"""Number of cells that a query searches."""
TRAINING_PER_CELL = 20
"""Number of vectors per cell in the sample for k-means."""
_BLOCK_SIZE = 4096


class InvertedFile:
    """Index of unit vectors (n, d), deterministic for the same vectors and seed."""

    def __init__(self, vectors: Float, seed: int = 0) -> None:
        n = len(vectors)
        self._centres = vectors[:0] if n <= MAX_EXHAUSTIVE else _centres(vectors, int(2 * np.sqrt(n)), seed)
        self._half_norm = 0.5 * np.sum(self._centres**2, axis=1)
        cells = max(1, len(self._centres))
        cell = self._assign(vectors) if len(self._centres) else np.zeros(n, np.int64)
        self._order = np.argsort(cell, kind="stable")
        self._start = np.searchsorted(cell[self._order], np.arange(cells + 1))
        self._sorted = np.ascontiguousarray(vectors[self._order])

    def candidates(self, vector: Float) -> tuple[NDArray[np.int64], Float]:
        """Return the rows in the cells nearest to a unit vector (d,), and their inner products with it."""
        if len(self._centres) == 0:
            return self._order, self._sorted @ vector
        score = self._centres @ vector - self._half_norm
        probed = np.argpartition(-score, PROBES)[:PROBES]
        spans = [slice(self._start[c], self._start[c + 1]) for c in probed]
        rows = np.concatenate([self._order[span] for span in spans])
        return rows, np.concatenate([self._sorted[span] @ vector for span in spans])

    def _assign(self, vectors: Float) -> NDArray[np.int64]:
        blocks = (vectors[k : k + _BLOCK_SIZE] for k in range(0, len(vectors), _BLOCK_SIZE))
        return np.concatenate(
            [np.argmax(block @ self._centres.T - self._half_norm, axis=1) for block in blocks]
        )


def _centres(vectors: Float, count: int, seed: int) -> Float:
    rng = np.random.default_rng(seed)
    sample = vectors[rng.choice(len(vectors), min(len(vectors), TRAINING_PER_CELL * count), replace=False)]
    cv2.setRNGSeed(seed)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 6, 1e-3)
    _, _, centres = cv2.kmeans(sample, count, None, stop, 1, cv2.KMEANS_RANDOM_CENTERS)
    return np.ascontiguousarray(centres, dtype=np.float32)

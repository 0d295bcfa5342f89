"""Time and recall of the search for similar keyframes among 1 000, 10 000 and 100 000.

Signatures are synthetic: two noisy passes over a path through places whose neighbours share three quarters of
their content, in 128 dimensions of decreasing variance, as with principal components. One thread is used.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from frontend.inverted_file import InvertedFile
from tests.benchmarks.metric import Metric, at_least, at_most, reported

Float = NDArray[np.float32]
SIZES = (1_000, 10_000, 100_000)
DIMENSIONS, QUERIES, ANSWERS = 128, 300, 20
SHARED = 4
"""Number of consecutive keyframes that show a piece of ground."""


def measure() -> list[Metric]:
    """Times of a query by ours, by looking at all, and by OpenCV's index; the share of places recognised."""
    cv2.setNumThreads(1)
    metrics, seconds = [], {}
    with threadpool_limits(1):
        for n in SIZES:
            x = signatures(n)
            queries = np.random.default_rng(1).choice(n // 2, QUERIES, replace=False) + n // 2
            began = time.perf_counter()
            index = InvertedFile(x)
            built = time.perf_counter() - began
            seconds[n], found = timed(lambda k, x=x, index=index: ours(index, x[k]), queries, n)
            linear, most = timed(lambda k, x=x: highest(x @ x[k]), queries, n)
            metrics += [
                reported(f"{n} keyframes: a query", 1e3 * seconds[n], "ms", f"index built in {built:.1f} s"),
                reported(f"{n} keyframes: a query that looks at all", 1e3 * linear, "ms"),
                at_least(
                    f"{n} keyframes: places recognised",
                    100 * found,
                    "%",
                    95,
                    f"by looking at all {100 * most:.1f} %",
                ),
            ]
        annoy, again = timed(annoys(signatures(SIZES[-1])), queries, SIZES[-1])
    source = f"places recognised {100 * again:.1f} %"
    metrics.append(
        reported(f"{SIZES[-1]} keyframes: a query of OpenCV's Annoy index", 1e3 * annoy, "ms", source)
    )
    growth = seconds[SIZES[2]] / seconds[SIZES[1]]
    source = "sublinear: 10 were linear, 3.2 the square root"
    metrics.append(at_most("10 000 to 100 000 keyframes: time of a query grows", growth, "x", 7, source))
    return metrics


def signatures(n: int) -> Float:
    """Return (n, d) unit vectors; keyframes k and k + n / 2 are of one place."""
    rng, half = np.random.default_rng(0), n // 2
    ground = rng.normal(size=(half + SHARED - 1, DIMENSIONS))
    seen = sum(ground[k : k + half] for k in range(SHARED)) / np.sqrt(SHARED)
    x = np.concatenate([seen, seen]) + 0.5 * rng.normal(size=(n, DIMENSIONS))
    x *= np.arange(1, DIMENSIONS + 1) ** -0.35
    return (x / np.linalg.norm(x, axis=1, keepdims=True)).astype(np.float32)


def timed(
    query: Callable[[int], NDArray[np.int64]], queries: NDArray[np.int64], n: int
) -> tuple[float, float]:
    """Return the median seconds of a query, and the share whose answer contains the place's first visit."""
    seconds, hits = [], 0
    for k in queries.tolist():
        began = time.perf_counter()
        answer = query(k)
        seconds.append(time.perf_counter() - began)
        hits += bool((np.abs(answer - (k - n // 2)) < SHARED - 1).any())
    return float(np.median(seconds)), hits / len(queries)


def ours(index: InvertedFile, vector: Float) -> NDArray[np.int64]:
    """Return the most similar of the candidates."""
    rows, likeness = index.candidates(vector)
    return rows[highest(likeness)]


def highest(likeness: Float) -> NDArray[np.int64]:
    """Return the indices of the highest values."""
    return np.argpartition(-likeness, min(ANSWERS, len(likeness) - 1))[:ANSWERS]


def annoys(x: Float) -> Callable[[int], NDArray[np.int64]]:
    """Return a query of OpenCV's Annoy index with 16 trees."""
    index = cv2.ANNIndex_create(DIMENSIONS, cv2.ANNINDEX_DIST_EUCLIDEAN)
    index.setSeed(1)
    index.addItems(x)
    index.build(16)
    return lambda k: index.knnSearch(x[k : k + 1], ANSWERS, search_k=4000)[0].ravel().astype(np.int64)

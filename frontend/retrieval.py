"""Image retrieval: aggregated local descriptors (VLAD) and their nearest neighbours.

Source: Jégou et al. 2010 (VLAD); Arandjelovic and Zisserman 2013 (intra-normalisation).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.inverted_file import InvertedFile

Gate = Callable[[int, NDArray[np.int64]], NDArray[np.bool_]]
"""Return for a keyframe and others (m,) whether each pair may be compared."""
Float = NDArray[np.float32]


@dataclass(frozen=True)
class RetrievalConfig:
    """Size of the vocabulary, the signatures and the answer."""

    words: int = 64
    sample: int = 30_000
    """Descriptors that the vocabulary is built from."""
    neighbours: int = 10
    """Candidates per keyframe."""
    dimensions: int = 128
    """Principal components of the signatures that are kept."""


def vocabulary(
    descriptors: Iterable[NDArray[Any]], counts: Sequence[int], config: RetrievalConfig, seed: int = 0
) -> Float:
    """Return (words, d) cluster centres of a sample of the flight's own descriptors.

    ``counts``: number of descriptors of each picture; only the sample is kept in memory.
    """
    total = int(sum(counts))
    chosen = np.arange(total)
    if total > config.sample:
        chosen = np.random.default_rng(seed).choice(total, config.sample, replace=False)
    order, at, pool = np.argsort(chosen), 0, np.empty((0, 0), np.float32)
    ends = np.searchsorted(chosen[order], np.cumsum([0, *counts]))
    for picture, begin, end in zip(descriptors, ends[:-1], ends[1:], strict=True):
        sampled = as_float(picture[chosen[order[begin:end]] - at])
        if pool.size == 0:
            pool = np.empty((len(chosen), sampled.shape[1]), np.float32)
        pool[order[begin:end]] = sampled
        at += len(picture)
    words = min(config.words, max(1, len(pool) // 8))
    cv2.setRNGSeed(seed)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 12, 1e-4)
    _, _, centres = cv2.kmeans(pool, words, None, stop, 1, cv2.KMEANS_RANDOM_CENTERS)
    return np.ascontiguousarray(centres, dtype=np.float32)


def signature(descriptor: NDArray[Any], centres: Float) -> Float:
    """Return the VLAD (words * d,) of one picture, unit length; zeros for a picture without features."""
    words, d = centres.shape
    out = np.zeros((words, d), np.float32)
    if len(descriptor):
        x = as_float(descriptor)
        nearest = np.argmin(np.sum(centres**2, axis=1) - 2 * x @ centres.T, axis=1)
        np.add.at(out, nearest, x - centres[nearest])
        out /= np.linalg.norm(out, axis=1, keepdims=True) + 1e-12
    norm = np.linalg.norm(out)
    return (out / norm if norm > 0 else out).ravel()


def principal_components(signatures: Float, dimensions: int) -> Float:
    """Return the directions (d, w) of largest variance of signatures (n, w); d <= dimensions.

    Source: Jégou and Chum 2012. The component common to all pictures of one floor is removed.
    """
    centred = signatures - signatures.mean(axis=0)
    _, strength, directions = np.linalg.svd(centred, full_matrices=False)
    useful = int((strength > 1e-6 * max(float(strength[0]), 1e-12)).sum()) if len(strength) else 0
    return np.ascontiguousarray(directions[: max(1, min(dimensions, useful))], dtype=np.float32)


def compressed(vlad: Float, components: Float) -> Float:
    """Return the unit vector (d,) of one signature on the principal components."""
    x = components @ vlad
    norm = float(np.linalg.norm(x))
    return x / norm if norm > 0 else x


@dataclass(frozen=True)
class Appearance:
    """Appearance model that maps descriptors to short signatures, learnt from a sample of pictures."""

    centres: Float
    components: Float

    def of(self, descriptor: NDArray[Any]) -> Float:
        """Return the unit vector (w,) of one picture; the inner product of two is their similarity."""
        return compressed(signature(descriptor, self.centres), self.components)


@dataclass(frozen=True)
class Candidates:
    """Pairs i < j of similar appearance, the most similar first."""

    pairs: tuple[tuple[int, int], ...]
    """Nearest pairs of each keyframe among those that pass the gate."""
    gated: tuple[tuple[int, int], ...]
    """Nearest pairs that the gate rejects."""


def propose(signatures: Float, neighbours: int, gate: Gate) -> Candidates:
    """Propose the most similar keyframes of each one. ``signatures`` (n, w)."""
    index = InvertedFile(signatures)
    found: dict[tuple[int, int], float] = {}
    similarities: dict[tuple[int, int], float] = {}
    for j in range(len(signatures)):
        rows, similarity = index.candidates(signatures[j])
        open_to = gate(j, rows) & (rows != j)
        for k in _highest(similarity, neighbours + 1):
            if not open_to[k] and rows[k] != j:
                similarities[_sorted(int(rows[k]), j)] = float(similarity[k])
        rows, similarity = rows[open_to], similarity[open_to]
        for k in _highest(similarity, neighbours):
            found[_sorted(int(rows[k]), j)] = float(similarity[k])
    return Candidates(
        tuple(sorted(found, key=lambda pair: -found[pair])),
        tuple(sorted(similarities.keys() - found.keys(), key=lambda pair: -similarities[pair])),
    )


def _sorted(i: int, j: int) -> tuple[int, int]:
    return (i, j) if i < j else (j, i)


def _highest(values: Float, count: int) -> NDArray[np.int64]:
    """Return the indices of the highest values, the highest first."""
    few = np.argpartition(-values, count - 1)[:count] if len(values) > count else np.arange(len(values))
    return few[np.argsort(-values[few], kind="stable")]


def as_float(descriptor: NDArray[Any]) -> Float:
    """Return descriptors as vectors; bit strings are unpacked to one value per bit."""
    if descriptor.dtype == np.uint8:
        return np.unpackbits(descriptor, axis=1).astype(np.float32)
    return descriptor.astype(np.float32, copy=False)

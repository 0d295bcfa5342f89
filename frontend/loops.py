"""Loop closure: proposal of keyframe pairs and their geometric verification."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from frontend.camera import Camera
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.motions import Expectation
from frontend.registration import Registration, register
from frontend.retrieval import (
    Appearance,
    Candidates,
    Gate,
    RetrievalConfig,
    principal_components,
    propose,
    signature,
    vocabulary,
)
from frontend.store import FeatureStore, StoredFeatures
from frontend.workers import workers

Array = NDArray[np.float64]
Pair = tuple[int, int]

MOST_PAIRS = 8
"""Pairs that are compared in one job: a quarter of a second. Neighbouring pairs share keyframes, so that less
than 8 MB of features go to another machine at a time."""
CHUNKS = 8
"""Smallest number of jobs for each worker, where there are as many pairs: all workers then end together."""

_LOG = logging.getLogger(__name__)


def propose_loops(store: FeatureStore, config: RetrievalConfig, gate: Gate) -> Candidates:
    """Propose keyframe pairs of similar appearance; separate those that the gate rejects."""
    if len(store) < 2:
        return Candidates((), ())
    return propose(signatures(store, config), config.neighbours, gate)


def appearance(store: FeatureStore, config: RetrievalConfig) -> Appearance:
    """Learn the appearance model from a sample of the pictures, which is read twice to save memory."""
    sample = range(0, len(store), max(1, len(store) // 200))
    counts = [store.count(k) for k in sample]
    centres = vocabulary((store[k].descriptor for k in sample), counts, config)
    vlad = np.array([signature(store[k].descriptor, centres) for k in sample])
    return Appearance(centres, principal_components(vlad, config.dimensions))


def signatures(store: FeatureStore, config: RetrievalConfig) -> NDArray[np.float32]:
    """Return (n, d) one unit vector per keyframe; the inner product of two is their similarity."""
    learnt = appearance(store, config)
    return np.array([learnt.of(store[k].descriptor) for k in range(len(store))])


def overlapping(
    camera: Camera,
    w_T_b: Array,
    floor_z: float,
    min_overlap: float,
    neighbours: int,
    world: NDArray[np.int64] | None = None,
) -> list[Pair]:
    """Return pairs i < j with the largest footprint overlaps of each keyframe, by the poses (n, 4, 4).

    Further pairs join groups of keyframes that these leave apart although footprints overlap. Where many
    pictures are taken at one place, their largest overlaps are all among themselves.

    ``world`` (n,): poses of different ones have no place relative to each other. None: all are of one.
    """
    shares = _shares(camera, w_T_b, floor_z, min_overlap, world)
    of_each: list[list[tuple[float, int]]] = [[] for _ in w_T_b]
    for (i, j), share in shares.items():
        of_each[i].append((-share, j))
        of_each[j].append((-share, i))
    found: set[Pair] = set()
    for k, of in enumerate(of_each):
        found.update((min(k, other), max(k, other)) for _, other in sorted(of)[:neighbours])
    if len(found) < len(shares):
        found |= _joining(found, shares, len(w_T_b))
    return sorted(found)


def _shares(
    camera: Camera, w_T_b: Array, floor_z: float, min_overlap: float, world: NDArray[np.int64] | None
) -> dict[Pair, float]:
    """Return the overlap of each pair i < j of at least ``min_overlap``, over the smaller footprint."""
    placed = np.flatnonzero(np.isfinite(w_T_b).all(axis=(1, 2)))
    quads = {int(k): camera.footprint(w_T_b[k], floor_z) for k in placed}
    quads = {k: q.astype(np.float32) for k, q in quads.items() if np.isfinite(q).all()}
    if len(quads) < 2:
        return {}
    keys = np.array(list(quads))
    world = np.zeros(len(w_T_b), dtype=np.int64) if world is None else world
    centre = np.array([quads[k].mean(axis=0) for k in keys])
    size = np.array([np.linalg.norm(quads[k] - quads[k].mean(axis=0), axis=1).max() for k in keys])
    area = {k: float(cv2.contourArea(q)) for k, q in quads.items()}
    found: dict[Pair, float] = {}
    tree = cKDTree(centre)
    for a, k in enumerate(keys.tolist()):
        # The radius reaches every overlapping footprint that is no larger; larger ones reach this one.
        for b in tree.query_ball_point(centre[a], 2 * size[a]):
            if (size[b], b) < (size[a], a) and world[k] == world[keys[b]]:
                i, j = sorted((k, int(keys[b])))
                shared = cv2.intersectConvexConvex(quads[i], quads[j])[0] / max(1e-12, min(area[i], area[j]))
                if shared >= min_overlap:
                    found[i, j] = shared
    return found


def _joining(found: Collection[Pair], shares: Mapping[Pair, float], n: int) -> set[Pair]:
    """Return the largest overlaps that join what the pairs ``found`` of ``n`` keyframes leave apart."""
    i, j = np.array(list(found)).T
    _, part = connected_components(coo_array((np.ones(len(i), np.int8), (i, j)), shape=(n, n)))
    joining: set[Pair] = set()
    for i, j in sorted((p for p in shares if part[p[0]] != part[p[1]]), key=lambda p: (-shares[p], p)):
        if part[i] != part[j]:
            part[part == part[j]] = part[i]
            joining.add((i, j))
    return joining


@dataclass(frozen=True)
class _Comparison:
    """Settings of all comparisons of pairs."""

    camera: Camera
    homography: HomographyConfig
    gates: GateConfig


@dataclass(frozen=True)
class _Chunk:
    """Pairs that one job compares."""

    pairs: Sequence[Pair]
    expected: Sequence[Expectation | None]
    features: StoredFeatures


def verify(
    pairs: Sequence[Pair],
    store: FeatureStore,
    camera: Camera,
    homography: HomographyConfig,
    gates: GateConfig,
    on_done: Callable[[int], None] = lambda done: None,
    expected: Callable[[int, int], Expectation | None] = lambda i, j: None,
) -> Iterable[Registration]:
    """Verify candidates geometrically, in their order; a rejected result has a reason.

    ``expected``: predicted place of the later picture of a pair in the earlier one, or None. The workers of
    `frontend.workers` share the pairs.
    """
    share = workers()
    size = int(np.clip(len(pairs) // (CHUNKS * share.count), 1, MOST_PAIRS))
    parts = [pairs[begin : begin + size] for begin in range(0, len(pairs), size)]
    chunks = (
        _Chunk(part, [expected(i, j) for i, j in part], StoredFeatures(store, {k for of in part for k in of}))
        for part in parts
    )
    done, verified = 0, 0
    for results in share.map(_compared, _Comparison(camera, homography, gates), chunks):
        for result in results:
            done, verified = done + 1, verified + result.ok
            on_done(done)
            yield result
    _LOG.info("%d of %d loop candidates passed the geometric verification", verified, len(pairs))


def _compared(settings: _Comparison, chunk: _Chunk) -> list[Registration]:
    """Return the registration of each pair of a chunk."""
    read = {k: chunk.features[k] for k in sorted({k for pair in chunk.pairs for k in pair})}
    return [
        register(
            i, j, read[i], read[j], settings.camera, settings.homography, settings.gates, expected
        )
        for (i, j), expected in zip(chunk.pairs, chunk.expected, strict=True)
    ]  # fmt: skip

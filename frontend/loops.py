"""Loop closure: proposal of keyframe pairs and their geometric verification."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from frontend.camera import Camera
from frontend.cores import usable_cores
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
from frontend.store import FeatureStore

Array = NDArray[np.float64]
Pair = tuple[int, int]

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
    camera: Camera, w_T_b: Array, floor_z: float, min_overlap: float, neighbours: int
) -> list[Pair]:
    """Return pairs i < j with the largest footprint overlaps of each keyframe, by the poses (n, 4, 4)."""
    placed = np.flatnonzero(np.isfinite(w_T_b).all(axis=(1, 2)))
    quads = {int(k): camera.footprint(w_T_b[k], floor_z) for k in placed}
    quads = {k: q.astype(np.float32) for k, q in quads.items() if np.isfinite(q).all()}
    if len(quads) < 2:
        return []
    keys = np.array(list(quads))
    centre = np.array([quads[k].mean(axis=0) for k in keys])
    size = np.array([np.linalg.norm(quads[k] - quads[k].mean(axis=0), axis=1).max() for k in keys])
    area = {k: float(cv2.contourArea(q)) for k, q in quads.items()}
    share: dict[int, list[tuple[float, int]]] = {int(k): [] for k in keys}
    tree = cKDTree(centre)
    for a, k in enumerate(keys.tolist()):
        # The radius reaches every overlapping footprint that is no larger; larger ones reach this one.
        for b in tree.query_ball_point(centre[a], 2 * size[a]):
            if (size[b], b) < (size[a], a):
                i, j = sorted((k, int(keys[b])))
                shared = cv2.intersectConvexConvex(quads[i], quads[j])[0] / max(1e-12, min(area[i], area[j]))
                if shared >= min_overlap:
                    share[i].append((-shared, j))
                    share[j].append((-shared, i))
    found: set[Pair] = set()
    for k, of in share.items():
        found.update((min(k, other), max(k, other)) for _, other in sorted(of)[:neighbours])
    return sorted(found)


def verify(
    pairs: Sequence[Pair],
    store: FeatureStore,
    camera: Camera,
    homography: HomographyConfig,
    gates: GateConfig,
    workers: int | None = None,
    on_done: Callable[[int], None] = lambda done: None,
    expected: Callable[[int, int], Expectation | None] = lambda i, j: None,
) -> Iterable[Registration]:
    """Verify candidates geometrically, in their order; a rejected result has a reason.

    ``expected``: predicted place of the later picture of a pair in the earlier one, or None. ``workers``
    threads share the pairs, one for each core by default; the result does not depend on their number.
    """

    def compare(pair: Pair) -> Registration:
        i, j = pair
        return register(i, j, store[i], store[j], camera, homography, gates, expected(i, j))

    held = 0
    with ThreadPoolExecutor(workers or usable_cores()) as pool:
        for done, result in enumerate(pool.map(compare, pairs), 1):
            held += result.ok
            on_done(done)
            yield result
    _LOG.info("%d of %d loop candidates passed the geometric verification", held, len(pairs))

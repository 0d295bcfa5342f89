"""Parts of a flight put together: numbered by size, each refined by itself."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from frontend.features import Features
from frontend.points import Points
from frontend.registration import Registration
from frontend.store import FeatureStore
from slam.core.progress import silent
from slam.mapping.fusion import Fused, fuse
from slam.mapping.mapper import Mapper
from slam.mapping.sightings import Sightings
from tests.slam.mapping.test_mapper import mapper_of, registration, seen, truth

PARTS = [(0, 1), (1, 2), (3, 4), (4, 5), (5, 6), (6, 7), (3, 5), (8, 9), (9, 10), (10, 11)]
"""Three keyframes, five, four."""


def sightings(w_T_b: np.ndarray, registrations: tuple[Registration, ...]) -> Sightings:
    store = FeatureStore()
    for pose in w_T_b:
        pixel = seen(pose)[1]
        store.append(Features(Points.alike(pixel), np.zeros((len(pixel), 4), np.float32)))
    n = len(w_T_b)
    return Sightings(store, np.arange(n), 3.0 * np.arange(n), (None,) * n, registrations, (), n, Counter())


def fused(mapper: Mapper, w_T_b: np.ndarray, rejected: tuple[tuple[int, int], ...] = ()) -> Fused:
    """All parts, with some of the graph's edges rejected."""
    registrations = tuple(registration(w_T_b, *pair) for pair in PARTS)
    edges = mapper.edges(registrations)
    solution = mapper.solve(edges)
    kept = np.array([pair not in rejected for pair in PARTS])
    return fuse(mapper, sightings(w_T_b, registrations), edges, replace(solution, edge_kept=kept), silent)


def test_the_largest_part_comes_first_and_each_is_right_by_itself():
    w_T_b = truth()
    found = fused(mapper_of(w_T_b), w_T_b)
    assert found.component.tolist() == [2, 2, 2, 0, 0, 0, 0, 0, 1, 1, 1, 1]
    assert np.isfinite(found.covariances).all()
    for part in range(3):
        own = found.component == part
        distances = [
            np.linalg.norm(poses[own, None, :3, 3] - poses[None, own, :3, 3], axis=-1)
            for poses in (found.w_T_b, w_T_b)
        ]
        assert distances[0] == pytest.approx(distances[1], abs=0.01)
        assert found.w_T_b[own, 2, 3] == pytest.approx(w_T_b[own, 2, 3], abs=0.01)


def test_a_part_whose_edges_were_all_rejected_leaves_no_empty_number():
    w_T_b = truth()
    found = fused(mapper_of(w_T_b), w_T_b, rejected=((3, 4), (4, 5), (5, 6), (6, 7), (3, 5)))
    assert found.component.tolist() == [1, 1, 1, -1, -1, -1, -1, -1, 0, 0, 0, 0]
    assert np.isnan(found.w_T_b[3:8]).all()
    assert np.isnan(found.covariances[3:8]).all()
    assert found.bundle is not None


def test_a_part_that_cannot_be_refined_keeps_its_place_and_says_so():
    """Too few points in common: the pose graph's answer, without a covariance."""
    w_T_b = truth()
    mapper = mapper_of(w_T_b)
    registrations = tuple(registration(w_T_b, *pair) for pair in PARTS)
    edges = mapper.edges(registrations)
    solution = mapper.solve(edges)
    poor = tuple(replace(r, matches=r.matches[:0]) if r.i >= 8 else r for r in registrations)
    found = fuse(mapper, sightings(w_T_b, poor), replace(edges, registrations=poor), solution, silent)
    assert (found.component >= 0).all()
    assert np.isfinite(found.w_T_b).all()
    assert np.isnan(found.covariances[8:]).all()
    assert np.isfinite(found.covariances[:8]).all()
    assert any("4 keyframes could not be refined" in warning for warning in found.warnings)

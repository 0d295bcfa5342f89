"""Matching against a brute-force oracle."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.features import Features
from frontend.matching import match, match_near
from frontend.points import Points


def brute_force(a: NDArray, b: NDArray, ratio: float) -> set[tuple[int, int]]:
    """By definition, pair by pair, in double precision."""
    if a.dtype == np.uint8:
        bits_a, bits_b = np.unpackbits(a, axis=1), np.unpackbits(b, axis=1)
        distance = (bits_a[:, None] != bits_b[None]).sum(axis=2).astype(float)
    else:
        distance = np.linalg.norm(a[:, None].astype(float) - b[None].astype(float), axis=2)
    found = set()
    for i, row in enumerate(distance):
        j = int(row.argmin())
        second = np.delete(row, j).min()
        if row[j] < ratio * second and distance[:, j].argmin() == i:
            found.add((i, j))
    return found


def two_views(rng: np.random.Generator, binary: bool, n: int = 120) -> tuple[Features, Features]:
    """Half the features of b are disturbed copies of a's, the rest have nothing to do with them."""
    if binary:
        a = rng.integers(0, 256, (n, 32), dtype=np.uint8)
        flips = np.packbits(rng.random((n, 256)) < rng.uniform(0, 0.4, (n, 1)), axis=1)
        b = np.where(np.arange(n)[:, None] % 2, a ^ flips, rng.integers(0, 256, (n, 32), dtype=np.uint8))
    else:
        a = rng.normal(size=(n, 24)).astype(np.float32)
        b = np.where(
            np.arange(n)[:, None] % 2,
            a + rng.normal(size=(n, 24)) * rng.uniform(0, 1, (n, 1)),
            rng.normal(size=(n, 24)),
        )
        a, b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, b))
        a, b = a.astype(np.float32), b.astype(np.float32)
    b = b[rng.permutation(n)][: n - 7]
    return Features(Points.alike(rng.uniform(0, 300, (len(a), 2))), a), Features(
        Points.alike(rng.uniform(0, 300, (len(b), 2))), b
    )


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("ratio", [0.6, 0.85, 1.0])
def test_agrees_with_brute_force(binary: bool, ratio: float) -> None:
    total = 0
    for seed in range(8):
        a, b = two_views(np.random.default_rng(seed), binary)
        pairs = match(a, b, ratio)
        assert pairs.dtype == np.int64
        assert {(int(i), int(j)) for i, j in pairs} == brute_force(a.descriptor, b.descriptor, ratio)
        total += len(pairs)
    assert total > 150  # the test would be empty otherwise


@pytest.mark.parametrize("binary", [False, True])
def test_no_feature_is_used_twice_and_no_pair_depends_on_order(binary: bool) -> None:
    rng = np.random.default_rng(11)
    a, b = two_views(rng, binary)
    pairs = match(a, b)
    assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)
    order = rng.permutation(len(b))
    shuffled = match(a, b[order])
    assert {(i, int(order[j])) for i, j in shuffled.tolist()} == {tuple(p) for p in pairs.tolist()}


@pytest.mark.parametrize("binary", [False, True])
def test_repeated_pattern_gives_no_match(binary: bool) -> None:
    """Two features of b look exactly alike: neither can be told to be the one."""
    rng = np.random.default_rng(5)
    b, _ = two_views(rng, binary, 20)
    if binary:
        seen = b.descriptor ^ np.packbits(rng.random((20, 256)) < 0.05, axis=1)
    else:
        seen = b.descriptor + rng.normal(0, 0.03, b.descriptor.shape)
        seen = (seen / np.linalg.norm(seen, axis=1, keepdims=True)).astype(np.float32)
    a = Features(b.points, seen)
    twice = b[np.tile(np.arange(len(b)), 2)]
    assert len(match(a, twice)) == 0
    np.testing.assert_array_equal(match(a, b), np.column_stack([np.arange(20)] * 2))


@pytest.mark.parametrize(("n", "m"), [(0, 5), (5, 0), (1, 5), (5, 1), (0, 0)])
def test_too_few_to_compare_gives_none(n: int, m: int) -> None:
    d = np.eye(8, dtype=np.float32)
    a, b = (Features(Points.alike(np.zeros((k, 2))), d[:k]) for k in (n, m))
    assert match(a, b).shape == (0, 2)


def test_a_spot_that_is_described_twice_is_matched_once() -> None:
    """As SIFT does where a spot has two orientations: one measurement, however many features find it."""
    rng = np.random.default_rng(12)
    b, _ = two_views(rng, False, 20)
    pixel = b.pixel.copy()
    pixel[[1, 7]], pixel[5] = pixel[3], pixel[4]
    here = Features(Points.alike(pixel), b.descriptor)
    there = Features(Points.alike(pixel[::-1] + 10.0), b.descriptor[::-1])
    pairs = match(here, there)
    kept = [k for k in range(20) if k not in (3, 5, 7)]
    assert pairs[:, 0].tolist() == kept
    np.testing.assert_allclose(there.pixel[pairs[:, 1]] - 10.0, here.pixel[pairs[:, 0]])
    crossed = np.array(pixel)
    crossed[1] += 5.0  # the two no longer show one spot in both pictures: two measurements
    assert len(match(Features(Points.alike(crossed), b.descriptor), there)) == 18


@pytest.mark.parametrize("binary", [False, True])
def test_the_place_decides_between_equal_matches_only(binary: bool) -> None:
    """Every feature of the second picture exists twice, and a part of the pairs may match."""
    for seed in range(4):
        a, b = two_views(np.random.default_rng(seed), binary)
        alone = match(a, b)
        np.testing.assert_array_equal(match_near(a, b, lambda i, j: i >= 0), alone)
        assert len(match_near(a, b, lambda i, j: i < 0)) == 0

        points = Points.alike(np.tile(b.pixel, (2, 1)) + np.repeat([0.0, 400.0], len(b))[:, None])
        twice = Features(points, np.tile(b.descriptor, (2, 1)))
        assert len(match(a, twice)) == 0
        second = match_near(a, twice, lambda i, j, n=len(b): j >= n)
        np.testing.assert_array_equal(second, alone + [0, len(b)])


@pytest.mark.parametrize("binary", [False, True])
def test_near_matches_agree_with_their_definition(binary: bool) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        a, b = two_views(rng, binary)
        near = rng.random((len(a), len(b))) < 0.6
        if binary:
            bits_a, bits_b = (np.unpackbits(f.descriptor, axis=1) for f in (a, b))
            distance = (bits_a[:, None] != bits_b[None]).sum(axis=2).astype(float)
        else:
            distance = np.linalg.norm(a.descriptor[:, None].astype(float) - b.descriptor, axis=2)
        best = np.maximum(distance.min(axis=1)[:, None], distance.min(axis=0))
        left = np.where(near & (0.85 * distance <= best), distance, np.inf)
        defined = set()
        for i, row in enumerate(left):
            j = int(row.argmin())
            if row[j] < 0.85 * np.delete(row, j).min() and left[:, j].argmin() == i:
                defined.add((i, j))
        assert len(defined) > 10
        assert {*map(tuple, match_near(a, b, lambda i, j, near=near: near[i, j]).tolist())} == defined

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backend.pose_graph.heights import adjust_heights

NOTHING = np.empty(0)
NOWHERE = np.empty(0, dtype=np.int64)


def samples(seed: int, n: int = 40, loops: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True log heights, and pairs that tie them all: a chain and loops."""
    rng = np.random.default_rng(seed)
    log_height = np.cumsum(rng.normal(0, 0.1, n))
    i, j = rng.integers(0, n, (2, loops))
    i, j = np.concatenate([np.arange(n - 1), i[i != j]]), np.concatenate([np.arange(1, n), j[i != j]])
    return log_height, i, j


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_exact_ratios_and_one_height_give_all_heights(seed):
    log_height, i, j = samples(seed)
    k = np.array([seed % 40])
    found = adjust_heights(
        40, i, j, log_height[j] - log_height[i], np.full(len(i), 0.01), k, log_height[k], np.array([0.01])
    )
    assert found.height_m == pytest.approx(np.exp(log_height), rel=1e-5)
    assert found.metric.all()


def test_without_a_measured_height_ratios_hold_and_the_mean_logarithm_is_zero():
    log_height, i, j = samples(1)
    ratio = log_height[j] - log_height[i]
    found = adjust_heights(40, i, j, ratio, np.full(len(i), 0.01), NOWHERE, NOTHING, NOTHING)
    assert not found.metric.any()
    assert np.log(found.height_m).mean() == pytest.approx(0.0, abs=1e-6)
    assert np.log(found.height_m[j] / found.height_m[i]) == pytest.approx(ratio, abs=1e-6)
    assert (found.log_std == 0).all()


def test_each_part_has_its_own_scale():
    """Two parts, only one of them with a measured height, and a keyframe by itself."""
    i, j = np.array([0, 1, 3]), np.array([1, 2, 4])
    found = adjust_heights(
        6, i, j, np.array([0.1, 0.1, 0.4]), np.full(3, 0.01), np.array([1]), np.log([5.0]), np.array([0.01])
    )
    assert found.metric.tolist() == [True, True, True, False, False, False]
    assert found.height_m[:3] == pytest.approx(5.0 * np.exp([-0.1, 0.0, 0.1]), rel=1e-6)
    assert found.height_m[3:] == pytest.approx(np.exp([-0.2, 0.2, 0.0]), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_deviations_are_those_of_the_whole_inverse(seed: int):
    """All readings agree, so that every weight is 1."""
    log_height, i, j = samples(seed)
    k = np.arange(0, 40, 3)
    found = adjust_heights(
        40,
        i,
        j,
        log_height[j] - log_height[i],
        np.full(len(i), 0.01),
        k,
        log_height[k],
        np.full(len(k), 0.02),
    )
    A = np.zeros((len(i) + len(k), 40))
    A[np.arange(len(i)), i], A[np.arange(len(i)), j] = -100, 100
    A[len(i) + np.arange(len(k)), k] = 50
    assert found.log_std == pytest.approx(np.sqrt(np.diag(np.linalg.inv(A.T @ A))), rel=1e-6)


def test_an_hour_of_keyframes_takes_seconds():
    """A solve for the deviation of each took thirteen."""
    n = 20_000
    i, j = np.arange(n - 1), np.arange(1, n)
    begin = time.process_time()
    adjust_heights(
        n, i, j, np.zeros(n - 1), np.full(n - 1, 0.01), np.arange(n), np.zeros(n), np.full(n, 0.01)
    )
    assert time.process_time() - begin < 4


def test_thirty_percent_outliers_do_no_harm():
    """Chain sound, three in ten loops and heights wild. An end of the chain may have no majority."""
    off = np.array([with_wild(seed) for seed in range(30)])
    assert np.mean(off[:, 1:-1] > 0.05) < 0.005
    assert np.median(off.max(axis=1)) < 0.02


def with_wild(seed: int) -> np.ndarray:
    """(40,) errors of the logarithm."""
    rng = np.random.default_rng(seed)
    log_height, i, j = samples(seed, loops=120)
    ratio = log_height[j] - log_height[i] + rng.normal(0, 0.01, len(i))
    wild = (np.arange(len(i)) >= 39) & (rng.uniform(size=len(i)) < 0.3)
    ratio[wild] += rng.choice([-1, 1], wild.sum()) * rng.uniform(0.3, 1.5, wild.sum())
    measured = log_height + rng.normal(0, 0.02, 40)
    high = rng.uniform(size=40) < 0.3
    measured[high] += rng.uniform(0.3, 1.0, high.sum())
    found = adjust_heights(40, i, j, ratio, np.full(len(i), 0.01), np.arange(40), measured, np.full(40, 0.02))
    return np.abs(np.log(found.height_m) - log_height)


def test_the_standard_deviation_is_that_of_the_errors():
    """Gaussian errors: whitened over 300 draws their mean square is 1, less what robust weights take off."""
    whitened = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        log_height, i, j = samples(seed, n=20, loops=10)
        k = np.arange(0, 20, 3)
        found = adjust_heights(
            20,
            i,
            j,
            log_height[j] - log_height[i] + rng.normal(0, 0.01, len(i)),
            np.full(len(i), 0.01),
            k,
            log_height[k] + rng.normal(0, 0.02, len(k)),
            np.full(len(k), 0.02),
        )
        whitened.append((np.log(found.height_m) - log_height) / found.log_std)
    assert 0.75 < np.mean(np.square(whitened)) < 1.15


def test_the_answer_does_not_hang_on_the_order():
    log_height, i, j = samples(7)
    rng = np.random.default_rng(7)
    ratio, k = log_height[j] - log_height[i] + rng.normal(0, 0.02, len(i)), np.arange(0, 40, 5)
    std, mixed = np.full(len(i), 0.02), rng.permutation(len(i))
    a, b = (
        adjust_heights(40, i[o], j[o], ratio[o], std, k, log_height[k], np.full(len(k), 0.02))
        for o in (np.arange(len(i)), mixed)
    )
    assert a.height_m == pytest.approx(b.height_m, rel=1e-9)
    assert a.log_std == pytest.approx(b.log_std, rel=1e-6)

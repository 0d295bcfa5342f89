"""Likelihood of comparisons whose errors are correlated within segments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.without_commands.likelihood import IN_TIME, likelihood_of
from slam.data_quality.whitened_rows import WhitenedRows
from slam.simulation.model import load_model

SEGMENTS, ROWS, DRAWS = 7, 20, 400
NAMES = ("gyro_bias.x", "accel_bias.x", "sonar_scale.eps", "gyro_scale.eps", "sonar_lag.T")


def comparison(columns, off, scale=1.0):
    """Return the search over as many segments of one flight as a minute has, with its rows."""
    times_s = 0.5 * np.arange(SEGMENTS * ROWS)
    rows = WhitenedRows("attitude", times_s, scale * off, columns, 1.0, None)
    return likelihood_of([[rows]], filter_parameters_of(load_model("nominal")))


def drawn(rng, names=NAMES):
    return {name: rng.standard_normal(SEGMENTS * ROWS) for name in names}


def lasting(rng, columns=1):
    """Return (rows, columns) errors with a correlation time of half a second, and a variance of 1."""
    kept = np.exp(-0.5 / 0.5)
    noise = np.sqrt(1.0 - kept**2) * rng.standard_normal((100 + SEGMENTS * ROWS, columns))
    return lfilter([1.0], [1.0, -kept], noise, axis=0)[100:]


def test_sizes_and_nats_are_those_of_least_squares_over_all_rows():
    rng = np.random.default_rng(1)
    columns, off = drawn(rng), rng.standard_normal(SEGMENTS * ROWS)
    found = comparison(columns, off)
    table = np.column_stack(list(columns.values()))
    size, rest, *_ = np.linalg.lstsq(table, off)
    maximum = found.last.maximise(found.last.effects)
    np.testing.assert_allclose(list(found.last.sizes(found.last.effects).values()), size, rtol=1e-6)
    assert maximum.nats == pytest.approx(0.5 * (off @ off - rest[0]))
    np.testing.assert_allclose(maximum.white, np.linalg.inv(table.T @ table), atol=1e-6)
    assert found.last.fisher.log_likelihood.sum() == pytest.approx(-0.5 * off @ off)


def test_the_error_that_grows_with_time_is_a_pattern_of_its_own():
    rng = np.random.default_rng(2)
    columns = drawn(rng, NAMES[:1])
    minutes = 0.5 / 60.0 * (np.arange(SEGMENTS * ROWS) - (SEGMENTS * ROWS - 1) / 2.0)
    found = comparison(columns, 3.0 * columns[NAMES[0]] * minutes)
    (growing,) = found.last.patterns
    assert growing.name == "gyro_bias" + IN_TIME
    assert found.last.sizes([growing]) == pytest.approx({NAMES[0] + IN_TIME: 3.0})


@pytest.mark.slow
@pytest.mark.parametrize("beside", [0, 4])
def test_an_interval_covers_its_size_however_many_others_are_fitted(beside):
    """An error of the size that comes and goes: 95 % of the intervals hold the common size."""
    rng = np.random.default_rng(3)
    columns = drawn(rng, NAMES[: 1 + beside])
    inside = 0
    for _ in range(DRAWS):
        off = columns[NAMES[0]] * lasting(rng)[:, 0] + rng.standard_normal(SEGMENTS * ROWS)
        last = comparison(columns, off).last
        maximum = last.maximise(last.effects, judged=1)
        half = last.fisher.half_interval
        inside += abs(maximum.step[0]) < half * np.sqrt(maximum.covariance[0, 0])
    print(f"{beside} others fitted: {inside / DRAWS:.3f} of the intervals hold the size")
    assert 0.93 < inside / DRAWS < 0.97


@pytest.mark.slow
@pytest.mark.parametrize("scattered", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("count", [1, 3])
def test_how_far_an_effect_stands_out_is_a_normal_deviate(count, scattered):
    """Where there is none, few segments make no more of it than chance does, whatever its errors scatter."""
    rng = np.random.default_rng(7)
    z = []
    for _ in range(DRAWS):
        columns = drawn(rng, [f"gyro_bias.{axis}" for axis in "xyz"[:count]])
        off = np.sum(scattered * lasting(rng, count) * np.column_stack(list(columns.values())), axis=1)
        last = comparison(columns, off + rng.standard_normal(SEGMENTS * ROWS)).last
        z.append(last.score_tests([], last.effects)[0].z)
    beyond = [float(np.mean(np.array(z) > limit)) for limit in (1.0, 2.0, 3.0, 4.0)]
    print(
        f"{count} sizes, scatter {scattered:g}: z is greater than 1, 2, 3 in {beyond}; by chance 0.317, 0.046"
    )
    assert 0.15 < beyond[0] < 0.36
    assert beyond[1] < 0.06
    assert beyond[2] < 0.008
    assert beyond[3] < 0.003


def test_parameters_that_are_judged_together_count_as_many_segments_less():
    """Seven segments say less about three parameters at once than about each of them."""
    rng = np.random.default_rng(4)
    columns = drawn(rng, [f"gyro_bias.{axis}" for axis in "xyz"])
    off = np.sum(10.0 * lasting(rng, 3) * np.column_stack(list(columns.values())), axis=1)
    last = comparison(columns, off).last
    alone, together = (last.maximise(last.effects, judged=k).covariance for k in (1, 3))
    segments = last.fisher.independent
    assert SEGMENTS < segments < 1.5 * SEGMENTS
    np.testing.assert_allclose(np.diag(together) / np.diag(alone), (segments - 1.0) / (segments - 3.0))


def test_an_effect_in_anothers_place_counts_for_what_it_explains_there():
    """What a rival explains besides is no reason for it; alone it counts in full."""
    rng = np.random.default_rng(5)
    columns = drawn(rng, NAMES[:2])
    found = comparison(columns, columns[NAMES[0]] + columns[NAMES[1]])
    gyro, accel = found.last.effects
    quadratic = found.last
    both, one = (quadratic.maximise(e).nats for e in ([gyro, accel], [gyro]))
    assert quadratic.nats([accel], [gyro]) < 0.2 * one
    assert quadratic.nats([accel], []) > 0.5 * quadratic.maximise([accel]).nats
    assert quadratic.nats([gyro, accel], [gyro]) == pytest.approx(both, rel=0.3)


def test_a_lead_that_one_segment_has_alone_counts_little():
    rng = np.random.default_rng(6)
    columns = drawn(rng, NAMES[:1])
    even = comparison(columns, columns[NAMES[0]])
    once = np.repeat(np.arange(SEGMENTS) == 3, ROWS) * SEGMENTS * columns[NAMES[0]]
    lone = comparison(columns, once)
    agreed, alone = (f.last.nats(f.last.effects, []) for f in (even, lone))
    assert alone < 0.5 * agreed

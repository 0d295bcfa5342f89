"""Intervals of a regression whose errors are correlated within segments."""

from __future__ import annotations

import numpy as np
import pytest

from slam.criticism.without_commands.regression import Regression

SEGMENTS, ROWS, DRAWS = 7, 20, 800


def regression(columns, off):
    """Return a regression of as many segments of one flight as a minute has."""
    cluster = np.repeat(np.arange(SEGMENTS), ROWS)
    seconds = 10.0 * cluster
    return Regression(
        off=off, columns=columns, kind=np.full(len(off), "attitude"), part=cluster, cluster=cluster,
        flight=0 * cluster, times_s=seconds, minutes=seconds / 60.0, by="segment",
    )  # fmt: skip


@pytest.mark.parametrize("beside", [0, 4])
def test_an_interval_covers_its_size_however_many_others_are_fitted(beside):
    """An error of the size that differs between segments: 95 % of the intervals hold the common size."""
    rng = np.random.default_rng(3)
    names = [f"effect{k}.x" for k in range(1 + beside)]
    columns = {name: rng.standard_normal(SEGMENTS * ROWS) for name in names}
    effects, inside = [name.removesuffix(".x") for name in names], 0
    for _ in range(DRAWS):
        varying = np.repeat(rng.standard_normal(SEGMENTS), ROWS)
        data = regression(columns, columns["effect0.x"] * varying + rng.standard_normal(SEGMENTS * ROWS))
        size, covariance = data.covariance(effects, one_by_one=True)
        inside += abs(size[0]) < data.wide * np.sqrt(covariance[0, 0])
    print(f"{beside} others fitted: {inside / DRAWS:.3f} of the intervals hold the size")
    assert 0.93 < inside / DRAWS < 0.97


def test_parameters_that_are_judged_together_count_as_many_segments_less():
    """Seven segments say less about three parameters at once than about each of them."""
    rng = np.random.default_rng(4)
    columns = {f"effect.{axis}": rng.standard_normal(SEGMENTS * ROWS) for axis in "xyz"}
    varying = np.repeat(rng.standard_normal((SEGMENTS, 3)), ROWS, axis=0)
    off = np.sum(varying * np.column_stack(list(columns.values())), axis=1)
    data = regression(columns, off)
    alone, together = (data.covariance(["effect"], one_by_one)[1] for one_by_one in (True, False))
    np.testing.assert_allclose(np.diag(together) / np.diag(alone), 6.0 / 4.0)

"""Search among the errors of instruments that are compared with each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.without_commands.explanation import search_linear
from slam.criticism.without_commands.likelihood import likelihood_of
from slam.data_quality.whitened_rows import WhitenedRows, segments_of
from slam.simulation.model import load_model

SEGMENTS, ROWS = 12, 60
ACCEL_SCALE, GYRO_RAD_S = 0.05, 0.02


def comparison(columns, off):
    times_s = np.repeat(10.0 * np.arange(SEGMENTS), ROWS)
    rows = WhitenedRows("attitude", times_s, off, columns, 1.0, None)
    return likelihood_of([[rows]], filter_parameters_of(load_model("nominal")))


def test_a_certain_error_is_not_lost_to_a_greater_one_on_which_segments_disagree():
    """The greater one explains the certain one too. In its place it would be dropped, and nothing be told."""
    rng = np.random.default_rng(1)
    own, more = rng.standard_normal((2, SEGMENTS * ROWS))
    columns = {"accel_scale.eps": own / ACCEL_SCALE, "gyro_bias.x": (own + more) / GYRO_RAD_S}
    disagreeing = np.repeat(np.tile([4.0, -2.0], SEGMENTS // 2), ROWS) * more
    found = search_linear(comparison(columns, rng.standard_normal(SEGMENTS * ROWS) + own + disagreeing))
    assert [e.name for e in found.chosen] == ["accel_scale"]
    assert found.last.score_tests((), found.last.effects)[0].effect.name == "gyro_bias"


@pytest.mark.parametrize("late_s", [7.0, 1234.567])
def test_segments_are_counted_from_the_first_moment(late_s):
    times_s = np.arange(0.3, 60.0, 0.5)
    rows = WhitenedRows("attitude", times_s, times_s, {}, 1.0, None)
    labels, begin_s, segment = segments_of([[rows]], 10.0)
    later = segments_of([[replace(rows, times_s=times_s + late_s)]], 10.0)
    np.testing.assert_array_equal(later[0], labels)
    np.testing.assert_allclose(later[1], begin_s + late_s)
    np.testing.assert_array_equal(later[2], segment)
    assert begin_s[0] == 0.3
    assert (np.bincount(segment) == 20).all()

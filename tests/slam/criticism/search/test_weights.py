"""What the gains are off by is free by itself: else heavy tails look like a target that goes with tilt."""

from __future__ import annotations

import numpy as np
import pytest

from slam.criticism.healthy import at_lower_rates, flown
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.record import record_of
from slam.criticism.kalman.setting import setting_of
from slam.criticism.manoeuvres import stick_for
from slam.criticism.search.columns import column_of
from slam.criticism.search.dictionary import dictionary, signals_of
from slam.criticism.search.fitting import changes_of
from slam.criticism.search.hypotheses import parabola_of
from slam.criticism.search.information import sums_of, weight_of
from slam.criticism.search.nuisances import MEAN, WEIGHED, direction_of
from slam.criticism.search.screening import project
from slam.simulation.model import load_model

BEHIND_TILT = ("force pitch ~ pitch", "force roll ~ roll")
TILT = weight_of("tilt_std_rad")


@pytest.fixture(scope="module")
def seen():
    """Sums over one healthy flight with the two targets that go with tilt, and the belief."""
    model = at_lower_rates(load_model("nominal"))
    record = record_of(flown(model, stick_for(["tilts of 15 deg to all four sides"]), 50))
    setting = setting_of(model)
    plain = whole(record, setting)
    shapes = [d for d in dictionary([record]) if d.name in BEHIND_TILT]
    directions = [*map(direction_of, MEAN), *shapes]
    signals = [signals_of(record, plain.states)]
    return sums_of([record], setting, directions, changes_of(), signals, [plain], WEIGHED), setting


def share_left(sums, column, out):
    left = project(
        sums.information.sum(axis=0), [sums.columns.index(name) for name in out], np.zeros(len(out))
    )
    return left.share[sums.columns.index(column)]


def test_a_wrong_gain_is_a_target_that_goes_with_tilt(seen):
    sums, _ = seen
    vehicle = [n.name for n in MEAN[:3]]
    assert share_left(sums, TILT, vehicle) > 0.5
    assert share_left(sums, TILT, [*vehicle, *BEHIND_TILT]) < 0.1
    # The scatter tells the size of the unrest all the same.
    assert share_left(sums, "tilt_std_rad", [*vehicle, *BEHIND_TILT]) > 0.3


def test_weights_are_free_but_nothing_that_a_belief_holds(seen):
    sums, setting = seen
    parabola = parabola_of(sums, setting, setting, {})
    answer = parabola.answer([])
    assert set(map(weight_of, WEIGHED)) <= set(parabola.names)
    assert answer.step[parabola.names.index(TILT)] != 0.0
    assert column_of(TILT).moved(setting, 0.1) is setting

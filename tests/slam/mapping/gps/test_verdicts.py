"""Which fixes the next refinement uses, by the comparisons with the maps before it."""

from __future__ import annotations

import numpy as np
import pytest

from slam.mapping.gps.consensus import Agreement
from slam.mapping.gps.verdicts import FixVerdicts

COUNT = 5
OFF_M = np.zeros((COUNT, 3))
NONE = np.zeros(COUNT, bool)
LAST = np.arange(COUNT) == COUNT - 1


def agreement(out: np.ndarray, altitude_out: np.ndarray) -> Agreement:
    return Agreement(~out, ~altitude_out, OFF_M)


@pytest.mark.parametrize("level", [True, False])
def test_a_fix_that_agrees_only_with_maps_without_it_stays_out(level: bool) -> None:
    """A map that is uncertain without a fix calls it back, and one with it tells that it is wrong."""
    out = agreement(LAST & level, LAST)
    verdicts, used = FixVerdicts.first(out), []
    for _ in range(6):
        before = verdicts.agreement
        is_used = bool(before.altitude_used[-1])
        found = out if is_used else agreement(NONE, NONE)
        verdicts = verdicts.after(found, NONE)
        used.append(bool(verdicts.agreement.altitude_used[-1]))
    assert used == [True, False, False, False, False, False]
    assert verdicts.agreement.same(before)
    assert verdicts.agreement.used[-1] == (not level)
    assert verdicts.agreement.used[:-1].all()


def test_a_fix_that_its_pictures_contradict_is_left_out_once_for_a_comparison() -> None:
    verdicts = FixVerdicts.first(agreement(NONE, NONE)).after(agreement(NONE, NONE), LAST)
    assert np.array_equal(verdicts.agreement.used, ~LAST)
    back = verdicts.after(agreement(NONE, NONE), NONE)
    assert back.agreement.used.all(), "it agrees with a map that does not use it"
    assert back.after(agreement(NONE, NONE), LAST).agreement.used.all(), "doubted a second time"


def test_a_fix_that_the_map_contradicts_without_it_stays_out() -> None:
    verdicts = FixVerdicts.first(agreement(NONE, NONE)).after(agreement(NONE, NONE), LAST)
    assert verdicts.after(agreement(LAST, LAST), NONE).agreement.same(verdicts.agreement)

"""How probable: what makes noise larger, and what comes late and no term is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.healthy import at_lower_rates, flown
from slam.criticism.kalman.record import record_of
from slam.criticism.kalman.reference import referred
from slam.criticism.kalman.setting import setting_of
from slam.criticism.manoeuvres import stick_for
from slam.criticism.search.search import search
from slam.criticism.search.thresholds import load_thresholds
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE, posterior_of
from slam.simulation.model import load_model

PLAN = ["tilts of 15 deg to all four sides"] * 2 + ["reversing forward at 0.2"]
LATE_S = 4e-3


def judged(flights):
    """Search and posterior."""
    setting = setting_of(at_lower_rates(load_model("nominal")))
    found = search(
        [referred(record_of(f), setting) for f in flights], setting, load_thresholds(pictures=False)
    )
    return found, posterior_of(found)


def test_faint_gusts_are_told_from_nothing_though_the_belief_that_holds_them_hides_it():
    model = at_lower_rates(load_model("nominal"))
    windy = model.with_term("gusts", sigma=0.07, tau=1.5)
    found, posterior = judged([flown(windy, stick_for(PLAN), seed, told=model) for seed in (1, 2)])
    assert [e.name for e in found.chosen] == ["gusts"]
    assert posterior.probability["gusts"] > 0.99
    assert posterior.probability[NOTHING] < 1e-3
    assert posterior.alternatives == (("gusts",),)


def test_an_attitude_that_comes_late_is_no_command_that_does():
    model = at_lower_rates(load_model("nominal"))
    flights = [flown(model, stick_for(PLAN), seed) for seed in (1, 2)]
    late = [replace(f, attitude=replace(f.attitude, stamps_s=f.attitude.stamps_s + LATE_S)) for f in flights]
    found, posterior = judged(late)
    assert [e.name for e in found.chosen] == ["attitude late"]
    assert posterior.probability[SOMETHING_ELSE] > 0.99
    look = found.last
    step, covariance = look.parabola.answer(found.chosen).of(look.parabola.index(found.chosen[0].columns))
    held_s = look.parabola.held.get("attitude.delay_s", 0.0)
    assert step[0] + held_s == pytest.approx(LATE_S, abs=4.0 * float(np.sqrt(covariance[0, 0])) + 2e-4)

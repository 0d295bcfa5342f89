"""What a verdict advises: what to do, and what to fly next."""

from __future__ import annotations

import re
from typing import get_args

import pytest

from slam.criticism.cause import Cause, Gain, Interval
from slam.criticism.verdict.criticism import Criticism, Verdict
from slam.report.criticism.advice import CHECK, advice_after, what_to_do
from slam.simulation.terms import CATALOGUE


def made(name: str) -> Cause:
    size = {"k_b": Interval(0.9, "1/s", 0.8, 1.0)}
    return Cause(name, 1.0, size, Gain(45.2, (30.0, 60.0), "flight", (20.0, 25.2), ()), 9.0, 20.0)


def test_a_healthy_vehicle_needs_nothing():
    assert what_to_do(Criticism("nothing_wrong"), "", "") == "simulate with the model as it is."
    unjudged = Criticism("nothing_wrong", limits="No command log.")
    assert what_to_do(unjudged, "", "") == "no instrument needs a correction."


def test_flights_that_cannot_be_judged_have_no_advice():
    assert advice_after(Criticism("unusable")) == ()


def test_the_next_flight_is_told_with_what_to_do():
    advised = "To distinguish a from b fly 'climb' once: 3.6 sigma a time."
    alike, named = (
        advice_after(Criticism(verdict, next_flight=advised))[-1] for verdict in ("ambiguous", "named")
    )
    assert alike == f"Next flight: {advised} Then criticise the flights together."
    assert named.endswith(advised)
    assert "docs/recipes.md" in advice_after(Criticism("ambiguous"))[-1]


def test_only_an_instrument_is_repaired():
    vehicle, camera = (
        advice_after(Criticism("named", causes=(made(name),)))[-2]
        for name in ("active_braking", "camera_tilt")
    )
    assert "instrument" not in vehicle
    assert "Calibrate, or repair, the instrument" in camera


def test_what_shows_effects_that_were_missed_is_told_with_a_healthy_verdict():
    seen = {"trim_offset": (0.02, "rad"), "sonar_lag": (2.5, "s")}
    flown = advice_after(Criticism("nothing_wrong", detectable=seen))[-1]
    assert f"To see more, fly for sonar_lag: {CATALOGUE['sonar_lag'].excitation}." in flown


def test_every_verdict_tells_a_pilot_what_to_do_next():
    verdicts = [verdict for verdict in get_args(Verdict) if verdict != "unusable"]
    told, flown = ({v: advice_after(Criticism(v))[k] for v in verdicts} for k in (-2, -1))
    assert all(line.startswith("Next flight: ") for line in flown.values())
    assert len(set(told.values())) == len(told) == 5
    for verdict, line in told.items():
        assert line.startswith("What to do next: "), verdict
        assert re.search(r"\b(simulate|fly|check|repair)\b", line), verdict
    assert "extended.toml" in told["named"]
    assert "extended.toml" not in told["unknown"]


@pytest.mark.parametrize("verdict", ["named", "ambiguous"])
def test_without_commands_and_a_correction_the_advice_promises_no_prediction(verdict):
    told = what_to_do(Criticism(verdict, limits="no commands"), CHECK, "")
    assert told == "these recordings cannot be corrected afterwards."
    assert "predicts flights like these" in what_to_do(Criticism("ambiguous"), CHECK, "")

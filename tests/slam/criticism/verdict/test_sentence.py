"""The verdict in one sentence: what was found and what it gains, in units that a pilot knows."""

from __future__ import annotations

import pytest

from slam.criticism.cause import Cause, ChannelError, Gain, Interval
from slam.criticism.verdict.power import within_reach
from slam.criticism.verdict.sentence import sentence_of
from slam.criticism.verdict.words import IN_WORDS
from slam.simulation.terms import CATALOGUE

SPEED = ChannelError("velocity_x", "m/s", 2.0, 0.31, 0.12)
PITCH = ChannelError("pitch", "rad", 2.0, 0.020, 0.018)
SOON, WORSE = ChannelError("pitch", "rad", 0.5, 0.02, 0.001), ChannelError("range", "m", 2.0, 0.01, 0.02)


def told(verdict: str, *channels: ChannelError, by: str | None = "flight", lead_nats: float = 20.0) -> str:
    cause = Cause(
        "active_braking",
        0.97,
        {"k_b": Interval(0.9, "1/s", 0.8, 1.0)},
        Gain(45.2, (30.0, 60.0), by, (20.0, 25.2), channels),
        9.0,
        lead_nats,
        ("active_braking", "asymmetric_drag") if verdict == "ambiguous" else ("active_braking",),
        "asymmetric_drag",
    )
    return sentence_of(verdict, (cause,), ("active_braking", "asymmetric_drag"), "", {})


@pytest.mark.parametrize("verdict", ["named", "ambiguous"])
def test_the_gain_is_told_where_it_is_greatest_two_seconds_ahead(verdict: str):
    said = told(verdict, PITCH, SOON, SPEED, WORSE)
    assert "active_braking: it brakes by itself" in said
    assert "(k_b = 0.9 (0.8 to 1) 1/s; probability 0.97)" in said
    assert "the error of velocity_x 2 s ahead is 0.12 m/s instead of 0.31 (log likelihood +45 nats)" in said


def test_pictures_are_told_from_one_to_another():
    px = ChannelError("reprojection", "px", 0.0, 1.3, 0.2)
    assert "the reprojection error from picture to picture is 0.2 px instead of 1.3" in told(
        "named", PITCH, px
    )


def test_what_was_not_held_out_is_not_told_as_held_out():
    assert "held-out" not in told("named", by=None)


def test_the_next_best_is_told_where_it_is_excluded():
    assert "asymmetric_drag, the next best, explains 20 nats less" in told("named", SPEED)
    for said in (told("ambiguous", SPEED), told("named", SPEED, lead_nats=float("inf"))):
        assert "next best" not in said


def test_every_term_has_words():
    assert list(IN_WORDS) == list(CATALOGUE)


@pytest.mark.parametrize("channels", [(), (WORSE,), (SOON,)])
def test_where_no_reading_gains_the_likelihood_is_told(channels: tuple[ChannelError, ...]):
    assert "the log likelihood gains 45 nats" in told("named", *channels)


def test_a_gain_that_no_reader_could_see_is_none():
    hardly = ChannelError("pitch", "rad", 2.0, 0.0210, 0.0208)
    assert "no channel is better 2 s ahead" in told("named", hardly)
    assert "0.021" not in told("named", hardly)
    assert "2 s ahead" not in told("named")


def test_only_what_shows_at_a_usual_size_counts_as_tested():
    seen = {"trim_offset": (0.02, "rad"), "attitude_lag": (2.5, "s"), "quadratic_drag": (0.024, "1/m")}
    seen |= {"sonar_scale": (0.038, "1")}
    shares = within_reach(seen)
    # Three degrees of trim, 0.3 /m of drag and 5 % of scale are usual; a lag of 2.5 s never is.
    assert shares == pytest.approx(
        {"quadratic_drag": 0.08, "trim_offset": 0.382, "sonar_scale": 0.76}, rel=0.01
    )
    assert list(shares) == ["quadratic_drag", "trim_offset", "sonar_scale"]
    said = sentence_of("nothing_wrong", (), (), "", seen)
    assert "3 of 46 effects, such as quadratic_drag of 0.024 1/m, sonar_scale of 0.038." in said


def test_coloured_noise_is_told_beside_the_verdict_and_white_noise_is_not():
    plain = sentence_of("nothing_wrong", (), (), "", {})
    assert sentence_of("nothing_wrong", (), (), "", {}, {}) == plain
    told_too = sentence_of("nothing_wrong", (), (), "", {}, {"gyro": 0.512, "sonar": 0.3})
    assert told_too.startswith(plain)
    assert "gyro (0.51), sonar (0.30)" in told_too

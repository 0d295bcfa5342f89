"""The sentences of a verdict: a short headline that agrees with the probabilities, and details below it."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import product

import pytest

from slam.criticism.cause import FAINT, LIKELY, Cause, ChannelError, Gain, Interval
from slam.criticism.finding import NameInDoubt, OutOfRange, ResidualPattern
from slam.criticism.verdict.criticism import Criticism, Rank
from slam.criticism.verdict.sentence import details, headline, unusable
from slam.simulation.terms import CATALOGUE

SPEED = ChannelError("velocity_x", "m/s", 2.0, 0.31, 0.12)
PITCH = ChannelError("pitch", "rad", 2.0, 0.020, 0.018)
SOON, WORSE = ChannelError("pitch", "rad", 0.5, 0.02, 0.001), ChannelError("range", "m", 2.0, 0.01, 0.02)
NAMES = ("active_braking", "asymmetric_drag", "quadratic_drag")
PROBABILITIES = (0.0, 0.004, 0.049, 0.05, 0.3, 0.5, 0.51, 0.97, 1.0)
LEFT_OVER = (
    (),
    (ResidualPattern.of("force ahead ~ tilt2", 23.5),),
    (
        ResidualPattern.of("a", 4.2),
        OutOfRange(0.3, "1/s", (0.5, 0.6), channel="b"),
        NameInDoubt(("d",), effect="c"),
    ),
)
LIMITS = "No command log: the vehicle's motion is not judged."


def made(
    name: str, probability: float, *channels: ChannelError, by: str | None = "flight",
    lead_nats: float = 20.0, alternatives: tuple[str, ...] = (),
) -> Cause:  # fmt: skip
    size = {"k_b": Interval(0.9, "1/s", 0.8, 1.0)}
    gain = Gain(45.2, (30.0, 60.0), by, (20.0, 25.2), channels)
    rival = "asymmetric_drag"
    return Cause(name, probability, size, gain, 9.0, lead_nats, (name, *alternatives), rival)


def sentences(text: str) -> list[str]:
    return re.split(r"(?<=[.!?])\s+(?=[A-Z])", text)


def lacking(text: str) -> str:
    """Return what the headline says that the model lacks."""
    return "".join(s for s in sentences(text) if "model lacks" in s)


def all_findings():
    verdicts = ("named", "named_with_remainder", "ambiguous", "unknown")
    for verdict, first, second, left, limits in product(
        verdicts, PROBABILITIES, (None, *PROBABILITIES), LEFT_OVER, ("", LIMITS)
    ):
        among = ("asymmetric_drag",) if verdict == "ambiguous" else ()
        causes = [made(NAMES[0], first, SPEED, alternatives=among)]
        causes += [made(NAMES[2], second)] if second is not None else []
        yield Criticism(
            verdict, causes=tuple(causes), equivalence_set=(NAMES[0], *among) if among else (),
            findings=left, ranking=(Rank("asymmetric_drag", 1.0 - first, 3.0),), limits=limits,
            noise_correlation={"gyro": 0.4},
        )  # fmt: skip
    for left, limits in product(LEFT_OVER, ("", LIMITS)):
        yield Criticism("unknown", findings=left, limits=limits)
    yield Criticism("nothing_wrong", detectable={"trim_offset": (0.02, "rad")}, limits=LIMITS)


def test_a_headline_is_at_most_three_short_sentences_that_agree_with_the_probabilities():
    for finding in all_findings():
        text = headline(finding)
        assert len(sentences(text)) <= 3, text
        assert max(len(s.split()) for s in sentences(text)) <= 30, text
        assert "0.00" not in text
        for cause in finding.causes:
            among_equals = finding.verdict == "ambiguous" and cause.name in finding.equivalence_set
            if cause.probability > LIKELY:
                assert cause.name in (text if among_equals else lacking(text)), text
                # It is named in a main clause, not in brackets.
                assert cause.name in re.sub(r"\([^)]*\)", "", text)
            else:
                assert cause.name not in lacking(text).split(";")[0], text
            if cause.probability < FAINT and finding.verdict == "unknown":
                assert cause.name not in text
        if finding.limits and finding.verdict != "nothing_wrong":
            assert LIMITS in text


def test_details_hold_every_cause_and_every_unexplained_finding():
    for finding in all_findings():
        lines = details(finding)
        for cause in finding.causes:
            expected = f"{cause.name}: {CATALOGUE[cause.name].meaning} (probability {cause.probability:.2f})"
            assert any(line.startswith(expected) for line in lines)
        unexplained = [line for line in lines if line.startswith("Unexplained: ")]
        assert unexplained == [f"Unexplained: {part}." for part in finding.remainder.split("; ") if part]


def test_one_cause_is_reported_with_its_size_and_what_it_gains_two_seconds_ahead():
    text = headline(Criticism("named", causes=(made(NAMES[0], 0.97, PITCH, SOON, SPEED, WORSE),)))
    assert text == (
        "The model lacks active_braking: it brakes by itself when the stick is released "
        "(k_b = 0.9 1/s; probability 0.97). "
        "On held-out flights the error of velocity_x 2 s ahead is 0.12 m/s instead of 0.31."
    )


def test_several_causes_are_listed_and_what_is_unexplained_is_counted():
    causes = [made(NAMES[0], 1.0, SPEED), made(NAMES[1], 0.99), made(NAMES[2], 0.0)]
    text = headline(Criticism("named_with_remainder", causes=tuple(causes), findings=LEFT_OVER[2]))
    assert text.startswith(
        "The model lacks active_braking (probability 1.00) and asymmetric_drag (probability 0.99). On "
    )
    assert text.endswith("Unexplained: a (z = 4.2), and 2 more.")


def test_errors_ahead_are_those_of_all_causes_together_and_stand_once():
    """Roll-outs are made with all causes in the model, so no cause has them for itself."""
    lines = details(
        Criticism(
            "named",
            causes=(
                made(NAMES[0], 1.0, SPEED),
                made(NAMES[1], 1.0, SPEED),
            ),
        )
    )
    assert ["velocity_x" in line for line in lines] == [False, False, True]
    assert lines[2].startswith("With all causes together, on held-out flights the error of velocity_x")
    (_, alone) = details(Criticism("named", causes=(made(NAMES[0], 1.0, SPEED),)))
    assert alone.startswith("On held-out flights the error of velocity_x")


def test_effects_that_cannot_be_distinguished_are_no_certain_causes():
    causes = [made(NAMES[0], 0.55, alternatives=NAMES[1:2]), made(NAMES[2], 1.0)]
    finding = Criticism(
        "ambiguous", causes=tuple(causes), equivalence_set=NAMES[:2], ranking=(Rank(NAMES[1], 0.45, 3.0),)
    )
    assert headline(finding).startswith(
        "The model lacks quadratic_drag (probability 1.00); "
        "the flights cannot distinguish active_braking and asymmetric_drag."
    )
    listed = "active_braking (probability 0.55), asymmetric_drag (probability 0.45)"
    assert f"Effects that the flights cannot distinguish: {listed}." in details(finding)


def test_pictures_gain_from_one_to_another():
    px = ChannelError("reprojection", "px", 0.0, 1.3, 0.2)
    text = headline(Criticism("named", causes=(made(NAMES[0], 1.0, PITCH, px),)))
    assert "the reprojection error from picture to picture is 0.2 px instead of 1.3" in text


def test_what_was_not_held_out_is_not_reported_as_held_out():
    finding = Criticism("named", causes=(made(NAMES[0], 1.0, by=None),))
    assert "held-out" not in headline(finding) + " ".join(details(finding))


def test_the_next_best_is_reported_where_it_is_excluded():
    def sentence(**how) -> str:
        return " ".join(details(Criticism("named", causes=(made(NAMES[0], 1.0, SPEED, **how),))))

    assert "asymmetric_drag, the next best, fits the flights worse by 20 nats" in sentence()
    assert "next best" not in sentence(alternatives=NAMES[1:2])
    assert "next best" not in sentence(lead_nats=float("inf"))


@pytest.mark.parametrize("channels", [(), (WORSE,)])
def test_where_no_reading_gains_the_likelihood_is_reported(channels: tuple[ChannelError, ...]):
    text = headline(Criticism("named", causes=(made(NAMES[0], 1.0, *channels),)))
    assert "the log likelihood gains 45 nats" in text


def test_a_gain_at_another_horizon_is_told_with_that_horizon():
    text = headline(Criticism("named", causes=(made(NAMES[0], 1.0, SOON, WORSE),)))
    assert f"of {SOON.channel} {SOON.horizon_s:g} s ahead is {math.degrees(SOON.after):.2g} deg" in text
    assert made(NAMES[0], 1.0, SOON, WORSE).gain.flies_worse


def test_a_gain_that_no_reader_could_see_is_none():
    hardly = ChannelError("pitch", "rad", 2.0, 0.0210, 0.0208)
    text = headline(Criticism("named", causes=(made(NAMES[0], 1.0, hardly),)))
    assert "no channel is predicted better" in text
    assert "0.021" not in text
    assert "2 s ahead" not in headline(Criticism("named", causes=(made(NAMES[0], 1.0),)))


def test_only_what_shows_at_a_usual_size_counts_as_tested():
    seen = {"trim_offset": (0.02, "rad"), "attitude_lag": (2.5, "s"), "quadratic_drag": (0.024, "1/m")}
    seen |= {"sonar_scale": (0.038, "1")}
    shares = Criticism("nothing_wrong", detectable=seen).within_reach
    # Three degrees of trim, 0.3 /m of drag and 5 % of scale are usual; a lag of 2.5 s never is.
    assert shares == pytest.approx(
        {"quadratic_drag": 0.08, "trim_offset": 0.382, "sonar_scale": 0.76}, rel=0.01
    )
    assert list(shares) == ["quadratic_drag", "trim_offset", "sonar_scale"]
    finding = Criticism("nothing_wrong", detectable=seen)
    assert headline(finding) == (
        "The flights show no error of the model. They would have shown 3 of 47 effects at their usual sizes."
    )
    unjudged = replace(finding, limits=LIMITS)
    assert headline(unjudged).startswith("The flights show no error of an instrument.")
    # The smallest visible sizes are reported as such, apart from the usual ones.
    smallest = "Smallest sizes that nine of ten such flights would have shown"
    assert details(finding) == (f"{smallest}: quadratic_drag 0.024 1/m, sonar_scale 3.8 %.",)


def test_correlated_noise_is_a_detail_and_white_noise_is_none():
    assert details(Criticism("nothing_wrong")) == ()
    (line,) = details(Criticism("nothing_wrong", noise_correlation={"gyro": 0.512, "sonar": 0.3}))
    assert "gyro (0.51), sonar (0.30)" in line


def test_flights_that_cannot_be_judged_have_one_reason_in_the_headline_and_all_in_the_details():
    found = unusable(["a: too short", "b: no readings", "c: no readings"], advice="Fly longer.")
    assert found.sentence == "These data cannot be judged: a: too short, and 2 further reasons. Fly longer."
    assert found.details == ("b: no readings.", "c: no readings.")

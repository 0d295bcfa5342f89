"""The page of a criticism: what a person must find on it, for each kind of verdict."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from slam.core.plot_style import BLUE, ORANGE, VERMILLION
from slam.criticism.cause import Cause, ChannelError, Gain, Interval
from slam.criticism.kalman.readings import CHANNELS
from slam.criticism.search.fitted_parameters import NUISANCES
from slam.criticism.verdict.criticism import Criticism, Rank
from slam.criticism.verdict.over_time import SizeOverTime
from slam.criticism.verdict.rollouts import ChannelResiduals, Covariate
from slam.evaluation.map_gain import MapErrors, MapGain
from slam.report.criticism.answers import criticism_answers, left_out_by_flight
from slam.report.criticism.certainty import longer_bar
from slam.report.criticism.changes import size_over_time
from slam.report.criticism.pictures import (
    covariate_caption,
    covariate_picture,
    fair_covariate,
    gain_picture,
    panels_of,
    ranking_picture,
)
from slam.report.criticism.plain_names import constant, quantity, reading, with_titles
from slam.report.criticism.segment import before_after_picture, evidence_segment
from slam.report.criticism.values import unshown_constants, value_rows
from slam.report.criticism.write import VERDICTS, render_criticism
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from slam.simulation.terms import CATALOGUE
from tests.slam.report.criticism.made_criticism import RANKING, REMAINDER, made

LEFT_OUT = "Which flights were judged, and what was left out?"
INSTRUMENTS = "Is an instrument damaged, or is the model incomplete?"


def test_the_page_shows_what_the_map_gains() -> None:
    nan = float("nan")
    gain = MapGain("flight_00", MapErrors(0.187, 0.943, 1600.0, 5.9), MapErrors(0.00065, 1.0, 4.6, nan))
    page = render_criticism(made(), [], [gain])
    assert "Gain in the map" in page
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    assert "position error, start and heading aligned 0.19 m 0.65 mm" in text
    assert "scale error of the map 6.04 % 0.00 %" in text
    assert "landmarks 5.90 % –" in text
    assert "right? NEES, 6 if so 1.6e+03 4.6" in text
    assert "The gain in the map" not in render_criticism(made(), [])


@pytest.mark.parametrize(
    "verdict",
    [
        pytest.param(
            v, marks=() if v in ("named_with_remainder", "ambiguous", "nothing_wrong") else pytest.mark.slow
        )
        for v in VERDICTS
    ],
)
def test_the_page_says_what_it_must(verdict: str) -> None:
    page = render_criticism(made(verdict), [])
    assert VERDICTS[verdict] in page
    assert ("The model lacks &lt;quadratic&gt; drag." in page) == (not verdict.startswith("named"))
    assert "0.437" in page
    assert "sonar_lag" in page  # what could not have been seen
    assert ("Steps of three sizes" in page) == (verdict != "unusable")  # the next flight
    assert "the line (3.7) is what chance &lt;seldom&gt; reaches" in page
    assert "flight_09: never moves" in page
    assert "http" not in re.sub(r"Content-Security-Policy|http-equiv", "", page)  # offline
    if verdict.startswith("named"):
        assert "0.080 (0.070 to 0.090)" in page  # to the digits of the interval
        assert "-61 %" in page
        assert "+10 %" in page  # channels that became worse are listed
    assert ("cannot distinguish" in page) == (verdict == "ambiguous")
    assert ("error of the gyro about the axis ahead in proportion to speed" in page.lower()) == (
        "remainder" in verdict
    )


def test_the_stretch_that_is_drawn_is_of_the_channel_that_gains_most() -> None:
    slow = load_model("nominal").with_term("climb_asymmetry", eps=-0.3)
    flights = [simulate_flight(slow, stick_for(["climb and descend by 0.6 m"]), 1)]
    assert made().causes[0].gain.foremost == ChannelError("velocity_x", "m/s", 2.0, 0.31, 0.12)
    for name, words in (("sonar.range", "Height reading"), ("attitude.pitch", "Pitch (nose down)")):
        drawn = before_after_picture(load_model("nominal"), slow, flights, name)
        assert drawn is not None
        assert drawn.caption.startswith(words)


@pytest.mark.parametrize("term", ["sonar_spikes", "timestamp_jitter"])
def test_what_single_readings_show_is_drawn_as_they_are(term: str, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr("slam.report.criticism.segment.png", lambda figure: drawn.append(figure) or b"")
    flights = [
        simulate_flight(load_model("nominal"), stick_for(["climb and descend by 0.6 m"]), seed)
        for seed in (1, 2)
    ]
    gain = Gain(30.0, (10.0, 50.0), None, (10.0, 20.0), ())
    result = replace(made(), causes=(replace(made().causes[0], name=term, parameters={}, gain=gain),))
    shown = evidence_segment(result, flights)
    assert shown is not None
    (axes,) = drawn[0].axes
    assert flights[1].name in axes.get_xlabel()
    times_s = axes.lines[0].get_xdata()
    assert 5.0 < np.ptp(times_s) <= 10.0
    if term == "sonar_spikes":
        assert set(axes.lines[0].get_ydata()) <= set(flights[1].sonar.range_m)
    page = render_criticism(result, flights)
    assert "What shows it" in page
    assert "Gain of single readings" in page


def test_the_covariate_is_drawn_for_cause_and_rival_with_means_before_and_after() -> None:
    x = np.linspace(-1.0, 1.0, 200)
    missed = {"": x, "quadratic_drag": 0.0 * x, "flow_scale": 0.5 * x}
    both = [
        ChannelResiduals(name, "velocity_x", "m/s", x, missed) for name in ("quadratic_drag", "flow_scale")
    ]
    result = replace(made(), covariate=Covariate("quadratic_drag", "flow_scale", tuple(both)))
    picture = np.asarray(Image.open(io.BytesIO(covariate_picture(result.covariate))).convert("RGB"))
    for colour in (BLUE, VERMILLION, ORANGE):
        rgb = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        assert (np.abs(picture.astype(int) - rgb).sum(axis=2) < 30).sum() > 500, colour
    page = render_criticism(result, [])
    assert "Why this cause" in page
    assert "Why this cause" not in render_criticism(made(), [])


def test_nothing_and_unknown_are_always_among_the_bars() -> None:
    """Twenty others do not push them off: a bar each for at most twelve."""
    many = np.asarray(Image.open(io.BytesIO(ranking_picture(made()))))
    few = np.asarray(Image.open(io.BytesIO(ranking_picture(Criticism("named", "", ranking=RANKING[-2:])))))
    assert many.shape[0] > few.shape[0] > 100


def test_no_hypothesis_shouts(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr("slam.report.criticism.pictures.png", lambda figure: drawn.append(figure) or b"")
    ranking_picture(made())
    drawn[0].canvas.draw()
    names = [tick.get_text() for tick in drawn[0].axes[0].get_yticklabels()]
    assert {"nothing is wrong", "something unknown", "drag with the square of the speed"} <= set(names)
    assert all(name == name.lower() for name in names)


def test_a_dot_a_part() -> None:
    picture = np.asarray(Image.open(io.BytesIO(gain_picture(made().causes[0].gain))).convert("RGB")).astype(
        int
    )
    green = np.abs(picture - [0x00, 0x9E, 0x73]).sum(axis=2) < 30
    red = np.abs(picture - [0xD5, 0x5E, 0x00]).sum(axis=2) < 30
    assert green.sum() > 1.5 * red.sum() > 0  # two gain, one loses


def test_a_pilots_questions_are_answered_from_the_lines_of_the_verdict() -> None:
    found = {row.label: " ".join((row.value, *row.lines)) for row in criticism_answers(made(REMAINDER))}
    assert found["Is the model right about these flights?"].startswith("No: a part")
    assert found["Is the model right about these flights?"].endswith("More is wrong than that explains.")
    assert (
        found["What is not explained?"]
        == "There is an error of the gyro about the axis ahead in proportion to speed, which no effect "
        "explains (by 7.0 standard deviations)."
    )
    use = found["Can I use the model now, and how?"]
    assert "one, for flights like these: give extended.toml to" in use
    assert "For the rest, the model's predictions stay wrong by what is not explained." in use
    assert found["What do I fly next?"].startswith("Steps of three sizes")
    assert (
        "What is not explained concerns the gyro: look at it before the next flight (mounting, wiring, "
        "settings and time stamps), and if all is in order, fly." in found[INSTRUMENTS]
    )
    assert "larger than stated: gyro 29 times." in found[INSTRUMENTS]
    assert "flight_09: never moves." in found[LEFT_OUT]


def test_effects_and_their_parameters_have_their_plain_names() -> None:
    lines = with_titles(["gyro_bias.x varies; steady_wind or gusts", "steady_wind and other_1"])
    assert lines == [
        "a gyro bias (axis ahead, x) varies; a steady wind or gusts",
        "a steady wind and other_1",
    ]
    for term in CATALOGUE.values():
        for parameter in term.parameters:
            told = quantity(term.name, parameter.name)
            assert told
            assert "_" not in told


def test_all_reasons_for_which_a_flight_was_left_out_stand_in_one_line() -> None:
    dropped = ("a 2: too few readings", "a 2: nothing is left", "b: never moves", "no command log: no motion")
    lines = left_out_by_flight(replace(made(), dropped=dropped))
    assert lines == [
        "a 2: too few readings; nothing is left.",
        "b: never moves.",
        "no command log: no motion.",
    ]
    assert left_out_by_flight(replace(made(), dropped=())) == ["No flight was left out."]


def test_a_cause_with_a_shorter_bar_is_explained_only_where_there_is_a_longer_one() -> None:
    assert longer_bar(made()) == ""
    longer = Rank("gusts", 0.0, 12.0)
    told = longer_bar(replace(made(), ranking=(*RANKING, longer)))
    assert told.startswith("Alone, gusts stands out more (12 sigma) than drag with the square of the speed")
    assert "worse by 20 nats or more" in told


def test_the_bar_of_a_found_cause_is_its_strength_beside_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr("slam.report.criticism.pictures.png", lambda figure: drawn.append(figure) or b"")
    ranking = tuple(replace(rank, z=min(rank.z, 1.0)) for rank in RANKING)
    ranking_picture(replace(made(), ranking=ranking))
    bars = {round(bar.get_width(), 1) for bar in drawn[0].axes[1].patches}
    assert bars == {0.0, 1.0, made().causes[0].z}


def test_two_names_that_share_a_probability_have_open_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr("slam.report.criticism.pictures.png", lambda figure: drawn.append(figure) or b"")
    ranking = (Rank("quadratic_drag", 1.0, 9.0), Rank("flow_scale", 0.0, 8.0), Rank("unknown", 0.0, 0.0))
    double = replace(made().causes[0], rival="flow_scale", lead_nats=24.0, probability=1.0)
    alike = ("flow_scale", "quadratic_drag", 0.99)
    ranking_picture(
        replace(made(), ranking=ranking, causes=(double,), confusable=(alike,), limits="No command log.")
    )
    bars = drawn[0].axes[0].patches
    assert [(bar.get_width(), bar.get_facecolor()[3]) for bar in bars] == [(1.0, 0.0)] * 2  # nothing unknown


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (Interval(0.96, "1", 0.95, 0.97), "healthy"),
        (Interval(1.0, "1", 0.94, 1.06), ""),  # healthy vehicles have 0.95 to 1.05
        (Interval(1.28, "1", 1.18, 1.38), "outside of healthy"),
    ],
)
def test_a_constant_is_told_with_its_healthy_range_or_as_not_shown(found: Interval, verdict: str) -> None:
    result = replace(made(), nuisances={"vehicle.gain": found})
    verdicts = {row.quantity: row.verdict for row in value_rows(result)}
    assert verdicts.get(constant("vehicle.gain"), "") == verdict
    assert (constant("vehicle.gain") in unshown_constants(result)) == (verdict == "")


def test_the_original_value_of_a_constant_is_that_of_the_model() -> None:
    found = {
        "velocity_std_m_s": Interval(0.055, "m/s", 0.048, 0.062),
        "vehicle.gain": Interval(1.3, "1", 1.2, 1.4),
    }
    rows = {row.quantity: row.original for row in value_rows(replace(made(), causes=(), nuisances=found))}
    assert rows == {constant("velocity_std_m_s"): "0.034 m/s", constant("vehicle.gain"): "1"}


def test_a_quantity_that_a_cause_has_is_told_once() -> None:
    lag = Cause("attitude_lag", 1.0, {"tau": Interval(0.37, "s", 0.3, 0.43)}, made().causes[0].gain, 9.0, 0.0)
    own = {"vehicle.attitude_time_s": Interval(0.37, "s", 0.32, 0.42)}
    rows = value_rows(replace(made(), causes=(lag,), nuisances=own))
    assert [(row.original, row.value, row.verdict) for row in rows] == [
        ("0.1 s", "0.37 (0.30 to 0.43) s", "more than usual, or usual")
    ]


def test_a_rival_that_explains_no_fair_part_has_no_panel() -> None:
    x = np.linspace(-1.0, 1.0, 200)
    missed = {"": x, "quadratic_drag": 0.0 * x, "flow_scale": x}
    both = [
        ChannelResiduals(name, "velocity_x", "m/s", x, missed) for name in ("quadratic_drag", "flow_scale")
    ]
    result = replace(made(), covariate=Covariate("quadratic_drag", "flow_scale", tuple(both)))
    assert fair_covariate(result) == replace(result.covariate, against=tuple(both[:1]))
    fair = replace(result, causes=(replace(made().causes[0], rival="flow_scale"),))
    assert fair_covariate(fair) == result.covariate


def test_a_rival_whose_errors_have_no_slope_leaves_the_width_to_the_cause() -> None:
    x = np.linspace(-1.0, 1.0, 200)
    missed = {"": x, "quadratic_drag": 0.0 * x, "flow_scale": x}
    cause, rival, flat = (
        ChannelResiduals(name, "velocity_x", "m/s", at, missed)
        for name, at in (("quadratic_drag", x), ("flow_scale", x), ("flow_scale", 0.0 * x))
    )
    found = Covariate("quadratic_drag", "flow_scale", (cause, rival))
    assert panels_of(found) == [cause, rival]
    assert panels_of(replace(found, against=(cause, flat))) == [cause]
    told = covariate_caption(replace(made(), covariate=replace(found, against=(cause, flat))))
    assert "other panel" not in told


def test_a_size_that_changes_is_drawn_over_time_and_told_with_its_flight() -> None:
    series = SizeOverTime(
        "control_latency", "T", "s", ("one", "one", "two"), np.array([0.0, 5.0, 0.0]),
        np.array([0.12, 0.4, 0.2]), np.array([0.02, 0.02, 0.03]), 0.3,
    )  # fmt: skip
    shown = size_over_time(replace(made(REMAINDER), changes=(series,)))
    assert shown is not None
    assert "delay is 0.12 s from 0 to 5 s of one and 0.4 s from 5 to 10 s of one" in shown.where
    assert size_over_time(made(REMAINDER)) is None


def test_sizes_are_told_in_everyday_units() -> None:
    sizes = {axis: Interval(0.03, "rad", 0.02, 0.04) for axis in "xy"}
    tilted = Cause("camera_tilt", 1.0, sizes, made().causes[0].gain, 9.0, 0.0)
    answers = {row.label: row for row in criticism_answers(replace(made(), causes=(tilted,)))}
    told = answers["What is wrong, and how large is it?"].value
    assert told.endswith("axis ahead, x 1.7 (1.1 to 2.3) deg; axis to the left, y 1.7 (1.1 to 2.3) deg.")


def test_every_reading_and_every_fitted_constant_has_plain_words():
    coded = re.compile(r"_|[a-z]\.[a-z]")
    for name in CHANNELS:
        assert not coded.search(reading(name))
    for nuisance in NUISANCES:
        assert not coded.search(constant(nuisance.name))

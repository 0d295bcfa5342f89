"""Certainty, values, instruments and data on the page of a criticism, and its pictures before and after."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from slam.criticism.cause import ChannelError, Gain, Interval
from slam.criticism.finding import Inconsistency, NameInDoubt, Onset, OutOfRange, ResidualPattern
from slam.criticism.verdict.criticism import Criticism, Rank
from slam.criticism.verdict.over_time import SizeOverTime
from slam.report.criticism.answers import criticism_answers
from slam.report.criticism.cause_evidence import evidence_of_causes, shown_in_short
from slam.report.criticism.certainty import (
    certainty_rows,
    doubt_of_name,
    how_sure,
    is_established,
    out_of_order,
    reservations,
)
from slam.report.criticism.detectable import UNSTEADY, detectable_rows
from slam.report.criticism.findings import concerned, distinct_findings, findings_in_words
from slam.report.criticism.headline import lead, promises
from slam.report.criticism.inertial_segment import compared_segment
from slam.report.criticism.instruments import instruments_doubted, whose_is_it
from slam.report.criticism.judged_data import judged_data
from slam.report.criticism.next_flights import to_fly, to_use
from slam.report.criticism.segment import before_after_picture
from slam.report.criticism.values import change_of_size, value_rows
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from tests.slam.report.criticism.made_criticism import cause_that_may_be_none, made


def test_what_is_there_and_what_it_is_are_two_certainties() -> None:
    (cause,) = made().causes
    assert is_established(cause, made())
    scale = cause_that_may_be_none()
    assert not is_established(scale, made())
    assert "not established by itself" in " ".join(reservations(scale, made()))
    alike = replace(made(), confusable=(("flow_scale", "quadratic_drag", 0.99),))
    assert is_established(cause, alike)  # nothing says that it explains a part
    double = replace(cause, rival="flow_scale", lead_nats=24.0)
    assert not is_established(double, alike)
    (reservation,) = reservations(double, alike)
    assert "(likeness 0.990), so its name is open: the 24 nats by which it fits better" in reservation
    assert doubt_of_name(double, alike) == "hardly distinct from speed wrong by a factor here"
    even = replace(cause, probability=0.5, z=5.0)
    unknown = replace(
        made(), ranking=(Rank("unknown", 1.0, 0.0),), patterns=(ResidualPattern.of("roll ~ pitch", 11.0),)
    )
    (why,) = reservations(even, unknown)
    assert "stands out more (11.0 standard deviations)" in why


def test_the_judged_data_are_told_with_their_streams_and_what_is_missing() -> None:
    flight = replace(
        simulate_flight(load_model("nominal"), stick_for(["climb and descend by 0.6 m"]), 1), imu=None
    )
    told = " ".join(judged_data(replace(made(), flights=(flight.name,)), [flight]))
    assert f"{flight.name}: " in told
    assert "Hz)" in told
    assert "The flight has no gyro and accelerometer and no pictures." in told


@pytest.mark.slow
def test_flights_without_commands_have_a_before_and_after_too() -> None:
    wrong = load_model("nominal").with_term("gyro_bias", y=0.02)
    flight = replace(simulate_flight(wrong, stick_for(["hover for 8 s"] * 4), 1), command=None)
    channel = ChannelError("pitch from the gyro", "rad", 2.0, 0.04, 0.002)
    cause = replace(
        made().causes[0], name="gyro_bias", parameters={"y": Interval(0.02, "rad/s", 0.019, 0.021)},
        gain=Gain(50.0, (40.0, 60.0), "segment", (25.0, 25.0), (channel,)),
    )  # fmt: skip
    result = replace(made(), causes=(cause,), extended=wrong, flights=(flight.name,))
    shown = compared_segment(result, [flight])
    assert shown is not None
    before, after = map(
        float, re.findall(r"pitch from the gyro ([\d.]+) deg before, ([\d.]+) deg", shown.caption)[0]
    )
    assert after < 0.3 * before
    assert compared_segment(made(), [flight]) is None


def test_the_stick_is_drawn_below_what_it_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr("slam.report.criticism.segment.png", lambda figure: drawn.append(figure) or b"")
    slow = load_model("nominal").with_term("climb_asymmetry", eps=-0.3)
    flight = simulate_flight(slow, stick_for(["climb and descend by 0.6 m"]), 1)
    assert before_after_picture(load_model("nominal"), slow, [flight], "sonar.range") is not None
    _, below = drawn[0].axes
    assert below.get_ylabel() == "stick up"
    assert set(below.lines[0].get_ydata()) <= {0.0, *flight.command.stick[:, 2]}


def test_an_instruments_error_is_told_beside_the_usual_one_with_what_to_do() -> None:
    bias, late = (
        replace(made().causes[0], name=name, parameters={p: Interval(size, unit, 0.9 * size, 1.1 * size)})
        for name, p, size, unit in (
            ("gyro_bias", "y", 0.003, "rad/s"),
            ("timestamp_jitter", "sigma", 0.03, "s"),
        )
    )
    usual = " ".join(instruments_doubted(replace(made(), causes=(bias,))))
    assert "none looks damaged" in usual
    assert "0.172 deg/s (usual: up to ±2 deg/s)" in usual
    far = " ".join(instruments_doubted(replace(made(), causes=(bias, late))))
    assert far.startswith("More than usual is wrong with the clock of the log")
    assert "look at how the log gets its stamps" in far


def test_an_effect_that_looks_like_a_cause_is_not_told_as_absent() -> None:
    (cause,) = made().causes
    seen = {"quadratic_drag": (0.02, "1/m"), "asymmetric_drag": (0.2, "1"), "flow_scale": (2.0, "1")}
    result = replace(
        made(), detectable=seen, causes=(replace(cause, rival="asymmetric_drag", lead_nats=5.0),),
        confusable=(("asymmetric_drag", "quadratic_drag", 0.99),),
    )  # fmt: skip
    verdicts = [row.verdict for row in detectable_rows(result)]
    assert verdicts == [
        "found, name uncertain",
        "perhaps, instead of what was found",
        "not even at usual sizes",
    ]
    alone = replace(result, confusable=())
    assert [row.verdict for row in detectable_rows(alone)][:2] == ["found", "not found"]


def test_one_finding_that_is_told_twice_and_reservations_are_not_counted() -> None:
    gain, pattern = OutOfRange(channel="vehicle.gain"), ResidualPattern.of("velocity_x ~ ahead", 11.0)
    varying = Inconsistency("during a flight", 120.0, is_cause=False, effect="flow_scale", z=11.0)
    doubt = NameInDoubt(effect="timestamp_jitter")
    result = replace(
        made(),
        findings=(gain, varying, pattern, doubt),
        nuisances={"vehicle.gain": Interval(1.28, "1", 1.18, 1.38)},
    )
    assert len(distinct_findings(result)) == 2
    assert len(findings_in_words(result)) == 2
    other = replace(result, findings=(gain, varying, replace(pattern, z=9.0), doubt))
    assert len(distinct_findings(other)) == 3
    assert concerned(result) == ["the scaling of the sticks in the autopilot", "the speed sensor"]
    assert "(extended.toml keeps 1): " in whose_is_it(result, [])[0]


def test_a_name_that_is_not_established_has_no_probability_and_is_deleted_first() -> None:
    (cause,) = made().causes
    scale = cause_that_may_be_none()
    result = replace(made(), causes=(cause, scale), detectable={"gyro_scale": (0.009, "1")})
    told = [row.probability for row in certainty_rows(result)]
    assert told == ["0.97", "not established: its size may be none"]
    assert [row.verdict for row in detectable_rows(result)] == ["not established"]
    steps = to_use(result, "Yes")
    assert "[terms.gyro_scale] and [std.gyro_scale]" in steps[1]
    assert steps[2].startswith("2. Give extended.toml to slam simulate")
    (alone,) = to_use(made(), "Yes")
    assert alone.startswith("Yes: give extended.toml to slam simulate and slam replay")


def test_a_visible_limit_lies_below_its_size_and_a_change_is_told_with_what_it_changes() -> None:
    seen = {"tilt_limit": (0.06, "rad"), "attitude_lag": (0.11, "s")}
    limit, lag = detectable_rows(replace(made(), detectable=seen))
    assert limit.size == "a limit below 3.44 deg"
    assert (lag.size, lag.usual) == (
        "above 0.21 s",  # none is faster than at once
        "0.05 to 0.3 s",
    )


def test_stamps_that_scatter_by_more_than_readings_are_apart_would_be_out_of_order() -> None:
    flight = simulate_flight(load_model("nominal"), stick_for(["climb and descend by 0.6 m"]), 1)
    small, large = (
        replace(made().causes[0], name="timestamp_jitter", parameters={"sigma": Interval(s, "s", s, s)})
        for s in (0.01, 0.06)
    )
    assert out_of_order(small, [flight]) == ""
    assert "only 40 ms apart" in out_of_order(large, [flight])  # its sonar's
    one = replace(flight.sonar, stamps_s=flight.sonar.stamps_s[:1], range_m=flight.sonar.range_m[:1])
    assert "nan" not in out_of_order(large, [replace(flight, sonar=one)])


def test_an_effect_whose_size_changes_is_told_as_such_whatever_size_would_show() -> None:
    unsteady = Inconsistency("during a flight", 120.0, is_cause=False, effect="accel_bias", z=11.0)
    for size in (0.01, 50.0):  # m/s^2: within and beyond the usual ones
        result = replace(made(), detectable={"accel_bias": (size, "m/s^2")}, findings=(unsteady,))
        assert [row.verdict for row in detectable_rows(result)] == [UNSTEADY]


def test_advice_on_an_unknown_error_is_to_check_what_it_concerns() -> None:
    (told,) = to_use(made("unknown"), "Not as it is")
    assert "check " in told
    assert "the model's predictions stay wrong" in told


def test_a_mean_rate_that_is_not_the_usual_one_is_told_with_its_reason() -> None:
    flight = simulate_flight(load_model("nominal"), stick_for(["climb and descend by 0.6 m"]), 1)
    sonar = flight.sonar
    assert sonar is not None
    kept = np.abs(np.arange(len(sonar.stamps_s)) - 40) > 20
    holed = replace(sonar, stamps_s=sonar.stamps_s[kept], range_m=sonar.range_m[kept])
    told = " ".join(judged_data(replace(made(), flights=(flight.name,)), [replace(flight, sonar=holed)]))
    assert re.search(
        r"height \(\d+ readings at [\d.]+ Hz on average, mostly 25 Hz; longest gap 1\.6\d* s\)", told
    )


def test_an_effect_whose_size_may_be_none_is_not_promised_to_be_there() -> None:
    (cause,) = made().causes
    scale = cause_that_may_be_none()
    result = replace(made(), causes=(cause, scale))
    assert "Not established, because the size may be none: a gyro wrong by a factor." in lead(result)
    assert "is there" not in lead(result)
    assert "that gyro wrong by a factor is there at all" in " ".join(promises(result))
    assert any(line.startswith("Perhaps not there: gyro_scale") for line in how_sure(result))
    assert "whether gyro_scale is there at all" in " ".join(to_fly(result))


def _with_a_change() -> Criticism:
    """A gyro bias that falls from 4 to 2 mrad/s at 20 s, in a flight of 40 s."""
    begin = np.arange(0.0, 40.0, 5.0)
    sizes = np.where(begin < 20.0, 0.004, 0.002)
    series = SizeOverTime(
        "gyro_bias", "y", "rad/s", ("flight_00",) * 8, begin, sizes, np.full(8, 1e-4), 0.003
    )
    found = {"y": Interval(0.003, "rad/s", 0.0025, 0.0035)}
    return replace(
        made(), causes=(replace(made().causes[0], name="gyro_bias", parameters=found),), changes=(series,),
        findings=(Onset(20.0, -0.002, "rad/s", effect="gyro_bias", parameter="y", z=9.0),),
    )  # fmt: skip


def test_a_size_that_changes_at_a_moment_is_told_before_and_after_it() -> None:
    result = _with_a_change()
    change = change_of_size(result, "gyro_bias", "y")
    assert change is not None
    assert (change.before.value, change.after.value) == pytest.approx((0.004, 0.002))
    assert change.before.low == pytest.approx(0.004 - 1.96e-4 / 2)  # four parts
    rows = {row.quantity: row.value for row in value_rows(result)}
    assert rows["axis to the left, y: before about 20 s"] == "0.229 (0.224 to 0.235) deg/s"
    assert rows["axis to the left, y: after about 20 s"].startswith("0.115 ")
    told = " ".join(instruments_doubted(result))
    assert "gyro bias 0.229 (0.224 to 0.235) deg/s before about 20 s and 0.115" in told
    assert "slam optimize --model extended.toml corrects the mean of its size, not the change" in told
    assert change_of_size(replace(result, findings=()), "gyro_bias", "y") is None


def test_the_effect_that_looks_like_a_cause_has_a_manoeuvre_too() -> None:
    scale = replace(
        made().causes[0], name="accel_scale", rival="accel_bias", lead_nats=5.0,
        parameters={"eps": Interval(-0.01, "1", -0.012, -0.008)},
    )  # fmt: skip
    result = replace(made(), causes=(scale,), confusable=(("accel_bias", "accel_scale", 0.999),))
    told = " ".join(to_fly(result))
    assert "To tell accel_scale from accel_bias: rest on the floor with motors off" in told
    assert "Log the sticks" not in told
    flight = replace(simulate_flight(load_model("nominal"), stick_for(["hover for 8 s"]), 1), command=None)
    unjudged = replace(
        result, limits="No command log.", flights=(flight.name,), detectable={"gyro_bias": (0.001, "rad/s")}
    )
    told = " ".join(to_fly(unjudged, [flight]))
    assert "Log the sticks as well" in told
    assert "delay of the sticks" in told


def test_a_model_of_motion_that_was_not_judged_is_not_called_right() -> None:
    sound = replace(made(), verdict="nothing_wrong", causes=(), findings=(), equivalence_set=())
    told = " ".join(item.value for item in criticism_answers(replace(sound, limits="No command log.")))
    assert "motion was not judged" in told
    assert "whether the model of motion holds was not judged" in told
    assert "Its instruments only: no instrument needs a correction." in told
    for claim in ("Yes", "simulate with the model as it is", "the model holds."):
        assert claim not in told
        assert claim in " ".join(item.value for item in criticism_answers(sound))


@pytest.mark.slow
def test_every_certain_cause_has_its_own_evidence() -> None:
    wrong = load_model("nominal").with_term("gyro_bias", y=0.02).with_term("sonar_lag", T=0.3)
    flight = simulate_flight(wrong, stick_for(["climb and descend by 0.6 m"] * 4), 1)
    bias, late = (
        replace(made().causes[0], name=name, parameters={p: Interval(x, unit, 0.9 * x, 1.1 * x)})
        for name, p, x, unit in (("gyro_bias", "y", 0.02, "rad/s"), ("sonar_lag", "T", 0.3, "s"))
    )
    for judged in (flight, replace(flight, command=None)):
        result = replace(made(), causes=(bias, late), extended=wrong, flights=(flight.name,))
        evidence = evidence_of_causes(result, [judged])
        assert evidence is not None
        assert evidence.picture is not None
        assert [row.title for row in evidence.rows] == ["gyro bias", "late sonar"]
        shown = {row.title: row.shown for row in evidence.rows}
        assert shown["late sonar"].startswith("panel ")
        assert any(
            "wherever it acts: it predicts 2 of 3 flights better" in line.lower()
            for line in shown_in_short(evidence)
        )
    assert evidence_of_causes(made(), [flight]) is None  # the whole page is about one cause


def test_a_gyro_bias_and_an_attitude_that_drifts_look_the_same() -> None:
    cause = replace(
        made().causes[0], name="gyro_bias", parameters={"z": Interval(0.005, "rad/s", 0.004, 0.006)}
    )
    answers = {row.label: " ".join((row.value, *row.lines)) for row in criticism_answers(made())}
    assert "No other effect" in answers["What else could it be, and why not?"]
    shown = replace(made(), causes=(cause,), confusable=())
    answers = {row.label: " ".join((row.value, *row.lines)) for row in criticism_answers(shown)}
    other = answers["What else could it be, and why not?"]
    assert "An attitude that drifts by as much looks the same in flight" in other
    assert "No other effect" not in other

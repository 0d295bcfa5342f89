"""Findings: one text and one row of verdict.json for each kind, and words for a pilot."""

from __future__ import annotations

import json

import numpy as np
import pytest

from slam.criticism.finding import (
    ImplausibleSize,
    Inconsistency,
    NameInDoubt,
    Onset,
    OutOfRange,
    ResidualPattern,
)
from slam.criticism.verdict.criticism import Criticism
from slam.data_quality.finding import Finding, Remark, VaryingSize, flights_to_name
from slam.data_quality.frozen import Frozen
from slam.data_quality.jumps import Jump
from slam.data_quality.lag import LateReadings
from slam.data_quality.oscillation import Line, Vibration
from slam.data_quality.rounding import Rounding
from slam.data_quality.silent import Silent
from slam.report.criticism.findings import concerned, in_words
from slam.simulation.model import load_model

EACH: tuple[tuple[Finding, str, str, str], ...] = (
    (
        Remark("the floor shines", channel="pictures"),
        "the floor shines", "the floor shines.", "the camera",
    ),
    (
        Remark("the floor shines", channel="pictures", flight="second"),
        "second: the floor shines", "second: the floor shines.", "the camera",
    ),
    (
        Frozen(np.array([1.0, 4.0]), np.array([0.5, 0.7]), 0.1, np.ones(9, dtype=bool), channel="sonar"),
        "the sonar repeats its reading 2 times for about 0.6 s, first at 1 s (10 % of its readings)",
        "the sonar repeats its reading 2 times", "the height sensor",
    ),
    (
        Rounding(0.0175, "rad", channel="pitch", flight="second"),
        "second: pitch is rounded to steps of 0.0175 rad (1 deg)",
        "second: pitch is rounded to steps", "the attitude",
    ),
    (
        Rounding(0.1, "m", 20.4, 19.6, channel="range"),
        "range is rounded to steps of 0.1 m from 20 s on, for 20 s",
        "from 20 s on, for 20 s.", "the height sensor",
    ),
    (
        Silent(20.4, 19.6, True, channel="gyro"),
        "the gyro has no readings from 20 s to the end, and the others go on",
        "has no readings from 20 s to the end", "the gyro",
    ),
    (
        Silent(20.4, 9.6, False, channel="sonar"),
        "the sonar has no readings from 20 s for 9.6 s, and the others go on",
        "has no readings from 20 s for 9.6 s", "the height sensor",
    ),
    (
        Line(7.0, 0.3, "m/s^2", channel="accel_z"),
        "accel_z oscillates at 7.0 Hz by 0.3 m/s^2",
        "acceleration up oscillates at 7.0 Hz", "the accelerometer",
    ),
    (
        Vibration(7.0, -20.0, channel="accel_z"),
        "accel_z oscillates at 7.0 Hz (by chance in 10^-20)",
        "acceleration up oscillates at 7.0 Hz", "the accelerometer",
    ),
    (
        ResidualPattern.of("velocity_x ~ ahead, velocity_y ~ left", 11.0),
        "velocity_x ~ ahead, velocity_y ~ left (z = 11.0)",
        "error of the speed ahead in proportion to the speed ahead and an error of the speed to the left",
        "the speed sensor",
    ),
    (
        Inconsistency("during a flight", 120.0, effect="sonar_lag", z=5.0),
        "sonar_lag changes during a flight (z = 5.0)",
        "sonar_lag changes during a flight (by 5.0 standard deviations).", "the height sensor",
    ),
    (
        Inconsistency("during a flight", 120.0, is_cause=False, effect="flow_scale", z=11.0),
        "what looks like flow_scale changes during a flight (z = 11.0)",
        ": a constant one is not all of it.", "the speed sensor",
    ),
    (
        NameInDoubt(("control_latency",), effect="attitude_lag"),
        "attitude_lag may be control_latency",
        "may be control_latency instead", "",
    ),
    (
        NameInDoubt(("accel_scale",), effect="accel_bias", parameter="z"),
        "accel_bias.z may be accel_scale",
        "may be accel_scale instead", "the accelerometer",
    ),
    (
        ImplausibleSize(0.117, "1", effect="gyro_scale", parameter="eps", z=12.3),
        "gyro_scale.eps would be 0.12, which is not plausible (z = 12.3)",
        "which is not plausible: something else has the same effect", "the gyro",
    ),
    (
        Jump(143.5, "deg", 11.3, 2, channel="yaw"),
        "yaw jumps by 144 deg at 11.3 s, where the gyro shows no such change; it does so 2 times",
        "yaw jumps by", "the heading",
    ),
    (
        NameInDoubt(effect="timestamp_jitter"),
        "timestamp_jitter may be something else",
        "an effect that the catalogue does not hold.", "the clock of the log",
    ),
    (
        OutOfRange(0.0, "1", (0.95, 1.0512345), channel="vehicle.gain"),
        "vehicle.gain is 0 (healthy: 0.95 to 1.05)",
        "tilt per stick over the model's is 0", "the scaling of the sticks in the autopilot",
    ),
    (
        OutOfRange(channel="velocity_std_m_s"),
        "velocity_std_m_s out of range",
        "speed that nobody commands: the best value lies outside", "",
    ),
    (
        LateReadings(-0.0491, channel="velocity"),
        "velocity early by 49.1 ms",
        "velocity come 49.1 ms too early by their stamps.", "the speed sensor",
    ),
    (
        VaryingSize(0.0, 0.2, "m/s^2", 10.0, 9.0, effect="accel_bias", parameter="y"),
        "accel_bias.y is 0 to 0.2 m/s^2 by segments of 10 s, like an attitude error of 9 deg",
        "0.00 to 0.20 m/s^2 in stretches of 10 s, like an attitude error of 9 deg", "the accelerometer",
    ),
    (
        VaryingSize(-0.1, 0.2, "rad/s", 10.0, effect="gyro_bias", parameter="x"),
        "gyro_bias.x is -0.1 to 0.2 rad/s by segments of 10 s",
        "-6 to 11 deg/s in stretches of 10 s", "the gyro",
    ),
    (
        Onset(490.0, -0.0023, "rad/s", effect="gyro_bias", parameter="y", z=10.2),
        "gyro_bias.y changes by -0.0023 rad/s at about 490 s (z = 10.2)",
        "by -0.132 deg/s at about 490 s (by", "the gyro",
    ),
    (
        Onset(21.4, 0.11, "m/s", channel="velocity_x", z=9.1),
        "an error of velocity_x changes by 0.11 m/s at about 21 s (z = 9.1)",
        "an error of the speed ahead changes by 0.11 m/s at about 21 s (by", "the speed sensor",
    ),
    (
        Onset(0.0, -0.0023, "rad/s", flight="first", effect="gyro_bias", parameter="y", z=10.2),
        "first: gyro_bias.y changes by -0.0023 rad/s at about 0 s (z = 10.2)",
        "first: a gyro bias (axis to the left, y) changes by -0.132 deg/s at about 0 s (by", "the gyro",
    ),
)  # fmt: skip
"""Findings, with their texts in verdict.json, a part of their words for a pilot, and the sensor concerned."""


def kinds(of: type[Finding]) -> set[type[Finding]]:
    return {kind for own in of.__subclasses__() for kind in (own, *kinds(own))}


def rows_of(*findings: Finding) -> list[dict[str, object]]:
    written = json.dumps(Criticism("unknown", findings=findings).to_json(), allow_nan=False)
    return json.loads(written)["findings"]


def test_each_kind_is_here():
    assert {type(finding) for finding, *_ in EACH} == kinds(Finding)


def test_verdict_json_has_each_finding_with_its_text():
    findings, texts, *_ = zip(*EACH, strict=True)
    rows = rows_of(*findings)
    assert [row["text"] for row in rows] == list(texts)
    assert len({row["kind"] for row in rows}) == len(kinds(Finding))
    assert Criticism("unknown", findings=findings).remainder == "; ".join(texts)


@pytest.mark.parametrize(
    ("finding", "fields"),
    [
        (
            Remark("bright", flight="second", channel="pictures"),
            {"kind": "remark", "flight": "second", "channel": "pictures", "text": "second: bright"},
        ),
        (EACH[2][0], {"kind": "frozen", "channel": "sonar", "share": 0.1}),
        (
            NameInDoubt(effect="gusts"),
            {"kind": "name_in_doubt", "effect": "gusts", "others": [], "is_cause": True},
        ),
        (
            NameInDoubt(("gusts",), is_cause=False),
            {"kind": "name_in_doubt", "others": ["gusts"], "is_cause": False},
        ),
        (
            OutOfRange(channel="a"),
            {"kind": "out_of_range", "channel": "a", "value": None, "unit": "", "healthy": None},
        ),
        (
            OutOfRange(0.0, "s", (0.1234567, 0.2), channel="a"),
            {"kind": "out_of_range", "channel": "a", "value": 0.0, "unit": "s", "healthy": [0.12346, 0.2]},
        ),
        (
            VaryingSize(0.0, 0.2, "1", 10.0, effect="a", parameter="b"),
            {
                "kind": "varying_size", "effect": "a", "parameter": "b",
                "least": 0.0, "most": 0.2, "unit": "1", "segment_s": 10.0, "like_attitude_deg": 0.0,
            },
        ),
        (
            Onset(0.0, 0.1234567, "s", effect="a", parameter="b", z=9.0),
            {
                "kind": "onset", "effect": "a", "parameter": "b", "z": 9.0,
                "time_s": 0.0, "change": 0.12346, "unit": "s",
            },
        ),
    ],
)  # fmt: skip
def test_a_row_has_all_fields_except_arrays(finding: Finding, fields: dict[str, object]) -> None:
    shared = {"flight": "", "channel": "", "effect": "", "parameter": "", "z": 0.0, "text": str(finding)}
    assert rows_of(finding) == [shared | fields]


@pytest.mark.parametrize(
    ("finding", "words", "sensor"), [(finding, words, sensor) for finding, _, words, sensor in EACH]
)
def test_each_kind_has_words_and_a_sensor(finding: Finding, words: str, sensor: str) -> None:
    result = Criticism("unknown", findings=(finding,), model=load_model("nominal"))
    told = in_words(finding, result)
    assert words in told
    assert told.endswith(".")
    assert " ~ " not in told
    assert concerned(result) == [sensor] * bool(sensor)


def test_what_flights_with_commands_show_otherwise_is_no_finding_of_theirs():
    assert [type(finding) for finding, *_ in EACH if finding.is_shown_otherwise] == [Line]
    assert Rounding(0.01, "m", channel="range").is_shown_otherwise


def test_a_flight_is_named_where_there_are_several():
    assert flights_to_name(["first", "second"]) == ["first", "second"]
    assert flights_to_name(["first"]) == [""]
    assert flights_to_name([]) == []

"""Findings: one text and one row of verdict.json for each kind, and words for a pilot."""

from __future__ import annotations

import json

import numpy as np
import pytest

from slam.criticism.finding import (
    Inconsistency,
    LateReadings,
    NameInDoubt,
    Onset,
    OutOfRange,
    ResidualPattern,
    VaryingSize,
)
from slam.criticism.verdict.criticism import Criticism
from slam.data_quality.finding import Finding, Remark
from slam.data_quality.frozen import Frozen
from slam.data_quality.oscillation import Line, Vibration
from slam.data_quality.rounding import Rounding
from slam.report.criticism.findings import concerned, in_words
from slam.simulation.model import load_model

EACH = (
    Remark("the floor shines", channel="pictures"),
    Frozen(np.array([1.0, 4.0]), np.array([0.5, 0.7]), 0.1, np.ones(9, dtype=bool), channel="sonar"),
    Rounding(0.0175, "rad", channel="pitch", flight="second"),
    Line(7.0, 0.3, "m/s^2", channel="accel_z"),
    Vibration(7.0, -20.0, channel="gyro_x"),
    ResidualPattern.of("velocity_x ~ ahead, velocity_y ~ left", 11.0),
    Inconsistency("during a flight", 120.0, effect="sonar_lag", z=5.0),
    NameInDoubt(("control_latency",), effect="attitude_lag"),
    OutOfRange(0.42, "1", (0.95, 1.05), channel="vehicle.gain"),
    LateReadings(-0.049, channel="velocity"),
    VaryingSize(-0.1, 0.2, "m/s^2", 10.0, 9.0, effect="accel_bias", parameter="y"),
    Onset(490.0, -0.0023, "rad/s", flight="first", effect="gyro_bias", parameter="y", z=10.2),
)


def kinds(of: type[Finding]) -> set[type[Finding]]:
    return {kind for own in of.__subclasses__() for kind in (own, *kinds(own))}


def test_each_kind_is_here():
    assert {type(finding) for finding in EACH} == kinds(Finding)


def test_verdict_json_has_each_finding_with_its_text_and_fields():
    found = Criticism("unknown", findings=EACH)
    rows = json.loads(json.dumps(found.to_json(), allow_nan=False))["findings"]
    assert [row["text"] for row in rows] == [str(finding) for finding in EACH]
    assert len({row["kind"] for row in rows}) == len(EACH)
    assert found.remainder == "; ".join(row["text"] for row in rows)
    frozen, rounding = rows[1:3]
    assert frozen == {"kind": "frozen", "text": str(EACH[1]), "channel": "sonar", "share": 0.1}
    assert rounding["text"] == "second: pitch is rounded to steps of 0.0175 rad (1 deg)"
    assert rows[-1]["time_s"] == 490.0
    assert rows[-1]["flight"] == "first"


@pytest.mark.parametrize("finding", EACH, ids=lambda finding: type(finding).__name__)
def test_each_kind_has_words_and_a_sensor(finding: Finding):
    result = Criticism("unknown", findings=(finding,), model=load_model("nominal"))
    told = in_words(finding, result)
    assert told.endswith(".")
    assert " ~ " not in told
    assert len(concerned(result)) == (finding.effect != "attitude_lag"), "a lag is no instrument's"

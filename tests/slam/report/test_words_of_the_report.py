"""The words of the report: none that only engineers know, and explanations of the others."""

from __future__ import annotations

import re
from dataclasses import replace

from slam.core.messages import reason
from slam.report.optimize_report import Accuracy
from slam.report.tables.evaluation import Evaluated, FigureTable
from tests.slam.made_estimate import made_estimate, made_flight, saying
from tests.slam.report.test_optimize_report import page


def test_words_that_only_engineers_know_are_not_on_the_page(no_figures):
    evaluation = FigureTable("Against the reference", (), (("mean NEES", "6"),))
    text = page(
        made_estimate(), made_flight(), accuracy=Accuracy(evaluated=Evaluated("", (evaluation,)))
    ).text
    assert not re.search(r"\b(median|variances?|RMSE|EKF|covariances?|Final error)\b", text)
    words, glossary = text.split("Words\n", 1)
    for term in ("Keyframe", "Loop closure", "σ"):
        assert term.lower() in words.lower()
        assert term in glossary
    assert "NEES (normalised" in words


def test_words_of_the_reasons_are_explained_where_they_can_occur(no_figures):
    rejected = {"loop: out of reach": 2, "view of a floor point far off": 3}
    estimate = replace(made_estimate(), rejected=rejected)
    flown = page(estimate, made_flight()).text
    assert "taken too far apart to show the same ground" in flown
    assert "elsewhere in all other pictures" in flown
    assert "NEES" not in flown
    assert "mean height over the floor" not in flown
    accuracy = (FigureTable("Against the reference", (), (("mean NEES", "6"),)),)
    assert (
        "stated standard deviation, squared"
        in page(estimate, made_flight(), accuracy=Accuracy(evaluated=Evaluated("", accuracy))).text
    )
    assert "mean height over the floor" in page(replace(estimate, metric=False), made_flight()).text
    assert "inlier" not in flown.lower()
    assert "docs/method" in flown


def test_words_are_explained_where_the_page_has_them():
    without = replace(made_estimate(), messages=())
    named = saying(without, "cam0: the IMU leans; check T_BS in cam0/sensor.yaml")
    for word in ("sensor.yaml, T_BS", "Inertial measurement unit"):
        found = [word in page(estimate, made_flight()).text for estimate in (without, named)]
        assert found == [False, True]
    said = reason("velocity0 reads 3.28 times the speed", "check scale_std in velocity0/sensor.yaml")
    in_status = replace(without, messages=(said,))
    assert "sensor.yaml, T_BS" in page(in_status, made_flight()).text, "the status stands above the rest"

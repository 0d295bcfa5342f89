"""An evaluation is put into a report that was written before."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import cv2
import numpy as np

from slam.core.control_points import ControlReport, PointResidual
from slam.core.figure_table import FigureTable
from slam.core.messages import CHECKED_BY_ONE_DISTANCE
from slam.core.summary import summarise
from slam.core.units import SPACE
from slam.evaluation.landmarks import LandmarkPlace
from slam.report.evaluation_in_report import with_evaluation
from slam.report.optimize_report import Accuracy, Mosaics, render
from slam.report.tables.evaluation import Evaluated
from tests.slam.made_estimate import made_estimate, made_flight

TABLE = FigureTable("Against the reference", (), (("error <of> a map", "3 mm"),))
TOLD = Evaluated("Typically 3 mm & more.", (TABLE,), checks_lengths=True)


def test_the_page_is_that_of_a_map_that_was_evaluated_at_once(tmp_path, no_figures):
    estimate, flight = replace(made_estimate(), accuracy_basis=CHECKED_BY_ONE_DISTANCE), made_flight()
    (tmp_path / "loops.csv").touch()
    summary = summarise(estimate)
    before = render(estimate, summary, flight, folder=tmp_path)
    (tmp_path / "evaluation.json").touch()
    at_once = render(estimate, summary, flight, accuracy=Accuracy(evaluated=TOLD), folder=tmp_path)
    later = with_evaluation(before, TOLD, tmp_path)
    assert later is not None
    assert later == at_once
    assert with_evaluation(later, TOLD, tmp_path) == later
    assert "error &lt;of&gt; a map" in later
    shown = re.sub("<!--.*?-->", "", later)
    assert CHECKED_BY_ONE_DISTANCE not in shown
    by_gps = replace(TOLD, checks_lengths=False)
    assert CHECKED_BY_ONE_DISTANCE in re.sub("<!--.*?-->", "", with_evaluation(later, by_gps, tmp_path))


def test_check_points_tell_how_far_a_map_is_from_the_truth():
    places = ((0.0, 0.0, 400.0), (30.0, 40.0, math.nan))
    residuals = ((1.2, -0.8, 2.5), (1.22, -0.8, math.nan))
    checks = tuple(
        PointResidual(
            name=name, role="check", used=False, reason="", views=3, surveyed_m=place, residual_m=off,
            std_m=(0.04, 0.04, 0.1),
        )
        for name, place, off in zip("PQ", places, residuals, strict=True)
    )  # fmt: skip
    estimate = replace(made_estimate(), control=ControlReport(points=checks))
    shown = re.sub("<!--.*?-->", "", render(estimate, summarise(estimate))).replace(SPACE, " ")
    assert "At 2 check points" in shown
    assert "it is off by 1.21 m east, 0.80 m north and 2.50 m up (root mean square)" in shown
    assert "50.0 m from P to Q, is 0.024 % longer on the map" in shown
    assert "Not measured here" not in shown
    assert "measure one distance" not in shown.lower()


def test_a_page_of_an_earlier_version_has_no_place_for_it(tmp_path):
    assert with_evaluation("<html></html>", TOLD, tmp_path) is None


def test_landmarks_are_drawn_on_the_map_of_a_report_that_was_written_before(tmp_path, no_figures):
    estimate, flight = made_estimate(), made_flight()
    pixels = np.full((300, 400, 3), 90, np.uint8)
    for name in ("mosaic", "mosaic_chain"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), pixels)
        (tmp_path / f"{name}.pgw").write_text("0.01\n0\n0\n-0.01\n-1.995\n1.495\n")
    point = PointResidual(
        name='"P&1"', role="control", used=True, reason="", views=3, surveyed_m=(0.5, 0.2, math.nan)
    )
    estimate = replace(estimate, control=ControlReport(points=(point,)))
    summary = summarise(estimate)
    mosaics = Mosaics(after=tmp_path / "mosaic.png", before=tmp_path / "mosaic_chain.png")
    before = render(estimate, summary, flight, mosaics, folder=tmp_path)
    told = replace(
        TOLD, landmarks=(LandmarkPlace("A", 0.0, 0.0),), chain_landmarks=(LandmarkPlace("A", 0.3, 0.1),)
    )
    at_once = render(estimate, summary, flight, mosaics, Accuracy(evaluated=told), tmp_path)
    later = with_evaluation(before, told, tmp_path)
    assert later == at_once != before
    assert "Rings with names" in later
    assert "Triangles with names" in before
    drawn = [re.findall('src="(data:[^"]*)"', page)[:2] for page in (before, later)]
    assert len({*drawn[0], *drawn[1]}) == 3, "alike before, and each map with its own landmarks after"
    plain = Evaluated()
    assert with_evaluation(later, plain, tmp_path) == before

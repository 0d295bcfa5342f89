"""What is doubtful about a truth stands beside the errors against it."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.streams import Truth
from slam.evaluation import evaluate
from slam.report.tables.evaluation import accuracy_tables
from slam.report.tables.truth import rows_about_truth, unit_of_truth
from tests.slam.evaluation.scene import disturbed, estimate_of, flight_of, smooth_poses

TRUE = smooth_poses(np.random.default_rng(0), 60)


def against(factor: float, std: float = 0.01):
    truth = TRUE.copy()
    truth[:, :3, 3] *= factor
    estimate = estimate_of(disturbed(np.random.default_rng(1), TRUE, np.full(6, std)))
    return evaluate(estimate, flight_of(truth))


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(1000, "millimetres"), (100, "centimetres"), (3.28084, "feet"), (0.001, "kilometres")],
)
def test_the_unit_of_a_truth_is_named(factor: float, unit: str):
    found = against(factor)
    assert unit_of_truth(found) == unit
    rows = dict(row for table in accuracy_tables(found) for row in table.rows if len(row) == 2)
    assert unit in rows["unit of the truth"]
    assert "too few rows" not in rows.get("is the stated uncertainty right?", "")


@pytest.mark.parametrize("factor", [1.0, 0.97, 1.2, 2.0, 5.0])
def test_metres_and_other_scales_are_no_unit(factor: float):
    assert unit_of_truth(against(factor)) == ""


def test_a_map_that_fits_no_scale_names_no_unit():
    assert unit_of_truth(against(100.0, std=1.0)) == ""


def test_rows_without_a_pose_are_counted():
    truth = np.repeat(TRUE, 2, axis=0)
    truth[10:17, :3, :3] = np.nan
    found = evaluate(estimate_of(TRUE), flight_of(TRUE, truth=Truth(np.arange(120) * 0.125, truth)))
    assert rows_about_truth(found)[0] == ("rows of the truth without a whole pose", "7, left out")
    assert found.to_json()["incomplete_truth_rows"] == 7

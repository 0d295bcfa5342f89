"""Distances and areas that are measured on the map's page, with their uncertainty."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.slam.made_estimate import made_estimate, made_flight
from tests.slam.report.map_page.browser import in_browser
from tests.slam.report.map_page.test_page import SIGMA_M, needs_browser, with_rasters, written


@needs_browser
def test_clicks_measure_distance_and_area_with_their_uncertainty(tmp_path):
    """A rectangle of 4 x 3 m: sides, area, and the laws of error propagation by hand.

    The table has the scale in it, which is counted once.
    """
    table = ((1.0, 0.06, 0.07), (3.0, 0.16, 0.2), (5.0, 0.26, 0.3))
    with_rasters(tmp_path)
    found = in_browser(
        written(tmp_path, replace(made_estimate(), length_stds=table), made_flight()),
        """
        const { map, data, distanceOf, areaOf } = lemniscate;
        document.getElementById("measure-start").click();
        const click = ([x, y]) => {
          const at = map.latLngToContainerPoint([y, x]);
          const box = document.getElementById("map").getBoundingClientRect();
          const place = { bubbles: true, clientX: box.left + at.x, clientY: box.top + at.y, detail: 1 };
          const under = document.querySelector("#map canvas") || document.getElementById("map");
          const kinds = ["mousedown", "mouseup", "click"];
          kinds.forEach((kind) => under.dispatchEvent(new MouseEvent(kind, place)));
        };
        const corners = [[0, 0.5], [4, 0.5], [4, 3.5], [0, 3.5]];
        corners.slice(0, 2).forEach(click);
        const words = document.getElementById("measured").textContent;
        corners.slice(2).forEach(click);
        const all = document.getElementById("measured").textContent;
        const one = distanceOf(corners.slice(0, 2)), area = areaOf(corners);
        return { words, all, one, area, scale: data.scaleStd };
        """,
    )
    assert found["scale"] == 0.05
    assert found["one"]["value"] == pytest.approx(4.0)
    assert found["one"]["std"] == pytest.approx(0.21, abs=1e-3)
    assert found["one"]["worst"] == pytest.approx(0.25, abs=1e-3)
    assert found["area"]["value"] == pytest.approx(12.0)
    # Each corner moves the area by half the diagonal, of 5 m.
    end_m = np.sqrt((0.26**2 - (0.05 * 5) ** 2) / 2)
    assert found["area"]["std"] == pytest.approx(np.hypot(2 * 0.05 * 12, 2 * end_m * 2.5), rel=1e-3)
    clicked = float(re.search(r"Distance ([\d.]+) m", found["words"])[1])
    assert clicked == pytest.approx(4.0, abs=0.02)
    assert float(re.search(r"Area ([\d.]+) m²", found["all"])[1]) == pytest.approx(12.0, rel=0.02)


@needs_browser
def test_what_moves_the_whole_map_is_no_error_of_a_distance(tmp_path):
    with_rasters(tmp_path)
    found = in_browser(
        written(tmp_path, replace(made_estimate(), middle_std_m=0.6 * SIGMA_M), flight=made_flight()),
        "return lemniscate.distanceOf([[0, 0.5], [4, 0.5]]).std;",
    )
    assert found == pytest.approx(2 * 0.8 * SIGMA_M, rel=1e-3)


@needs_browser
def test_no_uncertainty_is_claimed_beside_the_mapped_ground(tmp_path):
    with_rasters(tmp_path)
    std = in_browser(
        written(tmp_path, flight=made_flight()),
        "return String(lemniscate.distanceOf([[1, 1], [90, 1]]).std);",
    )
    assert std == "NaN"


@needs_browser
def test_without_a_joint_covariance_the_errors_of_both_ends_add_up(tmp_path):
    """They contain the scale, and may be shared in any way."""
    with_rasters(tmp_path)
    found = in_browser(
        written(tmp_path, flight=made_flight()),
        "return lemniscate.distanceOf([[0, 0.5], [4, 0.5]]);",
    )
    assert found["std"] == pytest.approx(2 * SIGMA_M, rel=1e-3)

"""The page ``map.html``: what a browser makes of it, and that no name from outside can change it."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from backend.measurements import LinkCheck, Rejection
from slam.core.control_points import ControlReport, PointResidual
from slam.core.floor_points import FloorPoints
from slam.io.geotiff import Grid, write_bands
from slam.report.answers.advice import limit_sentence
from slam.report.facts import gather
from slam.report.map_page.features import MOST_POINTS, floor_points, links, spread
from slam.report.map_page.write import write_map_page
from tests.slam.made_estimate import REJECTION, made_estimate, made_flight, saying
from tests.slam.report.map_page.browser import BROWSER, in_browser, paint_times
from tests.slam.report.map_page.largest_page import largest_page

HOSTILE = "</script><script>alert(1)</script><!-- \u2028 \x1b[31m {{ 7 * 7 }}"
needs_browser = pytest.mark.skipif(BROWSER is None, reason="Chromium is not installed")
SIGMA_M = 0.01
SURVEYED = ControlReport(
    points=(
        PointResidual(
            name="P<1>", role="check", used=False, reason="", views=3,
            surveyed_m=(2.0, 1.0, math.nan), residual_m=(0.03, 0.04, math.nan),
        ),
    )
)  # fmt: skip


def written(folder: Path, estimate=None, flight=None) -> Path:
    estimate = estimate or made_estimate()
    path = write_map_page(folder, estimate, flight, gather(estimate, flight), estimate.status)
    assert path is not None
    return path


def data_of(path: Path) -> dict:
    text = path.read_text(encoding="utf-8")
    (found,) = re.findall(r'<script id="data" type="application/json">(.*?)</script>', text, re.DOTALL)
    return json.loads(found)


def with_rasters(folder: Path) -> None:
    """Write mosaics, an elevation and a quality over the made eight: 5 x 5 m at 10 mm."""
    rgba = np.full((500, 500, 4), 255, np.uint8)
    rgba[..., 0] = np.arange(500) // 2
    for name in ("mosaic", "mosaic_chain"):
        cv2.imwrite(str(folder / f"{name}.png"), rgba)
        (folder / f"{name}.pgw").write_text("0.01\n0\n0\n-0.01\n-0.245\n4.745\n")
    heights = np.tile(np.linspace(0, 0.2, 50, dtype=np.float32), (50, 1))
    write_bands(folder / "elevation.tif", Grid(-0.25, 4.75, 0.1, 50, 50), {"height": heights})
    sigma = np.full((50, 50), SIGMA_M, np.float32)
    bands = {"pictures": 0 * sigma, "position": sigma, "seam": 0 * sigma}
    write_bands(folder / "mosaic_quality.tif", Grid(-0.25, 4.75, 0.1, 50, 50), bands)


def with_points(count: int = 200):
    """An estimate with points of the ground under its keyframes; 0.8 m below them."""
    estimate = made_estimate()
    keyframe = np.arange(count) % len(estimate.w_T_b)
    b_p_m = np.column_stack([np.linspace(-0.2, 0.2, count), np.zeros(count), np.full(count, -0.8)])
    return replace(
        estimate,
        floor_points=FloorPoints(keyframe, b_p_m, 2 + np.arange(count) % 7, np.full((count, 3), 0.01)),
    )


def test_an_unknown_uncertainty_of_the_scale_leaves_the_page_whole(tmp_path):
    estimate = replace(made_estimate(), scale_std=float("nan"), middle_std_m=float("nan"))
    data = data_of(written(tmp_path, estimate))
    assert (data["scaleStd"], data["middleStd"]) == (0.0, 0.0)


def test_a_bridge_by_instruments_is_no_link_of_pictures():
    estimate = made_estimate()
    before = links(estimate)
    bridge = replace(estimate.relative_poses[0], kind="inertial")
    assert links(replace(estimate, relative_poses=(*estimate.relative_poses, bridge))) == before


def test_names_from_outside_stay_text(tmp_path):
    estimate = replace(made_estimate(name=HOSTILE), frame_names=(HOSTILE,) * 60)
    estimate = saying(estimate, reasons=(HOSTILE,))
    loops = tuple(
        replace(loop, rejection=loop.rejection and Rejection(LinkCheck.OTHER, HOSTILE))
        for loop in estimate.loops
    )
    path = written(tmp_path, replace(estimate, loops=loops), made_flight())
    text = path.read_text(encoding="utf-8")
    assert "alert(1)</script>" not in text
    assert text.count("<script") == 3
    assert data_of(path)["keyframes"]["name"] == [HOSTILE] * 60


def test_the_page_may_load_nothing(tmp_path):
    text = written(tmp_path).read_text(encoding="utf-8")
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert not re.findall(r'<(?:script|img|link|iframe)[^>]*\s(?:src|href)="(?!data:)', text)


def test_the_page_holds_what_the_estimate_has(tmp_path):
    estimate = made_estimate()
    data = data_of(written(tmp_path, estimate, made_flight()))
    frames = data["keyframes"]
    np.testing.assert_allclose(frames["x"], estimate.w_T_b[:, 0, 3], atol=1e-5)
    np.testing.assert_allclose(frames["height"], estimate.w_T_b[:, 2, 3], rtol=1e-5)
    np.testing.assert_allclose(
        frames["sigma"], np.sqrt(np.trace(estimate.covariances[:, 3:, 3:], axis1=1, axis2=2)), rtol=1e-5
    )
    assert data["links"]["unproven"] == {"count": 1, "pairs": [[5, 51, str(REJECTION)]]}
    assert data["links"]["contradicted"]["count"] == 0
    assert data["links"]["loop"]["count"] == 2
    assert data["links"]["odometry"]["count"] == 59
    assert not any(frames["unseen"])
    without = tuple(e for e in estimate.relative_poses if (e.i, e.j) != (20, 21))
    frames = data_of(written(tmp_path, replace(estimate, relative_poses=without), made_flight()))["keyframes"]
    assert [k for k, unseen in enumerate(frames["unseen"]) if unseen] == [21]


def test_the_first_lines_are_those_of_the_report(tmp_path):
    estimate = replace(made_estimate(), information_shares={"ground": {"range": 1.0}})
    ground = np.full((40, 60), 0.5, np.float32)
    grid = Grid(-3.0, 3.0, 0.1, 60, 40)
    write_bands(
        tmp_path / "mosaic_quality.tif", grid, {"pictures": ground, "position": ground, "seam": ground}
    )
    write_bands(tmp_path / "mosaic.tif", grid, {"any": ground})
    page = html.unescape(write_map_page(tmp_path, estimate, None, gather(estimate, None), "ok").read_text())
    assert "a point on the ground is typically known to" in page
    assert limit_sentence(estimate.information_shares, on_ground=True) in page


def test_keyframes_that_are_not_placed_are_left_out(tmp_path):
    estimate = made_estimate()
    poses = estimate.w_T_b.copy()
    poses[7] = np.nan
    data = data_of(written(tmp_path, replace(estimate, w_T_b=poses), made_flight()))
    assert 7 not in data["keyframes"]["number"]
    assert len(data["keyframes"]["x"]) == 59
    assert all(7 not in pair[:2] for pair in data["links"]["odometry"]["pairs"])


def test_points_of_the_ground_are_where_the_keyframes_see_them(tmp_path):
    estimate = with_points()
    assert data_of(written(tmp_path, made_estimate()))["points"] is None
    points = data_of(written(tmp_path, estimate))["points"]
    rows = np.frombuffer(base64.b64decode(points["data"]), "<f4").reshape(-1, 4)
    assert points["count"] == len(rows) == 200
    found, own = estimate.floor_points, estimate.w_T_b[estimate.floor_points.keyframe]
    np.testing.assert_allclose(rows[:, :3], own[:, :3, 3] + found.b_p_m, atol=1e-5)
    np.testing.assert_array_equal(rows[:, 3], found.views)
    lost = estimate.w_T_b.copy()
    lost[0] = np.nan
    assert floor_points(replace(estimate, w_T_b=lost))["count"] == 200 - 4


def test_many_points_are_thinned_evenly_and_keep_what_most_keyframes_see():
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, [40, 10], (50_000, 2))
    xy[:40_000] *= 0.1  # a place where the drone hovered
    views = rng.integers(2, 20, len(xy))
    chosen = spread(xy, views, MOST_POINTS)
    assert 0.3 * MOST_POINTS < len(chosen) <= MOST_POINTS
    assert views[chosen].mean() > views.mean() + 2
    assert (xy[chosen] > [4, 1]).any(axis=1).mean() > 0.9
    line = np.column_stack([np.arange(9000.0), np.zeros(9000)])
    assert 0.4 * MOST_POINTS < len(spread(line, np.full(9000, 2), MOST_POINTS)) <= MOST_POINTS
    assert len(spread(np.zeros((9000, 2)), np.full(9000, 2), MOST_POINTS)) == 1


def test_nothing_placed_gives_no_page(tmp_path):
    estimate = made_estimate()
    nowhere = replace(estimate, w_T_b=np.full_like(estimate.w_T_b, np.nan))
    assert write_map_page(tmp_path, nowhere, None, gather(nowhere, None), nowhere.status) is None
    assert not list(tmp_path.iterdir())


@needs_browser
def test_every_layer_can_be_switched_and_every_link_says_why(tmp_path):
    with_rasters(tmp_path)
    found = in_browser(
        written(tmp_path, replace(with_points(), control=SURVEYED), made_flight()),
        """
        const boxes = [...document.querySelectorAll("#layers input")];
        const before = boxes.map((box) => box.checked);
        boxes.forEach((box) => { if (!box.checked) box.click(); });
        const tiles = document.querySelectorAll("img.leaflet-tile").length;
        const overlays = document.querySelectorAll("img.leaflet-image-layer").length;
        const legends = [...document.querySelectorAll("#legend .ends")].length;
        const words = [];
        lemniscate.map.eachLayer((layer) => {
          if (layer.getPopup && layer.getPopup() && words.length < 500) {
            layer.openPopup();
            words.push(layer.getPopup().getElement().textContent);
            layer.closePopup();
          }
        });
        document.getElementById("colour-sigma").click();
        const swipe = document.getElementById("swipe");
        swipe.value = 50;
        swipe.dispatchEvent(new Event("input"));
        const clips = ["chain", "mosaic"].map((pane) => lemniscate.map.getPane(pane).style.clipPath);
        boxes.forEach((box) => box.click());
        const left = document.querySelectorAll("img.leaflet-image-layer").length;
        return { names: boxes.map((box) => box.id), before, tiles, overlays, legends, words, clips, left };
        """,
    )
    assert found["names"] == [
        f"show-{n}"
        for n in (
            "map",
            "elevation",
            "sigma",
            "points",
            "surveyed",
            "path",
            "loop",
            "unproven",
            "odometry",
            "keyframes",
        )
    ]
    assert found["tiles"] > 0
    assert (found["overlays"], found["legends"], found["left"]) == (2, 4, 0)
    assert any(str(REJECTION) in words for words in found["words"])
    assert sum(words.startswith("Keyframe ") for words in found["words"]) == 60
    points = [words for words in found["words"] if words.startswith("Point of the ground")]
    assert len(points) == 200
    assert "seen in 2 keyframes" in points[0]
    assert "position known to 10 mm" in points[0]
    (surveyed,) = (words for words in found["words"] if words.startswith("Check point P<1>"))
    assert "the map has it 50.0" in surveyed
    assert found["clips"][0] != found["clips"][1]


@needs_browser
@pytest.mark.parametrize("window_px", [(1366, 768), (390, 844)], ids=["laptop", "phone"])
def test_the_scale_bar_is_not_covered(tmp_path, window_px):
    with_rasters(tmp_path)
    found = in_browser(
        written(tmp_path, flight=made_flight()),
        """
        const box = document.querySelector(".leaflet-control-scale-line").getBoundingClientRect();
        const panel = document.getElementById("panel").getBoundingClientRect();
        const apart = box.bottom <= panel.top || box.top >= panel.bottom
          || box.right <= panel.left || box.left >= panel.right;
        return { apart, shown: box.width > 0 && box.bottom <= innerHeight };
        """,
        window_px,
    )
    assert found == {"apart": True, "shown": True}


@needs_browser
def test_a_graph_without_pictures_is_a_map_too(tmp_path):
    estimate = replace(made_estimate(), metric=False)
    found = in_browser(
        written(tmp_path, estimate),
        "return [...document.querySelectorAll('#layers input')].map((box) => box.id);",
    )
    assert found == [f"show-{name}" for name in ("path", "loop", "unproven", "odometry", "keyframes")]


@needs_browser
@pytest.mark.slow
def test_the_largest_page_is_seen_within_two_seconds(tmp_path, capsys):
    path = largest_page(tmp_path)
    found = paint_times(path)
    with capsys.disabled():
        print(f"\nmap.html of {path.stat().st_size / 1e6:.1f} MB: {found}")
    assert path.stat().st_size < 25e6
    assert found.contentful_s < 2.0
    assert found.shown_s < 4.0

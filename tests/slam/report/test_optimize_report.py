"""The report: one offline page that says what came out, whatever names the flight holds."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from backend.measurements import LinkCheck, Rejection
from slam.cli.tables import outcome_table
from slam.core.estimate import LoopVerdict
from slam.core.geodesy import GeoOrigin
from slam.core.messages import CHECKED_BY_ONE_DISTANCE, reason, warning
from slam.core.plot_style import ground_labels
from slam.core.streams import Truth
from slam.core.summary import summarise
from slam.core.units import length
from slam.evaluation.aligned_maps import chain_on_result
from slam.io.estimate_text import trajectory_text
from slam.report.answers.headline import sentence
from slam.report.answers.left_out import left_out
from slam.report.facts import gather
from slam.report.optimize_report import Mosaics, render, write_report
from tests.slam.made_estimate import REJECTION, made_estimate, made_flight, saying

HOSTILE = "<script>alert(1)</script>\n../../etc\x1b[31m\u202egnp.exe & \"quoted\" '$\\frac{x'"


class Page(HTMLParser):
    """What a browser would make of the page: the elements, their links, and the text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "action", "data")]

    def handle_data(self, data):
        self.text += data


def page(estimate, flight=None, **more) -> Page:
    return Page(render(estimate, summarise(estimate, graph_alone=flight is None), flight, **more))


def test_the_page_needs_no_network_and_runs_no_script():
    made = page(made_estimate(), made_flight())
    assert made.links
    assert all(link.startswith("data:image/") for link in made.links)
    assert not {"script", "link", "iframe", "object"} & set(made.tags)


def test_hostile_names_stay_text():
    estimate = made_estimate(name=HOSTILE)
    hostile_loop = LoopVerdict(0, 9, Rejection(LinkCheck.OTHER, HOSTILE))
    estimate = replace(
        estimate,
        frame_names=(HOSTILE,) * len(estimate.frame_names),
        loops=(*estimate.loops, hostile_loop),
        rejected={HOSTILE: 3},
        messages=(reason(HOSTILE), warning("lone surrogate \udcff")),
    )
    flight = replace(made_flight(), name=HOSTILE, landmarks={HOSTILE: np.zeros(3)})
    html = render(estimate, summarise(estimate), flight)
    made = Page(html)
    assert "script" not in made.tags
    assert made.text.count("<script>alert(1)</script>") >= 6, "shown as it is written, not run"
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f\u202e]", html)


def test_a_lone_surrogate_in_a_name_can_be_written(tmp_path):
    estimate = saying(made_estimate(), "\udcff.jpg cannot be read")
    write_report(tmp_path / "report.html", estimate, summarise(estimate), made_flight())
    assert ".jpg cannot be read" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_the_page_says_what_was_dropped_and_why(no_figures):
    estimate = made_estimate()
    text = page(estimate, made_flight()).text
    for row in left_out(estimate.rejected):
        assert row.what in text
        assert str(row.count) in text
    assert str(REJECTION) in text
    assert estimate.warnings[0] in text


def test_the_sentence_names_what_is_wrong():
    estimate = made_estimate()
    good = sentence(gather(estimate, made_flight()), "ok")
    assert good.startswith("All 60 keyframes")
    assert "lengths are relative" not in good
    relative = gather(replace(estimate, metric=False, range_errors=None), made_flight())
    assert "lengths are relative" in sentence(relative, "ok")
    assert relative.scale_source == "none"
    open_chain = replace(estimate, loops=(), relative_poses=estimate.relative_poses[:59])
    assert "errors that the status names come on top" in sentence(gather(estimate, made_flight()), "twisted")
    assert "come on top" not in good
    assert "errors add up" in sentence(gather(open_chain, made_flight()), "ok")
    torn = replace(estimate, component=np.repeat([0, 1], 30))
    assert "2 separate maps" in sentence(gather(torn, made_flight()), "ok")
    lost = replace(estimate, w_T_b=np.where(np.arange(60)[:, None, None] < 10, np.nan, estimate.w_T_b))
    assert sentence(gather(lost, made_flight()), "ok").startswith("50 of 60")
    nothing = replace(estimate, w_T_b=estimate.w_T_b * np.nan, component=np.full(60, -1))
    assert sentence(gather(nothing, made_flight()), "ok").startswith("Nothing could be placed")


def test_what_a_flight_shows_of_its_height_sensor_is_distinguished_from_what_is_assumed(no_figures):
    facts = gather(made_estimate(), made_flight())
    assert "this flight does not determine it" in facts.sensor_gain
    assert facts.sensor_zero == "+3.5 ±\N{NO-BREAK SPACE}1.1\N{NO-BREAK SPACE}mm"
    graph = gather(made_estimate(), None)
    assert (graph.sensor_gain, graph.sensor_zero) == ("", "")


def test_the_sentence_says_what_a_position_is_relative_to():
    """A height sensor whose scale is not known makes all positions uncertain together, the first excepted."""
    estimate, flight = made_estimate(sigma_m=0.001), made_flight()
    away = np.linalg.norm(estimate.w_T_b[:, :3, 3] - estimate.w_T_b[0, :3, 3], axis=1)
    scaled = estimate.covariances.copy()
    scaled[:, 3:, 3:] += (0.05 * away)[:, None, None] ** 2 * np.eye(3) / 3
    vague = gather(replace(estimate, covariances=scaled), flight)
    assert vague.mostly_scale
    assert "relative to the first keyframe" in sentence(vague, "ok")
    assert "scale of all lengths is known to 5\N{NO-BREAK SPACE}% only" in sentence(vague, "ok")
    exact = gather(replace(estimate, covariances=scaled, scale_std=0.0), flight)
    assert "relative to the first keyframe" in sentence(exact, "ok")
    assert "scale" not in sentence(exact, "ok")
    placed = gather(replace(estimate, covariances=scaled, origin=GeoOrigin(47.0, 8.0, 400.0)), flight)
    assert "relative" not in sentence(placed, "ok")
    assert "scale" not in sentence(placed, "ok")
    assert "relative to the pose that is held" in sentence(gather(estimate, None), "ok")


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"covariances": np.full((60, 6, 6), np.nan)},
        {"loops": (), "relative_poses": ()},
        {"w_T_b": np.full((60, 4, 4), np.nan), "component": np.full(60, -1)},
        {"chain_w_T_b": np.full((60, 4, 4), np.nan), "odometry_w_T_b": np.full((60, 4, 4), np.nan)},
        {"component": np.repeat([0, 1, -1], 20)},
        {"origin": GeoOrigin(47.0, 8.0, 400.0)},
        {"messages": (), "rejected": {}, "timing_s": {}},
        {"graph_error": float("nan")},
    ],
    ids=lambda change: "+".join(change) or "whole",
)
@pytest.mark.parametrize(
    "flight",
    [
        pytest.param(made_flight(), id="full"),
        pytest.param(made_flight(with_sonar=False), id="bare", marks=pytest.mark.slow),
        pytest.param(None, id="graph"),
    ],
)
def test_whatever_is_missing_a_page_comes_out(change, flight):
    made = page(replace(made_estimate(), **change), flight)
    assert "h1" in made.tags
    assert not re.search(r"\b(nan|None|inf)\b", made.text)


def test_one_keyframe_is_enough_for_a_page():
    estimate = made_estimate(2)
    rows = ("stamps_s", "frame_names", "frame_index", "w_T_b", "covariances", "component")
    others = ("chain_w_T_b", "odometry_w_T_b", "over_floor_covariances")
    single = {name: getattr(estimate, name)[:1] for name in (*rows, *others)}
    assert "1 / 1" in page(replace(estimate, relative_poses=(), loops=(), **single), made_flight()).text


def test_cells_that_may_not_wrap_are_short(no_figures):
    """Cells of class ``n`` stay on one line: a long one pushes the table beyond the page."""
    html = render(made_estimate(), summarise(made_estimate()), made_flight())
    cells = re.findall(r'<td class="n">(.*?)</td>', html, re.DOTALL)
    assert cells
    assert max(len(re.sub(r"<.*?>|&[a-z#0-9]+;", "", cell)) for cell in cells) <= 40


def test_figures_agree_with_the_estimate(no_figures):
    estimate = made_estimate(sigma_m=0.006)
    facts = gather(estimate, made_flight())
    assert facts.sigma_median_m == pytest.approx(
        np.median(np.sqrt(np.trace(estimate.covariances[:, 3:, 3:], axis1=1, axis2=2)))
    )
    # The chain is the path enlarged by up to 15 % about its first keyframe.
    away = np.linalg.norm(estimate.w_T_b[:, :3, 3] - estimate.w_T_b[0, :3, 3], axis=1)
    assert facts.chain_moved_m == pytest.approx((np.linspace(0, 0.15, 60) * away).max(), rel=1e-6)
    # A turned and shifted chain is the same chain.
    G = np.array([[0.0, -1, 0, 5], [1, 0, 0, -3], [0, 0, 1, 1], [0, 0, 0, 1]])
    turned = replace(estimate, chain_w_T_b=G @ estimate.chain_w_T_b)
    assert gather(turned, made_flight()).chain_moved_m == pytest.approx(facts.chain_moved_m)
    # Without loops the same path lies 3 cm higher at its end, wherever it begins; on Earth it is not moved.
    higher = estimate.w_T_b.copy()
    higher[:, 2, 3] += np.linspace(0, 0.03, 60)
    lifted = replace(estimate, odometry_w_T_b=G @ higher)
    median_m, largest_m = gather(lifted, made_flight()).loops_moved_m
    assert (median_m, largest_m) == pytest.approx((0.015, 0.03), rel=1e-6)
    on_earth = replace(estimate, odometry_w_T_b=higher + 0.0, origin=GeoOrigin(52.0, 4.0, 0.0))
    on_earth.odometry_w_T_b[:, 0, 3] += 1.0
    assert gather(on_earth, made_flight()).loops_moved_m[0] == pytest.approx(np.hypot(1.0, 0.015), rel=1e-4)
    assert facts.path_m == pytest.approx(
        np.linalg.norm(np.diff(estimate.w_T_b[:, :3, 3], axis=0), axis=1).sum()
    )
    assert (facts.loops_kept, facts.loops_rejected) == (2, 1)


@pytest.mark.parametrize(
    ("metres", "said"),
    [(0.00123, "1.23 mm"), (0.0456, "45.6 mm"), (0.0996, "0.10 m"), (1.234, "1.23 m"), (123.4, "123 m"),
     (26400.0, "26.4 km"), (float("nan"), "not known"), (0.0, "0.00 mm"), (4.8, "4.80 m")],
)  # fmt: skip
def test_lengths_read_well(metres, said):
    assert length(metres).replace("\N{NO-BREAK SPACE}", " ") == said


def test_a_map_without_a_scale_has_no_metres(no_figures):
    """Nowhere on the page, in no table and not in the trajectory's header."""
    estimate = replace(made_estimate(), metric=False, range_errors=None, scale_std=None)
    text = page(estimate, made_flight(with_sonar=False)).text.replace("\N{NO-BREAK SPACE}", " ")
    assert "heights" in text
    assert not re.search(r"[0-9] (mm|m|km)\b", text)
    assert "[heights]" in trajectory_text(estimate)
    assert ground_labels(on_earth=False, metric=False) == ("x [heights]", "y [heights]")
    told = Console(file=io.StringIO(), width=200)
    told.print(outcome_table(gather(estimate, made_flight()), summarise(estimate)))
    assert re.search(r"typically [\d.]+ heights", told.file.getvalue().replace("\N{NO-BREAK SPACE}", " "))
    assert not re.search(r"[0-9]\s(mm|m|km)\b", told.file.getvalue())


def test_the_terminal_asks_for_no_distance_where_known_ones_were_compared():
    estimate = replace(made_estimate(), accuracy_basis=f"One sensor. {CHECKED_BY_ONE_DISTANCE}")
    said = []
    for compared in (False, True):
        told = Console(file=io.StringIO(), width=200)
        told.print(
            outcome_table(gather(estimate, made_flight()), summarise(estimate), None, compared=compared)
        )
        said.append(CHECKED_BY_ONE_DISTANCE in told.file.getvalue())
    assert said == [True, False]


def test_links_lead_to_the_files_that_exist(tmp_path, no_figures):
    made = page(made_estimate(), made_flight(), folder=tmp_path)
    assert not [link for link in made.links if not link.startswith("data:")]
    for name in ("map.html", "mosaic.tif", "loops.csv"):
        (tmp_path / name).touch()
    write_report(tmp_path / "report.html", made_estimate(), summarise(made_estimate()), made_flight())
    links = Page((tmp_path / "report.html").read_text()).links
    assert {link for link in links if not link.startswith("data:")} == {
        "map.html", "mosaic.tif", "loops.csv", "#files",
    }  # fmt: skip


def test_before_and_after_stand_side_by_side(tmp_path, no_figures):
    for name in ("a.png", "b.png"):
        Image.fromarray(np.full((40, 50, 4), 128, np.uint8)).save(tmp_path / name)
    both = page(made_estimate(), made_flight(), mosaics=Mosaics(tmp_path / "a.png", tmp_path / "b.png"))
    assert sum(link.startswith("data:image/jpeg") for link in both.links) == 2
    assert "Before" in both.text
    assert "After" in both.text
    assert "left edge" not in both.text, "no world file says where it lies"
    (tmp_path / "a.pgw").write_text("0.1\n0\n0\n-0.1\n-1.95\n2.95\n")
    one = page(made_estimate(), made_flight(), mosaics=Mosaics(tmp_path / "a.png"))
    assert "x = -2.0 to 3.0 m" in one.text
    assert "y = -1.0 to 3.0 m" in one.text
    assert "Before" not in one.text


def test_the_chain_is_laid_on_the_first_keyframe():
    """Before and after are drawn alike: the chain's own origin and heading do not matter, its drift does."""
    estimate = made_estimate()
    yaw = np.array([[0.6, -0.8, 0, 5], [0.8, 0.6, 0, -3], [0, 0, 1, 7], [0, 0, 0, 1]])
    perfect = replace(estimate, chain_w_T_b=yaw @ estimate.w_T_b)
    np.testing.assert_allclose(chain_on_result(perfect), estimate.w_T_b, atol=1e-12)
    np.testing.assert_allclose(chain_on_result(estimate), estimate.chain_w_T_b, atol=1e-12)


def test_an_unknown_uncertainty_is_no_small_one():
    estimate = made_estimate(sigma_m=0.006)
    for unknown in (59, 1):
        covariances = estimate.covariances.copy()
        covariances[60 - unknown :] = np.nan
        covariances[0] = 0.0
        facts = gather(replace(estimate, covariances=covariances), None)
        assert np.isnan(facts.sigma_max_m)
        assert np.isnan(facts.sigma_median_m) == (unknown > 30)
        assert ("others are not known" in sentence(facts, "ok")) == (unknown < 30)
        assert "0.00" not in sentence(facts, "ok")


def test_a_flight_with_a_true_path_says_that_it_can_check_the_map(no_figures):
    estimate, flight = made_estimate(), made_flight()
    truth = Truth(estimate.stamps_s, estimate.w_T_b)
    assert "holds a true path" in page(estimate, replace(flight, truth=truth)).text
    assert "holds a true path" not in page(estimate, replace(flight, truth=None)).text


def test_the_status_names_the_doubt_that_it_excepts():
    estimate = saying(made_estimate(), "attitude0 is tilted by 5°: a slope; check")
    told = page(estimate, made_flight()).text
    assert "agree with each other, with one exception: attitude0 is tilted by 5°; see the warning" in told

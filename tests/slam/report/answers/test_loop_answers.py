"""Places that were recognised again, matches that were rejected, and what loop closures changed."""

from __future__ import annotations

import html
from dataclasses import replace

import numpy as np

from backend.measurements import LinkCheck, Rejection
from backend.pose_graph.certificate import Certificate
from slam.core.estimate import LoopVerdict
from slam.core.geodesy import GeoOrigin
from slam.core.summary import summarise
from slam.core.units import length
from slam.report.facts import median_height_m
from slam.report.optimize_report import render
from tests.slam.made_estimate import made_estimate, made_flight
from tests.slam.report.answers.asked import AGAIN, answers


def test_where_positions_hold_the_path_errors_do_not_add_up_without_loops():
    estimate, flight = replace(made_estimate(), loops=()), made_flight()
    assert answers(estimate, flight)[AGAIN].startswith("No, so errors add up")
    on_earth = replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0))
    assert answers(on_earth, flight)[AGAIN].startswith("No: positions alone hold the path")
    page = html.unescape(render(on_earth, summarise(on_earth), flight))
    assert "errors add up along" not in page


def test_a_proof_tells_how_far_the_best_arrangement_of_the_pictures_is_from_the_map():
    estimate, flight = made_estimate(), made_flight()
    question = "Could the pictures fit together in another way?"
    assert question not in answers(estimate, flight)
    proven = Certificate(True, "", objective=50.0, lower_bound=50.0, gap=0.0, moved_m=0.002, moved_rad=0.001)
    found = answers(replace(estimate, certificate=proven), flight)[question]
    assert found.startswith("No: no other arrangement")
    assert "differs from this map by up to 2.00\N{NO-BREAK SPACE}mm and 0.057°" in found
    failed = replace(proven, certified=False, reason="no poses have less than 40, these have 50")
    found = answers(replace(estimate, certificate=failed), flight)[question]
    assert found.startswith("That is not excluded")
    assert failed.reason in found
    tree = replace(proven, objective=0.0, moved_m=0.0)
    assert question not in answers(replace(estimate, certificate=tree), flight)


def test_contradicted_matches_are_counted_apart_from_unproven_ones():
    estimate, flight = made_estimate(), made_flight()
    first, second, third = estimate.loops
    loops = (
        replace(third, rejection=Rejection(LinkCheck.GRAPH, "9 sigma")),
        replace(third, rejection=Rejection(LinkCheck.TOO_FEW_INLIERS)),
        first,
        second,
    )
    found = answers(replace(estimate, loops=loops), flight)[AGAIN]
    assert (
        "2 others were rejected, and the map rests on none of them. The rest of the map contradicts 1"
        in found
    )
    assert "1 shows too little to tell whether it is right" in found
    page = html.unescape(render(replace(estimate, loops=loops), summarise(estimate), flight))
    contradicted, unproven = (
        "<b>Contradicted:</b> they contradict the other",
        "<b>Unproven:</b> they have too few",
    )
    assert 0 < page.index(contradicted) < page.index("<td>9 standard deviations</td>") < page.index(unproven)


def test_an_inexact_match_of_the_right_place_is_told_from_one_of_another_place():
    estimate, flight = made_estimate(), made_flight()
    height_m = median_height_m(estimate)

    def told(*figures, estimate=estimate, check=LinkCheck.GRAPH):
        loops = tuple(LoopVerdict(0, 20 + k, Rejection(check, text)) for k, text in enumerate(figures))
        return answers(replace(estimate, loops=loops), flight)[AGAIN]

    near = f"9.1 sigma (limit 4.7): {0.03 * height_m:.4g} m, 1 deg"
    before_metres = "9.1 sigma (limit 4.7): 0.03 heights, 1 deg"
    away = f"90 sigma (limit 4.7): {0.4 * height_m:.4g} m, 1 deg"
    turned = "90 sigma (limit 4.7): 0.01 heights, 170 deg"
    found = told(near, before_metres, away, turned)
    assert "The rest of the map contradicts 4: 2 show the right place but inexactly" in found
    assert f"off by {length(np.hypot(0.03, np.radians(1)) * height_m)} at most" in found
    assert "; 2 show another place that looks alike, or fit wrongly." in found
    assert "contradicts 1: it shows the right place but inexactly, off by" in told(near)
    assert "right place" not in told(away, turned)
    assert "right place" not in told("0.1 m from where the poses put it", check=LinkCheck.PLACE)
    # Poses of a planar graph file lie in its plane: no height measures a miss.
    flat = replace(estimate, w_T_b=estimate.w_T_b * np.array([[1.0], [1.0], [0.0], [1.0]]), floor_z_m=0.0)
    assert "right place" not in told(near, before_metres, estimate=flat)


def test_the_keyframe_of_most_contradictions_is_named():
    estimate, flight = made_estimate(), made_flight()
    rejection = Rejection(LinkCheck.GRAPH, "9.0 sigma")
    loops = tuple(LoopVerdict(3, j, rejection) for j in (30, 40, 50))
    question = "Was a place recognised again, and is that right?"
    found = answers(replace(estimate, loops=loops), flight)[question]
    assert f"Keyframe 3, {estimate.frame_names[3]}, is in 3 of the 3, more than any other" in found
    assert "more than any other" not in answers(replace(estimate, loops=loops[:1]), flight)[question]


def test_the_gain_of_loop_closures_is_told_where_there_are_any():
    estimate, flight = made_estimate(), made_flight()
    moved = estimate.w_T_b.copy()
    moved[:, 1, 3] += np.linspace(0, 0.4, 60)
    found = answers(replace(estimate, odometry_w_T_b=moved), flight)
    assert (
        f"{length(0.2)} away from here typically, and {length(0.4)} at most"
        in found["What did loop closures change?"]
    )
    none = replace(estimate, odometry_w_T_b=moved, loops=(), relative_poses=())
    assert "What did loop closures change?" not in answers(none, flight)


def test_errors_grow_between_matches_only_where_nothing_else_holds_the_path():
    estimate, flight = made_estimate(), made_flight()
    kept = [loop for loop in estimate.loops if loop.verdict == "kept"]
    ends = len({end for loop in kept for end in (loop.i, loop.j)})
    assert ends < estimate.placed.sum()
    told = answers(estimate, flight)[AGAIN]
    assert (
        f"{ends} of {estimate.placed.sum()} keyframes belong to such a pair. Between them errors grow" in told
    )
    on_earth = replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0))
    assert "errors grow" not in answers(on_earth, flight)[AGAIN], "fixes hold the others"


def test_the_change_by_loops_counts_the_fit_that_follows_them():
    estimate, flight = made_estimate(), made_flight()
    question = "What did loop closures change?"
    refined = replace(estimate, information_shares={"x": {"pictures": 1.0}})
    found = [answers(each, flight)[question] for each in (estimate, refined)]
    assert ["without both all lengths" in text for text in found] == [False, True]
    assert ["without them all lengths" in text for text in found] == [True, False]

"""How accurate places, distances, heights and the scale of a map are, as the report says it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frontend.camera import Camera
from slam.core.estimate import GroundFacts
from slam.core.geodesy import GeoOrigin
from slam.core.instrument_errors import AttitudeErrors, LensNumber
from slam.core.messages import about, warning
from slam.core.summary import summarise
from slam.core.units import error_length, length, percent, round_length
from slam.report.answers.distances import area_share
from slam.report.answers.headline import sentence
from slam.report.answers.questions import pilots_answers
from slam.report.facts import gather
from slam.report.mosaic_facts import MosaicFacts
from tests.slam.made_estimate import made_estimate, made_flight, saying
from tests.slam.report.answers.asked import answers, by_accelerometer


def test_instruments_that_tell_the_scale_agree_unless_a_warning_names_one():
    question = "Is the scale right, and by which instrument?"
    estimate, flight = replace(made_estimate(), messages=()), made_flight()
    assert answers(estimate, flight)[question].endswith(
        "if the height sensor is right. Lengths told 1 % too long make the map 1 % too large."
    )
    facts = replace(gather(estimate, flight), scale_source="height sensor and accelerometer")
    assert replace(facts, scale_source="control points").condition == "if the control points are right"
    assert replace(facts, scale_source="GPS").condition == "if the GPS is right"

    def told(*messages):
        rows = pilots_answers(estimate, summarise(replace(estimate, messages=messages)), facts)
        return next(row.value for row in rows if row.label == question)

    assert told(about("gps0", "far off")).partition("\ue000")[0].endswith("they agree.")
    assert (
        told(about("imu0", "an offset that the map estimates").as_note())
        .partition("\ue000")[0]
        .endswith("they agree.")
    )
    assert "a warning below names imu0" in told(about("imu0", "the accelerometer reads 9.04 m/s^2 at rest"))


def test_the_least_certain_place_is_told():
    estimate, flight = made_estimate(), made_flight()
    x, y = estimate.w_T_b[29, :2, 3]
    found = answers(estimate, flight)["Where is it least certain?"]
    assert f"x = {x:.2f} m, y = {y:.2f} m" in found
    assert "keyframe 29, 000029.png" in found
    mosaic = MosaicFacts(0.004, 800, 600, 0.011, 0.02, 3.0, -1.5)
    both = pilots_answers(estimate, summarise(estimate), gather(estimate, flight), mosaic=mosaic)
    (told,) = (item.value for item in both if item.label == "Where is it least certain?")
    assert told.startswith("The ground around x = 3.00 m, y = -1.50 m, known to ±\N{NO-BREAK SPACE}20")
    assert f"The path: around x = {x:.3g} m" in told
    unknown = estimate.covariances.copy()
    unknown[7] = np.nan
    assert "Where is it least certain?" not in answers(replace(estimate, covariances=unknown), flight)


def test_a_point_of_the_mosaic_is_told_apart_from_a_keyframe():
    """A pilot measures on the mosaic, whose ground is known less well than the camera, or better."""
    estimate, flight = made_estimate(), made_flight()
    facts, summary = gather(estimate, flight), summarise(estimate)
    mosaic = MosaicFacts(0.004, 800, 600, 0.011, 0.02, 3.0, -1.5)
    told = {item.label: item.value for item in pilots_answers(estimate, summary, facts, mosaic=mosaic)}
    point = told["How accurate is a place on it?"]
    assert point.index(error_length(0.011)) < point.index(error_length(0.02))
    assert f"800 x 600 pixels of {length(0.004)}" in told["Where is the mosaic, and how big is a pixel?"]
    both_ends = error_length(np.sqrt(2) * 0.011)
    assert both_ends in told["How far can I trust a distance or an area?"]


def test_a_height_over_the_floor_does_not_count_the_altitude_on_earth():
    """The error of an altitude moves keyframes and floor together."""
    estimate, flight = replace(made_estimate(), origin=GeoOrigin(52.1, 4.3, 10.0)), made_flight()
    on_earth = replace(estimate, covariances=estimate.covariances + 400.0 * np.eye(6))
    question = "Are the heights true?"
    found = answers(on_earth, flight)[question]
    over_floor, on_the_whole = found.split(" The camera's own altitude, on Earth, ")
    assert answers(estimate, flight)[question].startswith(over_floor)
    assert f"±\N{NO-BREAK SPACE}{error_length(20.0)} where it is least certain" in on_the_whole
    up_m = np.sqrt(np.median(estimate.over_floor_covariances[:, 5, 5]))
    assert f"typically known to ±\N{NO-BREAK SPACE}{error_length(up_m)}" in found


def test_a_doubted_attitude_says_what_its_tilt_does_to_heights():
    estimate, flight = made_estimate(), made_flight()
    question = "Are the heights true?"
    told = answers(replace(estimate, messages=()), flight)[question]
    assert told.startswith("Yes")
    assert "raise one end" not in told
    on_earth = replace(estimate, messages=(), origin=GeoOrigin(52.1, 4.3, 10.0))
    assert "As altitudes, only as the GPS counts them" in answers(on_earth, flight)[question]
    assert answers(saying(estimate, reasons=("x",)), flight)[question].startswith(
        "Only after you have checked"
    )
    off = AttitudeErrors((0.08, 0.06), (0.01, 0.01), 0.1, 0.1, None)
    noted = replace(
        estimate,
        messages=(warning("attitude0 is tilted by 5.7 degrees").concerning("attitude0"),),
        instruments=replace(estimate.instruments, attitude=off),
    )
    across_m = max(gather(estimate, flight).extent_m)
    found = answers(noted, flight)[question]
    assert found.startswith("Near each other, yes; across the map, no, because it may lean: 5.7° raise")
    use = answers(noted, flight)["Can I use this map?"]
    assert "heights only near each other, because the map may lean: 5.7° raise" in use
    assert f"by {error_length(np.tan(0.1))} for each {round_length(1.0)}" in found
    assert f"raise one end of the path by {length(np.tan(0.1) * across_m)} against the other" in found


def test_the_mosaic_says_where_its_pictures_differ_most():
    question = "What on the mosaic may not be as it is on the ground?"
    estimate, flight = made_estimate(), made_flight()
    mosaic = MosaicFacts(0.004, 800, 600, 0.011, 0.02, 3.0, -1.5, 0.56, 2.0, 1.25)
    rows = pilots_answers(estimate, summarise(estimate), gather(estimate, flight), mosaic)
    told = next(row.value for row in rows if row.label == question)
    verdict = told.split(". ")[0]
    assert "around x = 2.00 m, y = 1.25 m" in verdict
    assert f"by {percent(0.56)} of the brightness" in verdict
    assert "Grey is what no picture shows" in told


def test_an_accuracy_by_the_gps_does_not_count_a_shift_of_all_its_fixes():
    estimate, flight = made_estimate(), made_flight()
    question = "How accurate is a place on it?"
    assert "share" not in answers(estimate, flight)[question]
    on_earth = replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0))
    facts = replace(gather(on_earth, flight), gps_std_m=5.0)

    def told(facts):
        rows = pilots_answers(on_earth, summarise(on_earth), facts)
        return next(row.value for row in rows if row.label == question)

    assert "on Earth, as the GPS has it, one standard deviation" in told(facts)
    of_one_fix = f"for one fix, ±\N{NO-BREAK SPACE}{error_length(5.0)}"
    assert f"may be as large as what is stated {of_one_fix}" in told(facts)
    assert f"is assumed {of_one_fix}" in told(replace(facts, gps_accuracy="assumed"))
    assert "GPS" not in told(replace(facts, controlled=True)), "control points hold the map"


def test_the_first_sentence_tells_the_ground_where_there_is_a_mosaic():
    estimate = made_estimate()
    facts = gather(estimate, made_flight())
    on_ground = sentence(facts, "ok", MosaicFacts(0.004, 800, 600, 0.012, 0.034, 0.0, 0.0))
    assert "a point on the ground is typically known to" in on_ground
    assert error_length(0.034) in on_ground
    assert "the position of a keyframe" in sentence(
        facts, "ok", MosaicFacts(0.004, 800, 600, np.nan, np.nan, 0.0, 0.0)
    )


def test_ground_whose_height_no_picture_shows_is_not_for_heights():
    estimate, flight = replace(made_estimate(), messages=()), made_flight()
    use, question = "Can I use this map?", "Are the heights true?"
    hilly = GroundFacts(
        misregistration_px=(0.3, 0.9), over_floor_px=(2.0, 9.0), relief_share=0.4, filled_share=0.1
    )
    found = answers(replace(estimate, ground=hilly), flight)
    assert "distances, areas and differences in height" in found[use]
    assert "4 % is filled in" in found[question].replace("\N{NO-BREAK SPACE}", " ")
    found = answers(replace(estimate, ground=replace(hilly, filled_share=1.0)), flight)
    assert "not for heights" in found[use]
    assert "no two pictures show its height" in found[question]
    flat = replace(hilly, relief_share=0.0, filled_share=0.0)
    assert (
        "not for heights of the ground, which was taken as flat"
        in answers(replace(estimate, ground=flat), flight)[use]
    )


def test_a_camera_that_is_known_better_than_its_height_over_the_ground_says_why():
    """Positions measure the camera; the ground is seen from there through an uncertain lens."""
    question = "Are the heights true?"
    estimate, flight = made_estimate(), made_flight()
    height_m = float(np.median(estimate.w_T_b[:, 2, 3])) - estimate.floor_z_m
    lens = {
        "fx": LensNumber(1000.0, 6.0, 1000.0, 7.0, False),
        "fy": LensNumber(1000.0, 6.0, 1000.0, 7.0, False),
    }
    by_lens = replace(
        estimate,
        origin=GeoOrigin(52.1, 4.3, 10.0),
        information_shares={"height": {"pictures": 0.9, "position": 0.1}},
        instruments=replace(estimate.instruments, lens=lens),
        covariances=np.tile(1e-8 * np.eye(6), (len(estimate.stamps_s), 1, 1)),
        over_floor_covariances=np.tile(np.eye(6) * (0.006 * height_m) ** 2, (len(estimate.stamps_s), 1, 1)),
    )
    found = answers(by_lens, flight)[question].replace("\N{NO-BREAK SPACE}", " ")
    assert "focal length is known to 0.6 % only, and heights hang on it" in found
    assert "because the GPS measured the camera itself" in found
    advice = answers(by_lens, flight)["How do I make the next map better?"]
    assert "For truer heights over the ground, calibrate the camera" in advice
    assert "lengths" not in advice, "the scale is known otherwise"
    held = replace(by_lens, instruments=replace(estimate.instruments, lens=None))
    found = answers(held, flight)[question].replace("\N{NO-BREAK SPACE}", " ")
    assert "focal length" not in found
    assert "90 % of what is left comes from the pictures themselves" in found


TABLE = ((0.8, 0.03, 0.05), (2.0, 0.11, 0.13), (4.0, 0.21, 0.25))
"""Distances with standard deviations, where the scale is known to 5 %."""


def test_a_distance_counts_the_scale_once():
    """The joint covariance of both ends has it; a scale of 5 % is most of it."""
    question = "How far can I trust a distance or an area?"
    estimate = replace(made_estimate(), length_stds=TABLE)
    told = answers(estimate, made_flight())[question].replace("\N{NO-BREAK SPACE}", " ")
    for size_m, std_m, worst_m in (
        (0.5, 0.03, 0.05),
        (2.0, 0.11, 0.13),
        (5.0, 0.21 * 5 / 4, 0.25 * 5 / 4),
    ):
        std, worst = (error_length(each).replace("\N{NO-BREAK SPACE}", " ") for each in (std_m, worst_m))
        assert f"{size_m:g} m apart: ± {std} (badly placed ones: ± {worst})" in told
    assert "the scale causes ± 0.25 m (5 % of any length)" in told
    rest = error_length(np.sqrt((0.21 * 5 / 4) ** 2 - 0.25**2)).replace("\N{NO-BREAK SPACE}", " ")
    assert f"the rest, ± {rest}." in told
    assert (
        f"differs from the map by less than {error_length(2 * 0.21 * 5 / 4)}".replace(
            "\N{NO-BREAK SPACE}", " "
        )
        in told
    )


def test_the_area_of_a_square_is_as_uncertain_as_its_drawn_corners_say():
    """Corners that move alone, and a scale that all share."""
    rng, draws, side_m, scale_std, end_m = np.random.default_rng(0), 20_000, 2.0, 0.05, 0.02
    corners = side_m * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    scale = 1 + scale_std * rng.standard_normal((draws, 1, 1))
    drawn = scale * corners + end_m * rng.standard_normal((draws, 4, 2))
    after = np.roll(drawn, -1, axis=1)
    area = 0.5 * np.sum(drawn[..., 0] * after[..., 1] - after[..., 0] * drawn[..., 1], axis=1)
    of_side_m = float(np.hypot(scale_std * side_m, np.sqrt(2) * end_m))
    sides = np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=1)
    assert np.std(sides) == pytest.approx(of_side_m, rel=0.02)
    estimate = replace(made_estimate(), scale_std=scale_std, length_stds=((side_m, of_side_m, of_side_m),))
    found = area_share(estimate, gather(estimate, made_flight()), side_m)
    assert found == pytest.approx(np.std(area) / side_m**2, rel=0.02)


def test_what_limits_the_ground_is_named_where_the_ground_is_told():
    estimate, flight = made_estimate(), made_flight()
    shares = {"x": {"position": 0.9, "flat_floor": 0.1}, "ground": {"position": 0.2, "flat_floor": 0.8}}
    by_ground = replace(
        estimate, information_shares=shares, camera=Camera((100.0, 100.0), (159.5, 119.5), (320, 240))
    )
    facts = gather(by_ground, flight)
    mosaic = MosaicFacts(0.004, 800, 600, 10 * facts.sigma_median_m, 1.0, 3.0, -1.5)
    rows = {row.label: row.value for row in pilots_answers(by_ground, summarise(by_ground), facts, mosaic)}
    assert rows["What limits the accuracy?"].startswith("How uneven the ground is (80")
    assert "For the place of a camera, the GPS" in rows["What limits the accuracy?"]
    assert "in a corner of a picture by 2 times" in rows["What limits the accuracy?"]  # 200 px over 100 px
    assert "comes from how uneven the ground is" in rows["How accurate is a place on it?"]
    assert answers(by_ground, flight)["What limits the accuracy?"].startswith("The GPS")


def test_an_accelerometer_that_agrees_but_is_vague_is_no_check():
    estimate, flight = made_estimate(), made_flight()
    question = "Is the scale right, and by which instrument?"
    estimate = replace(estimate, scale_std=0.01, accuracy_basis="lengths rest on one height sensor alone")

    def told(scale_std):
        found = replace(estimate.instruments, accelerometer=by_accelerometer(1.01, scale_std, used=False))
        return answers(replace(estimate, instruments=found), flight)[question]

    assert "The accelerometer agrees with the lengths, but" in told(0.05)
    assert "The accelerometer agrees" not in told(0.01), "it is as good as the rest"
    assert "The accelerometer agrees" not in told(0.004), "it contradicts them"


def test_heights_that_nothing_measured_are_told_where_a_place_is_least_certain():
    estimate, flight = made_estimate(), made_flight()
    mosaic = MosaicFacts(0.004, 800, 600, 0.011, 0.02, 3.0, -1.5, 0.56, 2.0, 1.25)
    hilly = GroundFacts(misregistration_px=(0.3, 0.9), over_floor_px=(2.0, 9.0), relief_share=0.4)
    for ground, is_stated in (
        (hilly, False),
        (replace(hilly, level_share=0.1), True),
        (replace(hilly, doubted_share=0.1), True),
    ):
        uneven = replace(estimate, ground=ground)
        rows = pilots_answers(uneven, summarise(uneven), gather(uneven, flight), mosaic)
        told = next(row.value for row in rows if row.label == "Where is it least certain?")
        assert ("Where no height was measured" in told) is is_stated

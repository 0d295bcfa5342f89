"""Pixels of control points that are counted otherwise than documented, against projections by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from backend.measurements import ControlPoint
from frontend.camera import NADIR_B_T_C, Camera
from slam.mapping.control_pixels import misread
from slam.mapping.control_points import ControlComparison
from slam.mapping.pipeline import optimize
from slam.mapping.warnings.control_points import control_warnings
from tests.backend.bundle.made_control import refined
from tests.slam.mapping.test_control_points import off_m, rms, small, told

WIDTH, HEIGHT, FOCAL_PX = 480, 360, 480.0
CAMERA = Camera((FOCAL_PX, FOCAL_PX), (239.5, 179.5), (WIDTH, HEIGHT), b_T_c=NADIR_B_T_C)
PLACES = np.array([(0.0, 0, 0), (6, 1, 0), (-3, 5, 0), (2, -4, 0)])
WRITTEN = {
    "": lambda u, v: (u, v),
    "upwards from the lower edge": lambda u, v: (u, HEIGHT - 1 - v),
    "from the right edge": lambda u, v: (WIDTH - 1 - u, v),
    "the row before the column": lambda u, v: (v, u),
    "180 degrees": lambda u, v: (WIDTH - 1 - u, HEIGHT - 1 - v),
    # The lower left corner of the stored picture becomes the upper left one.
    "90 degrees clockwise": lambda u, v: (HEIGHT - 1 - v, u),
    "90 degrees anticlockwise": lambda u, v: (v, WIDTH - 1 - u),
}


def over_the_floor() -> np.ndarray:
    """Level poses at 30 m whose pictures have the north above, and every other one the south."""
    poses = np.tile(np.eye(4), (4, 1, 1))
    for k, (east, north) in enumerate([(-5, -3), (4, -2), (5, 4), (-4, 3)]):
        forward = 1.0 if k % 2 == 0 else -1.0
        poses[k, :3, :3] = np.column_stack([(0, forward, 0), (-forward, 0, 0), (0, 0, 1)])
        poses[k, :3, 3] = east, north, 30.0
    return poses


def points(written) -> list[ControlPoint]:
    """Points of which every picture shows a pixel: to the right is east in one whose top is north."""
    out = []
    for number, (east, north, _) in enumerate(PLACES):
        pixels = []
        for T in over_the_floor():
            right = T[1, 0] * (east - T[0, 3])
            down = -T[1, 0] * (north - T[1, 3])
            pixels.append(written(239.5 + FOCAL_PX * right / 30, 179.5 + FOCAL_PX * down / 30))
        std_m = np.full(3, 0.02)
        out.append(ControlPoint(f"P{number}", PLACES[number], std_m, np.arange(4), np.array(pixels), 1.0))
    return out


def refinement(marks: float, up: float = 1.0) -> SimpleNamespace:
    poses = over_the_floor()
    poses[:, 2, 2] = up
    return SimpleNamespace(noise=SimpleNamespace(marks=marks), w_T_b=poses)


@pytest.mark.parametrize("count", WRITTEN)
def test_the_count_that_fits_is_named(count):
    found = misread(refinement(marks=100.0), points(WRITTEN[count]), CAMERA, over_the_floor())
    assert (count or "their pixels lie 100 px off") in found


@pytest.mark.parametrize("seed", range(5))
def test_no_count_is_named_for_pixels_anywhere_in_the_picture(seed):
    draw = np.random.default_rng(seed)
    anywhere = points(lambda u, v: draw.uniform(0, (WIDTH, HEIGHT)))
    found = misread(refinement(marks=100.0), anywhere, CAMERA, over_the_floor())
    assert "their pixels lie 100 px off" in found


def test_marks_of_a_person_are_trusted():
    assert misread(refinement(marks=4.5), points(WRITTEN[""]), CAMERA, over_the_floor()) == ""
    assert misread(refinement(marks=100.0), [], CAMERA, over_the_floor()) == ""


def test_a_map_that_is_turned_over_is_no_map():
    """Turned pictures from below a floor show it as straight ones do from above, without any noise."""
    turned = points(WRITTEN["180 degrees"])
    assert "180 degrees" in misread(refinement(marks=1.0, up=-1.0), turned, CAMERA, over_the_floor())
    straight = points(WRITTEN[""])
    assert "upside down" in misread(refinement(marks=1.0, up=-1.0), straight, CAMERA, over_the_floor())


def test_points_whose_pixels_are_not_trusted_are_not_used_and_that_is_said():
    _, bundle, made, _ = refined(0)
    comparison = replace(ControlComparison(tuple(told(p) for p in made)), misread="their pixels lie off")
    assert not comparison.candidates.any()
    verdict = comparison.judge(bundle, np.ones(len(made), bool))
    assert not verdict.used.any()
    (line,) = control_warnings(verdict.report(bundle, verdict.used))
    expected = "control points: none is used: their pixels lie off; count pixels from the upper"
    assert str(line).startswith(expected)


@pytest.mark.slow
def test_a_map_does_not_follow_pixels_that_are_counted_from_the_lower_edge():
    made = small()
    flight = made.flight
    upwards = tuple(
        replace(p, views=tuple(v._replace(v_px=359 - v.v_px) for v in p.views)) for p in flight.surveyed
    )
    estimate = optimize(replace(flight, surveyed=upwards))
    assert "counted upwards from the lower edge" in estimate.status
    assert not estimate.control.is_followed
    without = optimize(replace(flight, surveyed=()))
    assert rms(off_m(made, estimate)) == pytest.approx(rms(off_m(made, without)), rel=0.05)

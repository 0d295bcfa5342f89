"""Ranges over a box that the pictures show: those of its top, or of the floor's level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.ground_below import fit_ground_below
from backend.bundle.refinement import Bundle, refine
from tests.backend.made_floor import Made, Scene, make

BOX = Scene(keyframes=24, points_in_view=60, box=(0.5, 2.0, -1.0, 1.0))
TOP_M = 0.25 * BOX.height_m


def made_over_box(seed: int, hears_box: bool) -> Made:
    """The scene, with ranges to the top of the box where the beam meets it."""
    made = make(BOX, seed)
    ranges = []
    for r in made.measurements.ranges:
        foot = made.w_T_b[r.k, :2, 3] / BOX.height_m
        over = BOX.box[0] < foot[0] < BOX.box[1] and BOX.box[2] < foot[1] < BOX.box[3]
        ranges.append(replace(r, range_m=r.range_m - TOP_M * (over and hears_box)))
    return replace(made, measurements=replace(made.measurements, ranges=tuple(ranges)))


def refined(made: Made) -> Bundle:
    return refine(made.measurements, made.start, made.floor_z_m)


@pytest.mark.parametrize("hears_box", [True, False])
def test_ranges_of_the_top_of_a_box_are_no_noise(hears_box: bool) -> None:
    bundle = refined(made_over_box(0, hears_box))
    problem = bundle.optimum.problem
    assert bundle.noise.range_m < 2 * BOX.range_std_m
    assert fit_ground_below(problem, bundle.optimum.values, 0.05, 0.5) == hears_box
    found = {r.k: r.ground_m for r in problem.measurements.ranges}
    assert max(found.values()) == (pytest.approx(TOP_M, rel=0.1) if hears_box else 0.0)


def test_ranges_over_a_flat_floor_are_those_that_were_read() -> None:
    made = make(Scene(), 0)
    ranges = refined(made).optimum.problem.measurements.ranges
    assert np.array_equal([r.range_m for r in ranges], [r.to_level_m for r in ranges])

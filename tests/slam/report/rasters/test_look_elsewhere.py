"""Photographs that are taken to look down, and show something else."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from backend.measurements import RelativePose
from frontend.camera import NADIR_B_T_C, Camera
from slam.core.flight import AttitudeSeries, Flight, Frames, Gps
from slam.core.geodesy import geodetic_from_enu
from slam.mapping.pipeline import optimize
from slam.report.rasters.look_elsewhere import LOOK_ELSEWHERE, looking_elsewhere
from slam.report.rasters.mosaic import write_mosaic
from tests.slam.io.exports.made_map import made_map, pose
from tests.slam.photo_survey import ORIGIN, SIZE_PX, ground, survey

CAMERA = Camera((480.0, 480.0), (239.5, 179.5), (480, 360), b_T_c=NADIR_B_T_C)
"""From 30 m it shows 30 m x 22 m."""
SURVEY = [(x, y) for x in (0.0, 9.0, 18.0) for y in (0.0, 9.0, 18.0)]
AMONG = [(3.0, 3.0), (9.0, 8.0), (15.0, 12.0)]


def mapped(others, are_matched=True):
    """A survey whose neighbours match, and a part of other photographs that match each other."""
    places, n = [*SURVEY, *others], len(SURVEY)
    links = [(i, j) for i in range(n) for j in range(i) if are_matched or i - j == 1]
    links += [(k, k - 1) for k in range(n + 1, len(places))]
    estimate = made_map(
        *(pose((x, y, 30.0)) for x, y in places),
        camera=CAMERA,
        origin=ORIGIN,
        component=np.repeat([0, 1], [n, len(others)]),
        relative_poses=tuple(RelativePose(i, j, np.eye(4), np.eye(6), "loop") for i, j in links),
        floor_z_m=0.0,
    )
    stamps_s = np.arange(len(places)) * 1.0
    gps = Gps(stamps_s, *geodetic_from_enu(estimate.w_T_b[:, :3, 3], ORIGIN), noise_std_m=(1.0,) * 3)
    return estimate, Flight("photographs", camera=CAMERA, gps=gps, all_keyframes=True)


def test_a_part_that_matches_no_photograph_of_its_place_is_named():
    estimate, flight = mapped(AMONG)
    assert looking_elsewhere(estimate, flight, CAMERA) == dict.fromkeys((9, 10, 11), LOOK_ELSEWHERE)


def test_photographs_whose_attitude_is_told_are_believed():
    estimate, flight = mapped(AMONG)
    attitude = AttitudeSeries(flight.gps.stamps_s, np.zeros((12, 3)))
    assert looking_elsewhere(estimate, replace(flight, attitude=attitude), CAMERA) == {}


@pytest.mark.parametrize(
    ("others", "are_matched"),
    [
        pytest.param([(60.0 + x, y) for x, y in AMONG], True, id="another place"),
        pytest.param([*AMONG, *((60.0 + x, y) for x, y in SURVEY)], True, id="the part's end alone"),
        pytest.param(AMONG, False, id="photographs of one ground seldom match"),
    ],
)
def test_a_part_that_may_look_down_is_drawn(others, are_matched):
    estimate, flight = mapped(others, are_matched)
    assert looking_elsewhere(estimate, flight, CAMERA) == {}


def test_fixes_that_may_be_wrong_by_a_picture_prove_nothing():
    estimate, flight = mapped(AMONG)
    coarse = replace(flight.gps, noise_std_m=(20.0,) * 3)
    assert looking_elsewhere(estimate, replace(flight, gps=coarse), CAMERA) == {}


@pytest.mark.slow
def test_photographs_of_far_hills_are_not_drawn_as_ground(tmp_path):
    """They match each other without parallax. They were drawn where no other photograph shows the ground."""
    made = survey(gps_std_m=1.0)
    flight, n = made.flight, len(made.w_T_c)
    hills = cv2.resize(ground()[:, ::-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)  # mirrored
    # Beside the last row of the survey, from where they would show ground that no other photograph does.
    places = np.vstack([made.w_T_c[:, :3, 3], [(24.0 + 2 * k, 30.0 + 1.5 * k, 30.0) for k in range(3)]])
    fixes = places + np.random.default_rng(0).normal(0, 1.0, places.shape)
    stamps_s, names = 2.0 * np.arange(n + 3), tuple(f"photo_{k:02}.jpg" for k in range(n + 3))

    def load(k):
        w, h = SIZE_PX
        return (
            flight.frames.load(k)
            if k < n
            else hills[9 * (k - n) : 9 * (k - n) + h, 20 * (k - n) : 20 * (k - n) + w]
        )

    gps = Gps(stamps_s, *geodetic_from_enu(fixes, ORIGIN), noise_std_m=(1.0,) * 3)
    both = replace(flight, frames=Frames(stamps_s, names, load), gps=gps, surveyed=())
    estimate = optimize(both)
    assert estimate.component.tolist() == [0] * n + [1] * 3
    not_drawn = write_mosaic(estimate, both, tmp_path).not_drawn
    assert {name for name, why in not_drawn.items() if why == LOOK_ELSEWHERE} == set(names[n:])

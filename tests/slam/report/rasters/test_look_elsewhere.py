"""Photographs that are taken to look down, and show something else."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from backend.measurements import RelativePose
from frontend.camera import NADIR_B_T_C, Camera
from slam.core.flight import Flight
from slam.core.geodesy import geodetic_from_enu
from slam.core.streams import AttitudeSeries, Frames, Gps
from slam.core.units import length
from slam.mapping.pipeline import optimize
from slam.report.rasters.look_elsewhere import looking_elsewhere
from slam.report.rasters.mosaic import write_mosaic
from tests.slam.io.exports.made_map import made_map, pose
from tests.slam.photo_survey import ORIGIN, SIZE_PX, ground, survey

CAMERA = Camera((480.0, 480.0), (239.5, 179.5), (480, 360), b_T_c=NADIR_B_T_C)
"""From 30 m it shows 30 m x 22 m."""
SURVEY = [(x, y) for x in (0.0, 12.0, 24.0) for y in (0.0, 12.0, 24.0)]
GPS_FIELDS = ("stamps_s", "latitude_deg", "longitude_deg", "altitude_m")
BURST = [(30.0 + 9.0 * k, 12.0 * k) for k in range(4)]


def mapped(places, others, moves=1.0, other_moves=0.01, noise_m=1.0):
    """A part at ``places`` and one at ``others``, by fixes; neighbours match, and move by shares of that."""
    every, n = np.array([*places, *others]), len(places)
    links = [(k - 1, k, moves if k < n else other_moves) for k in range(1, len(every)) if k != n]
    T = np.tile(np.eye(4), (len(links), 1, 1))
    T[:, :2, 3] = [share * (every[j] - every[i]) for i, j, share in links]
    estimate = made_map(
        *(pose((x, y, 30.0)) for x, y in every),
        camera=CAMERA,
        origin=ORIGIN,
        component=np.repeat([0, 1], [n, len(others)]),
        relative_poses=tuple(
            RelativePose(i, j, i_T_j, np.eye(6), "odometry")
            for (i, j, _), i_T_j in zip(links, T, strict=True)
        ),
        floor_z_m=0.0,
    )
    stamps_s = np.arange(len(every)) * 1.0
    gps = Gps(stamps_s, *geodetic_from_enu(estimate.w_T_b[:, :3, 3], ORIGIN), noise_std_m=(noise_m,) * 3)
    frames = Frames(stamps_s, estimate.frame_names, lambda _: None)
    return estimate, Flight("photographs", camera=CAMERA, frames=frames, gps=gps, all_keyframes=True)


def test_a_part_whose_pictures_hardly_move_is_named_with_what_was_measured():
    found = looking_elsewhere(*mapped(SURVEY, BURST))
    assert list(found) == [9, 10, 11, 12]
    (reason,) = set(found.values())
    assert f"moves by {length(15.0)} according to its positions, but only by {length(0.15)}" in reason


def test_photographs_whose_attitude_is_told_are_believed():
    estimate, flight = mapped(SURVEY, BURST)
    attitude = AttitudeSeries(flight.gps.stamps_s, np.zeros((13, 3)))
    assert looking_elsewhere(estimate, replace(flight, attitude=attitude)) == {}


@pytest.mark.parametrize(
    ("places", "others", "moves", "other_moves"),
    [
        pytest.param(SURVEY, [(3.0 + 12.0 * k, 6.0) for k in range(3)], 1.0, 0.9, id="across a river"),
        pytest.param(SURVEY, SURVEY[:8], 1.0, 1.1, id="a flight of another season"),
        pytest.param(SURVEY, BURST, 1.0, 0.4, id="over a valley"),
        pytest.param(SURVEY, BURST[:1], 1.0, 0.0, id="a single photograph"),
        # The floor is then as far as the horizon, and the ground moves faster than it.
        pytest.param([(15.0 * k, 0.0) for k in range(20)], SURVEY, 1.0, 50.0, id="below a larger horizon"),
    ],
)
def test_ground_is_drawn_that_matches_no_other_photograph(places, others, moves, other_moves):
    assert looking_elsewhere(*mapped(places, others, moves, other_moves)) == {}


def test_fixes_that_may_be_wrong_by_their_distance_prove_nothing():
    assert looking_elsewhere(*mapped(SURVEY, BURST, noise_m=5.0)) == {}


def test_photographs_without_a_fix_are_drawn():
    estimate, flight = mapped(SURVEY, BURST)
    known = np.arange(13) < 9
    lost = replace(flight.gps, latitude_deg=np.where(known, flight.gps.latitude_deg, np.nan))
    fewer = Gps(*(getattr(flight.gps, name)[known] for name in GPS_FIELDS), noise_std_m=(1.0,) * 3)
    for gps in (lost, fewer):
        assert looking_elsewhere(estimate, replace(flight, gps=gps)) == {}


@pytest.mark.slow
def test_photographs_of_far_hills_are_not_drawn_as_ground(tmp_path):
    """They match each other without parallax. They were drawn where no other photograph shows the ground."""
    made = survey(gps_std_m=1.0)
    flight, n = made.flight, len(made.w_T_c)
    hills = cv2.resize(ground()[:, ::-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)  # mirrored
    # Beside the last row of the survey, from where they would show ground that no other photograph does.
    places = np.vstack([made.w_T_c[:, :3, 3], [(24.0 + 12 * k, 30.0 + 9 * k, 30.0) for k in range(3)]])
    fixes = places + np.random.default_rng(0).normal(0, 1.0, places.shape)
    stamps_s, names = 2.0 * np.arange(n + 3), tuple(f"photo_{k:02}.jpg" for k in range(n + 3))

    def load(k):
        w, h = SIZE_PX
        return (
            flight.frames.load(k)
            if k < n
            else hills[2 * (k - n) : 2 * (k - n) + h, 4 * (k - n) : 4 * (k - n) + w]
        )

    gps = Gps(stamps_s, *geodetic_from_enu(fixes, ORIGIN), noise_std_m=(1.0,) * 3)
    both = replace(flight, frames=Frames(stamps_s, names, load), gps=gps, surveyed=())
    estimate = optimize(both)
    assert estimate.component.tolist() == [0] * n + [1] * 3
    not_drawn = write_mosaic(estimate, both, tmp_path).not_drawn
    assert {name for name, why in not_drawn.items() if "far away" in why} == set(names[n:])

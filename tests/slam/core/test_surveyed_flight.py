"""Control points of a flight, and of flights that are joined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.join_flights import join_flights
from slam.core.streams import Gps
from slam.core.surveyed_flight import with_surveyed
from tests.slam.io.made_gcp_list import ROWS, UTM, flight, read


def test_points_that_are_held_out_must_exist(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    held = with_surveyed(flight(), points, ["north"])
    assert [p.role for p in held.surveyed] == ["check", "check"]
    with pytest.raises(InputError, match=r"--check west: no control point of that name; the points are nor"):
        with_surveyed(flight(), points, ["west"])


def test_a_standard_deviation_counts_for_all_points_and_is_refused_without_any(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    both = with_surveyed(with_surveyed(flight(), points[:1]), points[1:], std_m=0.1)
    assert [p.std_m for p in both.surveyed] == [0.1, 0.1]
    with pytest.raises(InputError, match=r"--gcp-std: there are no control points; give --gcp FILE"):
        with_surveyed(flight(), (), std_m=0.1)


def test_the_origin_is_a_point_where_there_is_no_gps(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    origin = with_surveyed(replace(flight(), gps=None), points).geo_origin()
    assert (origin.latitude_deg, origin.altitude_m) == (points[0].latitude_deg, 402.5)
    flat = [replace(points[0], altitude_m=np.nan), points[1]]
    origin = with_surveyed(replace(flight(), gps=None), flat).geo_origin()
    assert (origin.latitude_deg, origin.altitude_m) == (points[1].latitude_deg, 401.0)
    origin = with_surveyed(replace(flight(), gps=None), flat[:1]).geo_origin()
    assert (origin.latitude_deg, origin.altitude_m) == (points[0].latitude_deg, 0.0)


def test_joined_flights_keep_their_points(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    one = with_surveyed(flight(), points)
    later = one.gps.latitude_deg + 1e-6
    other = replace(one, name="other", gps=replace(one.gps, latitude_deg=later))
    joined = join_flights([one, other])
    assert [p.name for p in joined.surveyed] == ["north", "south"]
    assert {v.picture for v in joined.surveyed[0].views} <= set(joined.frames.names)
    assert len(joined.surveyed[0].views) == 4


def test_a_point_with_two_altitudes_in_joined_flights_is_left_out(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    one = with_surveyed(flight(), points)
    higher = tuple(replace(p, altitude_m=p.altitude_m + 10 * (p.name == "north")) for p in points)
    gps = replace(one.gps, latitude_deg=one.gps.latitude_deg + 1e-6)
    joined = join_flights([one, replace(one, name="other", gps=gps, surveyed=higher)])
    assert [p.fault for p in joined.surveyed] == ["flights give it different coordinates", ""]


def test_a_list_replaces_points_of_a_flight_whose_receiver_had_no_fix(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    nowhere = np.full(3, np.nan)
    blind = replace(flight(), gps=Gps(np.arange(3.0), nowhere, nowhere, nowhere), surveyed=points)
    again, _ = read(tmp_path, [*UTM, *ROWS], blind)
    assert again == points


def test_points_without_names_of_two_flights_are_two_points(tmp_path):
    first, _ = read(tmp_path, [*UTM, ROWS[0].removesuffix(" north")])
    second, _ = read(tmp_path, [*UTM, "465025.0 5250010.0 401 10 20 DJI_0010.JPG", ROWS[0][:-6]])
    assert [p.name for p in (*first, *second)] == ["GCP 1", "GCP 1", "GCP 2"]
    one = with_surveyed(flight(), first)
    gps = replace(one.gps, latitude_deg=one.gps.latitude_deg + 1e-6)
    joined = join_flights([one, replace(one, name="other", gps=gps, surveyed=second)])
    found = [(p.name, len(p.views), p.fault) for p in joined.surveyed]
    assert found == [("photos/GCP 1", 2, ""), ("other/GCP 1", 1, "")]

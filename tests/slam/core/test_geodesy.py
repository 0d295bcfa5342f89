"""Geodesy against PROJ, published points, and what a rigid frame must keep."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from rasterio.warp import transform
from scipy.spatial.distance import pdist

from slam.core.geodesy import (
    GeoOrigin,
    ecef_from_geodetic,
    enu_from_geodetic,
    geodetic_from_ecef,
    geodetic_from_enu,
)


def points(seed, n=500, low_m=-1e3, high_m=1e5):
    rng = np.random.default_rng(seed)
    return rng.uniform(-90, 90, n), rng.uniform(-180, 180, n), rng.uniform(low_m, high_m, n)


def test_ecef_agrees_with_proj():
    lat, lon, alt = points(0)
    proj = np.column_stack(transform("EPSG:4979", "EPSG:4978", lon, lat, alt))
    assert_allclose(ecef_from_geodetic(lat, lon, alt), proj, rtol=0, atol=5e-9)


def test_geodetic_agrees_with_proj():
    e_p = ecef_from_geodetic(*points(1, high_m=1e4))
    lon, lat, alt = (np.array(a) for a in transform("EPSG:4978", "EPSG:4979", *e_p.T))
    ours = geodetic_from_ecef(e_p)
    # PROJ's own inverse takes a single step of the iteration.
    assert_allclose(ours[0], lat, rtol=0, atol=1e-10)
    assert_allclose(ours[1], lon, rtol=0, atol=1e-12)
    assert_allclose(ours[2], alt, rtol=0, atol=1e-5)


def test_inverse_is_exact_from_the_deep_to_geostationary_height():
    e_p = ecef_from_geodetic(*points(3, low_m=-5e6, high_m=4e7))
    assert_allclose(ecef_from_geodetic(*geodetic_from_ecef(e_p)), e_p, rtol=0, atol=3e-8)
    near = ecef_from_geodetic(*points(4, high_m=1e4))
    assert_allclose(ecef_from_geodetic(*geodetic_from_ecef(near)), near, rtol=0, atol=4e-9)


@pytest.mark.parametrize(
    ("origin", "point", "enu", "atol"),
    [
        # MathWorks, geodetic2enu: the Matterhorn seen from Zermatt.
        ((46.017, 7.750, 1673.0), (45.976, 7.658, 4531.0), (-7134.8, -4556.3, 2852.4), 0.06),
        # pymap3d's reference point: azimuth 33, elevation 70, range 1000 m from (42, -82, 200 m).
        (
            (42.0, -82.0, 200.0),
            (42.002581974253744, -81.99775196006746, 1139.701799575106),
            (186.277521, 286.842228, 939.692621),
            1e-6,
        ),
    ],
)
def test_published_points(origin, point, enu, atol):
    assert_allclose(enu_from_geodetic(*point, GeoOrigin(*origin))[0], enu, rtol=0, atol=atol)


def test_enu_follows_the_geodesics_of_proj_nearby():
    origin = GeoOrigin(30.17, -98.09, 0.0)
    rng = np.random.default_rng(2)
    lat, lon = (
        origin.latitude_deg + rng.uniform(-3e-3, 3e-3, 50),
        origin.longitude_deg + rng.uniform(-3e-3, 3e-3, 50),
    )
    plane = transform("EPSG:4326", "+proj=aeqd +lat_0=30.17 +lon_0=-98.09 +ellps=WGS84", lon, lat)
    ours = enu_from_geodetic(lat, lon, 0.0, origin)
    assert_allclose(ours[:, :2], np.column_stack(plane), rtol=0, atol=1e-4)
    assert np.all(ours[:, 2] <= 0)  # the ellipsoid falls away below the tangent plane


@settings(max_examples=100, deadline=None)
@given(st.floats(-90, 90), st.floats(-180, 180), st.floats(-500, 9000), st.integers(0, 2**32 - 1))
def test_round_trip_and_rigidity(lat, lon, alt, seed):
    origin = GeoOrigin(lat, lon, alt)
    w_p = np.random.default_rng(seed).uniform(-5e3, 5e3, (6, 3))
    geodetic = geodetic_from_enu(w_p, origin)
    assert_allclose(enu_from_geodetic(*geodetic, origin), w_p, rtol=0, atol=1e-8)
    assert_allclose(pdist(ecef_from_geodetic(*geodetic)), pdist(w_p), rtol=0, atol=1e-8)


def test_origin_is_zero_and_axes_point_east_north_up():
    origin = GeoOrigin(-33.9, 151.2, 40.0)
    lat, lon, alt = origin.latitude_deg, origin.longitude_deg, origin.altitude_m
    assert_allclose(enu_from_geodetic(lat, lon, alt, origin), np.zeros((1, 3)), atol=1e-9)
    step = enu_from_geodetic([lat, lat + 1e-5, lat], [lon + 1e-5, lon, lon], [alt, alt, alt + 1], origin)
    assert np.array_equal(step.argmax(axis=1), [0, 1, 2])
    assert_allclose(step[2], [0, 0, 1], atol=1e-9)


def test_poles_and_date_line():
    for lat in (90.0, -90.0):
        assert_allclose(geodetic_from_ecef(ecef_from_geodetic(lat, 0.0, 12.5))[0], lat, atol=1e-12)
        assert_allclose(geodetic_from_ecef(ecef_from_geodetic(lat, 0.0, 12.5))[2], 12.5, atol=5e-9)
    across = enu_from_geodetic(0.0, -179.999, 0.0, GeoOrigin(0.0, 179.999, 0.0))
    assert 0 < across[0, 0] < 300


def test_unknown_altitude_keeps_the_horizontal_position():
    origin = GeoOrigin(30.0, -98.0, 350.0)
    with_nan = enu_from_geodetic([30.001, 30.001], [-98.001, -98.001], [np.nan, 350.0], origin)
    assert_allclose(with_nan[0, :2], with_nan[1, :2])
    assert np.isnan(with_nan[0, 2])
    assert np.isfinite(with_nan[1, 2])

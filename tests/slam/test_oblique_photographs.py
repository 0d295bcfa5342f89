"""The whole job on photographs that do not look straight down: oblique, of a kite, and with the horizon."""

from __future__ import annotations

import numpy as np
import pytest
from PIL.ExifTags import Base

from frontend.camera import NADIR_B_T_C
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic, geodetic_from_enu
from slam.io.photos.import_photos import import_photos
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from tests.slam.io.photos.photo_files import NADIR, fill, jpeg
from tests.slam.photo_survey import ORIGIN, SIZE_PX, photographed, picture, poses, with_gimbal

GPS_STD_M = 0.5


def flown(w_T_c: np.ndarray, gimbal: bool, **settings: float) -> Flight:
    rng = np.random.default_rng(5)
    flight = photographed(w_T_c, rng, GPS_STD_M, **settings)
    return with_gimbal(flight, w_T_c, rng) if gimbal else flight


def assert_within_what_is_told(estimate: Estimate, w_T_c: np.ndarray, most_m: float = 2 * GPS_STD_M) -> None:
    """Errors of all positions beside their standard deviations: within three of these in the root mean."""
    shift = enu_from_geodetic(ORIGIN.latitude_deg, ORIGIN.longitude_deg, ORIGIN.altitude_m, estimate.origin)
    placed = estimate.placed
    off = (estimate.w_T_b[:, :3, 3] - w_T_c[:, :3, 3] - shift)[placed]
    variance = np.einsum("kaa->k", estimate.covariances[placed][:, 3:, 3:])
    assert np.sqrt((off**2).sum(axis=1).mean()) < 3 * np.sqrt(variance.mean())
    assert np.sqrt(variance.mean()) < most_m


def test_a_few_oblique_photographs_are_a_map():
    w_T_c = poses(3, 1, np.random.default_rng(1), np.radians(45), 0.03)
    flight = flown(w_T_c, gimbal=True)
    estimate = optimize(flight)
    assert estimate.placed.all()
    assert_within_what_is_told(estimate, w_T_c)


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", [30, 45, 60, 65])
def test_oblique_photographs_are_placed_and_drawn(tilt_deg, tmp_path):
    w_T_c = poses(4, 3, np.random.default_rng(1), np.radians(tilt_deg), 0.03)
    flight = flown(w_T_c, gimbal=True)
    estimate = optimize(flight)
    assert estimate.placed.all()
    assert estimate.status == "ok"
    assert_within_what_is_told(estimate, w_T_c)
    mosaic = write_mosaic(estimate, flight, tmp_path)
    assert mosaic.pictures >= 3
    assert not mosaic.left_out


@pytest.mark.slow
def test_photographs_with_the_horizon_are_placed_by_the_ground_below_it(tmp_path):
    """A wide lens at 60 degrees: a fifth of the picture is at or above the horizon, with clouds in it."""
    w_T_c = poses(4, 3, np.random.default_rng(1), np.radians(60), 0.03)
    flight = flown(w_T_c, gimbal=True, focal_px=300.0)
    estimate = optimize(flight)
    assert estimate.placed.all()
    assert estimate.status == "ok"
    assert_within_what_is_told(estimate, w_T_c)
    mosaic = write_mosaic(estimate, flight, tmp_path)
    # Nothing is drawn beyond 70 degrees off straight down, 2.75 flying heights of 30 m away.
    assert mosaic.height * mosaic.gsd_m < 9.0 * 3 + 2 * 2.75 * 34


@pytest.mark.slow
def test_photographs_of_a_kite_without_attitude_are_placed():
    w_T_c = poses(4, 3, np.random.default_rng(1), 0.0, np.radians(20))
    flight = flown(w_T_c, gimbal=False)
    estimate = optimize(flight)
    assert np.count_nonzero(estimate.placed) >= 10
    names = {flight.frames.names[k] for k in np.flatnonzero(~estimate.placed)}
    assert names == set(estimate.not_placed)
    assert_within_what_is_told(estimate, w_T_c)


@pytest.mark.slow
def test_photographs_from_above_and_oblique_ones_are_one_map(tmp_path):
    rng = np.random.default_rng(1)
    oblique = poses(4, 2, rng, np.radians(45), 0.03)
    oblique[:, :2, 3] += [6.0, -20.0]  # to look at the ground that the others see from above
    w_T_c = np.concatenate([poses(4, 3, rng), oblique])
    flight = flown(w_T_c, gimbal=True)
    estimate = optimize(flight)
    assert (estimate.component == 0).all()
    assert estimate.status == "ok"
    assert_within_what_is_told(estimate, w_T_c)
    assert not write_mosaic(estimate, flight, tmp_path).left_out


@pytest.mark.slow
def test_files_with_the_angles_of_an_oblique_gimbal_are_a_map(tmp_path):
    """From tags to places: a gimbal at -45 degrees to the north sees the ground to the north of it."""
    w_T_c = poses(3, 2, np.random.default_rng(1), np.radians(45), 0.0)
    fixes = w_T_c[:, :3, 3] + np.random.default_rng(2).normal(0, GPS_STD_M, (len(w_T_c), 3))
    degrees = np.column_stack(geodetic_from_enu(fixes, ORIGIN))
    files = {
        f"P{k}.jpg": jpeg(
            size=SIZE_PX,
            place=(lat, lon),
            altitude=alt,
            time=f"2024:05:06 07:08:{2 * k:02}",
            tags={Base.FocalLengthIn35mmFilm: 35},
            drone=NADIR | {"GimbalPitchDegree": "-45"},
            pixels=picture(w_T_c[k])[..., ::-1],
        )
        for k, (lat, lon, alt) in enumerate(degrees.tolist())
    }
    estimate = optimize(import_photos(fill(tmp_path, files)))
    assert estimate.placed.all()
    assert estimate.status == "ok"
    assert_within_what_is_told(estimate, w_T_c, most_m=2.0)
    looks = (estimate.w_T_b[:, :3, :3] @ NADIR_B_T_C[:3, :3])[:, :, 2]
    assert np.degrees(np.arccos(looks @ [0, np.sqrt(0.5), -np.sqrt(0.5)])).max() < 5

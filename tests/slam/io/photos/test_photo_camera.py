"""The camera from lens and sensor tags."""

import math
from dataclasses import replace

import pytest

from slam.io.photos.camera import photo_camera
from slam.io.photos.exif import PhotoTags

PLAIN = PhotoTags((2000, 1500))
CANON = replace(PLAIN, original_size_px=(4000, 3000), focal_mm=4.5, sensor_px_per_mm=16393.4426 / 25.4)
PHANTOM = PhotoTags((5472, 3648), focal_mm=8.8, focal_35mm=24.0)
DEWARP = (3706.73, 3703.46, -30.57, -20.34, -0.2646, 0.1064, 0.0001669, 0.00007934, -0.04412)


def focal(tags):
    camera, _ = photo_camera([tags])
    assert camera.focal_px[0] == camera.focal_px[1]
    return camera.focal_px[0]


def test_sensor_resolution_refers_to_the_original_size():
    camera, remarks = photo_camera([CANON])
    assert camera.focal_px[0] == pytest.approx(1452, abs=0.5)
    assert camera.center_px == (999.5, 749.5)
    assert (camera.focal_std_ratio, camera.aspect_std_ratio, camera.radial_std) == (0.03, 0.0, 0.1)
    assert "scaled from 4000 to 2000 px" in str(remarks[0])
    assert focal(replace(CANON, size_px=(4000, 3000))) == pytest.approx(2904.4, abs=1)
    assert focal(replace(CANON, size_px=(1500, 2000))) == pytest.approx(1452, abs=0.5)  # turned as well


def test_cropping_keeps_the_pixels_of_the_sensor():
    assert focal(replace(CANON, size_px=(2000, 3000))) == pytest.approx(2904.4, abs=1)


def test_film_equivalent_refers_to_the_diagonal():
    # 84 degrees on the diagonal of a 13.2 x 8.8 mm sensor, as its maker says.
    assert focal(PHANTOM) == pytest.approx(8.8 / 13.2 * 5472, rel=0.01)
    wide = PhotoTags((4000, 3000), focal_35mm=24.0)
    view = 2 * math.degrees(math.atan(2500 / focal(wide)))
    assert view == pytest.approx(84, abs=0.2)


def test_film_equivalent_is_preferred_to_an_unscaled_sensor_resolution():
    scaled = replace(CANON, original_size_px=(2000, 1500), focal_35mm=25.0)
    camera, remarks = photo_camera([scaled])
    assert camera.focal_px[0] == pytest.approx(25 / 43.267 * 2500, rel=1e-3)
    assert "the sensor's resolution would give 2904 px" in str(remarks[0])


def test_calibration_comes_first_and_is_scaled():
    calibrated = replace(
        PHANTOM, calibrated_focal_px=3666.67, size_px=(2736, 1824), original_size_px=(5472, 3648)
    )
    camera, _ = photo_camera([calibrated])
    assert camera.focal_px[0] == pytest.approx(3666.67 / 2)
    assert camera.focal_std_ratio == 0.03, "the designed value, not a measured one"
    camera, _ = photo_camera([replace(calibrated, dewarp=DEWARP)])
    assert camera.focal_px == pytest.approx((3706.73 / 2, 3703.46 / 2))
    assert camera.center_px == pytest.approx((1367.5 - 30.57 / 2, 911.5 - 20.34 / 2))
    assert camera.distortion == DEWARP[4:]
    assert (camera.focal_std_ratio, camera.aspect_std_ratio, camera.radial_std) == (0.03, 0.005, 0.02)
    camera, _ = photo_camera([replace(calibrated, dewarp=DEWARP, dewarped=True)])
    assert not camera.is_distorted


def test_missing_tags_are_replaced_by_a_noted_assumption():
    camera, remarks = photo_camera([PLAIN])
    assert 2 * math.degrees(math.atan(1000 / camera.focal_px[0])) == pytest.approx(65)
    assert camera.focal_std_ratio == 0.3
    assert "assumed" in str(remarks[0])
    assert focal(replace(PLAIN, size_px=(1500, 2000))) == pytest.approx(camera.focal_px[0])


@pytest.mark.parametrize(
    "absurd",
    [{"focal_35mm": 1e5}, {"calibrated_focal_px": 3.0}, {"dewarp": (1.0, 5e3, 0, 0, 9, 9, 9, 9, 9)}],
)
def test_implausible_tag_is_ignored(absurd):
    assert focal(replace(CANON, **absurd)) == pytest.approx(1452, abs=0.5)


def test_one_damaged_tag_does_not_change_the_camera():
    camera, _ = photo_camera([replace(CANON, sensor_px_per_mm=900.0), CANON, replace(PLAIN), CANON, CANON])
    assert camera.focal_px[0] == pytest.approx(1452, abs=0.5)


@pytest.mark.parametrize("original_px", [(800, 600), None])
def test_the_resolution_of_a_sensor_that_would_be_tiny_is_that_of_the_original(original_px):
    """A picture of 4000 px was resized to 800 px; 656 px/mm would make its sensor 1.2 mm wide."""
    resized = replace(CANON, size_px=(800, 600), original_size_px=original_px, sensor_px_per_mm=656.0)
    camera, remarks = photo_camera([resized])
    assert camera.focal_std_ratio == 0.3, "assumed"
    assert "a sensor 1.2 mm wide" in str(remarks[0])
    assert photo_camera([replace(resized, focal_35mm=28.0)])[0].focal_std_ratio == 0.03


def test_a_digital_zoom_enlarges_the_focal_length_by_the_sensor():
    whole, _ = photo_camera([CANON])
    zoomed, remarks = photo_camera([replace(CANON, digital_zoom=2.0)])
    assert zoomed.focal_px[0] == pytest.approx(2 * whole.focal_px[0])
    assert any("enlarged 2 times" in str(remark) for remark in remarks)

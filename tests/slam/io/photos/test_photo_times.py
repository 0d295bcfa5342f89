"""Times and order of photographs: the camera's clock, the satellites' clock, and the names."""

import pytest
from numpy.testing import assert_allclose
from PIL import ExifTags
from PIL.TiffImagePlugin import IFDRational

from slam.io.photos.import_photos import import_photos
from tests.slam.io.photos.photo_files import fill, jpeg, strip, warned

Base, GPS = ExifTags.Base, ExifTags.GPS


def test_fractions_and_zone_of_the_time(tmp_path):
    tags = {Base.SubsecTimeOriginal: "25", Base.OffsetTimeOriginal: "+02:00"}
    files = {"a.jpg": jpeg(tags=tags), "b.jpg": jpeg(tags=tags | {Base.SubsecTimeOriginal: "750"})}
    flight = import_photos(fill(tmp_path, files))
    assert flight.epoch_ns == (1714979289 - 7200) * 10**9 + 250_000_000
    assert flight.frames.stamps_s.tolist() == [0, 0.5]
    assert not warned(flight, "time zone")


def test_one_zone_missing_puts_all_on_the_camera_clock(tmp_path):
    files = strip(2) | {"P0.jpg": jpeg(time="2024:05:06 07:08:00", tags={Base.OffsetTimeOriginal: "+02:00"})}
    flight = import_photos(fill(tmp_path, files))
    assert flight.frames.stamps_s.tolist() == [0, 2]
    assert warned(flight, "time zone unknown")


def test_time_orders_the_photographs_not_their_names(tmp_path):
    files = {"a.jpg": jpeg(time="2024:05:06 07:08:09"), "b.jpg": jpeg(time="2024:05:06 07:08:01")}
    assert import_photos(fill(tmp_path, files)).frames.names == ("b.jpg", "a.jpg")


def test_equal_stamps_are_spread_in_order_of_the_names(tmp_path):
    seconds = {"P9": 0, "P10": 0, "P11": 0, "P12": 1, "P13": 5, "P14": 5}
    files = {f"{n}.jpg": jpeg(time=f"2024:05:06 07:08:0{s}", seed=int(n[1:])) for n, s in seconds.items()}
    flight = import_photos(fill(tmp_path, files))
    assert [name.removesuffix(".jpg") for name in flight.frames.names] == list(seconds)
    assert_allclose(flight.frames.stamps_s, [0, 1 / 3, 2 / 3, 1, 5, 5.5], atol=1e-8)
    assert warned(flight, "3 equal time stamps")


def test_satellite_time_where_the_camera_has_none(tmp_path):
    def when(s):
        return {GPS.GPSDateStamp: "2024:05:06", GPS.GPSTimeStamp: tuple(IFDRational(v) for v in (7, 8, s))}

    files = {"a.jpg": jpeg(time=None, gps=when(4)), "b.jpg": jpeg(time=None, gps=when(1))}
    flight = import_photos(fill(tmp_path, files))
    assert flight.frames.names == ("b.jpg", "a.jpg")
    assert flight.epoch_ns == 1714979281 * 10**9
    assert warned(flight, "satellites")


@pytest.mark.parametrize(
    "time",
    [
        None,
        "0000:00:00 00:00:00",
        "2024:05:06 07:08:09",
        "yesterday",
        "9024:05:06 07:08:09",
        "2024:13:40 99:00:00",
    ],
)
def test_without_times_the_names_give_the_order(tmp_path, time):
    files = {f"DJI_{k}.jpg": jpeg(time=time, seed=k) for k in (9, 10, 100, 1)}
    flight = import_photos(fill(tmp_path, files))
    assert flight.frames.names == ("DJI_1.jpg", "DJI_9.jpg", "DJI_10.jpg", "DJI_100.jpg")
    assert flight.frames.stamps_s.tolist() == [0, 1, 2, 3]
    assert warned(flight, "order of the names, 1 s apart")
    assert "date" not in flight.notes

"""Positions in copies of the photographs, with Pillow and our reader of tags as readers."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base

from slam.core.errors import InputError
from slam.core.geodesy import GeoOrigin
from slam.io.exports.camera_position import REPLACED, CameraPosition
from slam.io.exports.exif import with_tags
from slam.io.exports.formats import export_map
from slam.io.exports.tiff_tags import EMPTY, TiffTags
from slam.io.exports.xmp_position import with_position
from slam.io.photos.exif import read_tags
from slam.io.photos.import_photos import import_photos
from tests.slam.io.exports.made_map import exported, made_map, pose
from tests.slam.io.photos.photo_files import NADIR, fill, jpeg, strip, with_xmp, xmp

ORIGIN = GeoOrigin(-33.5, -70.25, -12.5)
AT = CameraPosition(-33.5, -70.2525, -12.5, (0.3, 0.4, 0.9))


def positioned(picture: bytes, at: CameraPosition = AT) -> bytes:
    return with_tags(picture, lambda tags: tags.set_gps(at.exif(), REPLACED), lambda p: with_position(p, at))


def gps_of(picture: bytes) -> dict:
    with Image.open(io.BytesIO(picture)) as image:
        image.load()
        return dict(image.getexif().get_ifd(IFD.GPSInfo))


def scan(picture: bytes) -> bytes:
    """The part of a JPEG from its last header segment on."""
    return picture[picture.index(b"\xff\xda") :]


def test_the_tags_are_those_of_the_standard():
    """-33.5 is 33 degrees 30 minutes south; 70.2525 is 70 degrees, 15 minutes and 9 seconds west."""
    gps = gps_of(positioned(jpeg()))
    assert (gps[GPS.GPSLatitudeRef], gps[GPS.GPSLongitudeRef]) == ("S", "W")
    assert gps[GPS.GPSLatitude] == (33, 30, 0)
    assert gps[GPS.GPSLongitude] == (70, 15, 9)
    assert (gps[GPS.GPSAltitudeRef], float(gps[GPS.GPSAltitude])) == (b"\1", 12.5)
    assert float(gps[GPS.GPSHPositioningError]) == 0.5
    assert gps[GPS.GPSMapDatum] == "WGS-84"


@pytest.mark.parametrize("place", [(30.1705, -98.0902), None])
def test_a_jpeg_keeps_its_pixels_and_its_other_tags(place):
    original = jpeg(place=place, gps={GPS.GPSImgDirection: 12.5, GPS.GPSDOP: 3.0})
    changed = positioned(original)
    assert scan(changed) == scan(original)
    with Image.open(io.BytesIO(original)) as before, Image.open(io.BytesIO(changed)) as after:
        assert np.array_equal(np.asarray(before), np.asarray(after))
        one, two = before.getexif(), after.getexif()
        assert dict(one.get_ifd(IFD.Exif)) == dict(two.get_ifd(IFD.Exif))
        assert [one[tag] for tag in (Base.Make, Base.Model)] == [two[tag] for tag in (Base.Make, Base.Model)]
    gps = gps_of(changed)
    assert float(gps[GPS.GPSImgDirection]) == 12.5
    assert GPS.GPSDOP not in gps, "the receiver's figure does not belong to the new position"


def test_nothing_in_the_old_tags_moves():
    """Makers' notes hold offsets of their own: the old bytes stay, but for the header's offset."""
    note = bytes(range(200))
    old = jpeg(tags={0x927C: note})
    new = positioned(old)
    start_old, start_new = (data.index(b"Exif\0\0") + 6 for data in (old, new))
    size = int.from_bytes(old[start_old - 8 : start_old - 6], "big") - 8
    before, after = old[start_old : start_old + size], new[start_new : start_new + size]
    assert before[8:] == after[8:]
    assert before[:4] == after[:4]
    with Image.open(io.BytesIO(new)) as image:
        assert image.getexif().get_ifd(IFD.Exif)[0x927C] == note


def test_a_picture_without_any_tag():
    pixels = Image.fromarray(np.arange(48 * 64, dtype=np.uint8).reshape(48, 64))
    for container in ("JPEG", "PNG", "TIFF"):
        plain = io.BytesIO()
        pixels.save(plain, container)
        assert gps_of(positioned(plain.getvalue()))[GPS.GPSLatitude] == (33, 30, 0), container


@pytest.mark.parametrize("container", ["PNG", "TIFF"])
def test_other_containers_keep_their_pixels(container):
    original = jpeg(container=container)
    changed = positioned(original)
    with Image.open(io.BytesIO(original)) as before, Image.open(io.BytesIO(changed)) as after:
        assert np.array_equal(np.asarray(before), np.asarray(after))
        assert before.getexif()[Base.Model] == after.getexif()[Base.Model]
    assert gps_of(changed)[GPS.GPSLongitude] == (70, 15, 9)
    if container == "TIFF":
        assert changed[8 : len(original)] == original[8:]
    else:
        at = original.index(b"IDAT")
        assert original[at - 4 :] in changed


def test_a_big_endian_structure():
    entry = struct.pack(">HHII", Base.Orientation, 3, 1, 6 << 16)
    tags = TiffTags(b"MM\0*\0\0\0\x08" + struct.pack(">H", 1) + entry + bytes(4))
    tags.set_gps(AT.exif(), REPLACED)
    exif = Image.Exif()
    exif.load(b"Exif\0\0" + tags.to_bytes())
    assert exif[Base.Orientation] == 6
    assert exif.get_ifd(IFD.GPSInfo)[GPS.GPSLatitude] == (33, 30, 0)


@pytest.mark.parametrize("elements", [False, True])
def test_the_maker_s_position_is_replaced_too(elements):
    drone = {**NADIR, "GpsLatitude": "+30.1", "GpsLongtitude": "-98.1", "AbsoluteAltitude": "+320.00"}
    drone |= {"RtkStdLon": "0.01", "RtkStdLat": "0.01", "RtkStdHgt": "0.02", "RelativeAltitude": "+60.0"}
    picture = positioned(with_xmp(jpeg(), xmp(drone, {"GPSXYAccuracy": "5.0"}, elements=elements)))
    for text in (b"-33.500000000", b"-70.252500000", b"-12.5000", b"0.30000", b"0.40000", b"0.90000"):
        assert picture.count(text) == 1, text
    assert b"+60.0" in picture
    assert b"-90.00" in picture
    assert b"320.00" not in picture


def test_adobe_s_own_names_have_minutes_and_fractions():
    packet = (
        b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><d xmlns:exif="http://ns.adobe.com/exif/1.0/" '
        b'exif:GPSLatitude=\'30,6.0N\' exif:GPSAltitude="320/1" exif:GPSAltitudeRef="0">'
        b"<exif:GPSLongitude>98,6.0W</exif:GPSLongitude></d></x:xmpmeta>"
    )
    changed = with_position(packet, AT)
    assert b'exif:GPSLatitude="33,30.0000000S"' in changed
    assert b"<exif:GPSLongitude>70,15.1500000W</exif:GPSLongitude>" in changed
    assert b'exif:GPSAltitude="125000/10000" exif:GPSAltitudeRef="1"' in changed


@pytest.mark.parametrize("maker", ["http://www.dji.com/drone-dji/1.0/", "http://ns.Maker.com/Drone/1.0/"])
def test_the_reader_finds_no_old_position_in_any_namespace_that_it_reads(maker, tmp_path):
    """Namespaces of makers are read in small and in capital letters."""
    packet = (
        f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><d xmlns:m="{maker}" '
        'm:Latitude="1" m:Longitude="2" m:AbsoluteAltitude="3"/></x:xmpmeta>'
    )
    original = with_xmp(jpeg(), packet.encode())
    (tmp_path / "old.jpg").write_bytes(original)
    (tmp_path / "new.jpg").write_bytes(positioned(original))
    old, new = (read_tags(tmp_path / name).position for name in ("old.jpg", "new.jpg"))
    assert (old.latitude_deg, old.longitude_deg, old.altitude_m) == (1, 2, 3)
    assert (new.latitude_deg, new.longitude_deg, new.altitude_m) == (-33.5, -70.2525, -12.5)


def test_names_of_other_families_stay():
    packet = b'<d xmlns:my="urn:mine" my:Latitude="1" my:GpsLatitude="2"/>'
    assert with_position(packet, AT) == packet


def test_a_set_comes_back_with_the_estimated_positions(tmp_path):
    """The copies are read as photographs: their positions are those of the map, within 0.1 mm."""
    fill(tmp_path / "photos", {**strip(3, drone=NADIR), "sub/Q.jpg": jpeg()})
    before = {p: p.read_bytes() for p in sorted((tmp_path / "photos").rglob("*.jpg"))}
    estimate = made_map(*(pose((10.0 * k, 20.0, 30.0)) for k in range(3)), origin=ORIGIN)
    source = exported(estimate, photos=tmp_path / "photos")
    notes = export_map(source, "exif", tmp_path / "copies")
    assert notes == ("1 photograph is not on the map, and not copied",)
    assert {p: p.read_bytes() for p in sorted((tmp_path / "photos").rglob("*.jpg"))} == before
    assert sorted(p.name for p in (tmp_path / "copies").iterdir()) == ["P0.jpg", "P1.jpg", "P2.jpg"]
    gps = import_photos(tmp_path / "copies").gps
    assert gps is not None
    latitude, longitude, altitude = source.geodetic(source.keyframes)
    np.testing.assert_allclose(gps.latitude_deg, latitude, atol=1e-9)
    np.testing.assert_allclose(gps.longitude_deg, longitude, atol=1e-9)
    np.testing.assert_allclose(gps.altitude_m, altitude, atol=1e-4)
    # 1 m north and 2 m east; Exif has one figure for both, our reader doubles it for the altitude.
    np.testing.assert_allclose(gps.noise_std_m, np.sqrt(2.5) * np.array([1, 1, 2]), rtol=1e-3)


@pytest.mark.parametrize("second", ["P0.jpg", "Q0.jpg"])
def test_photographs_of_several_flights_are_copied_from_the_folder_above(tmp_path, second):
    fill(
        tmp_path / "photos", {"a/P0.jpg": jpeg(seed=1), f"b/{second}": jpeg(seed=2), "b/R.jpg": jpeg(seed=3)}
    )
    estimate = made_map(pose(), pose(), origin=ORIGIN, frame_names=("a/P0.jpg", f"b/{second}"))
    notes = export_map(exported(estimate, photos=tmp_path / "photos"), "exif", tmp_path / "copies")
    assert notes == ("1 photograph is not on the map, and not copied",)
    copies = sorted((tmp_path / "copies").iterdir())
    assert [path.name for path in copies] == ["a_P0.jpg", f"b_{second}"]
    assert scan(copies[1].read_bytes()) == scan(jpeg(seed=2))


def test_an_unknown_covariance_states_no_accuracy(tmp_path):
    fill(tmp_path / "photos", {"P0.jpg": jpeg(gps={GPS.GPSHPositioningError: 3.0})})
    estimate = made_map(pose(), covariances=np.full((1, 6, 6), np.nan), origin=ORIGIN)
    export_map(exported(estimate, photos=tmp_path / "photos"), "exif", tmp_path / "copies")
    assert read_tags(tmp_path / "copies" / "P0.jpg").position.std_m is None


def test_an_unknown_altitude_leaves_the_altitude_tags_as_they_are(tmp_path):
    fill(tmp_path / "photos", {"P0.jpg": jpeg(altitude=None, drone={"AbsoluteAltitude": "+0.00"})})
    origin = GeoOrigin(-33.5, -70.25, 0.0, altitude_known=False)
    source = exported(made_map(pose(), origin=origin), photos=tmp_path / "photos")
    notes = export_map(source, "exif", tmp_path / "copies")
    assert any("no altitude is recorded" in note for note in notes)
    found = read_tags(tmp_path / "copies" / "P0.jpg").position
    assert (found.latitude_deg, found.altitude_m, found.exif_altitude_m) == (pytest.approx(-33.5), 0.0, None)


def test_pictures_that_cannot_be_copied_are_named(tmp_path):
    room = 0xFFFF - 2 - len(b"http://ns.adobe.com/xap/1.0/\0")
    full = with_xmp(jpeg(), xmp({"GpsLatitude": "1"}, {}).ljust(room))
    fill(tmp_path / "photos", {"P0.jpg": jpeg(), "P1.jpg": full, "P3.jpg": b"\xff\xd8\xff\xe1"})
    estimate = made_map(*[pose()] * 4, origin=ORIGIN)
    notes = export_map(exported(estimate, photos=tmp_path / "photos"), "exif", tmp_path / "copies")
    assert [path.name for path in (tmp_path / "copies").iterdir()] == ["P0.jpg"]
    assert any("no room for more tags (P1.jpg)" in note for note in notes)
    assert any("not in the folder (P2.jpg)" in note for note in notes)
    assert any("damaged" in note and "P3.jpg" in note for note in notes)


def test_another_folder_is_refused(tmp_path):
    fill(tmp_path / "photos", {"other.jpg": jpeg()})
    with pytest.raises(InputError, match="give the folder that the map was made of"):
        export_map(exported(made_map(pose()), photos=tmp_path / "photos"), "exif", tmp_path / "copies")
    assert not (tmp_path / "copies").exists()


def test_photos_with_another_format_are_refused(tmp_path):
    with pytest.raises(InputError, match="leave --photos out"):
        export_map(exported(made_map(pose()), photos=tmp_path), "gpx", tmp_path / "track.gpx")


@pytest.mark.parametrize("seed", [11])
def test_damaged_structures_are_refused_or_keep_their_pixels(seed):
    whole = jpeg(drone=NADIR)
    begin = len(whole) - len(scan(whole))
    rng, accepted = np.random.default_rng(seed), []
    for _ in range(300):
        damaged = bytearray(whole)
        for at in rng.integers(2, begin, 4):
            damaged[at] = rng.integers(256)
        with contextlib.suppress(ValueError):
            accepted.append(positioned(bytes(damaged)))
    assert 0 < len(accepted) < 300, "some damage is refused, and some leaves the structure whole"
    assert all(picture.endswith(scan(whole)) for picture in accepted)
    for cut in range(0, begin, 37):
        with pytest.raises(ValueError):  # noqa: PT011  the reason depends on the place
            positioned(whole[:cut])
    with pytest.raises(ValueError, match="no TIFF structure"):
        TiffTags(EMPTY[:9])


def test_a_png_chunk_has_its_checksum():
    changed = positioned(jpeg(container="PNG"))
    at = changed.index(b"eXIf")
    size = int.from_bytes(changed[at - 4 : at], "big")
    stored = int.from_bytes(changed[at + 4 + size : at + 8 + size], "big")
    assert stored == zlib.crc32(changed[at : at + 4 + size])

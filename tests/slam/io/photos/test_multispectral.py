"""Photographs of multispectral cameras: one band is read, with the lens that its tags describe."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import ExifTags
from PIL.TiffImagePlugin import IFDRational

from slam.core.errors import InputError
from slam.io.photos.bands import band_of, chosen_band
from slam.io.photos.camera import photo_camera
from slam.io.photos.exif import read_tags
from slam.io.photos.import_photos import import_photos
from tests.slam.io.photos.photo_files import fill, jpeg

Base = ExifTags.Base
PX_PER_MM = 1 / 0.00375
"""Sensors of Parrot's narrow bands, with pixels of 3.75 um."""
RESOLUTION = {
    Base.FocalPlaneXResolution: IFDRational(round(PX_PER_MM * 10**4), 10**4),
    Base.FocalPlaneResolutionUnit: 4,
}
COLOUR = {
    "ModelType": "perspective",
    "PrincipalPoint": "2.3,1.8",
    "PerspectiveFocalLength": "4.88",
    "PerspectiveFocalLengthUnits": "mm",
    "PerspectiveDistortion": "-0.05,0.01,0.002,0.0004,-0.0003",
}
FISHEYE = {
    "ModelType": "fisheye",
    "PrincipalPoint": "2.45,1.75",
    "FisheyePolynomial": "0.0,1.0,-0.0147,-0.1375",
    "FisheyeAffineMatrix": "1666.6,0.0,0.0,1666.6",
}
NARROW = {"GRE": "Green", "NIR": "NIR", "RED": "Red", "REG": "Red edge"}


def xmp(values, items=()):
    """A packet of Pix4D's names; ``items`` become a list of the band's names."""
    listed = "".join(f"<rdf:li>{item}</rdf:li>" for item in items)
    band = f"<Camera:BandName><rdf:Seq>{listed}</rdf:Seq></Camera:BandName>" if items else ""
    inside = "".join(f"<Camera:{k}>{v}</Camera:{k}>" for k, v in values.items())
    return (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF'
        ' xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about=""'
        f' xmlns:Camera="http://pix4d.com/camera/1.0/">{band}{inside}</rdf:Description></rdf:RDF></x:xmpmeta>'
    ).encode()


def shot(k, packet, **options):
    place, time = (30 + k * 1e-4, -98.0), f"2017:01:01 10:10:{2 * k:02d}"
    return jpeg(place=place, time=time, make="Parrot", model="Sequoia", packet=packet, **options)


def narrow(k, band, **options):
    packet = xmp(FISHEYE | {"BandName": band})
    return shot(k, packet, size=(64, 48), tags=RESOLUTION, container="TIFF", deep=True, **options)


def sequoia(count=3):
    """A set as a Sequoia writes it: one colour and four narrow pictures each time, of other sizes."""
    files = {}
    for k in range(count):
        stem = f"IMG_170101_1010{2 * k:02d}_{k:04d}"
        files[f"{stem}_RGB.JPG"] = shot(
            k, xmp(COLOUR, ("Red", "Green", "Blue")), size=(92, 68), tags=RESOLUTION, seed=k
        )
        for suffix, band in NARROW.items():
            files[f"{stem}_{suffix}.TIF"] = narrow(k, band, seed=k + 7)
    return files


def test_the_colour_pictures_of_a_sequoia_are_read(tmp_path):
    flight = import_photos(fill(tmp_path, sequoia()))
    assert [name[-7:] for name in flight.frames.names] == ["RGB.JPG"] * 3
    lines = [line for line in flight.warnings if "another band" in line]
    assert [line.split(" (")[0] for line in lines] == [
        f"3 of 15 photographs left out: another band, {band}" for band in ("Green", "NIR", "Red", "Red edge")
    ]
    assert any("band RGB is used; slam import --band reads another" in line for line in flight.warnings)


@pytest.mark.parametrize("asked", ["NIR", "nir", "red edge", "REG"])
def test_the_band_asked_for_is_read(tmp_path, asked):
    flight = import_photos(fill(tmp_path, sequoia()), band=asked)
    suffix = "NIR.TIF" if asked.lower() == "nir" else "REG.TIF"
    assert [name[-7:] for name in flight.frames.names] == [suffix] * 3


def test_a_band_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"no photograph of band blue; choose one of Green, NIR, RGB, Red"):
        import_photos(fill(tmp_path, sequoia()), band="blue")


def tags_of(tmp_path, values, size, **options):
    path = tmp_path / "a.jpg"
    path.write_bytes(shot(0, xmp(values), size=size, tags=RESOLUTION, **options))
    return read_tags(path)


def test_the_perspective_lens_of_the_tags(tmp_path):
    """Pix4D's order is R1, R2, R3, T1, T2, and the principal point is in millimetres from the corner."""
    camera, (message,) = photo_camera([tags_of(tmp_path, COLOUR, (1226, 960))])
    remark = str(message)
    assert camera.focal_px == pytest.approx((4.88 * PX_PER_MM,) * 2)
    assert camera.center_px == pytest.approx((2.3 * PX_PER_MM - 0.5, 1.8 * PX_PER_MM - 0.5))
    assert camera.distortion == (-0.05, 0.01, 0.0004, -0.0003, 0.002)
    assert "calibration of the lens" in remark


def fisheye_pixels(directions):
    """Pixels (n, 2) of directions (n, 3) by Pix4D's own equations."""
    x, y = directions[:, 0] / directions[:, 2], directions[:, 1] / directions[:, 2]
    r = np.hypot(x, y)
    share = 2 / np.pi * np.arctan(r)
    p0, p1, p2, p3 = (float(p) for p in FISHEYE["FisheyePolynomial"].split(","))
    radius = p0 + p1 * share + p2 * share**2 + p3 * share**3
    scale = float(FISHEYE["FisheyeAffineMatrix"].split(",")[0])
    return np.column_stack([scale * radius * x / r, scale * radius * y / r])


def test_the_fisheye_lens_of_the_tags(tmp_path):
    camera, (message,) = photo_camera([tags_of(tmp_path, FISHEYE, (1280, 960))])
    remark = str(message)
    rng = np.random.default_rng(0)
    directions = np.column_stack([rng.uniform(-0.6, 0.6, (500, 2)) * [1, 0.75], np.ones(500)])
    expected = fisheye_pixels(directions) + np.array([2.45, 1.75]) * PX_PER_MM - 0.5
    inside = np.all((expected > 0) & (expected < [1279, 959]), axis=1)
    assert inside.sum() > 300
    error_px = np.linalg.norm(camera.project(directions) - expected, axis=1)[inside].max()
    stated_px = float(remark.split("described by OpenCV's fisheye, with errors of up to ")[1].split()[0])
    assert error_px < 1.1 * stated_px < 0.1
    zero = np.zeros(3)
    lens = camera.matrix, np.array(camera.distortion)
    by_opencv = cv2.fisheye.projectPoints(directions[:, None], zero, zero, *lens)[0][:, 0]
    assert np.linalg.norm(by_opencv - expected, axis=1)[inside].max() == pytest.approx(error_px)
    pinhole = cv2.projectPoints(directions, np.zeros(3), np.zeros(3), camera.matrix, None)[0].reshape(-1, 2)
    assert np.linalg.norm(pinhole - expected, axis=1)[inside].max() > 50


def test_a_fisheye_of_too_wide_a_view_is_reported(tmp_path):
    wide = FISHEYE | {"FisheyeAffineMatrix": "700,0,0,700"}
    camera, (message,) = photo_camera([tags_of(tmp_path, wide, (1280, 960))])
    remark = str(message)
    assert not camera.is_distorted
    assert "the view of its fisheye is too wide" in remark


@pytest.mark.parametrize(
    "broken",
    [
        {"PerspectiveDistortion": "nan,0,0,0,0"},
        {"PerspectiveDistortion": "1,2"},
        {"PerspectiveDistortion": "1e9,0,0,0,0"},
        {"PerspectiveFocalLength": "-4"},
        {"PerspectiveFocalLength": "4/0"},
    ],
)
def test_broken_lens_tags_are_ignored(tmp_path, broken):
    assert tags_of(tmp_path, COLOUR | broken, (64, 48)).lens is None


def test_a_scaled_picture_has_a_scaled_lens(tmp_path):
    sizes = {Base.ExifImageWidth: 1280, Base.ExifImageHeight: 960}
    path = tmp_path / "a.jpg"
    path.write_bytes(shot(0, xmp(FISHEYE), size=(640, 480), tags=RESOLUTION | sizes))
    whole = photo_camera([tags_of(tmp_path, FISHEYE, (1280, 960))])[0]
    path.write_bytes(shot(0, xmp(FISHEYE), size=(640, 480), tags=RESOLUTION | sizes))
    half = photo_camera([read_tags(path)])[0]
    assert_allclose(half.focal_px, np.array(whole.focal_px) / 2, rtol=1e-4)
    assert_allclose(half.distortion, whole.distortion, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "band"),
    [
        ("IMG_170101_101010_0000_GRE.TIF", "Green"),
        ("IMG_170101_101010_0000_RGB.JPG", "RGB"),
        ("DJI_0010.JPG", "RGB"),
        ("DJI_0011.TIF", "band 1"),
        ("DJI_20230101120000_0001_MS_RE.TIF", "Red edge"),
        ("IMG_0007_4.tif", "band 4"),
        ("IMG_0007.tif", "RGB"),
        ("DJI_20230101120000_0001_T.JPG", "Thermal"),
        ("DJI_20230101120000_0001_W.JPG", "RGB"),
        ("DJI_20210301120000_0001_THRM.JPG", "Thermal"),
        ("court_T.jpg", "RGB"),
    ],
)
def test_without_the_tag_the_name_of_the_file_holds_the_band(tmp_path, name, band):
    (tmp_path / "a.jpg").write_bytes(jpeg())
    assert band_of(name, read_tags(tmp_path / "a.jpg")) == band


def test_the_choice_among_bands():
    assert chosen_band(["NIR", "Red", "Green"] * 5, None) == "Green"
    assert chosen_band(["NIR"] * 5 + ["Green"] * 4, None) == "NIR"
    assert chosen_band(["Green"] * 9 + ["RGB"], None) == "Green"  # one stray colour photograph
    assert chosen_band(["Green"] * 9 + ["RGB"] * 5, None) == "RGB"
    assert chosen_band(["band 2", "band 1"], None) == "band 1"
    assert chosen_band(["band 2", "band 1"], "2") == "band 2"


def test_of_a_thermal_camera_the_colour_pictures_are_read(tmp_path):
    files = {}
    for k in range(3):
        for letter, source, size in (("T", "InfraredCamera", (40, 32)), ("W", "WideCamera", (64, 48))):
            time = f"2023:01:01 10:10:{2 * k:02d}"
            packet = {"ImageSource": source}
            files[f"DJI_2023_{k}_{letter}.JPG"] = jpeg(time=time, drone=packet, size=size, seed=k)
            files[f"{letter}/{k}.jpg"] = jpeg(time=time, drone=packet, size=size, seed=k + 9)
    flight = import_photos(fill(tmp_path, files))
    assert flight.camera.size_px == (64, 48)
    assert len(flight.frames.names) == 6
    assert any("6 of 12 photographs left out: another band, Thermal" in line for line in flight.warnings)
    assert import_photos(tmp_path, band="thermal").camera.size_px == (40, 32)


def test_a_band_without_a_name_is_called_by_its_number(tmp_path):
    flight = import_photos(fill(tmp_path, {"IMG_0001_1.tif": jpeg(), "IMG_0001_2.tif": jpeg(seed=1)}))
    assert any(
        line.startswith("band 1 is used; slam import --band reads another: band 2")
        for line in flight.warnings
    )


def test_mutated_tiffs_give_a_flight_or_a_refusal(tmp_path):
    """Flipped bytes and cuts; warnings are errors here."""
    rng = np.random.default_rng(0)
    original = narrow(0, "NIR")
    outcomes = {"flight": 0, "refused": 0}
    for _ in range(150):
        data = bytearray(original)
        for at in rng.integers(2, len(data), rng.integers(1, 30)):
            data[at] = rng.integers(256)
        cut = rng.integers(len(data)) if rng.random() < 0.15 else len(data)
        (tmp_path / "a_NIR.TIF").write_bytes(data[:cut])
        try:
            flight = import_photos(tmp_path)
        except InputError:
            outcomes["refused"] += 1
        else:
            flight.frames.load(0)
            assert np.isfinite([*flight.camera.focal_px, *flight.camera.distortion]).all()
            outcomes["flight"] += 1
    assert min(outcomes.values()) > 0

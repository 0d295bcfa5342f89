"""Pictures of more than 8 bits, integers and floats, as PNG and TIFF."""

import contextlib
import struct
import warnings

import cv2
import numpy as np
import pytest
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile

from slam.io.images import common_levels, read_image
from slam.io.levels import Levels
from slam.io.photos.import_photos import import_photos
from slam.io.picture_headers import UnreadableImageError, image_size
from tests.slam.io.made_flight import picture

SIZE = (60, 44)
GREY = picture(5, SIZE, colour=False)


def tiff(pixels, **options):
    """A TIFF of pixels (h, w) or (h, w, 3) RGB, without tags of a camera."""
    bands = np.moveaxis(pixels.reshape(*pixels.shape[:2], -1), -1, 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        memory = MemoryFile()
        shape = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
        with memory.open(driver="GTiff", dtype=pixels.dtype, **shape, **options) as file:
            file.write(bands)
        return bytes(memory.read())


def read(tmp_path, data, name="a.tif"):
    (tmp_path / name).write_bytes(data)
    assert image_size(tmp_path / name) == SIZE
    return read_image(tmp_path / name)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
@pytest.mark.parametrize("packed", [False, True])
def test_a_tiff_is_read_as_the_png_of_the_same_pixels(tmp_path, bits, packed):
    deep = (GREY.astype(np.uint16) << (bits - 8)) + 1
    options = {"nbits": bits} if packed and bits < 16 else {"compress": "deflate"}
    np.testing.assert_array_equal(read(tmp_path, tiff(deep, **options)), GREY)
    np.testing.assert_array_equal(read(tmp_path, cv2.imencode(".png", deep)[1].tobytes()), GREY)


@pytest.mark.parametrize("interleave", ["pixel", "band"])
def test_deep_colours(tmp_path, interleave):
    colour = picture(3, SIZE)
    deep = colour[..., ::-1].astype(np.uint16) << 4
    np.testing.assert_array_equal(read(tmp_path, tiff(deep, interleave=interleave)), colour)
    with_alpha = np.dstack([deep, np.full(deep.shape[:2], 4095, np.uint16)])
    np.testing.assert_array_equal(read(tmp_path, tiff(with_alpha)), colour)


@pytest.mark.parametrize("bits", [12, 16])
def test_a_picture_whose_zero_is_white_is_no_negative(tmp_path, bits):
    deep = (GREY.astype(np.uint16) << (bits - 8)) + 1
    options = {"nbits": bits} if bits < 16 else {}
    data = tiff((1 << bits) - 1 - deep, photometric="MINISWHITE", **options)
    np.testing.assert_array_equal(read(tmp_path, data), GREY)


def as_kelvin(grey):
    """Counts of a radiometric thermal camera, 0.01 K each: 293 to 303 K."""
    return (29300 + grey * 1000.0 / 255).astype(np.uint16)


@pytest.mark.parametrize(
    "deep",
    [
        pytest.param(as_kelvin(GREY), id="thermal counts"),
        pytest.param(as_kelvin(GREY).astype(np.int32), id="int32"),
        pytest.param(GREY.astype(np.uint32) << 20, id="uint32"),
        pytest.param((GREY.astype(np.int16) - 128) * 16, id="int16 about zero"),
        pytest.param(GREY / np.float32(1000), id="reflectance"),
        pytest.param(20 + GREY / 25.0, id="degrees, float64"),
    ],
)
def test_every_number_type_keeps_its_grey_levels(tmp_path, deep):
    found = read(tmp_path, tiff(deep))
    assert len(np.unique(found)) > 0.5 * len(np.unique(GREY))
    assert np.corrcoef(found.ravel(), GREY.ravel())[0, 1] > 0.999
    assert found.max() > 250


def test_hot_dead_and_missing_pixels_do_not_set_the_range(tmp_path):
    deep = GREY / np.float32(255)
    expected = read(tmp_path, tiff(deep)).astype(int)
    deep[0, 0], deep[1, 1], deep[2, 2] = 3e38, -3e38, np.nan
    found = read(tmp_path, tiff(deep)).astype(int)
    assert found[0, 0] == 255
    assert found[1, 1] == found[2, 2] == 0
    assert np.abs(found - expected)[3:].max() <= 3
    deep[5:10] = -9999
    found = read(tmp_path, tiff(deep, nodata=-9999)).astype(int)
    assert not found[5:10].any()
    assert np.abs(found - expected)[10:].max() <= 3


def test_a_picture_without_contrast_is_read(tmp_path):
    for value in (0, 7, 3e38, np.nan):
        assert len(np.unique(read(tmp_path, tiff(np.full(GREY.shape, value, np.float32))))) == 1


def test_cut_short_and_too_large_tiffs_are_refused(tmp_path):
    data = tiff(GREY.astype(np.float32))
    for size in (4, 20, 100, len(data) // 2, len(data) - 30):
        (tmp_path / "a.tif").write_bytes(data[:size])
        with pytest.raises(UnreadableImageError, match=r"truncated|damaged"):
            read_image(tmp_path / "a.tif")
    bomb = tiff(np.zeros((9000, 9000), np.float64), compress="deflate", sparse_ok=True)
    (tmp_path / "a.tif").write_bytes(bomb)
    with pytest.raises(UnreadableImageError, match="more than 512 MB"):
        read_image(tmp_path / "a.tif")


def test_random_damage_of_a_tiff_raises_nothing_else(tmp_path):
    rng = np.random.default_rng(4)
    data = tiff((GREY.astype(np.uint16) << 4), compress="deflate")
    for _ in range(150):
        bad = bytearray(data)
        at = np.concatenate([rng.integers(0, 250, 2), rng.integers(0, len(data), 2)])
        for k in at:
            bad[k] = int(rng.integers(256))
        (tmp_path / "a.tif").write_bytes(bytes(bad))
        with contextlib.suppress(UnreadableImageError):
            assert read_image(tmp_path / "a.tif").dtype == np.uint8


def test_photographs_of_one_set_share_their_levels(tmp_path):
    for k, gain in enumerate((1, 4)):
        (tmp_path / f"P{k}.tif").write_bytes(tiff(GREY.astype(np.float32) * gain / 1020, nodata=-1))
    flight = import_photos(tmp_path)
    dark, bright = flight.frames.load(0).astype(int), flight.frames.load(1).astype(int)
    assert np.abs(bright - 4 * dark)[bright < 255].max() <= 5
    assert [line for line in flight.warnings if "more than 8 bits per pixel" in line]
    paths = [tmp_path / "P0.tif", tmp_path / "P1.tif"]
    assert isinstance(common_levels(paths, []), Levels)


def test_of_more_than_four_samples_the_first_is_read(tmp_path):
    many = np.dstack([GREY, *[GREY // 2] * 4])
    np.testing.assert_array_equal(read(tmp_path, tiff(many)), GREY)
    np.testing.assert_array_equal(read(tmp_path, tiff(many.astype(np.uint16) << 8)), GREY)


def test_samples_that_are_not_read_are_told(tmp_path):
    (tmp_path / "a.tif").write_bytes(tiff(np.dstack([GREY] * 5)))
    notes = []
    assert common_levels([tmp_path / "a.tif"], notes) is None
    assert [*map(str, notes)] == [
        "pictures have 5 samples a pixel: the first alone is read; convert them if others show more"
    ]


def test_a_sound_tiff_of_a_kind_that_is_not_read_is_not_called_damaged(tmp_path):
    whole = tiff(GREY)
    entry = struct.pack("<HHIHH", 259, 3, 1, 1, 0)
    assert entry in whole
    webp = whole.replace(entry, struct.pack("<HHIHH", 259, 3, 1, 50001, 0))
    for data, reason in (
        (webp, r"a TIFF of a compression that is not read \(tag 259: 50001\)"),
        (tiff(GREY.astype(np.complex64)), "a TIFF of complex numbers"),
    ):
        (tmp_path / "a.tif").write_bytes(data)
        with pytest.raises(UnreadableImageError, match=reason):
            read_image(tmp_path / "a.tif")


def test_a_big_tiff_is_named(tmp_path):
    (tmp_path / "a.tif").write_bytes(tiff(GREY, BIGTIFF="YES"))
    with pytest.raises(UnreadableImageError, match="is a BigTIFF picture, no PNG"):
        read_image(tmp_path / "a.tif")


def test_eight_bit_tiffs_are_as_opencv_reads_them(tmp_path):
    path = tmp_path / "a.tif"
    path.write_bytes(tiff(picture(3, SIZE)[..., ::-1].copy()))
    np.testing.assert_array_equal(read_image(path), picture(3, SIZE))
    assert read_image(path).flags.writeable

"""One picture that may be anything."""

import contextlib
import io
import struct
import warnings
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image

from slam.io.images import PictureFiles, common_levels, read_image
from slam.io.levels import Levels
from slam.io.picture_headers import MAX_PIXELS, UnreadableImageError, image_size
from tests.slam.io.made_flight import picture

SIZE = (60, 44)


def encoded(kind, image=None, **options):
    out = io.BytesIO()
    image = Image.fromarray(picture(5, SIZE)[..., ::-1].copy()) if image is None else image
    image.save(out, format=kind, **options)
    return out.getvalue()


@pytest.fixture
def put(tmp_path):
    def write(data, name="a.png"):
        (tmp_path / name).write_bytes(data)
        return tmp_path / name

    return write


def reason(path, size=None):
    with pytest.raises(UnreadableImageError) as caught:
        read_image(path, size)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_png_is_as_opencv_reads_it(put):
    path = put(encoded("PNG"))
    np.testing.assert_array_equal(read_image(path), cv2.imread(str(path), cv2.IMREAD_COLOR))
    assert image_size(path) == SIZE
    assert read_image(path).flags.c_contiguous
    assert read_image(path).flags.writeable


def test_jpeg_is_as_opencv_reads_it(put):
    smooth = cv2.GaussianBlur(picture(5, SIZE), (0, 0), 4)
    path = put(
        encoded("JPEG", Image.fromarray(smooth[..., ::-1].copy()), quality=95, progressive=True), "a.jpg"
    )
    theirs = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    assert np.abs(read_image(path).astype(int) - theirs).max() <= 4
    assert image_size(path) == SIZE


def test_orientation_in_exif_is_ignored(put):
    exif = Image.Exif()
    exif[0x0112] = 6
    turned = put(encoded("JPEG", exif=exif.tobytes()), "turned.jpg")
    np.testing.assert_array_equal(read_image(turned), read_image(put(encoded("JPEG"), "plain.jpg")))
    assert cv2.imread(str(turned)).shape[:2] == SIZE  # OpenCV by itself turns it


@pytest.mark.parametrize(
    "damage", [b"MM\0*\xff\xff\xff\xff", b"II*\0\x08\0\0\0\x09\0\x1a\x01\x05", b"\0" * 8]
)
@pytest.mark.parametrize("block", [(b"\xff\xe1", b"Exif\0\0"), (b"\xff\xe2", b"MPF\0")])
def test_damaged_tags_do_not_affect_the_picture(put, block, damage):
    """Warnings are errors here: Pillow by itself warns of these."""
    marker, name = block
    whole, content = encoded("JPEG"), name + damage + b"\xff" * 40
    path = put(whole[:2] + marker + struct.pack(">H", len(content) + 2) + content + whole[2:], "tags.jpg")
    np.testing.assert_array_equal(read_image(path), read_image(put(whole, "plain.jpg")))


def test_other_kinds_of_pixels(put):
    grey = picture(1, SIZE, colour=False)
    np.testing.assert_array_equal(read_image(put(encoded("PNG", Image.fromarray(grey)))), grey)
    deep = (grey.astype(np.uint16) << 8) + 77
    np.testing.assert_array_equal(read_image(put(encoded("PNG", Image.fromarray(deep)))), grey)
    bits = Image.fromarray(grey).convert("1", dither=Image.Dither.NONE)
    np.testing.assert_array_equal(read_image(put(encoded("PNG", bits))), np.where(grey > 127, 255, 0))
    rgba = np.dstack([picture(2, SIZE)[..., ::-1], grey])
    np.testing.assert_array_equal(read_image(put(encoded("PNG", Image.fromarray(rgba)))), picture(2, SIZE))
    palette = Image.fromarray(grey).convert("P")
    np.testing.assert_array_equal(read_image(put(encoded("PNG", palette)))[..., 1], grey)
    la = Image.merge("LA", [Image.fromarray(grey), Image.fromarray(grey)])
    np.testing.assert_array_equal(read_image(put(encoded("PNG", la))), grey)


def test_sixteen_bit_colour_keeps_its_upper_byte(put):
    image = picture(3, SIZE).astype(np.uint16) * 256 + 9
    path = put(cv2.imencode(".png", image)[1].tobytes())
    np.testing.assert_array_equal(read_image(path), picture(3, SIZE))


@pytest.mark.parametrize(
    ("kind", "name"), [("GIF", "a GIF"), ("BMP", "a BMP"), ("WEBP", "a WebP"), ("PDF", "a PDF")]
)
def test_other_formats_are_named_in_the_error(put, kind, name):
    assert name in reason(put(encoded(kind)))


def test_every_truncation_is_detected(put):
    for kind in ("PNG", "JPEG"):
        data = encoded(kind)
        for size in [*range(0, 40), *np.linspace(40, len(data) - 20, 30).astype(int)]:
            assert reason(put(data[:size])) in ("empty", "truncated", "damaged", "no PNG, JPEG or TIFF")


def test_any_flipped_bit_in_a_png_is_detected(put):
    data = encoded("PNG")
    rng = np.random.default_rng(3)
    good = read_image(put(data))
    for at in rng.integers(8, len(data), 200):
        bad = bytearray(data)
        bad[at] ^= 1 << int(rng.integers(8))
        try:
            image = read_image(put(bytes(bad)))
        except UnreadableImageError:
            continue
        np.testing.assert_array_equal(image, good)  # only what no decoder needs


def test_random_damage_raises_nothing_else(put):
    rng = np.random.default_rng(4)
    data = encoded("JPEG")
    for _ in range(200):
        bad = bytearray(data)
        for at in rng.integers(0, len(data), 4):
            bad[at] = int(rng.integers(256))
        with contextlib.suppress(UnreadableImageError):
            assert read_image(put(bytes(bad))).dtype == np.uint8


def bomb(width, height):
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b"\0" * 999))
        + chunk(b"IEND", b"")
    )


def test_decompression_bomb_is_refused_by_its_header(put):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "million" in reason(put(bomb(40_000, 40_000)))
        assert "million" in reason(put(bomb(MAX_PIXELS, 2)))
        assert reason(put(bomb(0, 10))) == "damaged"


def test_size_must_be_that_of_the_camera(put):
    path = put(encoded("PNG"))
    assert read_image(path, SIZE).shape == (SIZE[1], SIZE[0], 3)
    assert "60 x 44" in reason(path, (61, 44))


def test_other_files_are_refused(put, tmp_path):
    assert reason(tmp_path / "nope.png") == "missing"
    assert reason(tmp_path) == "not a file"
    assert reason(put(b"")) == "empty"
    assert reason(put(b"\0" * 4000)) == "zeroed"
    assert "no PNG" in reason(put(b"GPS,1,2,3\n" * 30))


def test_loader_keeps_the_reason(put):
    files = PictureFiles((put(encoded("PNG"), "a.png"), put(encoded("PNG")[:-40], "b.png")), SIZE)
    assert files(0) is not None
    assert files(1) is None
    assert list(files.failures) == [1]


@pytest.mark.parametrize("colour", [False, True])
def test_sixteen_bit_files_keep_the_bits_that_the_camera_fills(put, colour):
    small = picture(2, SIZE) if colour else picture(2, SIZE)[..., 0]
    small[0, 0] = 255
    for bits in (8, 10, 12, 14, 16):
        _, data = cv2.imencode(".png", small.astype(np.uint16) << (bits - 8))
        path = put(data.tobytes())
        np.testing.assert_array_equal(read_image(path), small)
        assert common_levels([path], notes := []) == Levels(0, 1 << bits)
        assert len(notes) == 1
    np.testing.assert_array_equal(read_image(path, levels=Levels(0, 1 << 12)), np.minimum(small * 16.0, 255))
    assert common_levels([put(encoded("PNG"))], []) is None


def test_a_damaged_sixteen_bit_file_is_refused(put):
    _, data = cv2.imencode(".png", picture(2, SIZE).astype(np.uint16) << 4)
    assert reason(put(data.tobytes()[:-200])) == "truncated"
    bad = bytearray(data.tobytes())
    bad[-100] ^= 0xFF
    assert reason(put(bytes(bad))) == "damaged"


@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_jpeg_may_be_read_grey_and_reduced(put, mode):
    """Each pixel is the mean of those it stands for."""
    image = Image.fromarray(picture(5, (96, 64))[..., ::-1].copy()).convert(mode)
    path = put(encoded("JPEG", image.resize((384, 256), Image.Resampling.BICUBIC), quality=95), "a.jpg")
    whole, reduced = read_image(path), read_image(path, (384, 256), side_px=90)
    grey = cv2.cvtColor(whole, cv2.COLOR_BGR2GRAY) if whole.ndim == 3 else whole
    assert reduced.shape == (64, 96)
    mean = cv2.resize(grey, (96, 64), interpolation=cv2.INTER_AREA).astype(float)
    assert np.abs(reduced - mean).mean() < 2.0
    assert read_image(path, side_px=400).shape == (256, 384)


def test_other_formats_are_read_whole(put):
    path = put(encoded("PNG"))
    np.testing.assert_array_equal(read_image(path, side_px=10), read_image(path))


def test_truncated_jpeg_is_refused_when_reduced_too(put):
    data = encoded("JPEG", Image.fromarray(picture(5, (96, 64))))
    with pytest.raises(UnreadableImageError, match="truncated"):
        read_image(put(data[: len(data) // 2], "a.jpg"), side_px=24)

"""Which files of a folder are photographs: subfolders, links, copies, unusual names, other kinds."""

import os

import pytest

from slam.core.errors import InputError
from slam.io.flight_folder import read_flight, write_flight
from slam.io.photos.import_photos import import_photos
from tests.slam.io.photos.photo_files import fill, jpeg, strip, warned


def test_subfolders(tmp_path):
    same = {"1/DJI_1.jpg": jpeg(seed=1), "2/DJI_1.jpg": jpeg(seed=2), "2/DJI_2.jpg": jpeg(seed=3)}
    flight = import_photos(fill(tmp_path / "deep", same))
    assert flight.frames.names == ("1_DJI_1.jpg", "2_DJI_1.jpg", "DJI_2.jpg")
    assert warned(flight, "subfolders")
    flight = import_photos(fill(tmp_path / "both", same | {"top.jpg": jpeg()}))
    assert flight.frames.names == ("1_DJI_1.jpg", "2_DJI_1.jpg", "DJI_2.jpg", "top.jpg")
    assert warned(flight, "3 of 4 photographs are in subfolders")


def test_a_stray_photograph_hides_no_subfolder(tmp_path):
    files = {f"100MEDIA/{name}": data for name, data in strip(3).items()}
    flight = import_photos(fill(tmp_path, files | {"selfie.jpg": jpeg(model="Phone")}))
    assert flight.frames.names == ("P0.jpg", "P1.jpg", "P2.jpg")
    assert warned(flight, "1 of 4 photographs left out: another camera", "selfie.jpg")


def test_copies_and_outputs_are_no_photographs(tmp_path):
    files = {f"best/{name}": data for name, data in strip(2).items()} | strip(3)
    files |= {"map/.slam-output": b"{}", "map/mosaic.png": jpeg(container="PNG")}
    flight = import_photos(fill(tmp_path, files))
    assert len(flight.frames) == 3
    assert warned(flight, "2 of 5 photographs left out: the same file as another")


def test_links_that_leave_the_folder_are_not_read(tmp_path):
    other = fill(tmp_path / "other", strip(2))
    folder = fill(tmp_path / "photos", {"a.jpg": jpeg()})
    (folder / "out.jpg").symlink_to(other / "P0.jpg")
    (folder / "inside.jpg").symlink_to("a.jpg")
    (folder / "folder").symlink_to(other, target_is_directory=True)
    flight = import_photos(folder)
    assert flight.frames.names == ("a.jpg",)
    assert warned(flight, "a link that leads out of the folder", "(out.jpg)")
    assert warned(flight, "the same file as another photograph", "(inside.jpg)")
    assert warned(flight, "1 link to a folder is not followed", "(folder)")
    (tmp_path / "link").symlink_to(folder, target_is_directory=True)
    assert import_photos(tmp_path / "link").frames.names == ("a.jpg",)


def test_a_folder_with_nothing_but_a_link_to_photographs(tmp_path):
    other = fill(tmp_path / "other", strip(2))
    folder = fill(tmp_path / "photos", {"notes.txt": b""})
    (folder / "DCIM").symlink_to(other, target_is_directory=True)
    with pytest.raises(InputError, match=r"only links to folders, which are not followed \(DCIM\)"):
        import_photos(folder)


@pytest.mark.parametrize(
    ("head", "kind"),
    [
        (b"\0\0\0\x18ftypheic", "a HEIC picture"),
        (b"RIFFxxxxWEBP", "a WebP picture"),
        (b"II+\0", "a BigTIFF picture"),
    ],
)
def test_a_picture_of_another_kind_than_its_name_says_is_named(tmp_path, head, kind):
    flight = import_photos(fill(tmp_path, strip(2) | {"x.jpg": head + bytes(99)}))
    assert warned(flight, f"1 of 3 photographs left out: {kind}", "convert it to JPEG", "(x.jpg)")


def test_a_name_that_is_not_utf_8_is_shown_with_escapes(tmp_path):
    path = os.fsencode(fill(tmp_path / "in", {"b.jpg": jpeg(seed=1)})) + b"/caf\xe9.jpg"
    with open(path, "wb") as file:
        file.write(jpeg())
    flight = import_photos(tmp_path / "in")
    assert flight.frames.names == ("b.jpg", "caf\\xe9.jpg")
    assert flight.frames.load(1) is not None
    write_flight(flight, tmp_path / "out")
    assert len(read_flight(tmp_path / "out").frames) == 2


@pytest.mark.parametrize(
    ("name", "do"),
    [
        ("a.HEIC", "convert them to JPEG"),
        ("a.bmp", "convert them to JPEG"),
        ("a.dng", "develop them to JPEG or TIFF"),
        ("a.GPR", "develop them to JPEG or TIFF"),
    ],
)
def test_kinds_that_are_not_read_are_named(tmp_path, name, do):
    with pytest.raises(InputError, match=rf"are not read \(1 {name[2:].upper()}\); {do}"):
        import_photos(fill(tmp_path, {name: b"x"}))
    flight = import_photos(fill(tmp_path, strip(2)))
    assert warned(flight, f"1 of 3 photographs left out: {name[2:].upper()} pictures are not read; {do}")

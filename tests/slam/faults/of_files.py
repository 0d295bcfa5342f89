"""Faults 1 to 27: files that are missing, damaged, of another kind, too large or hostile."""

from __future__ import annotations

import io
import json
import re
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from typer.testing import CliRunner

from slam.cli import app
from tests.slam.faults.damages import (
    also,
    column,
    data,
    file,
    flipped,
    folder_for_file,
    key,
    linked,
    pictures,
    pipe,
    png_bomb,
    rows,
)  # fmt: skip
from tests.slam.faults.fault import Damage, Event, Fault, Sources
from tests.slam.io.photos.photo_files import jpeg

ALIASES = b"a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n"
MAPPED = '"status": "ok", "frames": 13, "keyframes": 1[01]'
HUGE = "rows: 1000000\n  cols: 1000000"
SONAR, CAMERA, IMU = (f"mav0/{name}/data.csv" for name in ("sonar0", "cam0", "imu0"))
YAML = "mav0/imu0/sensor.yaml"
JPEG = jpeg(time="2024:05:06 07:08:04")
TAR = b"../../x".ljust(257, b"\0") + b"ustar"
CUT = JPEG[:-2000] + bytes(2000)
GZIP = b"\x1f\x8b\x08" + bytes(50)
ZIP = b"PK\x03\x04" + bytes(60)
PICKLED = np.array([{}], dtype=object)
ZEROS = np.zeros((1 << 19, 4, 4))
MARKUP = "<script>alert(1)</script>\nnext ../line"


def picture(kind: str, mode: str = "RGB", size: tuple[int, int] = (48, 36), **options: object) -> bytes:
    """A picture file of noise."""
    values = np.random.default_rng(1).integers(0, 255, (size[1], size[0], 4), dtype=np.uint8)
    out = io.BytesIO()
    Image.fromarray(values, "RGBA").convert(mode).save(out, kind, **options)
    return out.getvalue()


def sixteen_bit(_: bytes) -> bytes:
    out = io.BytesIO()
    values = np.random.default_rng(1).integers(0, 4096, (36, 48), dtype=np.uint16)
    Image.fromarray(values).save(out, "PNG")
    return out.getvalue()


def recoded(content: bytes, mode: str = "RGB", orientation: int = 1) -> bytes:
    """The same picture with other pixels, or with a tag that says how it is to be turned."""
    exif, out = Image.Exif(), io.BytesIO()
    exif[0x0112] = orientation
    with Image.open(io.BytesIO(content)) as held:
        held.convert(mode).save(out, "PNG", exif=exif)
    return out.getvalue()


def rgba(content: bytes) -> bytes:
    return recoded(content, "RGBA")


def turned(content: bytes) -> bytes:
    return recoded(content, orientation=6)


def estimate(change: dict[str, np.ndarray]) -> Damage:
    """Replace arrays of the map's estimate."""

    def damage(folder: Path) -> None:
        path = folder / "map" / "estimate.npz"
        with np.load(path) as held:
            arrays = {name: held[name] for name in held.files} | change
        np.savez_compressed(path, **arrays)

    return damage


def hostile_names(sources: Sources, place: Path) -> str:
    """Names with a line break, ../ and HTML: one line each on the terminal, escaped in the report."""
    flight, out = place / "flight", place / "out"
    shutil.copytree(sources["optimize"], flight)
    (flight / "flight.yaml").write_text(f"name: {json.dumps(MARKUP)}\nplace: {json.dumps(MARKUP)}\n")
    before = {path for path in place.iterdir()}
    result = CliRunner().invoke(app, ["optimize", str(flight), "--out", str(out), "--no-mosaic"])
    assert result.exit_code == 0, result.stderr
    assert {path for path in place.iterdir()} - before == {out}
    assert not re.search(r"(?m)^next", result.stdout)
    report = (out / "report.html").read_text()
    assert "<script>alert" not in report
    return report


FLIPPED = pictures(flipped, 4)
SHORT = pictures(lambda b: b[:-99], 4)
FAULTS = (
    Fault(1, "no data.csv", "E", "does not exist", lambda f: (f / IMU).unlink()),
    Fault(1, "no flight", "E", "does not exist", shutil.rmtree),
    Fault(2, "empty data.csv", "E", "is empty", data(SONAR, lambda _: b"")),
    Fault(2, "empty graph", "E", "is empty", file("a.g2o", b"")),
    Fault(3, "a picture as a graph", "E", "is a JPEG picture", file("a.g2o", JPEG)),
    Fault(3, "an archive as a flight", "E", "bag, but is a ZIP archive", file("a.bag", ZIP)),
    Fault(3, "a picture as a stream", "E", "is a PNG picture", data(SONAR, lambda _: picture("PNG"))),
    Fault(3, "a document as sensor.yaml", "E", "is a PDF", data(YAML, lambda _: b"%PDF-1")),
    Fault(3, "a document as a photograph", "W", "a PDF document", also("P2.jpg", b"%PDF-1.4"), "import"),
    Fault(4, "half of a stream", "W", "s are lost", data(SONAR, lambda b: b[: len(b) // 2])),
    Fault(4, "half of the list of pictures", "W", "s are lost", data(CAMERA, lambda b: b[:-260])),
    Fault(5, "last bytes of a picture's name", "W", "cut short", data(CAMERA, lambda b: b[:-3])),
    Fault(5, "last byte of a photograph", "W", "cut short", also("P2.jpg", JPEG[:-1]), "import"),
    Fault(6, "zeroed tail", "W", "zeros", data(IMU, lambda b: b[:-900] + bytes(900))),
    Fault(6, "zeroed tail of a text", "W", "zeros", data("flight.yaml", lambda b: b + bytes(90))),
    Fault(6, "zeroed tail of a photograph", "W", "cut short", also("P2.jpg", CUT), "import"),
    Fault(7, "text in a number", "E", "line 9", rows("sonar0", lambda t: [*t[:7], [t[7][0], "x"], *t[8:]])),
    Fault(7, "a bit of a picture", "W", "unreadable: damaged", FLIPPED, "optimize", is_slow=True),
    Fault(7, "a bit of a header", "E", "line 1", data(SONAR, lambda b: flipped(b, 3))),
    Fault(11, "compressed stream", "E", "is a gzip archive", data(SONAR, lambda _: GZIP)),
    Fault(12, "a pipe for a file", "E", "named pipe", pipe),
    Fault(12, "a folder for a file", "E", "is a folder", folder_for_file),
    Fault(15, "truncated PNG", "W", "unreadable: truncated", SHORT, "optimize", is_slow=True),
    Fault(15, "truncated JPEG", "W", "cut short", also("P2.jpg", JPEG[:-300]), "import"),
    Fault(16, "picture bombs", "E", "40000 x 49000 px, more than", pictures(png_bomb), "optimize"),
    Fault(17, "16-bit pictures", "W", "more than 8 bits", pictures(sixteen_bit)),
    Fault(17, "RGBA pictures", "W", MAPPED, pictures(rgba), "optimize", is_slow=True),
    Fault(18, "orientation in the tags", "W", MAPPED, pictures(turned), "optimize", is_slow=True),
    Fault(19, "another size", "W", "another size", also("P2.jpg", jpeg(size=(32, 24))), "import"),
    Fault(20, "archive with a way upwards", "E", "ZIP", file("a.zip", ZIP + b"../../x"), "import"),
    Fault(21, "tar with a way upwards", "E", "tar", file("a.tar", TAR), "import"),
    Fault(22, "link out of the folder", "E", "leads out", linked),
    Fault(23, "pickled arrays", "E", "estimate.npz", estimate({"frame_names": PICKLED}), "evaluate", "map"),
    Fault(24, "npz bomb", "E", "estimate.npz", estimate({"w_T_b": ZEROS}), "evaluate", "map"),
    Fault(25, "aliases", "E", "aliases", also("flight.yaml", ALIASES)),
    Fault(26, "matrix of a million rows", "E", "4 x 4", key("imu0", r"cols: 4\n  rows: 4", HUGE)),
    Fault(27, "name with ..", "E", "outside data/", column("cam0", 1, lambda _: "../../../x.png")),
    Event(27, "markup in names", "W", "&lt;script&gt;", hostile_names),
)  # fmt: skip

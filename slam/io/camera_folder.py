"""Reading of ``cam0``: intrinsics from ``sensor.yaml``, and pictures of ``data.csv`` read on request."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
from numpy.polynomial.polynomial import polyval

from backend.measurements import LensModel
from backend.wording import counted, either
from frontend.camera import NADIR_B_T_C, Camera
from slam.core.messages import Message, warning
from slam.core.streams import Frames
from slam.io.csv_header import CsvColumn
from slam.io.csv_table import CsvTable
from slam.io.files import brief, check_inside, refusal
from slam.io.images import PictureFiles, common_levels
from slam.io.picture_headers import UnreadableImageError, image_size
from slam.io.sensor_yaml import YamlFile
from slam.io.transparent_pixels import transparent_pixels

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
RADTAN = ("radial-tangential", "radtan", "plumb_bob", "none", "")
EQUIDISTANT = ("equidistant", "fisheye", "kannala_brandt4")
"""Names of the fisheye of OpenCV and Kalibr, with k1 to k4."""
PICTURE_VELOCITY = tuple(
    CsvColumn(f"v_{axis}", "m s^-1", 200.0, optional=True) for axis in ("east", "north", "up")
)
"""Columns of a picture's velocity in ``data.csv``; no vehicle that takes photographs is as fast as the limit.
"""
_MAX_READOUT_S = 0.2
"""Largest readout time of a rolling shutter, as in the catalogue of effects."""
_FOCAL_PER_WIDTH = (0.02, 250.0)
"""Limits of the focal length over the width: 177 to 0.2 degrees of view. Values outside are not those of a
pinhole camera and lead to numerical errors.
"""
SIZES_CHECKED = 32
"""Number of picture headers that are checked on reading. Every picture is checked again when it is loaded."""


def camera_of(sensor: YamlFile, notes: list[Message]) -> Camera:
    """Return the camera. Raises ``InputError`` if the intrinsics are missing or invalid."""
    model = sensor.text("camera_model", "pinhole")
    if model != "pinhole":
        raise sensor.refuse(
            "camera_model", f"is {model}", "only pinhole is known; undistort the pictures first"
        )
    width, height = sensor.numbers("resolution", (2,))
    if min(width, height) < 1 or width % 1 or height % 1:
        raise sensor.refuse(
            "resolution", f"is {width:g} x {height:g}", "write two positive integers: width, height"
        )
    fu, fv, cu, cv = sensor.numbers("intrinsics", (4,))
    if min(fu, fv) <= 0:
        raise sensor.refuse(
            "intrinsics", f"has focal lengths {fu:g}, {fv:g}", "write [fu, fv, cu, cv] in px, all positive"
        )
    if not _FOCAL_PER_WIDTH[0] < fu / width < _FOCAL_PER_WIDTH[1]:
        raise sensor.refuse(
            "intrinsics",
            f"has the focal length {fu:g} for pictures {width:g} px wide",
            "write [fu, fv, cu, cv] in px of these pictures",
        )
    if not (-0.5 * width < cu < 1.5 * width and -0.5 * height < cv < 1.5 * height):
        raise sensor.refuse(
            "intrinsics", f"puts the centre at {cu:g}, {cv:g}", "write [fu, fv, cu, cv] in px"
        )
    if not 0.1 < fu / width < 20 or not 0.5 < fu / fv < 2:
        notes.append(
            warning(
                f"focal lengths {fu:g}, {fv:g} px are unusual for a picture {width:g} px wide",
                "check intrinsics in sensor.yaml",
            )
        )
    if (readout_s := sensor.number("readout", 0.0)) > _MAX_READOUT_S:
        raise sensor.refuse(
            "readout",
            f"is {readout_s:g} s from the first row to the last",
            f"write seconds, {_MAX_READOUT_S:g} at most",
        )
    if not sensor.has("T_BS"):
        notes.append(
            warning(
                "sensor.yaml has no T_BS: a down-looking camera with the nose at the top is assumed",
                "add T_BS if it is mounted otherwise",
            )
        )
    lens, distortion = _lens(sensor)
    corner = math.hypot(max(cu, width - 1 - cu) / fu, max(cv, height - 1 - cv) / fv)
    if (share := _valid_share(lens, distortion, corner)) < 0.5:
        raise sensor.refuse(
            "distortion_coefficients",
            f"are only valid over {100 * share:.0f} % of the way from centre to corner; beyond, the "
            "picture folds back on itself",
            "calibrate again, or write zeros",
        )
    if share < 1:
        notes.append(
            warning(
                f"distortion_coefficients are valid over {100 * share:.0f} % of the way from centre to "
                "corner, not beyond",
                "calibrate again with a target that reaches the corners",
            )
        )
    return Camera(
        focal_px=(fu, fv),
        center_px=(cu, cv),
        size_px=(int(width), int(height)),
        distortion=distortion,
        b_T_c=sensor.transform() if sensor.has("T_BS") else NADIR_B_T_C.copy(),
        focal_std_ratio=sensor.std("focal_std_ratio", 0.0, 1.0),
        aspect_std_ratio=sensor.std("aspect_std_ratio", 0.0, 1.0),
        center_std_px=sensor.std("center_std", 0.0, max(width, height)),
        radial_std=sensor.std("radial_std", 0.0, 1.0),
        tangential_std=sensor.std("tangential_std", 0.0, 1.0),
        mount_std_rad=sensor.std("mount_std", 0.0, math.pi) if sensor.has("mount_std") else None,
        readout_s=readout_s,
        lens=lens,
    )


def _lens(sensor: YamlFile) -> tuple[LensModel, tuple[float, ...]]:
    """Return the lens model and its coefficients."""
    model = sensor.text("distortion_model", "")
    if model.lower() in EQUIDISTANT:
        return "equidistant", _coefficients(sensor, (4,), "k1, k2, k3, k4")
    if model.lower() not in RADTAN:
        raise sensor.refuse(
            "distortion_model",
            f"is {brief(model, 40)}",
            "radial-tangential and equidistant are known; undistort first",
        )
    if not sensor.has("distortion_coefficients"):
        if model.lower() in ("none", ""):
            return "brown", (0.0, 0.0, 0.0, 0.0)
        raise refusal(
            sensor.path, "has no distortion_coefficients", "add [k1, k2, p1, p2], zeros where it has none"
        )
    return "brown", _coefficients(sensor, (4, 5), "k1, k2, p1, p2[, k3]")


def _coefficients(sensor: YamlFile, counts: tuple[int, ...], names: str) -> tuple[float, ...]:
    coefficients = sensor.numbers("distortion_coefficients", counts)
    if max(map(abs, coefficients)) > 100:
        raise sensor.refuse("distortion_coefficients", "are beyond 100", f"write OpenCV's {names}")
    return coefficients


def _valid_share(lens: LensModel, distortion: tuple[float, ...], corner: float) -> float:
    """Return the radius up to which OpenCV's polynomial is monotonic, as a share of the corner's radius.

    That of a fisheye is one of the angle, of less than 180 degrees.
    """
    if lens == "equidistant":
        radius, terms = np.linspace(0.0, np.pi, 4000), distortion
    else:
        k1, k2, _, _, *k3 = distortion
        radius, terms = np.linspace(0.0, 4.0 * max(corner, 1.0), 4000), (k1, k2, *k3)
    distorted = radius * polyval(radius**2, [1.0, *terms])
    decreasing = np.flatnonzero(np.diff(distorted) <= 0)
    return 1.0 if not len(decreasing) else min(1.0, float(distorted[decreasing[0]]) / corner)


def frames_of(
    table: CsvTable, camera: Camera, epoch_ns: int, root: Path, notes: list[Message]
) -> Frames | None:
    """Return the pictures that ``data.csv`` lists, or None if it lists none. Raises ``InputError``."""
    folder = table.path.parent / "data"
    if not len(table.stamps_ns):
        return None
    paths = tuple(folder / name for name in table.names)
    entries = _entries(folder, root)
    missing = 0
    for path, name, line in zip(paths, table.names, table.lines, strict=True):
        if entries.get(name) is not False:  # an absent file, a link, or a name with folders in it
            _check_name(path, name, table.path, int(line), folder, root)
            missing += not path.is_file()
    if missing == len(paths):
        raise refusal(
            folder, f"holds none of the {len(paths)} pictures that data.csv lists", "copy them there"
        )
    if missing:
        notes.append(
            warning(
                f"{missing} of {len(paths)} pictures {either(missing, 'is', 'are')} missing in data/",
                "copy them there, or ground may be missing on the map",
            )
        )
    unlisted = len(set(entries) - set(table.names))
    if unlisted:
        notes.append(
            warning(
                f"{counted(unlisted, 'file')} in data/ {either(unlisted, 'is', 'are')} not listed in "
                "data.csv",
                "add a line for each that the map shall use",
            )
        )
    _check_sizes(paths, camera, notes)
    notes += transparent_pixels(paths)
    stamps_s = ((table.stamps_ns - epoch_ns) * 1e-9).astype(float)
    files = PictureFiles(paths, camera.size_px, common_levels(paths, notes))
    velocity = table.values if np.isfinite(table.values).any() else None
    return Frames(stamps_s, table.names, files, files.failures, velocity)


def _entries(folder: Path, root: Path) -> dict[str, bool]:
    """Return a map of the pictures in the folder to whether each is a symbolic link."""
    check_inside(folder, root)
    try:
        with os.scandir(folder) as entries:
            return {e.name: e.is_symlink() for e in entries if e.name.lower().endswith(PICTURES)}
    except FileNotFoundError:
        raise refusal(folder, "does not exist", "put the pictures there") from None
    except OSError as error:
        raise refusal(folder, f"cannot be read ({error.strerror})", "check its permissions") from None


def _check_name(path: Path, name: str, table: Path, line: int, folder: Path, root: Path) -> None:
    if "\0" in name or max(map(len, name.split("/"))) > 200 or len(name) > 1000:
        raise refusal(table, f"names the picture {name[:40]!r}", "repair or remove the line", line)
    if not os.path.normpath(path).startswith(os.path.join(folder, "")):
        raise refusal(table, f"names the picture {name[:80]!r} outside data/", "copy it into data/", line)
    check_inside(path, root)


def _check_sizes(paths: tuple[Path, ...], camera: Camera, notes: list[Message]) -> None:
    """Refuse ``resolution`` if no picture has it. Note pictures of another size, which are left out when
    loaded.
    """
    chosen = [paths[k] for k in np.unique(np.linspace(0, len(paths) - 1, SIZES_CHECKED).astype(int))]
    other: dict[tuple[int, int], Path] = {}
    matching = 0
    for path in chosen:
        try:
            size = image_size(path)
        except UnreadableImageError:
            continue  # it is counted when it is loaded
        if size == camera.size_px:
            matching += 1
        else:
            other.setdefault(size, path)
    if not other:
        return
    (width, height), path = next(iter(other.items()))
    w, h = camera.size_px
    what = f"is {width} x {height} px but sensor.yaml gives {w} x {h}"
    if matching == 0:
        raise refusal(path, what, "correct resolution and intrinsics in cam0/sensor.yaml")
    notes.append(
        warning(
            f"pictures change their size: {path.name} {what}", "those are left out", "record with one size"
        )
    )

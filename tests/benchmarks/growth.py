"""Made surveys of 400, 1600 and 6400 photographs: how processor time and peak memory grow.

Each survey is rendered into a folder of JPEG files by a process of its own, and mapped by another one: from
the files to the map and its mosaic. ``python -m tests.benchmarks.growth 25 100`` prints the figures of other
sizes, which are square numbers.
"""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL.ExifTags import Base

from slam.core.geodesy import enu_from_geodetic, geodetic_from_enu
from slam.core.stage_timer import Stopwatch
from slam.io.photos.import_photos import import_photos
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from tests.benchmarks.apart import peak_mb, run_apart, timed
from tests.benchmarks.metric import Metric, at_most, reported, rms_length
from tests.benchmarks.processor_time import stages_by_processor
from tests.slam.io.photos.photo_files import jpeg
from tests.slam.photo_survey import ORIGIN, poses

Array = NDArray[np.float64]

_ME = "tests.benchmarks.growth"

SIZES = (400, 1600, 6400)
WARM = 100
"""Photographs that are mapped first, so that compilation and imports are in no stage's time."""
MOST_EXPONENT, MOST_MEMORY = 1.1, 1.5
SIZE_PX, FOCAL_35MM = (500, 375), 35
FOCAL_PX = FOCAL_35MM * math.hypot(*SIZE_PX) / math.hypot(36, 24)
GPS_STD_M = 1.0
INTERVAL_S = 2
OCTAVES_M = (5.0, 1.0, 0.25, 0.07)
"""Sizes of the blots of the ground; the smallest are those of a pixel."""
BLOTS = 512
"""Number of blots after which an octave repeats. Each repeats elsewhere, so that no two places look alike."""
PADDED = 2
"""Blots that cubic interpolation reads beyond a place."""
TRUTH = "truth.npy"


@dataclass(frozen=True)
class Survey:
    """One survey, mapped."""

    photographs: int
    placed: int
    pairs: int
    """Registered pairs of photographs."""
    error_m: float
    """RMS of the positions against the true ones, nothing aligned."""
    cpu_s: dict[str, float]
    """Processor time of each stage."""
    map_mb: float
    """Peak memory until the map was complete."""
    mosaic_mb: float
    """Peak memory until the mosaic was complete."""
    wall_s: float


def measure(sizes: Sequence[int] = SIZES) -> list[Metric]:
    """Return the figures of surveys of some sizes."""
    surveys = []
    for size in sizes:
        with tempfile.TemporaryDirectory() as scratch:
            folder, warm = Path(scratch) / "survey", Path(scratch) / "warm"
            run_apart(_ME, "render", size, folder)
            run_apart(_ME, "render", WARM, warm)
            surveys.append(Survey(**run_apart(_ME, "map", folder, warm)))
    return figures(surveys)


def figures(surveys: Sequence[Survey]) -> list[Metric]:
    """Return the growth from each survey to the next, and what else is to know of them."""
    small, large = surveys[0], surveys[-1]
    sizes = f"{', '.join(str(s.photographs) for s in surveys)} photographs"
    stages = [*large.cpu_s]
    whole = [sum(s.cpu_s.values()) for s in surveys]
    grown = {stage: [s.cpu_s[stage] for s in surveys] for stage in stages} | {"all stages": whole}
    counts = [s.photographs for s in surveys]
    return [
        *(exponent(stage, counts, seconds) for stage, seconds in grown.items()),
        *(
            at_most(
                f"peak memory, {what} mosaic, {large.photographs} over {small.photographs} photographs",
                values[-1] / values[0], "x", MOST_MEMORY, f"{_listed(values, '.0f')} MB",
            )
            for what, values in (
                ("without", [s.map_mb for s in surveys]), ("with", [s.mosaic_mb for s in surveys]),
            )
        ),
        reported("time of the largest", large.wall_s, "s", f"{whole[-1]:.0f} s of processor time"),
        reported("photographs placed of the largest", large.placed, f"of {large.photographs}"),
        reported(
            "position error of the largest, nothing aligned", large.error_m, "m",
            f"{_listed([s.error_m for s in surveys], '.3f')} m of {sizes}; GPS of {GPS_STD_M:g} m",
        ),
        reported(
            "registered pairs a photograph, the largest", large.pairs / large.photographs, "",
            f"{_listed([s.pairs / s.photographs for s in surveys], '.2f')} of {sizes}",
        ),
    ]  # fmt: skip


def exponent(stage: str, counts: Sequence[int], seconds: Sequence[float]) -> Metric:
    """Return the largest exponent of the processor time of a stage from one size to the next."""
    found = np.diff(np.log(seconds)) / np.diff(np.log(counts))
    source = f"{_listed(found, '.2f')} from size to size; {_listed(seconds, '.3g')} s"
    return at_most(f"{stage}: largest exponent of processor time", max(found), "", MOST_EXPONENT, source)


def _listed(values: Sequence[float], form: str) -> str:
    return ", ".join(format(value, form) for value in values)


def render(count: int, folder: Path) -> None:
    """Write a survey's photographs, with the tags of a camera, and the true positions beside them."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    side = math.isqrt(count)
    w_T_c = poses(side, side, rng)
    fixes_m = w_T_c[:, :3, 3] + rng.normal(0, GPS_STD_M, (count, 3))
    fixes = np.column_stack(geodetic_from_enu(fixes_m, ORIGIN)).tolist()
    octaves = [
        np.pad(rng.normal(0, 1, (BLOTS, BLOTS)), PADDED, mode="wrap").astype(np.float32) for _ in OCTAVES_M
    ]

    def write(k: int) -> None:
        level = np.clip(128 + 30 * ground_in(w_T_c[k], octaves), 0, 255)
        latitude, longitude, altitude_m = fixes[k]
        taken = datetime(2026, 5, 6) + timedelta(seconds=INTERVAL_S * k)
        content = jpeg(
            pixels=np.dstack([level, 0.9 * level, 0.8 * level]).astype(np.uint8),
            place=(latitude, longitude),
            altitude=altitude_m,
            time=f"{taken:%Y:%m:%d %H:%M:%S}",
            tags={Base.FocalLengthIn35mmFilm: FOCAL_35MM},
        )
        (folder / f"{k:05}.jpg").write_bytes(content)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(write, range(count)))
    np.save(folder / TRUTH, w_T_c[:, :3, 3])


def ground_in(w_T_c: Array, octaves: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Return the blots of the ground in a picture, whose sizes are those of ``OCTAVES_M``."""
    (width, height), center = SIZE_PX, (np.array(SIZE_PX) - 1) / 2
    x, y = np.meshgrid((np.arange(width) - center[0]) / FOCAL_PX, (np.arange(height) - center[1]) / FOCAL_PX)
    east, north, up = (r[0] * x + r[1] * y + r[2] for r in w_T_c[:3, :3])
    east, north = (w_T_c[axis, 3] - w_T_c[2, 3] * ray / up for axis, ray in enumerate((east, north)))
    total = np.zeros((height, width), np.float32)
    for number, (octave, blot_m) in enumerate(zip(octaves, OCTAVES_M, strict=True)):
        a, b = np.cos(number) / blot_m, np.sin(number) / blot_m
        cells = (np.mod(place, BLOTS) + PADDED for place in (a * east - b * north, b * east + a * north))
        total += cv2.remap(octave, *(cell.astype(np.float32) for cell in cells), cv2.INTER_CUBIC)
    return total


def mapped(folder: Path, warm: Path) -> Survey:
    """Map a survey in this process, after a small one."""
    with stages_by_processor():
        _mapped(warm)
        return _mapped(folder)


def _mapped(folder: Path) -> Survey:
    timer = Stopwatch()
    with timed() as took:
        with timer("import"):
            flight = import_photos(folder)
        estimate = optimize(flight)
        map_mb = peak_mb()
        with timer("mosaic"), tempfile.TemporaryDirectory() as scratch:
            write_mosaic(estimate, flight, scratch)
    stages = {"import": timer.seconds["import"], **estimate.timing_s, "mosaic": timer.seconds["mosaic"]}
    truth_m = np.load(folder / TRUTH)
    placed = np.flatnonzero(estimate.placed)
    assert estimate.origin is not None
    assert flight.frames is not None
    off_m = np.array(enu_from_geodetic(*geodetic_from_enu(estimate.w_T_b[:, :3, 3], estimate.origin), ORIGIN))
    off_m = (off_m - truth_m[[int(Path(name).stem) for name in estimate.frame_names]])[placed]
    return Survey(
        photographs=len(flight.frames),
        placed=len(placed),
        pairs=len(estimate.relative_poses),
        error_m=rms_length(off_m),
        cpu_s=stages,
        map_mb=map_mb,
        mosaic_mb=took[0].peak_mb,
        wall_s=took[0].seconds,
    )


def main(*arguments: str) -> None:
    """Run one process, or the surveys of other sizes."""
    if arguments[0] == "render":
        render(int(arguments[1]), Path(arguments[2]))
        print(json.dumps(None))
    elif arguments[0] == "map":
        print(json.dumps(asdict(mapped(Path(arguments[1]), Path(arguments[2])))))
    else:
        for metric in measure([int(size) for size in arguments]):
            print(metric)


if __name__ == "__main__":
    main(*sys.argv[1:])

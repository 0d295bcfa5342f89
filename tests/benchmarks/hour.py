"""An hour of video, 30 pictures of 320x240 a second: processor time and peak memory of the whole map.

The camera flies line after line over a hall, at the height and speed of the figure eight. Half of the view
of each line is also in the next one. The video of the benchmark of imports cannot serve: it repeats one
minute. A tenth of the hour stands beside it. ``python -m tests.benchmarks.hour 1 6`` prints the figures of
other minutes.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from slam.cli.source import import_source
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.core.streams import AttitudeSeries, Sonar, Truth
from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from tests.benchmarks.apart import run_apart, timed
from tests.benchmarks.metric import Metric, at_most, reported
from tests.benchmarks.processor_time import stages_by_processor

Array = NDArray[np.float64]

_ME = "tests.benchmarks.hour"

HOUR_MIN = 60.0
MINUTES = (6.0, HOUR_MIN)
WARM_MIN = 1.0
"""A piece that is mapped first, so that no kernel is compiled in the measured time."""
MOST_MIN, MOST_MB = 20.0, 1500.0
SIZE_PX, FOCAL_PX, RATE_HZ = (320, 240), 256.0, 30
HEIGHT_M, CRUISE_M_S = 0.8, 0.513
"""Those of the figure eight, as are the camera's view and the noise of pictures and instruments."""
NOISE_STD, RANGE_STD_M, ATTITUDE_STD_RAD = 2.0, 0.01, math.radians(0.5)
SONAR_HZ, ATTITUDE_HZ = 25, 50
PX_M = FOCAL_PX / HEIGHT_M
"""Pixels of the floor a metre: as many as in the pictures."""
ASIDE_M = 0.5 * SIZE_PX[0] / PX_M
MARGIN_M = 1.0
BLOTS_M = (0.6, 0.12, 0.03, 0.008)
"""Sizes of the blots of the floor."""
SMOOTH_S = 0.3
"""The vehicle takes about so long to turn from a line into the next one."""
SWAY_RAD, SWAY_S = 0.02, 4.0


@dataclass(frozen=True)
class Piece:
    """Some minutes of video, mapped."""

    minutes: float
    pictures: int
    keyframes: int
    placed: int
    error_m: float
    cpu_s: dict[str, float]
    """Processor time of each stage."""
    whole_s: float
    """Processor time from the file to the map."""
    mosaic_s: float
    """Processor time of the mosaic."""
    map_mb: float
    """Peak memory until the map was complete."""
    mosaic_mb: float
    wall_s: float
    """Time from the file to the map."""


def measure(minutes: Sequence[float] = MINUTES) -> list[Metric]:
    """Map pieces of some minutes, each in a process of its own."""
    pieces = []
    for each in (WARM_MIN, *minutes):
        with tempfile.TemporaryDirectory() as scratch:
            video = Path(scratch) / "flight.mp4"
            run_apart(_ME, "film", video, each)
            pieces.append(Piece(**run_apart(_ME, "map", video, each)))
    return figures(pieces[1:])


def figures(pieces: Sequence[Piece]) -> list[Metric]:
    """Return the figures of the longest piece, and its growth from the shortest one."""
    short, long = pieces[0], pieces[-1]
    factor = math.log(long.minutes / short.minutes)
    how = "measured" if long.minutes == HOUR_MIN else f"{long.minutes:g} minutes, in proportion to an hour"
    stages = ", ".join(
        f"{stage} {seconds:.0f} s ({math.log(seconds / short.cpu_s[stage]) / factor:.2f})"
        for stage, seconds in long.cpu_s.items()
    )
    return [
        at_most(
            "processor time of the map of an hour", long.whole_s / 60 * HOUR_MIN / long.minutes, "min",
            MOST_MIN, f"{how}; {long.keyframes} keyframes of {long.pictures} pictures",
        ),
        at_most(f"peak memory of {long.minutes:g} minutes", long.map_mb, "MB", MOST_MB, "without mosaic"),
        reported("the same, with mosaic", long.mosaic_mb, "MB", f"{long.mosaic_s:.0f} CPU s for the mosaic"),
        reported(
            f"exponent of its processor time from {short.minutes:g} minutes",
            math.log(long.whole_s / short.whole_s) / factor, "", f"and of each stage: {stages}",
        ),
        reported(
            f"peak memory, {long.minutes:g} minutes over {short.minutes:g}", long.map_mb / short.map_mb, "x",
            f"{long.map_mb:.0f} over {short.map_mb:.0f} MB",
        ),
        reported("pictures a second, from the file to the map", long.pictures / long.wall_s, ""),
        reported("keyframes placed", long.placed, f"of {long.keyframes}"),
        reported("position error (ATE)", long.error_m, "m", f"of a path of {path_m(long.minutes):.0f} m"),
    ]  # fmt: skip


def path_m(minutes: float) -> float:
    """Return the length of the path."""
    return 60 * minutes * CRUISE_M_S


def side_m(minutes: float) -> float:
    """Return the side of the square that the lines fill."""
    return math.sqrt(path_m(minutes) * ASIDE_M)


def poses(minutes: float) -> Array:
    """Return the poses (n, 4, 4) of the body at the pictures, along lines to and fro."""
    count, side = round(60 * minutes * RATE_HZ), side_m(minutes)
    line, along = np.divmod(np.arange(count) / RATE_HZ * CRUISE_M_S, side + ASIDE_M)
    to = np.where(line % 2 == 0, np.minimum(along, side), side - np.minimum(along, side))
    xy = np.column_stack([to, ASIDE_M * (line + np.maximum(along - side, 0) / ASIDE_M)])
    xy = gaussian_filter1d(xy, SMOOTH_S * RATE_HZ, axis=0, mode="nearest")
    phase = 2 * np.pi * np.arange(count) / RATE_HZ / SWAY_S
    angles = SWAY_RAD * np.column_stack([np.sin(phase / 3), np.sin(phase), np.sin(0.7 * phase + 1)])
    w_T_b = np.tile(np.eye(4), (count, 1, 1))
    w_T_b[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    w_T_b[:, :3, 3] = np.column_stack([xy, HEIGHT_M * (1 + SWAY_RAD * np.sin(0.4 * phase))])
    return w_T_b


def camera() -> Camera:
    """Return the camera of the figure eight."""
    width, height = SIZE_PX
    return Camera((FOCAL_PX, FOCAL_PX), ((width - 1) / 2, (height - 1) / 2), SIZE_PX)


def film(path: Path, minutes: float) -> None:
    """Write the video of the flight."""
    rng = np.random.default_rng(0)
    side = math.ceil((side_m(minutes) + 2 * MARGIN_M + ASIDE_M) * PX_M)
    floor = np.full((side, side), 128.0, np.float32)
    for blot_m in BLOTS_M:
        cells = math.ceil(side / (blot_m * PX_M))
        blots = rng.normal(0, 30, (cells, cells)).astype(np.float32)
        floor += cv2.resize(blots, (side, side), interpolation=cv2.INTER_CUBIC)
    levels = np.clip(floor, 0, 255, out=floor).astype(np.uint8)
    del floor
    grain = rng.normal(0, NOISE_STD, (4 * SIZE_PX[1], 4 * SIZE_PX[0])).astype(np.float32)
    texel_H_floor = np.array([[PX_M, 0, PX_M * MARGIN_M], [0, PX_M, PX_M * MARGIN_M], [0, 0, 1]])
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), RATE_HZ, SIZE_PX)
    lens = camera()
    for w_T_b in poses(minutes):
        texel_H_pixel = texel_H_floor @ lens.floor_H_image(w_T_b)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        picture = cv2.warpPerspective(levels, texel_H_pixel, SIZE_PX, flags=flags)
        x, y = rng.integers(0, 3 * np.array(SIZE_PX))
        noisy = picture + grain[y : y + SIZE_PX[1], x : x + SIZE_PX[0]]
        writer.write(cv2.cvtColor(np.clip(noisy, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR))
    writer.release()


def flight_of(path: Path, minutes: float) -> Flight:
    """Return the flight of a video, with the instruments of the figure eight."""
    rng = np.random.default_rng(1)
    w_T_b = poses(minutes)
    flight = import_source(path, silent)
    assert flight.frames is not None
    stamps_s = flight.frames.stamps_s
    at, up = stamps_s[0] + np.arange(len(w_T_b)) / RATE_HZ, w_T_b[:, 2, 2]
    sonar_s, attitude_s = (np.arange(at[0], at[-1], 1 / rate) for rate in (SONAR_HZ, ATTITUDE_HZ))
    slant_m = np.interp(sonar_s, at, w_T_b[:, 2, 3] / up) + rng.normal(0, RANGE_STD_M, len(sonar_s))
    yaw_pitch_roll = Rotation.from_matrix(w_T_b[:, :3, :3]).as_euler("ZYX")
    angles = np.column_stack([np.interp(attitude_s, at, angle) for angle in yaw_pitch_roll.T[::-1]])
    angles += rng.normal(0, ATTITUDE_STD_RAD, angles.shape)
    return replace(
        flight,
        camera=camera(),
        sonar=Sonar(sonar_s, slant_m, RANGE_STD_M),
        attitude=AttitudeSeries(attitude_s, angles, (ATTITUDE_STD_RAD,) * 3),
        truth=Truth(at, w_T_b, np.gradient(w_T_b[:, :3, 3], 1 / RATE_HZ, axis=0)),
    )


def mapped(path: Path, minutes: float) -> Piece:
    """Map a video in this process."""
    with timed() as mapping, stages_by_processor():
        flight = flight_of(path, minutes)
        estimate = optimize(flight)
    with timed() as drawing, tempfile.TemporaryDirectory() as scratch:
        write_mosaic(estimate, flight, scratch)
    assert flight.frames is not None
    return Piece(
        minutes,
        pictures=len(flight.frames),
        keyframes=len(estimate.stamps_s),
        placed=int(estimate.placed.sum()),
        error_m=evaluate(estimate, flight).ate_m.rmse,
        cpu_s=estimate.timing_s,
        whole_s=mapping[0].cpu_s,
        mosaic_s=drawing[0].cpu_s,
        map_mb=mapping[0].peak_mb,
        mosaic_mb=drawing[0].peak_mb,
        wall_s=mapping[0].seconds,
    )


def main(work: str, *arguments: str) -> None:
    """Run one process, or pieces of other minutes."""
    if work == "film":
        film(Path(arguments[0]), float(arguments[1]))
        print(json.dumps(None))
    elif work == "map":
        print(json.dumps(asdict(mapped(Path(arguments[0]), float(arguments[1])))))
    else:
        for metric in measure([float(work), *map(float, arguments)]):
            print(metric)


if __name__ == "__main__":
    main(*sys.argv[1:])

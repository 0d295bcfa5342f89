"""An hour of video at 1920 x 1080: import into a flight folder beside decoding alone.

A minute of a made pan over textured ground is encoded once, and its packets are repeated for the hour. Each
run has a process of its own. The peak memory of a minute stands beside that of the hour.
"""

from __future__ import annotations

import json
import struct
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np

from slam.cli import app
from slam.io.recordings.video.mp4 import read_tracks
from tests.benchmarks.apart import Took, run_apart, timed
from tests.benchmarks.metric import Metric, at_least, at_most, reported
from tests.slam.io.recordings.video.made_video import box, full, replaced, table

_ME = "tests.benchmarks.video_import"
SIZE_PX, RATE_HZ, MINUTE_S, HOUR_S = (1920, 1080), 30, 60, 3600
GROUP = 12
"""A picture that is coded whole comes each 12th time (FFmpeg's default)."""
WIDTH_PX, SOME_HZ = 640, 10
"""Width and rate of the pictures that are taken: the front end tracks smaller ones still."""


def measure() -> list[Metric]:
    """Return memory, speed and ratio to decoding alone, of an hour and of all pictures of a minute."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        minute = pan(folder / "minute.mp4", MINUTE_S)
        hour = repeated(minute, folder / "hour.mp4", HOUR_S // MINUTE_S)
        some = ("--width", WIDTH_PX, "--picture-rate", SOME_HZ)
        short, long = (
            Took(**run_apart(_ME, "import", video, folder / f"{video.stem}-some", *some))
            for video in (minute, hour)
        )
        bare = Took(**run_apart(_ME, "decode", hour))
        bare_minute = Took(**run_apart(_ME, "decode", minute))
        reduced = Took(**run_apart(_ME, "import", minute, folder / "reduced", "--width", WIDTH_PX))
        whole = Took(**run_apart(_ME, "import", minute, folder / "whole"))
    taken = f"{SOME_HZ} pictures a second, {WIDTH_PX} px"
    return [
        at_most(
            f"peak memory of an hour, {taken}", long.peak_mb, "MB", 400, f"a minute: {short.peak_mb:.0f} MB"
        ),
        at_least(f"speed, {taken}, over the video's own", HOUR_S / long.seconds, "x", 5, _said(long)),
        at_most(f"CPU, {taken}, over decoding alone", long.cpu_s / bare.cpu_s, "x", 1.3, _said(bare)),
        reported(
            f"CPU, all pictures, {WIDTH_PX} px, over decoding alone", reduced.cpu_s / bare_minute.cpu_s, "x"
        ),
        reported("CPU, all pictures, whole, over decoding alone", whole.cpu_s / bare_minute.cpu_s, "x"),
    ]


def _said(took: Took) -> str:
    return f"{took.seconds:.0f} s, {took.cpu_s:.0f} CPU s"


def pan(path: Path, seconds: float) -> Path:
    """Write a flight over a textured floor with a whole picture every ``GROUP``."""
    rng = np.random.default_rng(0)
    (width, height), count = SIZE_PX, int(seconds * RATE_HZ)
    floor = np.zeros((height + 400, width + 800, 3), np.uint8)
    for octave in (4, 16, 64):
        rough = rng.integers(0, 85, (floor.shape[0] // octave + 1, floor.shape[1] // octave + 1, 3), np.uint8)
        floor += cv2.resize(rough, floor.shape[1::-1], interpolation=cv2.INTER_CUBIC)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), RATE_HZ, SIZE_PX)
    for k in range(count):
        x, y = (int(side * (0.5 + 0.5 * np.sin(k / period))) for side, period in ((799, 90), (399, 70)))
        writer.write(floor[y : y + height, x : x + width])
    writer.release()
    return path


def repeated(source: Path, path: Path, times: int) -> Path:
    """Write an MP4 file that shows the pictures of another one several times, one behind another."""
    (track,) = read_tracks(source)
    content, count = source.read_bytes(), len(track.sizes)
    sizes = np.tile(track.sizes, times)
    head = box(b"ftyp", b"isom" + bytes(4))
    offsets = len(head) + 16 + np.concatenate([[0], np.cumsum(sizes)[:-1]])
    samples = b"".join(content[at : at + size] for at, size in zip(track.offsets, track.sizes, strict=True))
    keys = 1 + GROUP * np.arange(-(-count // GROUP))
    boxes = {
        b"edts": b"",
        b"stts": table(b"stts", (len(sizes), 1)),
        b"stss": table(b"stss", *((int(key + k * count),) for k in range(times) for key in keys)),
        b"stsc": table(b"stsc", (1, 1, 1)),
        b"stsz": full(b"stsz", struct.pack(f">II{len(sizes)}I", 0, len(sizes), *sizes)),
        b"stco": full(b"co64", struct.pack(f">I{len(sizes)}Q", len(sizes), *offsets)),
        b"mdhd": full(b"mdhd", struct.pack(">IIII", 0, 0, RATE_HZ, len(sizes)) + bytes(4)),
    }
    movie = content[content.index(b"moov") - 4 :]
    for kind, new in boxes.items():
        movie = replaced(movie, kind, new)
    with path.open("wb") as target:
        target.write(head + struct.pack(">I4sQ", 1, b"mdat", 16 + times * len(samples)))
        for _ in range(times):
            target.write(samples)
        target.write(movie)
    return path


def run(work: str, source: str, *options: str) -> Took:
    """Decode or import a video in this process."""
    with timed() as took:
        if work == "decode":
            video = cv2.VideoCapture(source, cv2.CAP_FFMPEG)
            while video.read()[0]:
                pass
        else:
            app(["import", source, "--quiet", "--out", *options], standalone_mode=False)
    return took[0]


if __name__ == "__main__":
    print(json.dumps(asdict(run(*sys.argv[1:]))))

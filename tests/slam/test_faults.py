"""Faults of a recording, each with the outcome that is promised: one line and nothing written, or a warning.

Faults of photographs, graphs, outputs and processes are tested beside the code that meets them.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.io.flight_folder import write_flight
from tests.slam.io.made_flight import made_flight
from tests.slam.small_flight import flown

Damage = Callable[[Path], object]
Rows = list[list[str]]


@dataclass(frozen=True)
class Fault:
    """One way in which a flight folder is broken, and what must come of it."""

    number: int
    """In the list of faults that the project promises to survive."""
    name: str
    outcome: str
    """E or W."""
    said: str
    damage: Damage
    command: str = "info"


def rows(stream: str, change: Callable[[Rows], Rows]) -> Damage:
    def damage(flight: Path) -> None:
        path = flight / "mav0" / stream / "data.csv"
        header, *lines = path.read_text().splitlines()
        changed = change([line.split(",") for line in lines])
        path.write_text("\n".join([header, *map(",".join, changed)]) + "\n")

    return damage


def column(stream: str, at: int, change: Callable[[str], object], every: int = 1) -> Damage:
    def changed(table: Rows) -> Rows:
        return [
            [*r[:at], str(change(r[at])), *r[at + 1 :]] if k % every == every // 2 else r
            for k, r in enumerate(table)
        ]

    return rows(stream, changed)


def data(name: str, change: Callable[[bytes], bytes]) -> Damage:
    def damage(flight: Path) -> None:
        path = flight / "mav0" / name
        path.write_bytes(change(path.read_bytes()))

    return damage


def key(name: str, pattern: str, value: str) -> Damage:
    def damage(flight: Path) -> None:
        path = flight / "mav0" / name / "sensor.yaml"
        text, count = re.subn(pattern, value, path.read_text(), count=1, flags=re.DOTALL)
        assert count
        path.write_text(text)

    return damage


def bent(k1: float) -> Damage:
    return key("cam0", r"coefficients: \[[^]]*\]", f"coefficients: [{k1}, 0, 0, 0]")


def without(stream: str) -> Damage:
    return lambda flight: shutil.rmtree(flight / "mav0" / stream)


def pipe(flight: Path) -> None:
    path = flight / "mav0" / "sonar0" / "data.csv"
    path.unlink()
    os.mkfifo(path)


def linked(flight: Path) -> None:
    outside = shutil.move(flight / "mav0" / "sonar0", flight.parent / "outside")
    (flight / "mav0" / "sonar0").symlink_to(outside)


def bombs(flight: Path) -> None:
    """Pictures that say they are 6 GB."""
    chunk = b"IHDR" + struct.pack(">IIBBBBB", 40_000, 49_000, 8, 2, 0, 0, 0)
    picture = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    for path in (flight / "mav0" / "cam0" / "data").iterdir():
        path.write_bytes(picture)


def later(ns: int) -> Callable[[Rows], Rows]:
    return lambda t: [[str(int(r[0]) + ns * (k >= len(t) // 2)), *r[1:]] for k, r in enumerate(t)]


def at_once(table: Rows) -> Rows:
    return [[table[0][0], *row[1:]] for row in table]


def no_turns(table: Rows) -> Rows:
    return [[*r[:4], *"0000", *r[8:]] if k % 9 == 0 else r for k, r in enumerate(table)]


ALIASES = "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n"
LOUD = "noise_std: [1e300]"
LOOKS_UP = "data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]"
FAULTS = (
    Fault(1, "no data.csv", "E", "does not exist", lambda f: (f / "mav0/imu0/data.csv").unlink()),
    Fault(1, "no flight", "E", "does not exist", shutil.rmtree),
    Fault(2, "empty data.csv", "E", "is empty", data("sonar0/data.csv", lambda _: b"")),
    Fault(4, "half of a stream", "W", "s are lost", data("sonar0/data.csv", lambda b: b[: len(b) // 2])),
    Fault(4, "half of the list of pictures", "W", "s are lost", data("cam0/data.csv", lambda b: b[:-260])),
    Fault(5, "last bytes of a picture's name", "W", "cut short", data("cam0/data.csv", lambda b: b[:-3])),
    Fault(6, "zeroed tail", "W", "zeros", data("imu0/data.csv", lambda b: b[:-900] + bytes(900))),
    Fault(7, "text in a number", "E", "line 9", rows("sonar0", lambda t: [*t[:7], [t[7][0], "x"], *t[8:]])),
    Fault(12, "a pipe for a file", "E", "named pipe", pipe),
    Fault(16, "picture bombs", "E", "40000 x 49000 px, more than", bombs, "optimize"),
    Fault(22, "link out of the folder", "E", "leads out", linked),
    Fault(25, "aliases", "E", "aliases", lambda f: (f / "flight.yaml").write_text(ALIASES)),
    Fault(27, "name with ..", "E", "outside data/", column("cam0", 1, lambda _: "../../../x.png")),
    Fault(28, "NaN stamps", "W", "without a finite stamp", column("imu0", 0, lambda _: "nan", every=50)),
    Fault(29, "repeated rows", "W", "repeated", rows("imu0", lambda t: [*t[:5], *t])),
    Fault(30, "unsorted", "W", "out of order", rows("imu0", lambda t: t[::-1])),
    Fault(31, "clock back", "W", "jumps back by 3", rows("sonar0", later(-3 * 10**9))),
    Fault(32, "clock an hour ahead", "W", "jumps ahead by 3600", rows("sonar0", later(3600 * 10**9))),
    Fault(33, "microseconds", "E", "microseconds", column("imu0", 0, lambda s: int(s) // 1000)),
    Fault(35, "gap", "W", "1 gap", rows("sonar0", lambda t: [*t[:20], *t[-20:]])),
    Fault(36, "no IMU", "W", "no IMU", without("imu0"), "optimize"),
    Fault(36, "attitude upside down", "W", "the sky", column("attitude0", 1, lambda _: 3.0), "optimize"),
    Fault(36, "no attitude", "W", "tilt is not measured", without("attitude0"), "optimize"),
    Fault(37, "no sonar", "W", "no metric scale", without("sonar0"), "optimize"),
    Fault(38, "no camera", "E", "slam estimate", without("cam0"), "optimize"),
    Fault(39, "sonar negative", "W", "zero or less", column("sonar0", 1, lambda _: -1, every=9)),
    Fault(39, "sonar saturated", "W", "no metric scale", column("sonar0", 1, lambda _: 6.0), "optimize"),
    Fault(39, "sonar echoes", "W", "echoes", column("sonar0", 1, lambda r: 2 * float(r or 1), every=9)),
    Fault(39, "sonar in cm", "E", "centimetres", column("sonar0", 1, lambda r: 100 * float(r or 1))),
    Fault(39, "sonar in mm", "E", "millimetres", column("sonar0", 1, lambda r: 1000 * float(r or 1))),
    Fault(39, "sonar of no use", "E", "noise_std", key("sonar0", r"noise_std: \[[^]]*\]", LOUD)),
    Fault(40, "gyro in deg/s", "E", "deg/s", column("imu0", 2, lambda w: 57.3 * float(w))),
    Fault(40, "accelerometer in g", "E", "in g", column("imu0", 6, lambda a: float(a) / 9.81)),
    Fault(40, "gravity upside down", "W", "upside down", column("imu0", 6, lambda a: -float(a))),
    Fault(41, "NaN IMU", "W", "a value is missing", column("imu0", 3, lambda _: "nan", every=10)),
    Fault(42, "all pictures at once", "E", "same stamp|stamp of another", rows("cam0", at_once), "optimize"),
    Fault(43, "zero quaternions", "W", "quaternion", rows("state_groundtruth_estimate0", no_turns)),
    Fault(44, "no intrinsics", "E", "intrinsics", key("cam0", "intrinsics: [^\n]*", "")),
    Fault(44, "camera that looks up", "E", "T_BS", key("cam0", r"data: \[.*?\]", LOOKS_UP), "optimize"),
    Fault(44, "distortion that folds", "E", "fold", bent(-5.0)),
    Fault(44, "distortion short of the corner", "W", "not beyond", bent(-0.8)),
)

results: dict[str, bool] = {}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, Path]:
    """One flight whose streams hold all there is, and one whose pictures make a map."""
    folder = tmp_path_factory.mktemp("whole")
    write_flight(made_flight(), folder / "info")
    small = {"way_points": ["A", "B"], "cruise_m_s": 0.5}
    write_flight(flown(maneuver=small, camera={"rate_hz": 4.0}), folder / "optimize")
    return {name: folder / name for name in ("info", "optimize")}


def told(fault: Fault, whole: Path, place: Path) -> str:
    """What the command says about the fault; raises where it breaks a promise that holds for all faults."""
    flight, out = shutil.copytree(whole, place / "flight"), place / "out"
    fault.damage(flight)
    arguments = ["--out", str(out), "--no-mosaic"] if fault.command == "optimize" else []
    result = CliRunner().invoke(app, [fault.command, str(flight), *arguments])
    if fault.outcome == "E":
        assert result.exit_code == 1, result.output
        assert re.fullmatch(r"([^\n]+\n)*slam: [^\n]+\n", result.stderr), result.stderr
        assert "internal error" not in result.stderr
        assert not out.exists()
        assert not list(place.glob(".*"))
        return result.stderr
    assert result.exit_code == 0, result.stderr
    assert "Error" not in result.stderr
    if fault.command == "optimize":
        return json.dumps(json.loads((out / "summary.json").read_text()))
    return " ".join(result.stdout.split())


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f"{f.number}-{f.name}".replace(" ", "_"))
def test_a_fault_has_the_outcome_that_is_promised(fault, whole, tmp_path):
    results[fault.name] = False
    line = told(fault, whole[fault.command], tmp_path)
    assert re.search(fault.said, line), line
    results[fault.name] = True


def test_the_score():
    good, failed = sum(results.values()), sorted(name for name, ok in results.items() if not ok)
    share = float(np.mean(list(results.values()))) if results else 1.0
    assert share == 1, (
        f"fault score {good}/{len(results)} = {share:.3f}; not as promised: {', '.join(failed)}"
    )

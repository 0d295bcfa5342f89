"""A fault of the input, how it is played, and the promises that hold for all faults."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.io.flight_folder import write_flight
from tests.slam.faults.made_graph import laps
from tests.slam.io.made_flight import made_flight
from tests.slam.io.photos.photo_files import fill, strip
from tests.slam.small_flight import flown

Damage = Callable[[Path], object]
"""Breaks the input at a path. It may return another path, which the command then gets."""


@dataclass(frozen=True)
class Fault:
    """One way in which an input is broken, and what must come of it."""

    number: int
    """In the list of 52 faults that the project promises to survive."""
    name: str
    outcome: str
    """E: one line, exit code 1 and nothing written. W: done, and the summary or the tables say it.
    R: a further run has the result that an undisturbed one has."""
    message: str
    """Regular expression of the message."""
    damage: Damage
    command: str = "info"
    source: str = ""
    """Name of the whole input; empty for the usual one of the command."""
    is_slow: bool = False

    def __str__(self) -> str:
        return f"{self.number}-{self.name}".replace(" ", "_")


@dataclass(frozen=True)
class Event:
    """One way in which a run is disturbed, and what must come of it."""

    number: int
    name: str
    outcome: str
    message: str
    play: Callable[[Sources, Path], str]
    """Disturbs a run in an empty folder and returns the message; it checks the promises itself."""
    is_slow: bool = False

    def __str__(self) -> str:
        return f"{self.number}-{self.name}".replace(" ", "_")


class Sources:
    """The whole inputs, each made when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __getitem__(self, name: str) -> Path:
        path = self._folder / name
        if not path.exists():
            _MADE[name](path)
        return path


def _info(path: Path) -> None:
    write_flight(made_flight(), path)


def _optimize(path: Path) -> None:
    small = {"way_points": ["A", "B"], "cruise_m_s": 0.5}
    write_flight(flown(maneuver=small, camera={"rate_hz": 4.0}), path)


def _photos(path: Path) -> None:
    fill(path, strip(4))


def _graph(path: Path) -> None:
    path.mkdir()
    laps(path / "laps.g2o")


def _map(path: Path) -> None:
    """A flight and its map."""
    _optimize(path / "flight")
    arguments = ["optimize", str(path / "flight"), "--out", str(path / "map"), "--no-mosaic"]
    assert CliRunner().invoke(app, arguments).exit_code == 0


_MADE: dict[str, Damage] = {
    "info": _info, "optimize": _optimize, "estimate": _info, "import": _photos, "graph": _graph, "map": _map,
}  # fmt: skip


def outcome(fault: Fault, sources: Sources, place: Path) -> str:
    """What the command says about the fault; raises where it breaks a promise that holds for all faults."""
    source, out = place / "input", place / "out"
    shutil.copytree(sources[fault.source or fault.command], source)
    given = fault.damage(source)
    arguments = [fault.command, str(given if isinstance(given, Path) else source)]
    if fault.command == "evaluate":
        arguments = ["evaluate", str(source / "map"), "--truth", str(source / "flight")]
    elif fault.command != "info":
        arguments += ["--out", str(out)]
    before = listing(place)
    result = CliRunner().invoke(app, [*arguments, *(["--no-mosaic"] if fault.command == "optimize" else [])])
    if fault.outcome == "E":
        assert_refused(result.exit_code, result.stderr, result.output)
        assert listing(place) == before, "nothing is written"
        return result.stderr
    assert result.exit_code == 0, result.stderr
    assert "Error" not in result.stderr
    if (out / "summary.json").exists():
        return json.dumps(json.loads((out / "summary.json").read_text()), ensure_ascii=False)
    return " ".join(result.stdout.split())


def optimized(source: Path, out: Path) -> str:
    """Map a flight or solve a graph, and return its summary."""
    result = CliRunner().invoke(app, ["optimize", str(source), "--out", str(out), "--no-mosaic"])
    assert result.exit_code == 0, result.stderr
    return json.dumps(json.loads((out / "summary.json").read_text()))


def listing(place: Path) -> list[str]:
    """Every file and folder below a place."""
    return sorted(str(path) for path in place.rglob("*"))


def assert_refused(code: int, stderr: str, output: str = "") -> None:
    """Refused in one line, which is the last one, after those of the progress."""
    assert code == 1, output
    assert re.fullmatch(r"([^\n]+\n)*slam: [^\n]+\n", stderr), stderr
    assert "internal error" not in stderr
    assert "Traceback" not in stderr + output


def parameters(faults: tuple[Fault | Event, ...]) -> list[object]:
    """The faults as parameters of a test, the slow ones marked."""
    marks = {True: (pytest.mark.slow,), False: ()}
    return [pytest.param(fault, id=str(fault), marks=marks[fault.is_slow]) for fault in faults]

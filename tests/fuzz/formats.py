"""The formats that slam reads: a whole input of each, its reader, and what the whole input holds."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from slam.cli.graph import solve_graph
from slam.cli.options import pipeline_config
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.core.streams import STREAMS
from slam.io.estimate import write_estimate
from slam.io.flight_folder import read_flight, write_flight
from slam.io.photos.import_photos import import_photos
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.formats import open_recording
from slam.mapping.config import PipelineConfig
from slam.simulation.model import Model, load_model, save_model
from slam.simulation.recipe import Recipe, load_recipe
from tests.fuzz.photographs import photograph
from tests.fuzz.recordings import RECORDINGS, SECONDS, Recorded, gopro, gopro_positions
from tests.slam.cli.commands import SQUARE
from tests.slam.io.made_flight import made_flight
from tests.slam.io.photos.photo_files import fill
from tests.slam.io.test_damage import check


@dataclass(frozen=True)
class Format:
    """A format: ``make`` writes a whole input and returns the files to mutate, ``read`` reads it."""

    make: Callable[[Path], list[Path]]
    read: Callable[[Path, Path], Any]
    """Gets the folder of the input and the mutated file; returns what was read."""
    holds: Callable[[Any], object]
    """Return figures of what was read."""
    whole: tuple[object, ...]
    """These figures of each file of the whole input."""


SPATIAL = """VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1 0 0 0 0 0 1
VERTEX_SE3:QUAT 2 1 1 0 0 0 0.7071068 0.7071068
FIX 0
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400
EDGE_SE3:QUAT 1 2 0 1 0 0 0 0.7071068 0.7071068 100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400
EDGE_SE3:QUAT 0 2 1 1.1 0 0 0 0.7071068 0.7071068 100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400
"""
CUES = """1
00:00:00,000 --> 00:00:01,000
<font size="28">FrameCnt: 1, DiffTime: 1000ms
2024-05-06 07:08:09.100
[latitude: 47.000001] [longitude: 8.000001] [rel_alt: 10.200 abs_alt: 410.1] [gb_yaw: 1.5]</font>

2
00:00:01,000 --> 00:00:02,000
<font size="28">FrameCnt: 2, DiffTime: 1000ms
2024-05-06 07:08:10.100
[latitude: 47.000011] [longitude: 8.000001] [rel_alt: 10.300 abs_alt: 410.2] [gb_yaw: 1.5]</font>

"""
SCRIPTED = """name = "scripted"
[maneuver]
script = "stick.csv"
start_m = [0.1, 0.1]
[world]
extent_m = [0, 0, 1, 1]
"""


def _checked(flight: Flight) -> Flight:
    """Check a flight and read its pictures."""
    check(flight)
    for k in range(0 if flight.frames is None else len(flight.frames)):
        flight.frames[k].read()
    return flight


def _rows(flight: Flight) -> dict[str, int]:
    """Number of readings of each stream, of landmarks, and of pictures that were read."""
    series = {name: getattr(flight, name) for name in STREAMS}
    rows = {name: len(one.stamps_s) for name, one in series.items() if one is not None}
    if flight.frames is not None:
        rows["frames"] -= len(flight.frames.failures)
    return rows | {"landmarks": len(flight.landmarks)}


def _flight(pattern: str, files: int) -> Format:
    def make(folder: Path) -> list[Path]:
        write_flight(made_flight(seconds=2.0), folder / "flight")
        return sorted((folder / "flight").glob(pattern))

    def read(folder: Path, _: Path) -> Flight:
        return _checked(read_flight(folder / "flight"))

    return Format(make, read, _rows, (_rows(made_flight(seconds=2.0)),) * files)


def _texts(
    suffix: str,
    texts: tuple[str, ...],
    read: Callable[[Path], Any],
    holds: Callable[[Any], object],
    whole: tuple[object, ...],
) -> Format:
    def make(folder: Path) -> list[Path]:
        paths = [folder / f"{k}{suffix}" for k in range(len(texts))]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return paths

    return Format(make, lambda _, path: read(path), holds, whole)


def _solved(path: Path) -> Estimate:
    estimate, _ = solve_graph(path, silent)
    write_estimate(estimate, path.parent)
    return estimate


def _remade(path: Path) -> Model:
    model = load_model(path)
    save_model(model, path.with_suffix(".saved"))
    return model


def _recipes(folder: Path) -> list[Path]:
    paths = [folder / "flown.toml", folder / "scripted.toml", folder / "stick.csv"]
    shipped = files("datasets")
    paths[0].write_text(shipped.joinpath("figure_eight.toml").read_text())
    paths[1].write_text(SCRIPTED)
    paths[2].write_text("0,0,0,0,0\n500,0.2,0,0,0.1\n1500,0,-0.1,0.05,0\n2500,0,0,0,0\n")
    return paths


def _recipe_read(folder: Path, path: Path) -> Recipe:
    return load_recipe(path if path.suffix == ".toml" else folder / "scripted.toml")


def settings_text(config: object, table: str = "") -> str:
    """The settings as TOML, every key with its default."""
    plain, tables = io.StringIO(), io.StringIO()
    for one in fields(config):  # type: ignore[arg-type]
        value, name = getattr(config, one.name), f"{table}.{one.name}".lstrip(".")
        if is_dataclass(value):
            tables.write(f"[{name}]\n{settings_text(value, name)}")
        elif isinstance(value, bool):
            plain.write(f"{one.name} = {str(value).lower()}\n")
        elif isinstance(value, int | float):
            plain.write(f"{one.name} = {value!r}\n")
        elif isinstance(value, str):
            plain.write(f'{one.name} = "{value}"\n')
    return plain.getvalue() + tables.getvalue()


def _photographs(suffix: str, container: str) -> Format:
    def make(folder: Path) -> list[Path]:
        fill(folder, {f"P{k}{suffix}": photograph(container, k) for k in range(2)})
        return [folder / f"P1{suffix}"]

    def read(folder: Path, _: Path) -> Flight:
        return _checked(import_photos(folder, silent))

    return Format(
        make, read, _rows, ({"frames": 2, "attitude": 2, "gps": 2, "barometer": 2, "landmarks": 0},)
    )


def _recording(one: Recorded) -> Format:
    whole = {"landmarks": 0} | one.rows if one.rows else _rows(made_flight(seconds=SECONDS))
    return Format(
        lambda folder: [one.write(folder)], lambda _, path: _checked(one.read(path)), _rows, (whole,)
    )


def _model(name: str) -> str:
    return files("datasets").joinpath(f"models/{name}.toml").read_text()


FORMATS: dict[str, Format] = {
    "flight.yaml": _flight("flight.yaml", 1),
    "sensor.yaml": _flight("mav0/*/sensor.yaml", 11),
    "csv": _flight("mav0/*/data.csv", 11),
    "picture of a flight": _flight("mav0/cam0/data/000.png", 1),
    "landmarks": _flight("landmarks.csv", 1),
    "g2o": _texts(".g2o", (SQUARE, SPATIAL), _solved, lambda found: len(found.stamps_s), (4, 3)),
    "recipe": Format(
        _recipes, _recipe_read, lambda recipe: recipe.name, ("figure_eight", "scripted", "scripted")
    ),
    "model": _texts(
        ".toml", (_model("nominal"), _model("paper")), _remade, lambda model: model.name, ("nominal", "paper")
    ),
    "settings": _texts(
        ".toml",
        (settings_text(PipelineConfig()),),
        lambda path: pipeline_config(path, None),
        lambda settings: settings,
        (PipelineConfig(),),
    ),
    "subtitles": _texts(
        ".srt",
        (CUES,),
        lambda path: _checked(flight_of(open_recording(path))),
        _rows,
        ({"gps": 2, "barometer": 2, "landmarks": 0},),
    ),
    "GoPro positions": Format(
        lambda folder: [gopro(folder)], lambda _, path: gopro_positions(path), lambda count: count, (3,)
    ),
    **{name: _recording(one) for name, one in RECORDINGS.items()},
    "jpeg": _photographs(".jpg", "JPEG"),
    "png": _photographs(".png", "PNG"),
    "tiff": _photographs(".tif", "TIFF"),
}
PICTURES = ("picture of a flight", "video", "jpeg", "png", "tiff")

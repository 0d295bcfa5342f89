"""The formats that slam reads: a whole input of each, and what reads it."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from importlib.resources import files
from pathlib import Path

from slam.cli.graph import solve_graph
from slam.cli.options import pipeline_config
from slam.core.progress import silent
from slam.io.estimate import write_estimate
from slam.io.flight_folder import read_flight, write_flight
from slam.io.photos import import_photos
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.formats import open_recording
from slam.mapping.config import PipelineConfig
from slam.simulation.model import load_model, save_model
from slam.simulation.recipe import load_recipe
from tests.fuzz.photographs import photograph
from tests.slam.cli.test_cli import SQUARE
from tests.slam.io.made_flight import made_flight
from tests.slam.io.photo_files import fill, strip
from tests.slam.io.test_damage import check


@dataclass(frozen=True)
class Format:
    """A format: ``make`` writes a whole input and returns the files to mutate, ``read`` reads it."""

    make: Callable[[Path], list[Path]]
    read: Callable[[Path, Path], object]
    """Gets the folder of the input and the mutated file."""


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


def _flight(pattern: str) -> Format:
    def make(folder: Path) -> list[Path]:
        write_flight(made_flight(seconds=2.0), folder / "flight")
        return sorted((folder / "flight").glob(pattern))

    return Format(make, lambda folder, _: check(read_flight(folder / "flight")))


def _texts(suffix: str, texts: tuple[str, ...], read: Callable[[Path], object]) -> Format:
    def make(folder: Path) -> list[Path]:
        paths = [folder / f"{k}{suffix}" for k in range(len(texts))]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return paths

    return Format(make, lambda _, path: read(path))


def _solved(path: Path) -> None:
    estimate, _ = solve_graph(path, silent)
    write_estimate(estimate, path.parent)


def _remade(path: Path) -> None:
    save_model(load_model(path), path.with_suffix(".saved"))


def _recipes(folder: Path) -> list[Path]:
    paths = [folder / "flown.toml", folder / "scripted.toml", folder / "stick.csv"]
    shipped = files("datasets")
    paths[0].write_text(shipped.joinpath("figure_eight.toml").read_text())
    paths[1].write_text(SCRIPTED)
    paths[2].write_text("0,0,0,0,0\n500,0.2,0,0,0.1\n1500,0,-0.1,0.05,0\n2500,0,0,0,0\n")
    return paths


def _recipe_read(folder: Path, path: Path) -> None:
    load_recipe(path if path.suffix == ".toml" else folder / "scripted.toml")


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
        fill(folder, strip(1) | {f"P9{suffix}": photograph(container)})
        return [folder / f"P9{suffix}"]

    def read(folder: Path, _: Path) -> None:
        flight = import_photos(folder, silent)
        check(flight)
        assert flight.frames is not None
        for k in range(len(flight.frames)):
            flight.frames.load(k)

    return Format(make, read)


def _model(name: str) -> str:
    return files("datasets").joinpath(f"models/{name}.toml").read_text()


FORMATS: dict[str, Format] = {
    "flight.yaml": _flight("flight.yaml"),
    "sensor.yaml": _flight("mav0/*/sensor.yaml"),
    "csv": _flight("mav0/*/data.csv"),
    "picture of a flight": _flight("mav0/cam0/data/000.png"),
    "landmarks": _flight("landmarks.csv"),
    "g2o": _texts(".g2o", (SQUARE, SPATIAL), _solved),
    "recipe": Format(_recipes, _recipe_read),
    "model": _texts(".toml", (_model("nominal"), _model("paper")), _remade),
    "settings": _texts(".toml", (settings_text(PipelineConfig()),), lambda path: pipeline_config(path, None)),
    "subtitles": _texts(".srt", (CUES,), lambda path: check(flight_of(open_recording(path)))),
    "jpeg": _photographs(".jpg", "JPEG"),
    "png": _photographs(".png", "PNG"),
    "tiff": _photographs(".tif", "TIFF"),
}
PICTURES = ("picture of a flight", "jpeg", "png", "tiff")

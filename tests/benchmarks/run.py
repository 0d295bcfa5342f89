"""``python -m tests.benchmarks.run [NAME...]``: measure, show, and write docs/figures.json and the pages made
from it.

These are docs/figures.md, with all figures, and the README's table. ``--write`` writes them without
measuring.

Each benchmark runs in a fresh process. Named ones replace their own figures and keep the others' of earlier
runs; a benchmark without figures is listed with the reason.
"""

from __future__ import annotations

import argparse
import importlib
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from slam.io.atomic import atomic_file
from tests.benchmarks.commit import commit
from tests.benchmarks.figures import Section, headlines, markdown, measured, verdict, with_block
from tests.benchmarks.metric import Metric, Skipped

TITLES = {
    "demo": "Figure-eight demo",
    "bound": "Figure eight against its Cramer-Rao bound",
    "calibration": "Covariances against errors, simulated flights",
    "hybrid": "AR.Drone 2 over a photographed floor (`ardrone2-hybrid`)",
    "instruments": "Instruments together, simulated flights",
    "inertial_alone": "Camera and IMU alone, lively simulated flights",
    "estimates": "Measured flights without a camera (`slam estimate`)",
    "caliterra": "75 aerial photographs (`caliterra`)",
    "isfm": "32 photographs with RTK positions (`isfm`)",
    "lens": "Wrong calibrations of made surveys",
    "gps_outliers": "Gross outliers among GPS fixes",
    "graphs": "Standard pose graphs",
    "graph_command": "Standard pose graphs, from the file to covariances and report",
    "false_loops": "Standard pose graphs with false loops",
    "selection_matrix": "Generated pose graphs with false loops",
    "incremental": "Incremental back end",
    "live": "Live map at the pace of the camera",
    "flow": "Optical flow on rendered pairs",
    "cluster": "Photographs on a cluster of Dask",
    "front_end": "Front end",
    "side_by_side": "Side by side on the demo's keyframes",
    "refinement": "Refinement of made surveys",
    "memory": "A flight ten times as long",
    "growth": "Made surveys of 400, 1600 and 6400 photographs",
    "hour": "An hour of video, mapped",
    "mosaic": "Mosaics",
    "commands": "Whole commands in fresh processes",
    "map_page": "Interactive map in a browser",
    "video_import": "Import of an hour of video",
    "criticism": "Criticism of ten flights",
    "blind_dev": "Blind cases of the test data (`blind-dev`)",
    "model_gain": "Gain of criticism in the map",
    "injections": "Errors injected into measured flights without commands",
    "simulator": "Simulator and Kalman filter",
    "masking": "Obstacle masking in the gym",
    "surface": "Ground that is not flat",
    "surface_photos": "Ground that is not flat, photographs",
    "features": "Features compared",
    "registration": "Registration of rendered pairs",
    "loops": "Loop closure",
    "aliased": "Repetitive floors",
    "breaks": "Segments without features",
    "retrieval": "Loop candidates among many keyframes",
}
ROOT = Path(__file__).parents[2]
BENCH, PAGE, README = (ROOT / name for name in ("docs/figures.json", "docs/figures.md", "README.md"))


@dataclass(frozen=True)
class Record:
    """Result of one benchmark."""

    name: str
    metrics: tuple[Metric, ...]
    skipped: str
    """Reason why there are no figures; empty otherwise."""
    seconds: float
    commit: str
    """State of the repository that was measured."""

    @staticmethod
    def of(data: dict[str, Any]) -> Record:
        """Return a record from an entry of figures.json."""
        metrics = tuple(Metric(**{**m, "limit": tuple(m["limit"])}) for m in data["metrics"])
        return Record(**{**data, "metrics": metrics})


def main() -> None:
    """Run the named benchmarks, or all."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.run", description=__doc__)
    parser.add_argument("name", nargs="*", help=f"any of: {', '.join(TITLES)}; all where none is given")
    parser.add_argument("--write", action="store_true", help="measure nothing")
    parser.add_argument("--inside", metavar="FILE", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if unknown := set(arguments.name) - set(TITLES):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are: {', '.join(TITLES)}")
    if arguments.inside:
        arguments.inside.write_text(json.dumps(inside(arguments.name[0])))
        return
    screen = Console(width=None if sys.stdout.isatty() else 150)
    for name in [] if arguments.write else arguments.name or TITLES:
        screen.print(f"[bold]{TITLES[name]}[/]")
        record = apart(name)
        screen.print(shown(record))
        # Read again: another run may have added its figures meanwhile.
        records = {**earlier(), name: record}
        content = json.dumps([asdict(each) for each in records.values()], indent=1, ensure_ascii=False)
        with atomic_file(BENCH) as path:
            path.write_text(content + "\n", encoding="utf-8")
    sections = sections_of(earlier())
    for page, block in ((PAGE, markdown(sections)), (README, headlines(sections))):
        with atomic_file(page) as path:
            path.write_text(with_block(page.read_text(), block))


def sections_of(records: dict[str, Record]) -> list[Section]:
    """Return all sections, in the order of ``TITLES``."""
    missing = {name: Record(name, (), "not measured yet", 0.0, "") for name in TITLES}
    found = [(TITLES[name], record) for name, record in {**missing, **records}.items()]
    return [Section(title, record.metrics, record.skipped, record.commit) for title, record in found]


def inside(name: str) -> dict[str, Any]:
    """Measure in this process."""
    try:
        metrics = importlib.import_module(f"tests.benchmarks.{name}").measure()
    except Skipped as skipped:
        return {"metrics": [], "skipped": str(skipped)}
    return {"metrics": [asdict(metric) for metric in metrics], "skipped": ""}


def apart(name: str) -> Record:
    """Measure in a fresh process. A benchmark that fails is recorded as such and stops no other."""
    began, state = time.perf_counter(), commit()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "metrics.json"
        command = [sys.executable, "-m", "tests.benchmarks.run", name, "--inside", str(file)]
        done = subprocess.run(command, cwd=ROOT, check=False)
        found = json.loads(file.read_text()) if file.exists() else {}
    found = found or {"metrics": [], "skipped": f"broke with exit code {done.returncode}"}
    return Record.of({"name": name, "seconds": time.perf_counter() - began, "commit": state, **found})


def earlier() -> dict[str, Record]:
    """Return the figures of earlier runs."""
    if not BENCH.exists():
        return {}
    records = [Record.of(data) for data in json.loads(BENCH.read_text(encoding="utf-8"))]
    return {record.name: record for record in records if record.name in TITLES}


def shown(record: Record) -> Table | str:
    """Return one benchmark for the screen."""
    if record.skipped:
        return f"  skipped: {record.skipped}"
    table = Table("figure", "measured", "target", "", "how", box=None, padding=(0, 2, 0, 0))
    colour = {"met": "green", "missed": "red"}
    for m in record.metrics:
        value, target, met = measured(m), *verdict(m)
        table.add_row(m.key, value, target, f"[{colour[met]}]{met}[/]" if met else "", m.source)
    return table


if __name__ == "__main__":
    main()

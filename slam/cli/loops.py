"""``slam loops``: measure how well loops are found, by our method and by others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frontend.feature_kinds import FeatureKind
from slam.cli import options

_FLIGHT = typer.Argument(
    metavar="FLIGHT",
    help="A flight folder, a recording or a folder of photos, with truth or GPS.",
    show_default=False,
)


def loops(
    source: Annotated[Path, _FLIGHT],
    out: Annotated[Path, options.OUT],
    config: Annotated[Path | None, options.CONFIG] = None,
    features: Annotated[FeatureKind | None, options.FEATURES] = None,
    topic: Annotated[list[str] | None, options.TOPICS] = None,
    picture_rate: Annotated[float | None, options.PICTURE_RATE] = None,
    quiet: Annotated[bool, options.QUIET] = False,
    as_json: Annotated[bool, options.JSON] = False,
) -> None:
    """Measure precision and recall of loop closure by stage, and compare them with other methods."""
    from slam.cli.console import Screen
    from slam.cli.output_folder import output_folder
    from slam.cli.source import open_flight
    from slam.cli.sources_table import show_sources
    from slam.core.summary import json_text
    from slam.evaluation.loops import evaluate_loops
    from slam.evaluation.loops.figure import draw
    from slam.evaluation.loops.output import EXPLAINED, full_record, summary_record, table

    screen = Screen(quiet, as_json)
    settings = options.pipeline_config(config, features)
    with output_folder(out) as folder, screen.progress() as progress:
        flight, _ = open_flight(source, progress, options.request_of(topic, picture_rate))
        show_sources(flight, screen)
        result = evaluate_loops(flight, settings, progress)
        (folder / "loops.json").write_text(json_text(full_record(result)), encoding="utf-8")
        (folder / "loops.png").write_bytes(draw(result))
        (folder / "summary.json").write_text(json_text(summary_record(result)), encoding="utf-8")
    screen.json_file(out / "summary.json")
    screen.table(table(result))
    for line in EXPLAINED:
        screen.line(line)
    for warning in result.warnings:
        screen.line(f"note: {warning}")
    screen.files([out / "loops.png"])

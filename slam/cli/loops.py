"""``slam loops``: how well a flight's loops are found, by ours and by other methods."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frontend.feature_kinds import FeatureKind
from slam.cli.options import CONFIG, FEATURES, OUT, pipeline_config

_FLIGHT = typer.Argument(
    metavar="FLIGHT",
    help="A flight folder, a EuRoC recording or a folder of photos, with truth or GPS.",
    show_default=False,
)


def loops(
    source: Annotated[Path, _FLIGHT],
    out: Annotated[Path, OUT],
    config: Annotated[Path | None, CONFIG] = None,
    features: Annotated[FeatureKind | None, FEATURES] = None,
) -> None:
    """Measure precision and recall of loop closure, beside other methods, stage by stage."""
    from slam.cli.console import console, show_progress
    from slam.cli.output_folder import output_folder
    from slam.cli.source import open_flight
    from slam.cli.tables import shown, written
    from slam.core.summary import json_text
    from slam.evaluation.loops import evaluate_loops
    from slam.evaluation.loops.figure import draw
    from slam.evaluation.loops.output import EXPLAINED, full_record, summary_record, table

    screen = console()
    settings = pipeline_config(config, features)
    with output_folder(out) as folder, show_progress(screen) as progress:
        flight, _ = open_flight(source, progress)
        result = evaluate_loops(flight, settings, progress)
        (folder / "loops.json").write_text(json_text(full_record(result)), encoding="utf-8")
        (folder / "loops.png").write_bytes(draw(result))
        (folder / "summary.json").write_text(json_text(summary_record(result)), encoding="utf-8")
    screen.print(shown(table(result)))
    for line in EXPLAINED:
        screen.print(line, markup=False)
    for warning in result.warnings:
        screen.print(f"note: {warning}", markup=False)
    screen.print(written([out / "loops.png"]), soft_wrap=True)

"""``slam evaluate``: compare an optimization with the truth, or the GPS, of its flight."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam.cli.options import JSON, PICTURE_RATE, QUIET, TOPICS, request_of

if TYPE_CHECKING:
    from slam.evaluation import Evaluation
    from slam.report.tables.evaluation import Evaluated

_TRUTH = typer.Option(
    "--truth",
    metavar="FLIGHT",
    help="The flight, with truth or GPS; repeat it for each flight of a joint map.",
)


def evaluate(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder that slam optimize wrote.")],
    truth: Annotated[list[Path], _TRUTH],
    topic: Annotated[list[str] | None, TOPICS] = None,
    picture_rate: Annotated[float | None, PICTURE_RATE] = None,
    quiet: Annotated[bool, QUIET] = False,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Measure the errors of a map against the truth; adds files to DIR, and the result to its report."""
    from slam.cli.console import Screen
    from slam.cli.mapped import mapped_flight
    from slam.cli.output_folder import EVALUATE_NAMES
    from slam.evaluation import evaluate as compare
    from slam.io.atomic import locked
    from slam.io.estimate import read_estimate
    from slam.report.tables.evaluation import evaluated

    screen, request = Screen(quiet, as_json), request_of(topic, picture_rate)
    folder = Path(os.path.realpath(folder))
    estimate = read_estimate(folder)
    evaluation = compare(estimate, mapped_flight(folder, truth, request))
    result = evaluated(evaluation)
    with locked(folder):
        write_evaluation(folder, evaluation)
        in_report = _add_to_report(folder, result)
    screen.json_file(folder / "evaluation.json")
    for table in result.tables:
        screen.table(table)
    if not in_report and (folder / "report.html").is_file():
        screen.line("report.html is of an earlier version and stays as it is; run slam optimize again")
    screen.files([folder / name for name in (*EVALUATE_NAMES, *(["report.html"] * in_report))])


def _add_to_report(folder: Path, result: Evaluated) -> bool:
    """Write the result into the report of the map; return False where no report has a place for it."""
    from slam.io.atomic import write_whole
    from slam.report.evaluation_in_report import with_evaluation

    path = folder / "report.html"
    page = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    changed = with_evaluation(page, result, folder)
    if changed is not None:
        write_whole(path, changed.encode())
    return changed is not None


def write_evaluation(folder: Path, evaluation: Evaluation) -> None:
    """Write evaluation.json and its pictures. Raises ``InputError`` where they cannot be written."""
    from slam.core.summary import json_text
    from slam.evaluation.plots import write_plots
    from slam.io.atomic import write_whole

    write_plots(evaluation, folder)
    write_whole(folder / "evaluation.json", json_text(evaluation.to_json()).encode())

"""``slam demo``: simulate the figure eight that comes with the project, map it, and evaluate the map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam.cli.options import OUT, QUIET, SEED

DEMO_RECIPE = "bare_eight"
"""A flight on which chain and map bend where the floor is bare, until loops are closed."""
_RECIPE = typer.Option(metavar="NAME", help="A recipe that slam ships, or a .toml file.")


def demo(
    out: Annotated[Path, OUT] = Path("out/demo"),
    seed: Annotated[int, SEED] = 0,
    recipe: Annotated[str, _RECIPE] = DEMO_RECIPE,
    quiet: Annotated[bool, QUIET] = False,
) -> None:
    """Fly a figure eight over a floor with bare pieces, map it, and compare the map with the truth."""
    from slam.cli.console import Screen
    from slam.cli.evaluate import write_evaluation
    from slam.cli.output_folder import output_folder
    from slam.cli.results import MosaicOptions, write_results
    from slam.cli.tables import outcome_table
    from slam.evaluation import evaluate
    from slam.mapping.pipeline import optimize
    from slam.report.optimize_report import Accuracy
    from slam.report.tables.evaluation import evaluated
    from slam.simulation import simulate

    screen = Screen(quiet)
    with output_folder(out) as folder, screen.progress() as progress:
        flight = simulate(recipe, seed)
        estimate = optimize(flight, progress=progress)
        evaluation = evaluate(estimate, flight)
        write_evaluation(folder, evaluation)
        accuracy = Accuracy(evaluated=evaluated(evaluation))
        results = write_results(
            folder, estimate, flight, MosaicOptions(previous_output=out), progress, accuracy
        )
    result = accuracy.evaluated
    screen.print(outcome_table(results.facts, results.summary, results.mosaic, result.checks_lengths))
    for table in result.tables:
        screen.table(table)
    pictures = (
        "mosaic.png",
        "mosaic_chain.png",
        "evaluation_trajectory.png",
        "evaluation_error.png",
        "map.html",
        "report.html",
    )
    screen.files([out / name for name in pictures if (out / name).exists()])

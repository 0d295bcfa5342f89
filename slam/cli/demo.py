"""``slam demo``: the main job on the figure eight that comes with the project, simulated on the spot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam.cli.options import OUT, SEED

_RECIPE = typer.Option(metavar="NAME", help="A recipe that comes with slam, or a .toml file.")


def demo(
    out: Annotated[Path, OUT] = Path("out/demo"),
    seed: Annotated[int, SEED] = 0,
    recipe: Annotated[str, _RECIPE] = "figure_eight",
) -> None:
    """Fly the paper's figure eight in simulation, map it, and compare the map with the truth."""
    from slam.cli.console import console, show_progress
    from slam.cli.evaluate import write_evaluation
    from slam.cli.output_folder import output_folder
    from slam.cli.results import MosaicOptions, write_results
    from slam.cli.tables import outcome, shown, written
    from slam.evaluation import evaluate
    from slam.mapping.pipeline import optimize
    from slam.report.accuracy import accuracy_tables
    from slam.simulation import simulate

    screen = console()
    with output_folder(out) as folder, show_progress(screen) as progress:
        flight = simulate(recipe, seed)
        estimate = optimize(flight, progress=progress)
        evaluation = evaluate(estimate, flight)
        tables = accuracy_tables(evaluation)
        write_evaluation(folder, evaluation)
        results = write_results(folder, estimate, flight, MosaicOptions(earlier=out), progress, tables)
    screen.print(outcome(results.facts, results.summary))
    for table in tables:
        screen.print(shown(table))
    pictures = (
        "mosaic.png",
        "mosaic_chain.png",
        "evaluation_trajectory.png",
        "evaluation_error.png",
        "report.html",
    )
    screen.print(written([out / name for name in pictures if (out / name).exists()]), soft_wrap=True)

"""``slam reproduce``: repeat the paper's experiments and compare its figures with ours."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from slam.cli.options import CLUSTER, JSON, OUT, QUIET, SCHEDULER, on_cluster

_NAMES = typer.Argument(
    metavar="NAME",
    help="table1, table2, feature_distance, table3 (with table 4), table5, hover, pulses, squares, "
    "eights, overlap_speed, arithmetic; all without a name.",
    show_default=False,
)
_SEEDS = typer.Option(min=1, max=100_000, help="Flights of each experiment; a few give a first impression.")
_JOBS = typer.Option(min=1, max=1024, help="Number of parallel processes.", show_default="all cores")


def reproduce(
    out: Annotated[Path, OUT],
    names: Annotated[list[str] | None, _NAMES] = None,
    seeds: Annotated[int, _SEEDS] = 20,
    jobs: Annotated[int | None, _JOBS] = None,
    cluster: Annotated[bool, CLUSTER] = False,
    scheduler: Annotated[str | None, SCHEDULER] = None,
    quiet: Annotated[bool, QUIET] = False,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Repeat the experiments of the paper in simulation and say which of its figures agree."""
    from slam.cli.console import Screen
    from slam.cli.output_folder import output_folder
    from slam.core.errors import InputError
    from slam.core.figure_table import FigureTable
    from slam.experiments.output import headline, write_all
    from slam.experiments.registry import chosen
    from slam.experiments.run import conclude, run
    from slam.parallel.processes import Processes

    if jobs is not None and (cluster or scheduler):
        raise InputError("--jobs: a cluster has workers of its own; leave --jobs out")
    wanted = chosen(names or ())
    screen = Screen(quiet, as_json)
    begin_s = time.perf_counter()
    with output_folder(out) as folder:
        with on_cluster(cluster, scheduler) as workers, screen.progress() as progress:
            trials = run(wanted, seeds, workers or Processes(jobs), progress)
        conclusions = conclude(wanted, trials)
        write_all(folder, trials, conclusions, time.perf_counter() - begin_s)
    screen.json_file(out / "summary.json")
    rows = tuple(line for name, found in conclusions.items() for line in headline(name, found))
    columns = ("experiment", "", "figure: median (95 % of seeds)", "verdict")
    screen.table(FigureTable("The paper's experiments", columns, rows))
    screen.files([out / "reproduce.html"])

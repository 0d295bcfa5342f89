"""``slam optimize``: the whole post-flight job, or the back end alone where the input is a graph."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frontend.feature_kinds import FeatureKind
from slam.cli.options import CONFIG, FEATURES, MODEL, OUT, pipeline_config

if TYPE_CHECKING:
    from rich.console import Console

    from slam.cli.results import MosaicOptions, Results
    from slam.core.flight import Flight
    from slam.core.progress import Progress
    from slam.mapping.config import PipelineConfig
    from slam.simulation.model import Model

_SOURCE = typer.Argument(
    metavar="FLIGHT",
    help="A flight folder, a EuRoC recording, a folder of photos, or a .g2o pose graph. Several flights of "
    "one camera over the same ground make one map.",
    show_default=False,
)
_GSD = typer.Option(
    metavar="M", min=1e-4, max=100.0, help="Metres a pixel of the mosaic; default: as the camera saw."
)


def optimize(
    sources: Annotated[list[Path], _SOURCE],
    out: Annotated[Path, OUT],
    gsd: Annotated[float | None, _GSD] = None,
    mosaic: Annotated[bool, typer.Option("--mosaic/--no-mosaic", help="Render the map.")] = True,
    config: Annotated[Path | None, CONFIG] = None,
    features: Annotated[FeatureKind | None, FEATURES] = None,
    model: Annotated[str | None, MODEL] = None,
) -> None:
    """Turn a flight, or several, into one consistent map: trajectory, graph, mosaic and a report."""
    from slam.cli.console import console
    from slam.cli.results import MosaicOptions
    from slam.cli.source import kind_of
    from slam.cli.tables import outcome, shown, written
    from slam.core.errors import InputError

    screen = console()
    if len(sources) == 1 and kind_of(sources[0]) == "graph":
        if model is not None:
            raise InputError(f"--model {model}: {sources[0]} is a graph, without instruments; leave it out")
        results = _graph(sources[0], out, screen)
    else:
        wish = MosaicOptions(mosaic, gsd, out)
        results = _flights(sources, out, wish, pipeline_config(config, features), model, screen)
    screen.print(outcome(results.facts, results.summary))
    for table in results.accuracy:
        screen.print(shown(table))
    first = [out / "report.html", out / "mosaic.png"]
    screen.print(written([path for path in first if path.exists()]), soft_wrap=True)


def _flights(
    sources: list[Path],
    out: Path,
    wish: MosaicOptions,
    settings: PipelineConfig,
    model: str | None,
    screen: Console,
) -> Results:
    from slam.cli.console import show_progress
    from slam.cli.output_folder import output_folder
    from slam.cli.results import write_results
    from slam.cli.source import open_flight
    from slam.core.join_flights import join_flights
    from slam.mapping.pipeline import optimize as run
    from slam.simulation.model import load_model

    believed = load_model(model) if model is not None else None
    with output_folder(out) as folder, show_progress(screen) as progress:
        flights = []
        for source in sources:
            flight, kind = open_flight(source, progress)
            flights.append(flight)
            if kind != "flight":
                screen.print(f"{source}: {kind}, imported on the fly", markup=False)
        if believed is not None:
            return _without(believed, flights, folder, wish, settings, progress)
        flight = join_flights(flights)
        return write_results(folder, run(flight, settings, progress), flight, wish, progress)


def _without(
    model: Model,
    flights: list[Flight],
    folder: Path,
    wish: MosaicOptions,
    settings: PipelineConfig,
    progress: Progress,
) -> Results:
    """The map without what a model says of the instruments; with truth, beside the map as recorded."""
    from slam.cli.output_folder import MODEL_NAME
    from slam.cli.results import write_results
    from slam.core.join_flights import join_flights
    from slam.evaluation.map_gain import can_be_compared, map_gain
    from slam.mapping.pipeline import optimize as run
    from slam.report.accuracy import map_gain_table
    from slam.simulation.inverse import corrected
    from slam.simulation.model import save_model

    save_model(model, folder / MODEL_NAME)
    mended = [corrected(flight, model) for flight in flights]
    flight = join_flights([each.flight.with_warning(each.told(model)) for each in mended])
    estimate, recorded = run(flight, settings, progress), join_flights(flights)
    if not any(each.taken_out for each in mended) or not can_be_compared(recorded):
        return write_results(folder, estimate, flight, wish, progress)
    gain = map_gain(recorded, flight, estimate, settings, progress)
    return write_results(folder, estimate, flight, wish, progress, (map_gain_table([gain]),))


def _graph(source: Path, out: Path, screen: Console) -> Results:
    from backend.g2o import write_g2o
    from slam.cli.console import show_progress
    from slam.cli.graph import solve_graph
    from slam.cli.output_folder import output_folder
    from slam.cli.results import write_summary_and_report
    from slam.io.estimate import write_estimate

    with output_folder(out) as folder, show_progress(screen) as progress:
        estimate, solved = solve_graph(source, progress)
        write_estimate(estimate, folder)
        with (folder / "graph.g2o").open("w", encoding="ascii") as stream:
            write_g2o(stream, solved)
        return write_summary_and_report(folder, estimate, None)

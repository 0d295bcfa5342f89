"""``slam criticise``: test a model against measured flights; write a verdict and an extended model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam.cli.options import JSON, OUT, QUIET, TOPICS, request_of

if TYPE_CHECKING:
    from rich.table import Table

    from slam.core.flight import Flight
    from slam.core.progress import Progress
    from slam.criticism import Criticism
    from slam.evaluation.map_gain import MapGain

_FLIGHTS = typer.Argument(metavar="FLIGHT", help="Flights of one vehicle, with commands or sensors only.")
_MODEL = typer.Option(
    metavar="MODEL", help="The model to criticise: a name (nominal, paper) or a .toml file."
)
MAX_PICTURES_BY_DEFAULT = 500
"""The shortest flights are mapped without ``--map``, with no more pictures together: about a minute on two
cores."""
_MAPS = typer.Option(
    "--map/--no-map",
    help="If instruments have errors: map the flights with pictures and truth with and without them. "
    f"Default: the shortest of these, with at most {MAX_PICTURES_BY_DEFAULT} pictures together.",
    show_default=False,
)


def criticise(
    flights: Annotated[list[Path], _FLIGHTS],
    out: Annotated[Path, OUT],
    model: Annotated[str, _MODEL] = "nominal",
    maps: Annotated[bool | None, _MAPS] = None,
    topic: Annotated[list[str] | None, TOPICS] = None,
    quiet: Annotated[bool, QUIET] = False,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Say what a simulation gets wrong about measured flights, name the cause and extend the model."""
    from slam.cli.console import Screen
    from slam.cli.output_folder import output_folder
    from slam.cli.source import open_flight
    from slam.cli.sources_table import show_sources
    from slam.core.flight import with_unique_names
    from slam.core.progress import Tally
    from slam.criticism import criticise as run
    from slam.report.criticism.advice import advice_after
    from slam.report.criticism.write import write_criticism_report
    from slam.report.tables.evaluation import map_gain_table
    from slam.simulation.model import load_model

    screen = Screen(quiet, as_json)
    nominal = load_model(model)
    with output_folder(out) as folder, screen.progress() as progress:
        request = request_of(topic)
        opened = with_unique_names([open_flight(path, progress, request)[0] for path in flights])
        for flight in opened:
            show_sources(flight, screen)
        result = run(opened, nominal, progress)
        result = replace(result, details=(*result.details, *advice_after(result)))
        max_pictures = {True: None, False: 0, None: MAX_PICTURES_BY_DEFAULT}[maps]
        gains = gains_in_maps(opened, result, max_pictures, progress)
        write_criticism(result, folder, gains)
        with Tally(progress, "report", 1).part():
            write_criticism_report(folder / "report.html", result, opened, gains)
    screen.json_file(out / "summary.json")
    screen.line(result.sentence)
    if result.causes:
        screen.print(_table(result))
    for line in result.details:
        screen.line(line)
    if gains:
        screen.table(map_gain_table(gains))
    for line in result.dropped:
        screen.line(line, "yellow")
    screen.files([out / "report.html", out / "verdict.json"])


def gains_in_maps(
    flights: Sequence[Flight], result: Criticism, max_pictures: int | None, progress: Progress
) -> list[MapGain]:
    """Return the gains of maps from corrected readings; none where no cause can be corrected."""
    from slam.evaluation.map_gain import map_gains
    from slam.simulation.terms import CATALOGUE

    corrected = [cause.name for cause in result.causes if CATALOGUE[cause.name].undo is not None]
    if result.extended is None or not corrected:
        return []
    return map_gains(flights, result.extended, max_pictures, progress)


def write_criticism(result: Criticism, folder: Path, gains: Sequence[MapGain] = ()) -> None:
    """Write verdict.json and summary.json, and extended.toml where there is an extended model."""
    import json

    from slam.simulation.model import save_model

    summary = {
        "status": result.verdict,
        "sentence": result.sentence,
        "details": list(result.details),
        "flights": list(result.flights),
        "dropped": list(result.dropped),
        "causes": {cause.name: cause.probability for cause in result.causes},
    }
    verdict = result.to_json() | {"map": [gain.to_json() for gain in gains]}
    for name, content in (("verdict.json", verdict), ("summary.json", summary)):
        text = json.dumps(content, indent=1, allow_nan=False)
        (folder / name).write_text(text + "\n", encoding="utf-8")
    if result.extended is not None:
        save_model(result.extended, folder / "extended.toml")


def _table(result: Criticism) -> Table:
    from rich.table import Table

    table = Table("cause", "probability", "parameter", "value", "95 % interval", "unit")
    for cause in result.causes:
        for k, (name, p) in enumerate(cause.parameters.items()):
            first = (cause.name, f"{cause.probability:.3f}") if k == 0 else ("", "")
            table.add_row(*first, name, f"{p.value:.4g}", f"{p.low:.4g} to {p.high:.4g}", p.unit)
    return table

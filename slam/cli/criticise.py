"""``slam criticise``: what a model gets wrong about measured flights, as a verdict and an extended model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam.cli.options import OUT

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
MAPPED_UNASKED = 500
"""Pictures: about a minute on two cores."""
_MAPS = typer.Option(
    "--map/--no-map",
    help="Where instruments are at fault: map flights that have pictures and truth with and without it. "
    f"Default: flights of {MAPPED_UNASKED} pictures together at most.",
    show_default=False,
)


def criticise(
    flights: Annotated[list[Path], _FLIGHTS],
    out: Annotated[Path, OUT],
    model: Annotated[str, _MODEL] = "nominal",
    maps: Annotated[bool | None, _MAPS] = None,
) -> None:
    """Say what a simulation gets wrong about measured flights, name the cause and extend the model."""
    from slam.cli.console import console, show_progress
    from slam.cli.output_folder import output_folder
    from slam.cli.source import open_flight
    from slam.cli.tables import shown, written
    from slam.core.flight import with_unique_names
    from slam.core.progress import Tally
    from slam.criticism import criticise as judge
    from slam.report.accuracy import map_gain_table
    from slam.report.criticism_report import write_criticism_report
    from slam.simulation.model import load_model

    screen = console()
    believed = load_model(model)
    with output_folder(out) as folder, show_progress(screen) as progress:
        opened = with_unique_names([open_flight(path, progress)[0] for path in flights])
        result = judge(opened, believed, progress)
        most = {True: None, False: 0, None: MAPPED_UNASKED}[maps]
        gains = gains_in_maps(opened, result, most, progress)
        write_criticism(result, folder, gains)
        with Tally(progress, "report", 1).part():
            write_criticism_report(folder / "report.html", result, opened, gains)
    screen.print(result.sentence, markup=False)
    if result.causes:
        screen.print(_table(result))
    if gains:
        screen.print(shown(map_gain_table(gains)))
    for line in result.dropped:
        screen.print(line, markup=False, style="yellow")
    screen.print(written([out / "report.html", out / "verdict.json"]), soft_wrap=True)


def gains_in_maps(
    flights: Sequence[Flight], result: Criticism, most: int | None, progress: Progress
) -> list[MapGain]:
    """Where what was found changes readings and can be taken out of them; else none."""
    from slam.evaluation.map_gain import map_gains
    from slam.simulation.inverse.corrected import UNDONE

    if result.extended is None or not any(cause.name in UNDONE for cause in result.causes):
        return []
    return map_gains(flights, result.extended, most, progress)


def write_criticism(result: Criticism, folder: Path, gains: Sequence[MapGain] = ()) -> None:
    """Write verdict.json and summary.json, and extended.toml where there is a model."""
    import json

    from slam.simulation.model import save_model

    summary = {
        "status": result.verdict,
        "sentence": result.sentence,
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

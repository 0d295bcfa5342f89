"""``slam replay``: simulate a measured flight's commands and compare both channel by channel."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slam.cli.options import JSON, OUT, QUIET

if TYPE_CHECKING:
    from slam.core.figure_table import FigureTable
    from slam.simulation.replay import Replay

_FLIGHT = typer.Argument(
    metavar="FLIGHT", help="A flight folder or a recording, with commands.", show_default=False
)
_MODEL = typer.Option(
    "--model", metavar="MODEL", help="The model to compare with: a name (nominal, paper) or a .toml file."
)


def replay(
    source: Annotated[Path, _FLIGHT],
    out: Annotated[Path, OUT],
    model: Annotated[str, _MODEL] = "nominal",
    quiet: Annotated[bool, QUIET] = False,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Simulate a measured flight's commands with a model and show where the two differ."""
    from slam.cli.console import Screen
    from slam.cli.output_folder import output_folder
    from slam.cli.source import open_flight
    from slam.core.flight_info import describe
    from slam.core.progress import silent
    from slam.core.summary import json_text
    from slam.simulation import load_model
    from slam.simulation.replay import replay as run
    from slam.simulation.replay.figure import draw

    screen = Screen(quiet, as_json)
    loaded = load_model(model)
    flight, _ = open_flight(source, silent)
    with output_folder(out) as folder:
        result = run(flight, loaded)
        (folder / "replay.png").write_bytes(draw(result))
        notes = (*flight.warnings, *describe(flight).anomalies, *result.warnings)
        summary = {**record(result), "warnings": list(notes)}
        (folder / "summary.json").write_text(json_text(summary), encoding="utf-8")
    screen.json_file(out / "summary.json")
    screen.table(table(result))
    for warning in notes:
        screen.line(f"note: {warning}")
    screen.files([out / "replay.png"])


def record(replay: Replay) -> dict[str, Any]:
    """Return the content of summary.json: RMS of measured minus simulated, in the channels' own units."""
    return {
        "flight": replay.flight,
        "model": replay.model,
        "begin_s": replay.begin_s,
        "end_s": replay.end_s,
        "max_tilt_rad": replay.max_tilt_rad,
        "started_from": replay.started_from,
        "rollouts": {f"{horizon:g}": count for horizon, count in replay.rollouts.items()},
        "skipped": {f"{horizon:g}": count for horizon, count in replay.skipped.items()},
        "channels": {
            channel.name: {
                "unit": channel.unit,
                "noise_std": channel.noise_std,
                "rms": {
                    **{f"{horizon:g}": rms for horizon, rms in channel.rms.items()},
                    "flight": channel.flight_rms,
                },
            }
            for channel in replay.channels
        },
    }


def table(replay: Replay) -> FigureTable:
    """Return the errors of all channels at all horizons, in the units of the picture."""
    from slam.core.figure_table import FigureTable
    from slam.simulation.replay.channels import display_unit

    horizons = [f"{horizon:g} s" for horizon in replay.rollouts]
    rows = []
    for channel in replay.channels:
        factor, unit = display_unit(channel.unit)
        errors = (*channel.rms.values(), channel.flight_rms)
        rows.append((f"{channel.name} [{unit}]", *(f"{factor * rms:.3g}" for rms in errors)))
    return FigureTable(
        f"{replay.flight}, measured less simulated by model {replay.model}: RMS over roll-outs",
        ("channel", *horizons, "whole flight"),
        tuple(rows),
    )

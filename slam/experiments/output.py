"""Output of the experiments: a JSON and a picture each, one page for all, and a summary."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slam.core.plot_style import png
from slam.core.summary import json_text
from slam.core.units import spaced
from slam.core.version import VERSION
from slam.experiments.experiment import Conclusion, Experiment, Row, SeedStatistics, Trial
from slam.experiments.registry import experiment

_DPI = 110


@dataclass(frozen=True)
class TextTable:
    """An experiment's rows as text, with the paper's columns first."""

    columns: tuple[str, ...]
    paper: int
    """Number of the paper's columns, which follow the first two."""
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class _Section:
    experiment: Experiment
    conclusion: Conclusion
    table: TextTable
    picture: str


def write_all(
    folder: Path,
    trials: Mapping[str, tuple[Trial, ...]],
    conclusions: Mapping[str, Conclusion],
    elapsed_s: float,
) -> None:
    """Write NAME.json, NAME.png, reproduce.html and summary.json into an empty ``folder``."""
    sections = []
    for name, conclusion in conclusions.items():
        made = experiment(name)
        text = json_text(record(made, trials[name], conclusion))
        (folder / f"{name}.json").write_text(text, encoding="utf-8")
        picture = draw(made, trials[name])
        (folder / f"{name}.png").write_bytes(picture)
        encoded = "data:image/png;base64," + base64.b64encode(picture).decode()
        sections.append(_Section(made, conclusion, table(conclusion), encoded))
    seeds = max(len(of) for of in trials.values())
    (folder / "reproduce.html").write_text(_page(sections, seeds), encoding="utf-8")
    (folder / "summary.json").write_text(json_text(summary(conclusions, seeds, elapsed_s)), encoding="utf-8")


def record(made: Experiment, trials: tuple[Trial, ...], conclusion: Conclusion) -> dict[str, Any]:
    """Return the content of NAME.json."""
    return {
        "name": made.name,
        "title": made.title,
        "source": made.source,
        "verdict": conclusion.verdict,
        "sentence": conclusion.sentence,
        "seeds": len(trials),
        "rows": [_row(row) for row in conclusion.rows],
        "trials": [{"seed": trial.seed, **trial.figures} for trial in trials],
    }


def summary(conclusions: Mapping[str, Conclusion], seeds: int, elapsed_s: float) -> dict[str, Any]:
    """Return the content of summary.json: verdicts, sentences, and each experiment's first row."""
    return {
        "seeds": seeds,
        "elapsed_s": elapsed_s,
        "experiments": {
            name: {
                "verdict": conclusion.verdict,
                "sentence": conclusion.sentence,
                "headline": _row(conclusion.rows[0]),
            }
            for name, conclusion in conclusions.items()
        },
    }


def _row(row: Row) -> dict[str, Any]:
    return {
        "name": row.name,
        "unit": row.unit,
        "paper": {
            column: asdict(figure) if isinstance(figure, SeedStatistics) else figure
            for column, figure in row.paper.items()
        },
        "ours": {column: asdict(figure) for column, figure in row.ours.items()},
    }


def draw(made: Experiment, trials: tuple[Trial, ...]) -> bytes:
    """Draw the experiment's picture as PNG; the plotting library's global state is not changed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=made.size_inches, dpi=_DPI, layout="constrained")
    made.draw(figure, trials)
    return png(figure)


def table(conclusion: Conclusion) -> TextTable:
    """Convert all rows to text, with every column that any of them has."""
    paper = tuple(dict.fromkeys(column for row in conclusion.rows for column in row.paper))
    ours = tuple(dict.fromkeys(column for row in conclusion.rows for column in row.ours))
    rows = tuple(
        (
            row.name,
            row.unit if row.unit != "1" else "",
            *(shown(row.paper[column]) if column in row.paper else "" for column in paper),
            *(shown(row.ours[column]) if column in row.ours else "" for column in ours),
        )
        for row in conclusion.rows
    )
    return TextTable(("", "", *paper, *ours), len(paper), rows)


def headline(name: str, conclusion: Conclusion) -> tuple[tuple[str, str, str, str], ...]:
    """Lines of the short table, one for each figure of the first row: experiment, quantity, figure,
    verdict."""
    row = conclusion.rows[0]
    unit = spaced(row.unit)
    figures = [(column, shown(value) + unit) for column, value in row.paper.items()]
    figures += [(column, shown(figure) + unit) for column, figure in row.ours.items()]
    first = (name, f"{row.name}", "", conclusion.verdict)
    return (first, *(("", f"  {column}", value, "") for column, value in figures))


def shown(figure: SeedStatistics | float) -> str:
    """Format median and 95 % interval; the figure alone where there is only one seed."""
    if not isinstance(figure, SeedStatistics):
        return _figure(figure)
    if figure.seeds < 2:
        return _figure(figure.median)
    return f"{_figure(figure.median)} ({_figure(figure.lower95)} to {_figure(figure.upper95)})"


def _figure(value: float) -> str:
    """Format three significant digits, without powers of ten."""
    if not np.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    digits = max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return f"{value:.{min(digits, 6)}f}"


def _page(sections: list[_Section], seeds: int) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("slam.experiments", "."), autoescape=True, undefined=StrictUndefined
    )
    return environment.get_template("page.html.j2").render(sections=sections, seeds=seeds, version=VERSION)

"""Fill docs/experiments.md from the output of ``slam reproduce``.

``python -m tests.benchmarks.experiments_page DIR...``
The folders may hold different experiments; the later folder counts for one that is in two.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from slam.experiments.experiment import Conclusion, Row, SeedStatistics
from slam.experiments.output import table
from slam.experiments.registry import NAMES
from tests.benchmarks.figures import with_block

PAGE = Path(__file__).parents[2] / "docs" / "experiments.md"
MOST_ROWS = 18
"""Number of rows shown of an experiment; its JSON has all."""


def markdown(records: dict[str, dict[str, Any]]) -> str:
    """Return the sections of all experiments, in the paper's order."""
    parts = [section(records[name]) for name in NAMES if name in records]
    return "\n\n".join(["", *parts, ""])


def section(record: dict[str, Any]) -> str:
    """Return the section of one experiment: sentence and table."""
    rows = tuple(
        Row(
            row["name"],
            row["unit"],
            {name: _spread(of) if isinstance(of, dict) else of for name, of in row["paper"].items()},
            {name: _spread(of) for name, of in row["ours"].items()},
        )
        for row in record["rows"][:MOST_ROWS]
    )
    made = table(Conclusion(rows, record["verdict"], ""))
    lines = [
        f"### {record['title']} (`{record['name']}`)",
        f"{record['source'].capitalize()}; {record['seeds']} seed{'s' * (record['seeds'] > 1)}.",
        f"**{record['sentence'].partition(': ')[0]}**: {record['sentence'].partition(': ')[2]}",
        "| " + " | ".join(made.columns) + " |\n|" + "---|" * len(made.columns),
    ]
    body = "\n".join("| " + " | ".join(row) + " |" for row in made.rows)
    return "\n\n".join(lines) + "\n" + body


def _spread(of: dict[str, Any]) -> SeedStatistics:
    return SeedStatistics(**{key: float("nan") if value is None else value for key, value in of.items()})


def main(folders: list[str]) -> None:
    """Rewrite the page's figures."""
    records = {}
    for folder in folders:
        for name in NAMES:
            path = Path(folder) / f"{name}.json"
            if path.exists():
                records[name] = json.loads(path.read_text(encoding="utf-8"))
    PAGE.write_text(with_block(PAGE.read_text(encoding="utf-8"), markdown(records)), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])

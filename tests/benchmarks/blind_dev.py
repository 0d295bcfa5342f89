"""Verdicts of `slam criticise` on the sixteen blind cases of the test data, by their own score card."""

from __future__ import annotations

import os
import runpy
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest import mock

from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_least, at_most, reported
from tests.blind.critic import flights_of, verdict_on

MOST_ERROR = 0.25


def measure() -> list[Metric]:
    """Return the verdicts of all cases, one process each; the first one compiles as after an installation."""
    home = folder("blind-dev")
    with tempfile.TemporaryDirectory() as scratch, mock.patch.dict(os.environ):
        answers, seconds = Path(scratch) / "answers", []
        os.environ["NUMBA_CACHE_DIR"] = str(Path(scratch) / "compiled")
        for case in sorted((home / "cases").iterdir()):
            began = time.perf_counter()
            verdict_on(flights_of(case), answers / case.name)
            seconds.append(time.perf_counter() - began)
        score = runpy.run_path(str(home / "score.py"))["score"]
        return figures(score(str(answers), str(home / "truth")), seconds)


def figures(scored: dict[str, Any], seconds: list[float]) -> list[Metric]:
    """Return figures from the folder's ``score`` and the times of the cases, of which the first is cold."""
    gate, card = scored["gate"], scored["card"]
    nulls, singles, strange = (gate[name] for name in ("nulls", "singles", "unknowns"))
    kept = strange - gate["unknowns_misnamed"]
    pair, error = card["pairs: both found"], card["parameter error, median"]
    slowest = max(range(1, len(seconds)), key=seconds.__getitem__)
    case = f"case {slowest} of {len(seconds)}, each in a process of its own"
    return [
        at_least("healthy cases judged to have nothing wrong", gate["nulls_right"], f"of {nulls}", nulls),
        at_least("single effects named, or in the set", gate["singles_right"], f"of {singles}", singles - 1),
        at_most("their sizes' relative error, median", error["rate"], "", MOST_ERROR),
        at_least("pairs of which both are found", pair["hits"], f"of {pair['of']}", pair["of"]),
        at_least("effects of no term that are not misnamed", kept, f"of {strange}", strange),
        reported("cases without a verdict", len(scored["missing"]), f"of {len(seconds)}"),
        reported("slowest case after the first, which compiles", seconds[slowest], "s", case),
    ]  # fmt: skip

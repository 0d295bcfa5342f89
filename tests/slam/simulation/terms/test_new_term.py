"""A new effect is one file: a copy of the project with that file simulates the effect and finds it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[4]
LONGEST_FILE = 60

FILE = '''"""A sonar whose error grows with the square of the range."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from slam.core.flight import Flight
from slam.simulation.terms.term import Array, Term, signed


def _bent(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    out[0] += values[first] * out[0] ** 2


def _straightened(flight: Flight, values: Array, std: float | None) -> Flight:
    """Solve the quadratic equation."""
    assert flight.sonar is not None
    read = flight.sonar.range_m
    range_m = 2.0 * read / (1.0 + (1.0 + 4.0 * values[0] * read) ** 0.5)
    return replace(flight, sonar=replace(flight.sonar, range_m=range_m))


BENT = (
    Term(
        name="sonar_curvature",
        title="a sonar with a curved response",
        meaning="its error grows with the square of the range",
        family="sonar",
        acts_on="sensor",
        parameters=(signed("a", "1/m", 0.1, 0.3, step=1e-3),),
        equation="r + a r^2",
        confounders=("sonar_scale",),
        excitation="three heights",
        instrument="sonar",
        stream="sonar",
        read=_bent,
        undo=_straightened,
        in_differences=True,
        tolerance=3e-3,
    ),
)
'''

PROGRAM = """
from dataclasses import replace
import numpy as np
from slam import criticise
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.inverse import correct_flight
from slam.simulation.model import load_model

nominal = at_lower_rates(load_model("nominal"))
ill = nominal.with_term("sonar_curvature", a=-0.03)
plan = ["brisk climb steps at full stick", "up to 2 m, hover, and back", "climb and descend by 0.6 m"]
flown = [
    [simulate_flight(m, stick_for(plan), seed, maker=nominal) for seed in (1, 2, 3)]
    for m in (ill, nominal)
]
fixed, healthy = correct_flight(flown[0][0], ill).flight.sonar.range_m, flown[1][0].sonar.range_m
assert np.nanmax(np.abs(fixed - healthy)) < 0.03 < np.nanmax(np.abs(flown[0][0].sonar.range_m - healthy))
found = criticise(flown[0])
lead = found.causes[0]
assert lead.name == "sonar_curvature", found.sentence
assert abs(lead.parameters["a"].value + 0.03) < 0.008, found.sentence
assert any("its error grows" in line for line in found.details)
# The heights of three flights by the accelerometer alone hardly tell a curve from a factor.
found = criticise([replace(f, command=None) for f in flown[0]])
assert "sonar_curvature" in found.sentence, found.sentence
"""


def test_the_file_is_short_and_makes_a_term():
    assert len(FILE.splitlines()) <= LONGEST_FILE
    made: dict[str, Any] = {}
    exec(FILE, made)
    assert [term.name for term in made["BENT"]] == ["sonar_curvature"]


@pytest.mark.slow
def test_a_new_effect_is_one_file_and_is_found(tmp_path: Path):
    for part in ("backend", "frontend", "slam", "datasets"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "slam" / "simulation" / "terms" / "bent.py").write_text(FILE, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr

"""The critic as a black box: folders in, verdict.json out, in a separate process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
LONGEST_S = 600.0


def verdict_on(flights: Sequence[Path], out: Path, options: Sequence[str] = ()) -> dict[str, Any]:
    """Return the verdict of ``slam criticise``; on failure a verdict "invalid" with its last line."""
    call = [sys.executable, "-m", "slam", "criticise", *map(str, flights)]
    return _verdict_of([*call, "--out", str(out), *options], out / "verdict.json")


PROGRAM = """
import json, sys
from slam import criticise
from slam.io.flight_folder import read_flight
found = criticise([read_flight(folder) for folder in sys.argv[2:]])
open(sys.argv[1], "w").write(json.dumps(found.to_json()))
"""


def verdict_of_call(flights: Sequence[Path], file: Path) -> dict[str, Any]:
    """Return the verdict of the library's ``slam.criticise``: the same without report."""
    return _verdict_of([sys.executable, "-c", PROGRAM, str(file), *map(str, flights)], file)


def _verdict_of(call: list[str], file: Path) -> dict[str, Any]:
    one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    env = {**os.environ, **one}
    try:
        done = subprocess.run(
            call, cwd=ROOT, env=env, capture_output=True, text=True, timeout=LONGEST_S, check=False
        )
    except subprocess.TimeoutExpired:
        return {"verdict": "invalid", "sentence": f"no answer within {LONGEST_S:g} s"}
    if done.returncode or not file.exists():
        lines = (done.stderr or done.stdout).strip().splitlines()
        return {"verdict": "invalid", "sentence": lines[-1] if lines else f"exit {done.returncode}"}
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


def flights_of(case: Path) -> list[Path]:
    """Return the flight folders of a case, in order."""
    return sorted(p for p in case.iterdir() if (p / "mav0").is_dir())

"""Processor time of whole commands and of imports, each in a fresh process: the better of two runs.

The first run compiles kernels that no earlier one has compiled, so it is not the better one. Both runs of the
first ``slam criticise`` begin with an empty cache of compiled modules.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_most, reported

ROOT = Path(__file__).parents[2]
REPEATS = 2
DEMO_S, HYBRID_S, FIRST_CRITICISM_S, IMPORT_S = 25.0, 30.0, 20.0, 0.4
CASE = "case_000"
"""Blind case that is criticised."""
IMPORT = "from slam import optimize"
FIRST_CALL = f"{IMPORT}; import slam.mapping.main_loop"
"""What the first call of ``optimize`` loads, too."""


def measure() -> list[Metric]:
    """Return the processor time of each command."""
    hybrid, case = folder("flights/ardrone2-hybrid"), folder("blind-dev") / "cases" / CASE
    flights = sorted(path for path in case.iterdir() if (path / "mav0").is_dir())
    criticism = ("-m", "slam", "criticise", *flights)
    with tempfile.TemporaryDirectory() as scratch:
        out = ("--quiet", "--out", Path(scratch) / "out")
        demo_s = cpu_s("-m", "slam", "demo", *out)
        hybrid_s = cpu_s("-m", "slam", "optimize", hybrid, *out)
        first_s = cpu_s(*criticism, *out, compiled=False)
        warm_s = cpu_s(*criticism, *out)
    bare_s, import_s, call_s = (cpu_s("-c", text) for text in ("pass", IMPORT, FIRST_CALL))
    return [
        at_most("`slam demo`", demo_s, "s", DEMO_S, "simulation, map, comparison, mosaics and report"),
        at_most("`slam optimize ardrone2-hybrid`", hybrid_s, "s", HYBRID_S, "with mosaics and report"),
        at_most(
            "first `slam criticise` after an installation", first_s, "s", FIRST_CRITICISM_S,
            f"{len(flights)} flights of a blind case; {warm_s:.1f} s once its kernels are compiled",
        ),
        at_most(f"`{IMPORT}`", import_s, "s", IMPORT_S, f"Python alone {bare_s:.2f} s"),
        reported("further imports of the first call of `optimize`", call_s - import_s, "s"),
    ]  # fmt: skip


def cpu_s(*arguments: object, compiled: bool = True) -> float:
    """Return the least processor time of Python with these arguments, its child processes included.

    ``compiled``: whether kernels that were compiled in other runs may be used.
    """
    return min(_cpu_s([sys.executable, *map(str, arguments)], compiled) for _ in range(REPEATS))


def _cpu_s(command: list[str], compiled: bool) -> float:
    with tempfile.TemporaryDirectory() as empty:
        env = os.environ if compiled else {**os.environ, "NUMBA_CACHE_DIR": empty}
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, cwd=ROOT, env=env, stdout=subprocess.DEVNULL, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

"""Jobs in separate processes, so that time and peak memory belong to one job, and both of a job."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_STATUS = Path("/proc/self/status")


def run_apart(module: str, *arguments: object, limit_s: float | None = None) -> Any:
    """Return the JSON of the last line that ``python -m module arguments`` prints; None after a time-out."""
    command = [sys.executable, "-m", module, *map(str, arguments)]
    try:
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        return None
    return json.loads(done.stdout.splitlines()[-1])


def peak_mb() -> float:
    """Return the peak resident memory of this process.

    It is read from ``/proc`` where that exists: ``ru_maxrss`` survives exec, so a child would start with the
    peak of its parent.
    """
    if _STATUS.exists():
        line = next(line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024**2 if sys.platform == "darwin" else 1024)


@dataclass(frozen=True)
class Took:
    """Time and memory of some work."""

    seconds: float
    cpu_s: float
    """Processor time."""
    peak_mb: float
    """Peak resident memory of the process until then."""


@contextmanager
def timed() -> Iterator[list[Took]]:
    """Give a list that has time and memory of the block after it."""
    began, cpu_began, took = time.perf_counter(), time.process_time(), list[Took]()
    yield took
    took.append(Took(time.perf_counter() - began, time.process_time() - cpu_began, peak_mb()))

"""Run some flights of a benchmark: ``python -m tests.benchmarks.NAME FIRST LAST``, both included."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from typing import Any


def print_alone(fly: Callable[[int], Any]) -> None:
    """Print a line of JSON for each flight as soon as it is done."""
    for number in range(int(sys.argv[1]), int(sys.argv[2]) + 1):
        print(json.dumps(asdict(fly(number))), flush=True)

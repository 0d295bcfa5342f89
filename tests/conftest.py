"""What holds for all tests."""

from __future__ import annotations

import gc
import os
import signal
from pathlib import Path

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    # Each worker has a core to itself: threads of linear algebra would wait for those of the other workers.
    # It is read when numpy is imported, which nothing has done yet.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# A shell that starts the tests in the background has Ctrl-C ignored, and every process that a test starts
# would inherit that; from one that handles it they get the default.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tutorial: the worker that ran the longest file last would finish alone.

    It compiles most kernels. The tests that need many of them come last, so that no other worker compiles
    them at the same time.
    """
    late = [Path(__file__).parent / name for name in ("backend", "blind")]

    def turn(item: pytest.Item) -> int:
        if item.path.name == "test_tutorial.py":
            return 0
        return 2 if any(folder in item.path.parents for folder in late) else 1

    items.sort(key=turn)


def pytest_collection_finish() -> None:
    """Leave the thousands of collected tests out of each later collection of garbage."""
    gc.collect()
    gc.freeze()

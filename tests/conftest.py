"""What holds for all tests."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

if "PYTEST_XDIST_WORKER" in os.environ:
    # Each worker has a core to itself: threads of linear algebra would wait for those of the other workers.
    # It is read when numpy is imported, which nothing has done yet.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# A shell that starts the tests in the background has Ctrl-C ignored, and every process that a test starts
# would inherit that; from one that handles it they get the default.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


settings.register_profile("any machine", deadline=None)  # how long an example takes is not judged
settings.load_profile("any machine")

FIRST = ("test_tutorial.py", "test_track_pictures.py")
"""Files that are run first, one by each of two workers."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tutorial: the worker that ran the longest file last would finish alone.

    Two workers that need the same kernels at the same time would both compile them. One file compiles those
    of the filter of `slam estimate` at the begin, and one those of the smoother of `slam criticise` long
    before the neighbours of that file need them.
    """
    names = [*FIRST, "the others"]
    items.sort(key=lambda item: names.index(item.path.name if item.path.name in FIRST else "the others"))
    smoothing = [item for item in items if item.path.name == "test_mismatched_pairs.py"]
    others = [item for item in items if item.path.name != "test_mismatched_pairs.py"]
    blind = next((k for k, item in enumerate(others) if item.path.parent.name == "blind"), None)
    if blind is not None:
        items[:] = [*others[:blind], *smoothing, *others[blind:]]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect no garbage while tests are collected, and leave them out of each later collection."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()

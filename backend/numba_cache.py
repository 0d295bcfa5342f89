"""Compiled kernels on disk.

numba looks at a kernel's own file to tell whether its cached machine code is still good, not at the files of
the kernels that are compiled into it: after a change there it would go on with the old code, without a word.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
from numba.core import event

GROUPS: list[frozenset[Path]] = []
"""Every group of files that `discard_stale` was called with so far."""


def njit(**options: Any) -> Any:
    """numba's ``njit``; what is to be cached is compiled in every process where it can be written nowhere.

    So it is where the project is installed read-only for a user without a home, as in a container; there
    ``NUMBA_CACHE_DIR`` may name one.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        try:
            return numba.njit(**options)(function)
        except RuntimeError:  # "no locator available"
            return numba.njit(**{**options, "cache": False})(function)

    return compiled


def discard_stale(sources: Iterable[Path]) -> int:
    """Delete what is cached of some source files where any of them is newer; returns how many files went.

    To be called before the first kernel of the sources is used, with all files whose kernels call each other
    and all whose constants they take.
    """
    files = list(sources)
    GROUPS.append(frozenset(files))
    cached = [c for f in files for c in (f.parent / "__pycache__").glob(f"{f.stem}.*.nb[ic]")]
    try:
        newest = max(f.stat().st_mtime for f in files)
        stale = [c for c in cached if c.stat().st_mtime < newest]
        if not stale:
            return 0
        for each in cached:
            each.unlink(missing_ok=True)
    except OSError:
        return 0  # another process is at it, or nothing may be written here
    return len(cached)


@contextmanager
def compiling(tell: Callable[[bool], None]) -> Iterator[None]:
    """Call ``tell(False)`` before a kernel is compiled within the block and ``tell(True)`` once it is, with
    all that it calls; what is loaded from the cache is not told."""
    with event.install_listener("numba:compile", _Outermost(tell)):
        yield


class _Outermost(event.Listener):
    """A kernel that calls others has them compiled while it is: only the outer one is told."""

    def __init__(self, tell: Callable[[bool], None]) -> None:
        self._tell = tell
        self._depth = 0

    def on_start(self, event: Any) -> None:
        if self._depth == 0:
            self._tell(False)
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._tell(True)

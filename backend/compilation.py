"""Compilation by numba: decorators of kernels, and invalidation of the cache.

numba checks only a kernel's own file to decide whether its cached machine code is valid. It does not check
the files of the kernels that are inlined: after a change there it would silently run the old code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

Function = TypeVar("Function", bound=Callable[..., Any])

GROUPS: list[frozenset[Path]] = []
"""Groups of files with which `discard_stale` has been called."""
_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
"""Kernels release the interpreter's lock. No ``fastmath``: a kernel that another one calls is compiled by
itself and within its caller. Which of the two runs depends on what the cache holds. If sums could be
reordered, the two would round differently; in the order of the source both give the same bits."""


def njit(**options: Any) -> Callable[[Function], Function]:
    """Return numba's ``njit``, without the cache where no cache folder is writable or its disk is full.

    The first happens in a container where the project is read-only and the user has no home folder. The
    environment variable ``NUMBA_CACHE_DIR`` can then name a folder.
    """

    options = {"no_cfunc_wrapper": True} | options  # none is called from C, and they take time to compile

    def compiled(function: Function) -> Function:
        try:
            kernel = numba.njit(**options)(function)
        except RuntimeError:  # "no locator available"
            kernel = numba.njit(**{**options, "cache": False})(function)
        save = kernel._cache.save_overload

        def save_if_possible(*overload: Any) -> None:
            with suppress(OSError):
                save(*overload)

        kernel._cache.save_overload = save_if_possible
        return cast(Function, kernel)

    return compiled


allocating_kernel = njit(**_OPTIONS)
"""Decorator of kernels that may allocate arrays."""
kernel = njit(**_OPTIONS, _nrt=False)
"""Decorator of kernels that allocate no arrays and count no references. Counting takes as long as their work,
and doubles the compile time. The Python caller must hold the arrays meanwhile."""
inner_kernel = njit(**_OPTIONS, _nrt=False, no_cpython_wrapper=True)
"""Decorator of such kernels that only kernels call: wrappers for Python take a fifth of the compile time. A
call from Python ends the process."""
inlined_kernel = njit(**_OPTIONS, _nrt=False, no_cpython_wrapper=True, inline="always")
"""Decorator of such kernels that one kernel calls once, and that would be compiled again within it."""


def discard_stale(sources: Iterable[Path]) -> int:
    """Delete the cached code of source files if any of them is newer; return the number of deleted files.

    Call it before the first kernel of the sources is used, with all files whose kernels call each other and
    all files whose constants they use.
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
        return 0  # another process deletes them, or the folder is read-only
    return len(cached)


@contextmanager
def compiling(report: Callable[[bool], None]) -> Iterator[None]:
    """Call ``report(False)`` before a kernel is compiled within the block and ``report(True)`` afterwards.

    Kernels loaded from the cache are not reported.
    """
    with event.install_listener("numba:compile", _Outermost(report)):
        yield


class _Outermost(event.Listener):  # type: ignore[misc]  # numba has no types
    """Listener that reports only the outermost of nested compilations."""

    def __init__(self, report: Callable[[bool], None]) -> None:
        self._report = report
        self._depth = 0

    def on_start(self, event: Any) -> None:
        if self._depth == 0:
            self._report(False)
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._report(True)

"""Turns every failure of a command into one line on standard error and an exit code.

0: done. 1: the input was refused, or an internal error, which says so. 2: wrong usage. 130: Ctrl-C.
"""

from __future__ import annotations

import errno
import resource
import sys
import traceback
from collections.abc import Callable
from contextvars import ContextVar
from functools import wraps
from typing import NoReturn, ParamSpec

import typer

from slam.core.errors import InputError, explain, one_line

P = ParamSpec("P")

show_traceback: ContextVar[bool] = ContextVar("show_traceback", default=False)
"""Set by ``slam --debug``."""
LEAST_MEMORY_BYTES = 1 << 30
"""With a lower limit of the address space OpenBLAS ends the process or hangs when it is loaded."""


def guarded(command: Callable[P, None]) -> Callable[P, None]:
    """Wrap a command so that each exception becomes one line and an exit code."""

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            _check_memory_limit()
            command(*args, **kwargs)
        except KeyboardInterrupt:
            _leave("interrupted; nothing was written", 130)
        except (typer.Exit, BrokenPipeError):
            raise
        except Exception as error:  # noqa: BLE001  the last place to catch an exception
            if show_traceback.get():
                traceback.print_exc()
            _leave(_message(error), 1)

    return run


def _check_memory_limit() -> None:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < LEAST_MEMORY_BYTES:
        raise MemoryError


def _message(error: Exception) -> str:
    if _is_out_of_memory(error):
        return (
            "not enough memory; close other programs or raise the limit (ulimit -v), choose a coarser mosaic "
            "(a larger --gsd) or none (--no-mosaic)"
        )
    # The module is looked up, not imported: without memory an import would fail too.
    backend = sys.modules.get("backend.errors")
    if isinstance(error, InputError) or (backend is not None and isinstance(error, backend.BackendError)):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename}: {explain(error)}" if error.filename is not None else explain(error)
    return (
        f"internal error: {type(error).__name__}: {error}; a fault of slam, not of the input: run again as "
        "`slam --debug ...` and report what it prints"
    )


def _is_out_of_memory(error: Exception) -> bool:
    """Recognise the errors of Python, the system, OpenCV (cv::Error::StsNoMem) and the library loader."""
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    if isinstance(error, ImportError):
        return any(words in str(error) for words in ("failed to map segment", "cannot allocate memory"))
    if type(error).__module__.startswith("cv2"):
        return getattr(error, "code", 0) == -4
    return isinstance(error, MemoryError)


def _leave(line: str, code: int) -> NoReturn:
    print(f"slam: {one_line(line)}", file=sys.stderr)
    raise typer.Exit(code)

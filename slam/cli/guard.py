"""Turns every failure of a command into one line on standard error and an exit code.

0: done. 1: the input was refused, or an internal error, which says so. 2: wrong usage. 130: Ctrl-C.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from contextvars import ContextVar
from functools import wraps
from typing import ParamSpec

import typer

from slam.cli.limits import check_limits
from slam.cli.signals import INTERRUPTED, exit_code
from slam.cli.supervisor import LESS_MEMORY
from slam.core.errors import MORE_PROCESSES, InputError, explain, one_line

P = ParamSpec("P")

show_traceback: ContextVar[bool] = ContextVar("show_traceback", default=False)
"""Set by ``slam --debug``."""


def guarded(command: Callable[P, None]) -> Callable[P, None]:
    """Wrap a command so that each exception becomes one line and an exit code."""

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            check_limits()
            command(*args, **kwargs)
        except KeyboardInterrupt:
            print(INTERRUPTED, file=sys.stderr)
            raise typer.Exit(130) from None
        except (typer.Exit, BrokenPipeError):
            raise
        except Exception as error:  # noqa: BLE001  the last place to catch an exception
            if show_traceback.get():
                traceback.print_exc()
            code = exit_code()
            if code == 128 + signal.SIGINT:
                print(INTERRUPTED, file=sys.stderr)
            elif code is None:
                print_error(error)
            raise typer.Exit(code or 1) from None

    return run


def print_error(error: Exception) -> None:
    """Print one line on standard error: what went wrong, where, and what to do."""
    print(f"slam: {one_line(_message(error))}", file=sys.stderr)


def _message(error: Exception) -> str:
    if _is_out_of_memory(error):
        return f"not enough memory; {LESS_MEMORY}"
    # The module is looked up, not imported: without memory an import would fail too.
    backend = sys.modules.get("backend.errors")
    if isinstance(error, InputError) or (backend is not None and isinstance(error, backend.BackendError)):
        return str(error)
    if isinstance(error, OSError):
        return _system_message(error)
    if "can't start new thread" in str(error):  # CPython's only sign of it
        return f"no thread can be started; {MORE_PROCESSES}"
    return (
        f"internal error: {type(error).__name__}: {error}; a fault of slam, not of the input: run again as "
        "`slam --debug ...` and report what it prints"
    )


def _system_message(error: OSError) -> str:
    if error.filename is None:
        return explain(error)
    temporary = (os.environ.get("TMPDIR", "/tmp"), tempfile.tempdir)
    other = "; or set TMPDIR to another folder" if error.filename in temporary else ""
    return f"{error.filename}: {explain(error)}{other}"


def _is_out_of_memory(error: Exception) -> bool:
    """Recognise the errors of Python, the system, OpenCV (cv::Error::StsNoMem) and the library loader."""
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    if isinstance(error, ImportError):
        return any(words in str(error) for words in ("failed to map segment", "cannot allocate memory"))
    if type(error).__module__.startswith("cv2"):
        return getattr(error, "code", 0) == -4
    return isinstance(error, MemoryError)

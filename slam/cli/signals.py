"""Signals that end a run, also where a library loses the exception that they raise.

Python raises ``KeyboardInterrupt`` or ``SystemExit`` in whatever code runs. In a callback of a library, such
as numba's compiler, the exception is only printed, and the library then fails for another reason.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

INTERRUPTED = "slam: interrupted; nothing was written"
"""Message after Ctrl-C."""
_AGAIN_S = 0.05
"""Time after which a lost exception is raised again: callbacks of the compiler end within milliseconds."""

_received: list[int] = []
"""Signals that asked for the end of the run."""


def end_by_signals() -> None:
    """Let SIGINT raise ``KeyboardInterrupt`` and SIGTERM ``SystemExit``, which clean up output folders.

    An exception that a library loses is raised again a moment later, and is not printed. A SIGINT that the
    parent set to be ignored, as shells do for commands in the background, stays ignored.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end)
    signal.signal(signal.SIGTERM, _end)
    signal.signal(signal.SIGALRM, lambda *_: _end(_received[-1], None))
    sys.unraisablehook = _lost


def exit_code() -> int | None:
    """Return the exit code of a run that a signal asked to end; None where none did."""
    return 128 + _received[-1] if _received else None


@contextmanager
def noted_interrupt(line: str) -> Iterator[Callable[[], bool]]:
    """Only note the first Ctrl-C in the block, and print ``line``; a second one interrupts as usual.

    The value is a function that returns whether Ctrl-C was pressed.
    """
    before = signal.getsignal(signal.SIGINT)
    noted: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        signal.signal(signal.SIGINT, before)
        os.write(2, f"{line}\n".encode())  # a print may be interrupted in the middle of another one

    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or before is signal.SIG_IGN:
        yield lambda: False
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield lambda: bool(noted)
    finally:
        signal.signal(signal.SIGINT, before)


def _end(number: int, frame: FrameType | None) -> NoReturn:
    _received.append(number)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(128 + number)


def _lost(unraisable: sys.UnraisableHookArgs) -> None:
    if _received and issubclass(unraisable.exc_type, (KeyboardInterrupt, SystemExit)):
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
    else:
        sys.__unraisablehook__(unraisable)

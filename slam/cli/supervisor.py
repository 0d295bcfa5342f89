"""Runs the command in a child process, so that one line remains where the system kills it.

A process that runs out of memory is killed without notice (SIGKILL), and a crash in a library ends it too.
The parent stays small, waits, and then says what happened and what to do.
"""

from __future__ import annotations

import ctypes
import math
import os
import resource
import signal
import sys
from contextlib import suppress
from typing import NoReturn

LESS_MEMORY = (
    "close other programs, raise the limit (ulimit -v, or that of the container), choose a coarser mosaic "
    "(a larger --gsd) or none (--no-mosaic), or give a smaller input"
)
"""Advice where memory is short."""
_PASSED_ON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_AWAITED = {*_PASSED_ON, signal.SIGTSTP, signal.SIGCHLD}
_PR_SET_PDEATHSIG = 1
_WORDS = {
    signal.SIGKILL: "the system ended the run (SIGKILL) when it used {rss_mb:.0f} MB, most likely because "
    f"memory ran out; {LESS_MEMORY}",
    signal.SIGXCPU: "the limit of processor time was reached; raise it (ulimit -t)",
    signal.SIGBUS: "a file that was read shrank or its disk failed (SIGBUS); check the input and run again",
}


def continue_in_child() -> None:
    """Return in a child process; the parent waits for its end and exits with its code.

    Signals that a user sends to the parent are passed on, each once: the child is in a process group of its
    own. If the parent is killed, the system kills the child. Where no process can be started, and on systems
    other than Linux, the function returns in the calling process.
    """
    if sys.platform != "linux":
        return
    child_signal = signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # an inherited SIG_IGN would hide the end
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _AWAITED)
    parent = os.getpid()
    try:
        child = os.fork()
    except OSError:
        child = 0
    if child:
        with suppress(OSError):  # the child does it too; whoever is later fails
            os.setpgid(child, child)
        _leave_like(*_end_of(child))
    elif os.getpid() != parent:
        os.setpgid(0, 0)
        signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # it may print in the background
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before the system was asked to end this process with it
            os._exit(1)
    signal.signal(signal.SIGCHLD, child_signal)
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _end_of(child: int) -> tuple[int, resource.struct_rusage]:
    """Pass signals on until the child has ended; return its exit code and what it used."""
    while True:
        number = signal.sigwaitinfo(_AWAITED).si_signo
        if number == signal.SIGTSTP:
            os.killpg(child, signal.SIGSTOP)
            os.kill(os.getpid(), signal.SIGSTOP)  # until the shell continues this process
            os.killpg(child, signal.SIGCONT)
        elif number != signal.SIGCHLD:
            os.kill(child, number)
        ended, status, usage = os.wait4(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status), usage


def _leave_like(code: int, used: resource.struct_rusage) -> NoReturn:
    """Exit with the child's code, or with a line about the signal that ended it."""
    if code >= 0:
        os._exit(code)
    number = signal.Signals(-code)
    if number in _PASSED_ON:
        os._exit(128 + number)
    if number == signal.SIGKILL and used.ru_utime + used.ru_stime >= _limit_s():
        number = signal.SIGXCPU
    unknown = (
        f"internal error: a library crashed ({number.name}); run again as `slam --debug ...` and report it"
    )
    print(
        f"slam: {_WORDS.get(number, unknown).format(rss_mb=used.ru_maxrss / 1024)}",
        file=sys.stderr,
        flush=True,
    )
    os._exit(1)


def _limit_s() -> float:
    """Return the limit of processor time, at which the system first warns, then kills."""
    limit, _ = resource.getrlimit(resource.RLIMIT_CPU)
    return math.inf if limit == resource.RLIM_INFINITY else limit - 1

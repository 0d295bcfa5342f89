"""Ctrl-C and SIGTERM end a run, also where a library loses the exception that they raise."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest
import typer

from slam.cli import signals
from slam.cli.guard import guarded

CODES = [(signal.SIGINT, 130), (signal.SIGTERM, 143)]


@pytest.mark.parametrize(("number", "code"), CODES)
def test_an_exception_that_a_callback_loses_comes_again(number, code):
    script = f"""
import ctypes, os, sys, time
from slam.cli.signals import end_by_signals
end_by_signals()
ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), {int(number)}))()
try:
    time.sleep(600)
except KeyboardInterrupt:
    sys.exit(130)"""
    done = subprocess.run(
        [sys.executable, "-c", script], text=True, capture_output=True, check=False, timeout=300
    )
    assert (done.returncode, done.stderr) == (code, "")


@pytest.mark.parametrize(("number", "code"), CODES)
def test_an_error_that_follows_a_signal_is_not_reported(monkeypatch, capsys, number, code):
    """The compiler of numba fails after a callback whose exception was lost."""
    monkeypatch.setattr(signals, "_received", [number])

    @guarded
    def command() -> None:
        raise RuntimeError("no compiled object yet")

    with pytest.raises(typer.Exit) as left:
        command()
    assert left.value.exit_code == code
    assert "internal error" not in capsys.readouterr().err


def test_the_first_interrupt_is_noted_and_the_second_one_interrupts(capfd):
    def press() -> None:
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with signals.noted_interrupt("the flight ends here") as is_pressed:
        assert not is_pressed()
        press()
        assert is_pressed()
        with pytest.raises(KeyboardInterrupt):
            press()
    assert signal.getsignal(signal.SIGINT) is before
    assert capfd.readouterr().err == "the flight ends here\n"

"""Standard output and error belong to slam: what libraries write to them is not printed."""

from __future__ import annotations

import subprocess
import sys

import pytest


def output_of(job: str) -> tuple[str, str]:
    script = f"import os, sys\nfrom slam.cli.standard_streams import separate_streams, show_libraries\n{job}"
    done = subprocess.run([sys.executable, "-c", script], text=True, capture_output=True, check=True)
    return done.stdout, done.stderr


LIBRARY = "os.write(1, b'gtsam\\n'); os.write(2, b'libtiff\\n')"
"""A library in C writes past Python's streams."""


def test_libraries_are_silent_and_slam_is_not():
    job = f"separate_streams(); {LIBRARY}; print('table'); print('progress', file=sys.stderr)"
    assert output_of(job) == ("table\n", "progress\n")


def test_shown_libraries_write_to_standard_error_alone():
    job = f"separate_streams(); show_libraries(); {LIBRARY}; print('{{}}')"
    assert output_of(job) == ("{}\n", "gtsam\nlibtiff\n")


@pytest.mark.parametrize("closed", [(1,), (2,), (1, 2), (0, 1, 2)])
def test_closed_streams_swallow_what_is_written(closed):
    names = {0: "stdin", 1: "stdout", 2: "stderr"}
    job = "".join(f"os.close({number}); sys.{names[number]} = None; " for number in closed)
    job += f"separate_streams(); {LIBRARY}; sys.stdout.write('table'); sys.stderr.write('error')"
    job += f"; sys.stdout.flush(); sys.stderr.flush(); assert open({__file__!r}).fileno() not in (1, 2)"
    assert output_of(job) == ("" if 1 in closed else "table", "" if 2 in closed else "error")

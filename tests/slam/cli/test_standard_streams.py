"""Standard output and error belong to slam: what libraries write to them is not printed."""

from __future__ import annotations

import subprocess
import sys


def output_of(job: str) -> tuple[str, str]:
    script = f"import os, sys\nfrom slam.cli.standard_streams import own_streams, show_libraries\n{job}"
    done = subprocess.run([sys.executable, "-c", script], text=True, capture_output=True, check=True)
    return done.stdout, done.stderr


LIBRARY = "os.write(1, b'gtsam\\n'); os.write(2, b'libtiff\\n')"
"""A library in C writes past Python's streams."""


def test_libraries_are_silent_and_slam_is_not():
    job = f"own_streams(); {LIBRARY}; print('table'); print('progress', file=sys.stderr)"
    assert output_of(job) == ("table\n", "progress\n")


def test_shown_libraries_write_to_standard_error_alone():
    job = f"own_streams(); show_libraries(); {LIBRARY}; print('{{}}')"
    assert output_of(job) == ("{}\n", "gtsam\nlibtiff\n")


def test_a_file_never_takes_the_descriptor_of_a_closed_stream():
    job = "os.close(1); os.close(2); sys.stdout = sys.stderr = None\nown_streams()\n"
    assert output_of(f"{job}file = open({__file__!r})\nassert file.fileno() > 2") == ("", "")

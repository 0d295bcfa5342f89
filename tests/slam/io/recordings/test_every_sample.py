"""Every recorded sample is read with streams of plausible rows, or refused in one line."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from slam.cli.source import open_flight
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.flight_info import describe
from slam.core.progress import silent

ROOT = Path(os.environ.get("SLAM_DATA", "")) / "recordings"
SAMPLES = sorted(p for p in ROOT.rglob("*") if p.is_file()) if "SLAM_DATA" in os.environ else []
KINDS = (".bag", ".bin", ".db3", ".mcap", ".mp4", ".srt", ".tlog", ".ulg")
LONGEST_S = 1000.0
"""No sample is longer; a stray stamp would stretch it by years."""

pytestmark = pytest.mark.slow


def read(path: Path) -> tuple[Flight | None, str]:
    """Return the flight of a sample, or the line that refuses it."""
    try:
        return open_flight(path, silent)[0], ""
    except InputError as refusal:
        return None, str(refusal)


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.name)
def test_a_sample_is_read_or_refused_in_one_line(path):
    flight, refusal = read(path)
    assert "\n" not in refusal
    assert "its reader cannot read" not in refusal, "a foreign exception"
    if flight is None:
        return
    assert path.suffix.lower() in KINDS
    info = describe(flight)
    assert info.streams
    assert 0 <= info.duration_s < LONGEST_S
    assert all("\n" not in line for line in (*flight.warnings, *info.anomalies))


@pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")
def test_there_are_samples():
    assert {path.suffix.lower() for path in SAMPLES} >= set(KINDS)

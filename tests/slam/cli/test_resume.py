"""`slam optimize` goes on behind a kill, and its map is that of an uninterrupted run to the bit."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slam.io.flight_writer import write_flight
from tests.slam.small_flight import flown, only, photographs

pytestmark = pytest.mark.slow

PROGRAM = """
import os, signal, sys
from slam.cli import app
from slam.io.checkpoint_file import CheckpointFile
from slam.mapping.checkpoints import tracking
tracking.EVERY_S = 0.1
left, keep = int(sys.argv.pop(1)), CheckpointFile.keep
def kept(file, *result):
    global left
    keep(file, *result)
    left -= 1
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)
CheckpointFile.keep = kept
app()
"""
"""The command, killed behind so many results."""


def run(flight: Path, out: Path, killed_behind: int = 0, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PROGRAM, str(killed_behind), "optimize", str(flight), "--out", str(out)]
    return subprocess.run([*command, *options], capture_output=True, text=True, check=False)


def content(out: Path) -> dict[str, bytes]:
    """All results but times."""
    files = "graph.g2o", "trajectory.tum", "loops.csv", "mosaic.tif", "mosaic_quality.tif", "mosaic_chain.png"
    found = {name: (out / name).read_bytes() for name in files}
    with np.load(out / "estimate.npz") as arrays:
        found |= {name: arrays[name].tobytes() for name in arrays.files if name != "record"}
    summary = json.loads((out / "summary.json").read_text())
    times = ("timing_s", "peak_rss_mb")
    return found | {"summary": str({k: v for k, v in summary.items() if k not in times}).encode()}


@pytest.fixture(scope="module", params=["video", "photographs"])
def flight(request, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp(request.param) / "flight"
    is_video = request.param == "video"
    write_flight(
        only(flown(0), range(60)) if is_video else photographs([(flown(0), 4 * k) for k in range(16)]), path
    )
    return path


def test_a_map_behind_several_kills_is_that_of_one_run(flight, tmp_path):
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert run(flight, whole).returncode == 0
    resumed = []
    for behind in (2, 9, 4, 30, 20, 15, 6):
        done = run(flight, out, behind)
        resumed += [line for line in done.stderr.splitlines() if line.startswith("slam: resumed: ")]
        if done.returncode == 0:
            break
        assert done.returncode == -signal.SIGKILL
        assert not out.exists()
    else:
        assert run(flight, out).returncode == 0
    assert len(resumed) >= 3
    assert content(out) == content(whole)
    assert sorted(os.listdir(tmp_path)) == ["out", "whole"]


def test_a_run_with_other_settings_and_one_without_resume_start_anew(flight, tmp_path):
    out, config = tmp_path / "out", tmp_path / "config.toml"
    config.write_text("[keyframes]\nmin_overlap = 0.7\n")
    assert run(flight, out, 9).returncode == -signal.SIGKILL
    done = run(flight, out, 9, "--no-resume", "--no-mosaic")
    assert done.returncode == -signal.SIGKILL
    assert "resumed" not in done.stderr
    done = run(flight, out, 0, "--config", str(config), "--no-mosaic")
    assert done.returncode == 0, done.stderr
    assert "starts anew: since the run that was ended, the settings changed" in done.stderr
    assert "resumed" not in done.stderr

"""The commands that handle flights, on one of five seconds: files, refusals, interruption, repetition."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio

from slam.cli.output_folder import EVALUATE_NAMES, MAP_MCAP, OPTIMIZE_NAMES
from slam.cli.results import write_summary_and_report
from slam.io.atomic import locked
from slam.io.flight_folder import write_flight
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from tests.slam.cli.commands import assert_refused, run
from tests.slam.cli.tiny_flight import bytes_of, simulated
from tests.slam.evaluation.scene import estimate_of, flight_of, smooth_poses

MAIN = [sys.executable, "-m", "slam"]


def test_a_simulated_flight_is_the_same_for_the_same_seed(flight, tmp_path):
    assert bytes_of(simulated(tmp_path)) == bytes_of(flight)
    (tmp_path / "other").mkdir()
    assert bytes_of(simulated(tmp_path / "other", seed=4)) != bytes_of(flight)


def test_an_unknown_recipe_is_refused(tmp_path):
    assert_refused(run("simulate", "figure_nine", "--out", tmp_path / "flight"), "figure_eight")
    assert os.listdir(tmp_path) == []


def test_info_shows_the_streams(flight, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")  # as terminals set it
    result = run("info", flight)
    assert result.exit_code == 0
    for stream in ("cam0", "imu0", "sonar0", "attitude0"):
        assert stream in result.stdout
    assert "no GPS" in result.stdout


def test_info_tells_exchanged_axes_and_commands_on_another_clock(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    plan = stick_for(["pulse of 1 s forward at 0.25 and coast", "steps of 0.25 to 0.10 and 0.25 to -0.15"])
    flown = simulate_flight(load_model("nominal"), plan, 1)
    late = replace(flown.command, stamps_s=flown.command.stamps_s - 2.0)
    exchanged = replace(flown.velocity, v_m_s=flown.velocity.v_m_s[:, ::-1])
    told = {}
    for name, changes in (("sound", {}), ("late", {"command": late}), ("exchanged", {"velocity": exchanged})):
        write_flight(replace(flown, **changes), tmp_path / name)
        told[name] = run("info", tmp_path / name).stdout
    for name, words in (
        ("late", "the vehicle answers 2.0 s after its commands"),
        ("exchanged", "velocity ahead reads the velocity to the left that the accelerometer gives"),
    ):
        assert [other for other in told if words in told[other]] == [name]


def test_optimize_writes_every_file(done):
    assert set(os.listdir(done)) == set(OPTIMIZE_NAMES)
    summary = json.loads((done / "summary.json").read_text())
    assert set(summary) == {
        "status", "frames", "keyframes", "edges", "landmarks", "timing_s", "peak_rss_mb", "warnings",
        "height_sensor", "attitude", "accuracy_basis", "picture_clock", "not_drawn", "information_shares",
        "ground", "obstacles", "notes", "certificate", "rolling_shutter",
    }, "too short a flight for the accelerometer to tell"  # fmt: skip
    assert summary["status"] == "ok"
    assert summary["landmarks"] == 2
    assert summary["frames"] > summary["keyframes"] >= 4
    trajectory = np.loadtxt(done / "trajectory.tum")
    assert len(trajectory) == summary["keyframes"]
    assert re.match(r"\d+\.\d{9} ", (done / "trajectory.tum").read_text().splitlines()[1])
    with rasterio.open(done / "mosaic.tif") as mosaic:
        assert mosaic.crs is not None
        width_m = mosaic.width * mosaic.transform.a
    assert 1.0 < width_m < 3.5, "0.8 m flown under a view of about 1 m"
    report = (done / "report.html").read_text()
    assert report.count("data:image/jpeg;base64,") == 3, "before, after, and how far to trust it"


def test_a_second_run_renders_no_tile_that_the_first_one_has(flight, done, tmp_path):
    again = shutil.copytree(done, tmp_path / "out")
    assert run("optimize", flight, "--out", again, "--mcap").exit_code == 0
    assert (again / "mosaic.tif").read_bytes() == (done / "mosaic.tif").read_bytes()
    notes = [w for w in json.loads((again / "summary.json").read_text())["warnings"] if "tiles" in w]
    assert len(notes) == 1
    kept, tiles = re.match(r"mosaic: (\d+) of its (\d+) tiles did not change", notes[0]).groups()
    assert kept == tiles
    # The file for Foxglove is the one that an export makes of the map and its flight.
    assert set(os.listdir(again)) == {*OPTIMIZE_NAMES, MAP_MCAP}
    assert run("export", again, "--to", "mcap", "--photos", flight, "--quiet").exit_code == 0
    assert (tmp_path / "out.mcap").read_bytes() == (again / MAP_MCAP).read_bytes()


def test_evaluate_adds_its_files_and_a_second_run_replaces_all(flight, done, tmp_path):
    out = shutil.copytree(done, tmp_path / "out")
    result = run("evaluate", out, "--truth", flight)
    assert result.exit_code == 0, result.output
    assert "A-B" in result.stdout
    assert set(os.listdir(out)) == {*OPTIMIZE_NAMES, *EVALUATE_NAMES}
    unchanged = {*OPTIMIZE_NAMES} - {"report.html"}
    assert {n: b for n, b in bytes_of(out).items() if n in unchanged} == {
        n: b for n, b in bytes_of(done).items() if n in unchanged
    }
    page = (out / "report.html").read_text()
    assert "compared with the true path recorded with the flight, at" in page
    assert "evaluation_error.png" in page
    assert "Not measured yet" in (done / "report.html").read_text()
    assert run("evaluate", out, "--truth", flight, "--quiet").exit_code == 0
    assert (out / "report.html").read_text() == page
    (out / "report.html").write_text("<html></html>")
    assert "of an earlier version" in run("evaluate", out, "--truth", flight).stdout
    assert (out / "report.html").read_text() == "<html></html>"
    record = json.loads((out / "evaluation.json").read_text())
    assert {"ate_m", "ate_aligned_m", "ate_sim3_m", "rpe", "nees", "landmarks", "loops"} <= set(record)
    assert record["ate_m"]["rmse"] < 0.1
    # An output with an evaluation in it is still ours to replace: with the same map, and nothing that
    # spoke of the output before.
    assert run("optimize", flight, "--out", out, "--no-mosaic").exit_code == 0
    assert set(os.listdir(out)) == {n for n in OPTIMIZE_NAMES if not n.startswith("mosaic")}
    for name in ("trajectory.tum", "loops.csv"):
        assert (out / name).read_bytes() == (done / name).read_bytes()


def test_demo_gives_each_step_what_the_one_before_made(monkeypatch, tmp_path, no_figures):
    """With a flight and a map made by hand, and figures left empty."""
    poses, given = smooth_poses(np.random.default_rng(1), 40), []
    landmarks = {"A": np.array([0.0, 0.0, 0.0]), "B": np.array([1.0, 0.0, 0.0])}
    made = flight_of(poses, landmarks=landmarks, landmark_pairs=(("A", "B"),))
    mapped = estimate_of(poses)

    def write(folder, estimate, flight, options, progress, accuracy):
        given.append((estimate is mapped, flight is made, options.previous_output))
        return write_summary_and_report(folder, estimate, flight, accuracy=accuracy)

    monkeypatch.setattr("slam.simulation.simulate", lambda *asked: given.append(asked) or made)
    monkeypatch.setattr("slam.mapping.pipeline.optimize", lambda seen, **_: given.append(seen) or mapped)
    monkeypatch.setattr("slam.cli.results.write_results", write)
    out = tmp_path / "new" / "demo"
    result = run("demo", "--recipe", "tiny.toml", "--seed", 3, "--out", out)
    assert result.exit_code == 0, result.output
    assert given == [("tiny.toml", 3), made, (True, True, out)]
    assert {*EVALUATE_NAMES, "report.html", "summary.json"} <= set(os.listdir(out))
    for text in ("chain", "without loops", "with loops", "A-B", "report.html"):
        assert text in result.stdout
    assert "Against the reference" in (out / "report.html").read_text()


@pytest.mark.slow  # its three steps are those of the tests above
def test_demo_does_all_of_it(flight, tmp_path):
    result = run(
        "demo", "--recipe", flight.parent / "tiny.toml", "--seed", 3, "--out", tmp_path / "new" / "demo"
    )
    assert result.exit_code == 0, result.output
    out = tmp_path / "new" / "demo"
    assert set(os.listdir(out)) == {*OPTIMIZE_NAMES, *EVALUATE_NAMES}
    for text in ("chain", "without loops", "with loops", "A-B", "mosaic.png", "report.html"):
        assert text in result.stdout
    assert "Against the reference" in (out / "report.html").read_text()


# ---- refusals and damage


def test_a_second_run_at_the_same_time_is_refused(flight, tmp_path):
    with locked(tmp_path / "out"):
        assert_refused(run("optimize", flight, "--out", tmp_path / "out"), "another run")
    assert os.listdir(tmp_path) == []


# ---- interruption


def started(flight: Path, out: Path) -> subprocess.Popen:
    """A run in a process of its own that has begun to work."""
    command = [*MAIN, "optimize", str(flight), "--out", str(out), "--no-mosaic"]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stderr is not None
    assert process.stderr.readline(), process.communicate()[0]
    return process


@pytest.mark.parametrize(
    ("sent", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_an_interrupted_run_leaves_nothing(flight, tmp_path, sent, code):
    process = started(flight, tmp_path / "out")
    process.send_signal(sent)
    _, stderr = process.communicate(timeout=300)
    assert process.returncode == code
    assert stderr.endswith("slam: interrupted; nothing was written\n") == (sent == signal.SIGINT)
    assert "Traceback" not in stderr
    assert os.listdir(tmp_path) == []


@pytest.mark.slow
def test_after_a_kill_the_next_run_gets_the_same_result(flight, done, tmp_path):
    process = started(flight, tmp_path / "out")
    process.kill()
    process.communicate(timeout=300)
    assert not (tmp_path / "out").exists()
    assert run("optimize", flight, "--out", tmp_path / "out", "--no-mosaic").exit_code == 0
    assert (tmp_path / "out" / "trajectory.tum").read_bytes() == (done / "trajectory.tum").read_bytes()
    assert os.listdir(tmp_path) == ["out"], "what the killed run left is cleared away"


@pytest.mark.slow
def test_the_graph_keyframe_by_keyframe_is_in_the_table_and_in_the_report(flight, tmp_path):
    result = run("optimize", flight, "--out", tmp_path / "out", "--no-mosaic", "--incremental")
    assert result.exit_code == 0, result.stderr
    for text in (result.stdout, (tmp_path / "out" / "report.html").read_text()):
        assert "keyframe by keyframe" in text
        assert "edges rejected at the end of the flight, by the batch" in text

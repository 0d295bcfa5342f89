"""``slam replay`` and ``slam simulate --model`` on the command line: files, refusals, repetition."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from slam.cli.output_folder import REPLAY_NAMES
from slam.simulation.model import Model, save_model
from tests.slam.cli.commands import assert_refused, run
from tests.slam.cli.pulse_recipe import RECIPE


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("pulse")
    (folder / "pulse.csv").write_text("0,0,0,0,0\n500,0.2,0,0,0\n2000,0,0,0,0\n5000,0,0,0,0\n")
    (folder / "pulse.toml").write_text(RECIPE)
    save_model(Model(name="windy").with_term("steady_wind", x=1.0), folder / "windy.toml")
    for name, more in (("flight", ()), ("windy", ("--model", folder / "windy.toml"))):
        made = run("simulate", folder / "pulse.toml", "--out", folder / name, *more)
        assert made.exit_code == 0, made.output
    return folder


@pytest.mark.slow
def test_a_replay_writes_a_picture_and_a_summary_and_may_be_repeated(folder, tmp_path):
    for _ in range(2):
        result = run("replay", folder / "flight", "--model", "nominal", "--out", tmp_path / "out")
        assert result.exit_code == 0, result.output
        assert "velocity.v_x" in result.stdout
    assert set(os.listdir(tmp_path / "out")) == set(REPLAY_NAMES)
    assert (tmp_path / "out" / "replay.png").read_bytes().startswith(b"\x89PNG")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["flight"], summary["model"]) == ("pulse-seed-0", "nominal")
    assert set(summary["channels"]["velocity.v_x"]["rms"]) == {"0.5", "2", "10", "flight"}
    assert summary["channels"]["imu.gyro_x"]["unit"] == "rad/s"
    assert summary["rollouts"]["2"] >= 3


@pytest.mark.slow
def test_a_model_from_a_file_is_simulated_and_replayed(folder, tmp_path):
    def off(flight: str, model: object) -> float:
        out = tmp_path / f"{flight}-{Path(str(model)).stem}"
        result = run("replay", folder / flight, "--model", model, "--out", out)
        assert result.exit_code == 0, result.output
        return json.loads((out / "summary.json").read_text())["channels"]["velocity.v_x"]["rms"]["flight"]

    assert off("windy", folder / "windy.toml") < 0.12
    assert off("windy", "nominal") > 0.3
    assert off("flight", "nominal") < 0.12


def test_a_flight_without_commands_is_refused_in_one_line(folder, tmp_path):
    out = tmp_path / "out"
    assert_refused(
        run("replay", folder / "flight", "--model", "nomnal", "--out", out), "did you mean 'nominal'"
    )
    assert_refused(run("replay", folder / "gone", "--out", out), "does not exist")
    (tmp_path / "bad.toml").write_text("[terms.steady_wind]\nz = 1.0\n")
    assert_refused(
        run("replay", folder / "flight", "--model", tmp_path / "bad.toml", "--out", out),
        "terms.steady_wind.z",
    )
    assert not out.exists()
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("mine")
    assert_refused(run("replay", folder / "flight", "--out", full), "mine.txt")


def test_a_missing_model_is_refused(folder, tmp_path):
    assert_refused(
        run("simulate", folder / "pulse.toml", "--out", tmp_path / "f", "--model", "papre"),
        "did you mean 'paper'",
    )
    assert not (tmp_path / "f").exists()

"""Flights and settings that the commands refuse, and damage that they report."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.slam.cli.commands import assert_refused, run
from tests.slam.cli.tiny_flight import bytes_of, simulated


def test_an_existing_flight_is_not_overwritten(own):
    before = bytes_of(own)
    assert_refused(run("simulate", "square", "--out", own), "exists already")
    assert bytes_of(own) == before


def test_evaluate_without_a_reference_is_refused(own, done, tmp_path):
    shutil.rmtree(own / "mav0" / "state_groundtruth_estimate0")
    out = shutil.copytree(done, tmp_path / "out")
    assert_refused(run("evaluate", out, "--truth", own), "neither truth nor GPS")
    assert bytes_of(out) == bytes_of(done)


@pytest.mark.parametrize(
    ("text", "saying"),
    [("[keyframes]\nmin_overlop = 0.5\n", "overlap"), ("keyframes = 3\n", "keyframes"), ("[", "TOML")],
)
def test_bad_settings_are_refused(flight, tmp_path, text, saying):
    (tmp_path / "settings.toml").write_text(text)
    result = run("optimize", flight, "--out", tmp_path / "out", "--config", tmp_path / "settings.toml")
    assert_refused(result, saying)
    assert os.listdir(tmp_path) == ["settings.toml"]


def edit(path: Path, change) -> None:
    lines = path.read_text().splitlines()
    path.write_text("\n".join(change(lines)) + "\n")


@pytest.mark.parametrize(
    ("damage", "saying"),
    [
        (lambda f: shutil.rmtree(f / "mav0" / "cam0"), "no camera"),
        (lambda f: shutil.rmtree(f / "mav0"), ""),
        (lambda f: (f / "mav0" / "cam0" / "sensor.yaml").write_text("intrinsics: [1, 2\n"), "sensor.yaml"),
        (lambda f: (f / "mav0" / "cam0" / "data.csv").unlink(), "data.csv"),
    ],
)  # fmt: skip
def test_an_unusable_flight_is_refused_and_nothing_is_written(own, tmp_path, damage, saying):
    damage(own)
    assert_refused(run("optimize", own, "--out", tmp_path / "new" / "out"), saying)
    assert os.listdir(tmp_path) == ["own"]


def test_a_featureless_flight_is_refused(own, tmp_path):
    """Every picture shows grey ground and noise."""
    rng = np.random.default_rng(0)
    for file in sorted((own / "mav0" / "cam0" / "data").iterdir()):
        shape = cv2.imread(str(file)).shape
        grey = np.clip(rng.normal(128, 2, shape[:2]), 0, 255).astype(np.uint8)
        assert cv2.imwrite(str(file), grey)
    assert_refused(run("optimize", own, "--out", tmp_path / "out"), "texture")
    assert not (tmp_path / "out").exists()


def test_two_marks_on_bare_ground_are_refused_with_the_reason(tmp_path):
    flight, out = simulated(tmp_path, texture="plain"), tmp_path / "out"
    result = run("optimize", flight, "--no-mosaic", "--out", out)
    assert result.exit_code != 0
    assert "too few features, and its lines align with no other" in result.output.replace("\n", " ")
    assert not out.exists()


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (lambda f: _halve(sorted((f / "mav0/cam0/data").iterdir())[5]), "unreadable: truncated"),
        pytest.param(
            lambda f: edit(f / "mav0/sonar0/data.csv", _without_ninth_value), "sonar", marks=pytest.mark.slow
        ),
        pytest.param(
            lambda f: edit(f / "mav0/imu0/data.csv", lambda r: [*r[:9], r[10], r[9], *r[11:]]), "imu",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            lambda f: edit(f / "mav0/attitude0/data.csv", lambda r: [*r[:9], r[8], *r[9:]]), "attitude",
            marks=pytest.mark.slow,
        ),
    ],
    ids=["half a picture", "infinity in the sonar", "IMU unsorted", "attitude twice"],
)  # fmt: skip
def test_damage_is_counted_and_reported(own, tmp_path, damage, text, no_figures):
    damage(own)
    result = run("optimize", own, "--out", tmp_path / "out", "--no-mosaic")
    if result.exit_code == 0:
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        assert text in json.dumps([summary["warnings"], summary["edges"]["rejected"]])
    else:  # the format may refuse instead: in one line that names the place
        assert_refused(result, text)


def _without_ninth_value(rows: list[str]) -> list[str]:
    return [*rows[:9], rows[9].split(",")[0] + ",inf", *rows[10:]]


def _halve(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])

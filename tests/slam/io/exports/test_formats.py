"""The table of formats, and what every export has in common."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.messages import reason
from slam.io.exports.formats import CAMERA, FORMATS, PHOTOGRAPHS, PLACE, ExportKind, export_map
from tests.slam.io.exports.made_map import exported, made_map, pose

FILES = [known for known in FORMATS if not known.is_folder]


def test_the_command_line_lists_the_formats():
    assert get_args(ExportKind) == tuple(known.name for known in FORMATS)
    assert len({known.ending for known in FORMATS}) == len(FORMATS)


@pytest.mark.parametrize("known", FORMATS, ids=lambda known: known.name)
def test_a_map_without_what_a_format_needs_is_refused_in_one_line(known, tmp_path):
    without = {PLACE: {"origin": None}, CAMERA: {"camera": None}}
    for need in known.needs:
        if need in without:
            photos = tmp_path if PHOTOGRAPHS in known.needs else None
            lacking = exported(made_map(pose(), **without[need]), photos=photos)
            with pytest.raises(InputError, match=need.lack) as refused:
                export_map(lacking, known.name, tmp_path / "out")
            assert "\n" not in str(refused.value)
            assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("known", FILES, ids=lambda known: known.name)
def test_what_exists_is_neither_replaced_nor_touched(known, tmp_path):
    target = tmp_path / "mine"
    target.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        export_map(exported(made_map(pose())), known.name, target)
    assert target.read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_map_without_a_placed_keyframe_is_refused(tmp_path):
    with pytest.raises(InputError, match="no keyframe of the map is placed"):
        export_map(exported(made_map(np.full((4, 4), np.nan))), "tum", tmp_path / "out")


def test_a_failure_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("slam.io.exports.tum.pose_lines", lambda *a: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        export_map(exported(made_map(pose())), "tum", tmp_path / "out" / "poses.tum")
    assert list(tmp_path.iterdir()) == []


def test_limits_of_the_map_are_named(tmp_path):
    estimate = made_map(pose(), pose(), pose(), origin=None, component=np.array([0, 0, 1]), metric=False)
    estimate = replace(estimate, messages=(reason("the scale is not observed"),))
    notes = export_map(exported(estimate), "tum", tmp_path / "out")
    assert len(notes) == 3
    assert "the scale is not observed" in notes[0]
    assert "1 of 3 keyframes" in notes[1]
    assert "not in metres" in notes[2]
    assert len((tmp_path / "out").read_text().splitlines()) == 3, "a header and two poses"


def test_parts_of_a_map_with_a_place_on_earth_share_a_frame():
    estimate = made_map(pose(), pose(), pose(), component=np.array([0, 1, 1]))
    frames = exported(estimate).keyframes
    assert len(frames) == 3
    assert [part.tolist() for part in frames.parts()] == [[0], [1, 2]]


def test_the_covariance_of_a_sensor_is_that_of_a_lever():
    """A body that may turn by 0.1 rad about its left axis moves a sensor 2 m ahead of it up and down."""
    covariance = np.zeros((1, 6, 6))
    covariance[0, 1, 1] = 0.1**2
    frames = exported(made_map(pose(), covariances=covariance)).keyframes
    arm = np.eye(4)
    arm[0, 3] = 2.0
    ahead = frames.of_sensor(arm)
    np.testing.assert_allclose(ahead.w_T_b[0, :3, 3], [0, 2, 10], atol=1e-12)
    np.testing.assert_allclose(ahead.position_stds_m, [[0, 0, 0.2]], atol=1e-12)

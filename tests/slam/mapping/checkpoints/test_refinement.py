"""Rounds of a refinement whose minima are known take no step, and end with the same bits."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import gtsam
import numpy as np

from backend.bundle.checkpoints import PlainValues, use_checkpoints
from backend.bundle.refinement import Bundle, refine
from slam.core.packing import digest_of
from slam.io.checkpoint_file import CheckpointFile
from slam.mapping.checkpoints.refinement import RefinementCheckpoints
from tests.backend.bundle.made_scenes import SCENES
from tests.backend.made_floor import Made, make


def refined(made: Made, path: Path, said: list[str]) -> tuple[Bundle, int]:
    """Refine with what the file holds; the number is that of steps."""
    steps: list[int] = []
    with CheckpointFile(path, {}, say=said.append) as file, use_checkpoints(RefinementCheckpoints(file)):
        bundle = refine(
            made.measurements, made.start, made.floor_z_m, on_step=lambda step, error: steps.append(step)
        )
    return bundle, len(steps)


def content(bundle: Bundle) -> bytes:
    """All figures of a bundle, and its optimum."""
    figures = [getattr(bundle, each.name) for each in fields(bundle) if each.name != "optimum"]
    return digest_of((figures, PlainValues.of(bundle.optimum.values), bundle.optimum.at.point))


def test_a_refinement_of_known_rounds_takes_no_step_and_has_the_same_bits(tmp_path):
    made, said = make(SCENES["gps over a slope"], 0), []
    alone = content(refine(made.measurements, made.start, made.floor_z_m))
    bundle, steps = refined(made, tmp_path / "checkpoint", said)
    assert content(bundle) == alone
    assert steps > 2
    assert said == []
    bundle, steps = refined(made, tmp_path / "checkpoint", said)
    assert content(bundle) == alone
    assert steps == 0
    assert said == ["resumed: rounds of the refinement are known"]


def test_other_measurements_and_another_start_are_solved_anew(tmp_path):
    made, said = make(SCENES["gps over a slope"], 0), []
    refined(made, tmp_path / "checkpoint", said)
    first = made.measurements.positions[0]
    other = replace(first, std_m=2 * first.std_m)
    measurements = replace(made.measurements, positions=(other, *made.measurements.positions[1:]))
    start = made.start.copy()
    start[0, 0, 3] += 1e-9
    for changed in (replace(made, measurements=measurements), replace(made, start=start)):
        assert refined(changed, tmp_path / "checkpoint", said)[1] > 2
    assert said == []


def test_values_that_are_neither_poses_nor_vectors_are_not_kept():
    values = gtsam.Values()
    values.insert(1, gtsam.Pose3())
    values.insert(2, np.arange(3.0))
    plain = PlainValues.of(values)
    assert plain is not None
    assert plain.put_into(values).atVector(2).tolist() == [0, 1, 2]
    assert plain.put_into(gtsam.Values()) is None
    values.insert(3, gtsam.Rot3())
    assert PlainValues.of(values) is None

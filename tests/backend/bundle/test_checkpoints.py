"""A minimum is found by all that it depends on."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from backend.bundle import rounds
from backend.bundle.checkpoints import PlainMinimum, minimum_of, use_checkpoints
from backend.bundle.refinement import refine
from slam.core.packing import digest_of
from tests.backend.bundle.made_scenes import SCENES
from tests.backend.made_floor import make


class StoppedError(Exception):
    """The work would begin here."""


class Asked:
    """Checkpoints that know nothing, and note what they were asked for."""

    def __init__(self) -> None:
        self.keys: set[bytes] = set()

    def recall(self, made_of: object) -> PlainMinimum | None:
        self.keys.add(digest_of(made_of))
        return None

    def keep(self, made_of: object, found: PlainMinimum) -> None:
        raise AssertionError


def test_each_input_of_a_round_counts(monkeypatch):
    given: list[tuple] = []

    def noted(*inputs):
        given.append(inputs)
        raise StoppedError

    monkeypatch.setattr(rounds, "minimum_of", noted)
    made = make(SCENES["gps"], 0)
    with pytest.raises(StoppedError):
        refine(made.measurements, made.start, made.floor_z_m)
    cost, unobserved, start, limits, *_ = given[0]
    fewer, held, moved = cost.used.copy(), gtsam.Values(unobserved), gtsam.Values(start.values)
    fewer[0] = False
    held.insert(gtsam.symbol("z", 9), np.zeros(1))
    key = start.values.keys()[-1]
    moved.update(key, gtsam.Pose3())
    shorter = replace(cost.problem, config=replace(cost.problem.config, rounds=9))
    inputs = [
        (cost, unobserved, start, limits),
        (replace(cost, problem=shorter), unobserved, start, limits),
        (replace(cost, noise=replace(cost.noise, pixel_scale=9.0)), unobserved, start, limits),
        (replace(cost, used=fewer), unobserved, start, limits),
        (cost, held, start, limits),
        (cost, unobserved, replace(start, values=moved), limits),
        (cost, unobserved, replace(start, point=start.point + 1e-9), limits),
        (cost, unobserved, start, (limits[0] + 1, limits[1])),
    ]
    asked = Asked()
    with use_checkpoints(asked):
        for of in inputs:
            with pytest.raises(StoppedError):
                minimum_of(*of, noted, None)
    assert len(asked.keys) == len(inputs)

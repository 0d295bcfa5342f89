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
    (problem, noise, used, unobserved), start, limits, *_ = given[0]
    fewer, held, moved = used.copy(), gtsam.Values(unobserved), gtsam.Values(start.values)
    fewer[0] = False
    held.insert(gtsam.symbol("z", 9), np.zeros(1))
    key = start.values.keys()[-1]
    moved.update(key, gtsam.Pose3())
    inputs = [
        ((problem, noise, used, unobserved), start, limits),
        (
            (replace(problem, config=replace(problem.config, rounds=9)), noise, used, unobserved),
            start,
            limits,
        ),
        ((problem, replace(noise, pixel_scale=9.0), used, unobserved), start, limits),
        ((problem, noise, fewer, unobserved), start, limits),
        ((problem, noise, used, held), start, limits),
        ((problem, noise, used, unobserved), replace(start, values=moved), limits),
        ((problem, noise, used, unobserved), replace(start, point=start.point + 1e-9), limits),
        ((problem, noise, used, unobserved), start, (limits[0] + 1, limits[1])),
    ]
    asked = Asked()
    with use_checkpoints(asked):
        for cost_of, at, until in inputs:
            with pytest.raises(StoppedError):
                minimum_of(cost_of, at, until, noted, None)
    assert len(asked.keys) == len(inputs)

"""Keyframes that stand where their own pictures contradict them."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from backend.bundle.contradicted import contradicted_keyframes
from backend.bundle.graph import POSE
from backend.bundle.refinement import refine
from tests.backend.bundle.made_scenes import SONAR
from tests.backend.made_floor import make


def test_a_keyframe_away_from_its_place_is_contradicted_and_no_other_one():
    for seed in range(5):
        made = make(SONAR, seed)
        optimum = refine(made.measurements, made.start).optimum
        assert not contradicted_keyframes(optimum).any()
        values = gtsam.Values(optimum.values)
        aside = gtsam.Pose3(gtsam.Rot3(), np.array([0.05, 0.0, 0.0]))
        values.update(POSE(3), values.atPose3(POSE(3)).compose(aside))
        moved = replace(optimum, at=replace(optimum.at, values=values))
        assert np.flatnonzero(contradicted_keyframes(moved)).tolist() == [3]

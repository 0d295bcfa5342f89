"""Costs of a refinement at their start, for tests of its solver."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B as BIAS
from gtsam.symbol_shorthand import V as VELOCITY
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.graph import start_calibration, start_variables
from backend.bundle.minimise import BundleCost
from backend.bundle.noise import start_noise
from backend.bundle.problem import BundleConfig, BundleProblem, Variables
from tests.backend.bundle.made_scenes import SCENES
from tests.backend.made_floor import make


def posed(
    name: str,
    seed: int = 0,
    free_lens: bool = False,
    wild: float = 0.0,
    drop: float = 0.0,
    more: bool = False,
    unseen: Collection[int] = (),
) -> tuple[BundleCost, Variables]:
    """A scene at its start, with shares of wrong observations and of observations that are not used.

    Keyframes of ``unseen`` keep no observation.
    """
    made, rng = make(SCENES[name], seed), np.random.default_rng(seed)
    tracks = made.measurements.tracks
    pixel = tracks.pixel + rng.normal(0, 20, (len(tracks.track), 2)) * (
        rng.uniform(size=(len(tracks.track), 1)) < wild
    )
    measured = replace(made.measurements, tracks=replace(tracks, pixel=pixel))
    problem = BundleProblem(measured, measured.tracks, measured.camera, BundleConfig(), free_lens)
    at = start_variables(problem, made.start, made.floor_z_m)
    if free_lens:
        at = start_calibration(at, measured.camera)
    used = rng.uniform(size=len(tracks.track)) >= drop
    used &= ~np.isin(tracks.keyframe, list(unseen))
    cost = BundleCost.of(problem, start_noise(measured, problem.config), used, at.values)
    return with_more_variables(cost, at) if more else (cost, at)


def with_more_variables(cost: BundleCost, at: Variables) -> tuple[BundleCost, Variables]:
    """The same with a vector and a bias at each keyframe, tied to its pose and to those of the next one."""
    rng, n = np.random.default_rng(1), cost.problem.measurements.count
    values, unit = gtsam.Values(at.values), gtsam.noiseModel.Unit
    for k in range(n):
        values.insert(VELOCITY(k), rng.normal(size=3))
        values.insert(BIAS(k), gtsam.imuBias.ConstantBias(rng.normal(size=3), rng.normal(size=3)))
        prior = gtsam.PriorFactorVector(VELOCITY(k), rng.normal(size=3), unit.Create(3))
        cost.pose_side.add("inertial prior", prior)
        still = gtsam.PriorFactorConstantBias(BIAS(k), gtsam.imuBias.ConstantBias(), unit.Create(6))
        cost.pose_side.add("inertial prior", still)
    for k in range(n - 1):
        for keys in ((POSE(k), VELOCITY(k), BIAS(k)), (VELOCITY(k), POSE(k + 1), VELOCITY(k + 1))):
            blocks = [part for key in keys for part in (key, rng.normal(size=(2, values.dims()[key])))]
            tie = gtsam.JacobianFactor(*blocks, np.zeros(2), unit.Create(2))
            cost.pose_side.add("inertial interval", gtsam.LinearContainerFactor(tie, values))
    return cost, Variables(values, at.point)

"""The minimisation of a refinement: its second method, and what it says of a problem without a solution."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.minimise import minimise_bundle
from backend.bundle.problem import Variables
from backend.bundle.refinement import refine
from backend.errors import BackendError
from tests.backend.bundle.made_scenes import SCENES
from tests.backend.bundle.posed_costs import posed
from tests.backend.made_floor import make


def far_from(at: Variables, seed: int) -> Variables:
    """The same with poses and points displaced so far that an undamped step raises the error."""
    rng, values = np.random.default_rng(seed), gtsam.Values(at.values)
    for key in values.keys():  # noqa: SIM118
        if gtsam.Symbol(key).chr() == ord("x"):
            values.update(key, values.atPose3(key).retract(rng.normal(0, 0.25, 6)))
    return Variables(values, at.point + rng.normal(0, 0.25, at.point.shape))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_damped_steps_reach_the_optimum_where_undamped_ones_raise_the_error(seed: int) -> None:
    cost, at = posed("gps over a slope")
    errors: list[float] = []
    found = minimise_bundle(cost, far_from(at, seed), 200, 1e-10, lambda _, error: errors.append(error))
    assert len(errors) == found.iterations - 1  # the step that raised the error is counted, not reported
    assert (np.diff([found.initial_error, *errors]) <= 1e-6 * np.array(errors) + 1e-7).all()
    assert found.converged
    near = minimise_bundle(cost, at, 200, 1e-10)
    assert found.error == pytest.approx(near.error, rel=1e-6)
    for k in range(cost.problem.measurements.count):
        ours, theirs = (one.at.values.atPose3(POSE(k)).matrix() for one in (found, near))
        np.testing.assert_allclose(ours, theirs, atol=1e-4)


def test_open_directions_are_named() -> None:
    """Range and attitude remain for a keyframe without pictures: they say nothing about place and heading."""
    cost, at = posed("sonar", unseen=[3])
    with pytest.raises(BackendError) as caught:
        minimise_bundle(cost, at, 30, 1e-5)
    assert str(caught.value) == "under-determined: 3 directions around keyframe 3 not observed"


def test_a_start_that_is_not_finite_is_named() -> None:
    made = make(SCENES["sonar"], 0)
    start = made.start.copy()
    start[4, 0, 3] = np.nan
    with pytest.raises(BackendError, match="the start of keyframe 4 is not finite"):
        refine(made.measurements, start, made.floor_z_m)


def test_a_measurement_that_is_not_finite_is_named() -> None:
    cost, at = posed("sonar")
    pixel = cost.observations.pixel.copy()
    pixel[7] = np.inf
    wrong = replace(cost, observations=replace(cost.observations, pixel=pixel))
    where = f"keyframe {cost.observations.keyframe[7]}"
    with pytest.raises(BackendError, match=f"observation of a floor point from {where} has no finite error"):
        minimise_bundle(wrong, at, 30, 1e-5)
    model = gtsam.noiseModel.Unit.Create(3)
    cost.pose_side.add(
        "gauge", gtsam.PoseTranslationPrior3D(POSE(2), gtsam.Point3(np.full(3, np.nan)), model)
    )
    with pytest.raises(BackendError, match="PoseTranslationPrior3D on keyframe 2 has no finite error"):
        minimise_bundle(cost, at, 30, 1e-5)

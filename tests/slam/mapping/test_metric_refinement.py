"""Which instruments tell the lengths of one part, in which order, and what is said if one fails."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from backend.bundle.problem import ScalePrior
from backend.inertial_scale.scale import InertialScale, NoScale
from slam.core.imu_at_rest import GravityReading
from slam.core.progress import silent
from slam.mapping import metric_refinement
from slam.mapping.calibration.inertial_scale import AccelerometerScale, InertialComparison
from slam.mapping.metric_refinement import MetricRefinement

PAIRS = ("aligned by lines",)
PART = SimpleNamespace(members=np.arange(3), w_T_b=np.tile(np.eye(4), (3, 1, 1)), floor_z_m=0.0)
OWN = InertialScale(1.0, 0.0, *((0.0,) * 3, (0.1,) * 3) * 2, (0.0, 0.0, 1.0), (0.0,) * 3, (0.1,) * 3)


def setup_with(heights: tuple[object, ...], ranges: tuple[object, ...] = ()) -> Any:
    readings = SimpleNamespace(positions=(), ranges=ranges, heights=heights, stamps_s=np.arange(3.0))
    config = SimpleNamespace(trust=SimpleNamespace(accel_gain_std=0.02))
    return SimpleNamespace(
        readings=readings, control=(), camera=None, config=config, without_heights=lambda: setup_with(())
    )


def bundle_of(
    scale_std: float | None, by_velocity: bool, heights: tuple[object, ...] = ()
) -> SimpleNamespace:
    optimum = SimpleNamespace(problem=SimpleNamespace(measurements=SimpleNamespace(heights=heights)))
    return SimpleNamespace(
        scale_std=scale_std,
        uses_reported_motion=by_velocity,
        uses_barometer=bool(heights),
        optimum=optimum,
        w_T_b=PART.w_T_b,
        floor_z_m=0.0,
        noise=None,
    )


class Calls:
    """Refinements in place of the real ones, which note what they are given."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, ratio: float = 1.0, failing: int | None = None
    ) -> None:
        """The accelerometer's lengths have this ``ratio`` to the others; ``failing``: the number of the
        refinement with the velocity that fails."""
        self.first = 0
        self.by_velocity: list[tuple[int, ScalePrior | None]] = []
        self.aligned: list[object] = []
        self.gravity: list[object] = []
        self.failing = failing
        self.by_inertia = InertialComparison(None, AccelerometerScale(OWN, ScalePrior(ratio, 0.03), 0.02))
        for name, stub in (
            ("refine_part", self.refine),
            ("scaled_by_velocity", self.velocity),
            ("scaled_by_heights", self.heights),
            ("compare_with_inertia", self.compared),
            ("calibrated", lambda *_: None),
        ):
            monkeypatch.setattr(metric_refinement, name, stub)

    def refine(self, *_: object) -> object:
        self.first += 1
        return bundle_of(None, by_velocity=False)

    def compared(self, *given: object) -> InertialComparison:
        self.gravity.append(given[-1])
        return self.by_inertia

    def velocity(self, bundle: object, setup: Any, *given: Any) -> tuple[object, str]:
        *_, aligned, _, lengths = given
        self.by_velocity.append((len(setup.readings.heights), lengths))
        self.aligned.append(aligned)
        if len(self.by_velocity) == self.failing:
            return bundle, "no solution (too few points)"
        return bundle_of(0.02, by_velocity=True, heights=setup.readings.heights), ""

    def heights(self, *given: Any) -> tuple[object, str]:
        *_, aligned, _ = given
        self.aligned.append(aligned)
        return bundle_of(0.1, by_velocity=False), ""


def refinement(velocity: bool = True, gravity: GravityReading | None = None) -> MetricRefinement:
    given: Any = SimpleNamespace()
    return MetricRefinement(given, given, given, given if velocity else None, silent, PAIRS, gravity)  # type: ignore[arg-type]


def test_the_accelerometer_is_compared_with_a_velocity_without_the_barometer(monkeypatch) -> None:
    calls = Calls(monkeypatch)
    found = refinement().of(setup_with((1, 2)), PART)
    assert calls.by_velocity == [(0, None), (2, ScalePrior(1.0, 0.03))]
    assert calls.aligned == [PAIRS, PAIRS]
    assert isinstance(found.compared.scale, AccelerometerScale)


def test_pairs_by_lines_are_given_to_a_scale_by_the_barometer(monkeypatch) -> None:
    calls = Calls(monkeypatch, ratio=2.0)
    refinement(velocity=False).of(setup_with((1, 2)), PART)
    assert calls.aligned == [PAIRS]


@pytest.mark.parametrize(
    ("heights", "others"), [((), "the accelerometer"), ((1, 2), "the accelerometer and the barometer")]
)
def test_an_accelerometer_whose_refinement_fails_is_not_said_to_be_used(monkeypatch, heights, others) -> None:
    Calls(monkeypatch, failing=2)
    found = refinement().of(setup_with(heights), PART)
    assert isinstance(found.compared.scale, NoScale)
    assert found.bundle.scale_std == 0.02
    (remark,) = found.remarks
    failed = f"a refinement that adds {others} failed: no solution (too few points)"
    assert remark.text == f"lengths come from velocity0 alone; {failed}"


def test_a_velocity_that_tells_no_lengths_is_told_with_its_reason(monkeypatch) -> None:
    Calls(monkeypatch, failing=1)
    found = refinement().of(setup_with(()), PART)
    (line,) = found.reasons
    assert line.text == "velocity0 could not determine the metric scale: no solution (too few points)"


def test_what_the_refinement_without_a_wrong_barometer_tells_is_kept(monkeypatch) -> None:
    calls = Calls(monkeypatch, failing=4)
    monkeypatch.setattr(metric_refinement, "falls_where_the_camera_climbs", lambda heights, _: bool(heights))
    found = refinement().of(setup_with((1, 2)), PART)
    assert [heights for heights, _ in calls.by_velocity] == [0, 2, 0, 0]
    assert calls.first == 1, "the part without the barometer is known already"
    failed, left_out = map(str, found.remarks)
    assert failed.startswith("lengths come from velocity0 alone; a refinement that adds the accelerometer")
    assert left_out.startswith("barometer0 is left out of the map: it falls")


@pytest.mark.parametrize("is_off", [False, True])
def test_an_accelerometer_that_is_off_at_rest_takes_no_velocity_out(monkeypatch, is_off: bool) -> None:
    calls = Calls(monkeypatch, ratio=0.7)
    gravity = GravityReading(9.04, np.array([0.0, 0.0, 1.0]), at_rest=True) if is_off else None
    found = refinement(gravity=gravity).of(setup_with(()), PART)
    assert all(given is gravity for given in calls.gravity)
    assert calls.first == 1, "the part without the velocity is known already"
    assert found.velocity_left_out is not is_off
    assert found.bundle.uses_reported_motion is is_off
    told = [line for line in map(str, found.warnings) if "velocity0 reads" in line and "imu0" in line]
    assert bool(told) is not is_off
    if is_off:
        assert "lengths by the accelerometer differ" in str(found.compared.scale.contradiction)

"""What tells the lengths of a map where neither ranges nor positions do."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from backend.bundle.problem import ScalePrior
from backend.errors import BackendError
from backend.inertial_scale.scale import InertialScale, NoScale
from backend.measurements import BarometerHeight, Measurements
from slam.evaluation import evaluate
from slam.mapping.calibration.fallback_scale import (
    falls_where_the_camera_climbs,
    scaled_by_heights,
    scaled_by_velocity,
)
from slam.mapping.calibration.inertial_scale import AccelerometerScale, velocity_contradicted
from slam.mapping.metric_refinement import no_scale_line
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from tests.benchmarks.memory import recipe


@pytest.mark.parametrize(
    ("sign", "noise_m", "falls"),
    [(1.0, 0.1, False), (-1.0, 0.1, True), (-1.0, 5.0, False), (0.0, 0.1, False)],
)
def test_a_turned_sign_is_told_from_noise(sign, noise_m, falls):
    rng = np.random.default_rng(2)
    w_T_b = np.tile(np.eye(4), (30, 1, 1))
    w_T_b[:, 2, 3] = 2 + np.sin(np.arange(30) / 3)
    read = 400 + sign * w_T_b[:, 2, 3] + rng.normal(0, noise_m, 30)
    heights = [BarometerHeight(k, float(value), noise_m) for k, value in enumerate(read)]
    assert falls_where_the_camera_climbs(heights, w_T_b) is falls
    assert not falls_where_the_camera_climbs(heights[:3], w_T_b)


@pytest.mark.parametrize(
    ("ratio", "map_std", "contradicts"), [(0.5, 0.04, True), (0.5, 0.3, False), (1.05, 1e-3, False)]
)
def test_a_velocity_off_by_more_than_both_errors_is_contradicted(ratio, map_std, contradicts):
    own = InertialScale(ratio, 0.0, *((0.0,) * 3, (0.1,) * 3) * 2, (0.0, 0.0, 1.0), (0.0,) * 3, (0.1,) * 3)
    found = velocity_contradicted(AccelerometerScale(own, ScalePrior(ratio, 0.03), map_std))
    # The deviation of the ratio is that of both.
    assert str(found).startswith(f"velocity0 reads {1 / ratio:.2f} (± 5 %) times the speed") is contradicts
    assert velocity_contradicted(NoScale("hovers")) is None


@pytest.mark.parametrize("scaled", [scaled_by_heights, scaled_by_velocity])
def test_a_part_tied_by_too_little_keeps_its_bundle(scaled, monkeypatch):
    """Pairs by lines count as ties; a refusal is a reason, and no error of the part."""
    seen = []

    def refuses(*given: object) -> Measurements:
        seen.append(given[3])
        raise BackendError("too few points")

    monkeypatch.setattr("slam.mapping.calibration.fallback_scale.part_measurements", refuses)
    bundle = SimpleNamespace(w_T_b=np.eye(4)[None], floor_z_m=0.0, noise=None)
    setup = SimpleNamespace(config=SimpleNamespace(bundle=None), camera=None)
    motion = (None, None) if scaled is scaled_by_velocity else ()
    kept, reason = scaled(bundle, setup, np.arange(1), None, *motion, ("pair",))
    assert kept is bundle
    assert "too few points" in reason
    assert seen == [("pair",)]


def test_heights_of_the_wrong_sign_are_refused_with_what_to_do(monkeypatch):
    w_T_b = np.tile(np.eye(4), (30, 1, 1))
    w_T_b[:, 2, 3] = 2 + np.sin(np.arange(30) / 3)
    heights = [BarometerHeight(k, 400.0 - z, 0.1) for k, z in enumerate(w_T_b[:, 2, 3])]
    problem = SimpleNamespace(measurements=SimpleNamespace(heights=heights))
    found = SimpleNamespace(uses_barometer=True, optimum=SimpleNamespace(problem=problem))
    module = "slam.mapping.calibration.fallback_scale"
    monkeypatch.setattr(f"{module}.part_measurements", lambda *_: None)
    monkeypatch.setattr(f"{module}.refine", lambda *_: found)
    bundle = SimpleNamespace(w_T_b=w_T_b, floor_z_m=0.0, noise=None)
    setup = SimpleNamespace(config=SimpleNamespace(bundle=None))
    kept, reason = scaled_by_heights(bundle, setup, np.arange(30), None, ())
    assert kept is bundle
    line = no_scale_line("barometer0", reason)
    assert line.verdict == "barometer0 could not determine the metric scale"
    assert line.next_step.startswith("check its sign")


@pytest.mark.slow
def test_a_velocity_that_is_stated_exact_tells_lengths_beside_an_imu():
    """The accelerometer's lengths, known to 4 %, had taken its place: the map was 140 mm off instead of 5."""
    flight = replace(simulate(recipe(1)), sonar=None)
    assert flight.velocity.scale_std == 0.0
    estimate = optimize(flight)
    assert estimate.scale_std < 0.01
    assert evaluate(estimate, flight).ate_m.rmse < 0.02
    fast = replace(flight.velocity, v_m_s=1.5 * flight.velocity.v_m_s)
    wrong = optimize(replace(flight, velocity=fast))
    assert "velocity0 reads 1.4" in wrong.status or "velocity0 reads 1.5" in wrong.status
    assert wrong.scale_std > 0.03

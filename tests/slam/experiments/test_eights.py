"""The thesis's eights: paths as long as its own, methods that are right on exact readings, a fair verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.rotations import roll_pitch_yaw_of
from slam.core.streams import AttitudeSeries, Velocity
from slam.evaluation.thesis_values import FREEDOM_MM, HALL, MAGAZINES, PATH_M
from slam.experiments import eights
from slam.experiments.experiment import Trial
from slam.simulation.manoeuvre import plan
from tests.slam.small_flight import flown


@pytest.mark.parametrize("floor", PATH_M)
def test_a_path_is_as_long_as_the_thesis_s(floor):
    """Within a seventh: a real path is not as straight."""
    recipe = eights.recipe_of(floor)
    path = plan(recipe.maneuver, recipe.landmarks, recipe.world.extent_m)
    at_s = np.arange(0.0, path.duration_s, 0.05)
    length_m = np.linalg.norm(np.diff(path.derivatives[0](at_s)[:, :2], axis=0), axis=1).sum()
    assert length_m == pytest.approx(PATH_M[floor], rel=1 / 7)


def test_exact_velocity_leads_along_the_true_path():
    flight = flown(1)
    truth = flight.truth
    angles = roll_pitch_yaw_of(truth.w_T_b[:, :3, :3])
    w_v = np.gradient(truth.w_T_b[:, :2, 3], truth.stamps_s, axis=0)
    turned = np.exp(-1j * angles[:, 2]) * (w_v[:, 0] + 1j * w_v[:, 1])
    exact = replace(
        flight,
        attitude=AttitudeSeries(truth.stamps_s, angles, np.full(3, 0.01)),
        velocity=Velocity(truth.stamps_s, np.column_stack([turned.real, turned.imag])),
    )
    assert eights.error_m(exact, *eights._by_velocity(exact)) < 2e-3


def test_a_method_that_lost_its_way_has_no_error():
    flight = flown(1)
    stamps_s, positions = flight.truth.stamps_s, flight.truth.w_T_b[:, :3, 3].copy()
    assert eights.error_m(flight, stamps_s, positions) == pytest.approx(0.0, abs=1e-9)
    positions[len(positions) // 2 :] = np.nan
    assert np.isnan(eights.error_m(flight, stamps_s, positions))


def trials(
    freedom: dict[str, float], hall: float, visual: float = 0.3, coarse: float = np.nan
) -> tuple[Trial, ...]:
    figures = {f"{MAGAZINES}/{name}": value for name, value in freedom.items()}
    figures |= {f"{MAGAZINES}/{eights.VISUAL}": visual, f"{MAGAZINES}/{eights.MAP}": 0.002}
    figures |= {f"{HALL}/{eights.MAP}": hall, "resolution/33": coarse, "resolution/100": 0.1}
    return (Trial(0, figures),)


def test_the_verdict_is_on_degrees_of_freedom_and_resolution():
    """And two-sided: errors far smaller than the real ones do not agree."""
    told = dict(zip(FREEDOM_MM, (0.3, 0.4, 2.0), strict=True))
    agrees = eights.EXPERIMENT.conclude(trials(told, np.nan))
    assert agrees.verdict == "agrees"
    assert "no map" in agrees.reason
    assert HALL in agrees.reason
    assert eights.EXPERIMENT.conclude(trials(told, np.nan, visual=0.013)).verdict == "agrees in part"
    turned = {**told, "translation": 3.0}
    for coarse, by_freedom, expected in (
        (np.nan, turned, "agrees in part"),
        (0.2, told, "agrees"),
        (0.05, told, "agrees in part"),
        (0.05, turned, "does not agree"),
    ):
        assert eights.EXPERIMENT.conclude(trials(by_freedom, 0.1, coarse=coarse)).verdict == expected
    lost = eights.EXPERIMENT.conclude(trials(dict.fromkeys(FREEDOM_MM, float("nan")), 0.1))
    assert "not in that order" in lost.reason

"""The incremental estimation with an IMU: it goes on where no picture joins, with an honest covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2

from backend import se3
from backend.errors import BackendError
from backend.measurements import (
    Attitude,
    Inertial,
    InertialNoise,
    InertialReadings,
    Measurements,
    RelativePose,
    SlantRange,
)
from backend.pose_graph.incremental.estimation import Incremental
from backend.pose_graph.incremental.inertial_noise import FlightNoise
from backend.pose_graph.solve import solve
from backend.preintegration.intervals import InertialInterval, preintegrate
from tests.backend.made_motion import MadeFlight, fly
from tests.benchmarks.inertial_bound import navigation_bound_m

LASTS_S, STEP_S, GAP_S, IMU_S = 12.0, 0.3, 2.0, 0.005
EDGE_STD = np.array([2e-3, 2e-3, 2e-3, 3e-3, 3e-3, 3e-3])
TILT_STD_RAD, RANGE_STD_M = 5e-3, 5e-3
NOISE = InertialNoise(gyro_offset_rad_s=0.01, accel_offset_m_s2=0.1)


@dataclass(frozen=True)
class Flown:
    """A flight with a gap between its pictures in the middle."""

    truth: np.ndarray
    """(n, 4, 4)."""
    edges: tuple[RelativePose, ...]
    attitudes: tuple[Attitude, ...]
    ranges: tuple[SlantRange, ...]
    stamps_s: np.ndarray
    inertial: Inertial
    gap: int
    """Last keyframe before the gap."""

    @cached_property
    def intervals(self) -> dict[int, InertialInterval]:
        """Later keyframe -> readings since the one before."""
        return {one.j: one for one in preintegrate(self.inertial, self.stamps_s, of_body=True)}

    @property
    def measurements(self) -> Measurements:
        """All measurements."""
        return Measurements(self.stamps_s, self.edges, self.attitudes, self.ranges, inertial=self.inertial)

    def replayed(self, with_imu: bool = True, **options) -> Incremental:
        """Add all keyframes."""
        live = Incremental(**options)
        for k in range(len(self.truth)):
            edges = tuple(e for e in self.edges if max(e.i, e.j) == k)
            inertial = self.intervals.get(k) if with_imu else None
            live.add(edges, (self.attitudes[k],), (self.ranges[k],), inertial=inertial)
        return live

    def off(self, w_T: np.ndarray) -> np.ndarray:
        """Return the error (n, 6) of poses relative to the first."""
        estimate, truth = (se3.inverse(T[0]) @ T for T in (w_T, self.truth))
        return se3.log(se3.inverse(truth) @ estimate)


def flown(seed: int, gyro_turned: bool = False, vibration: float = 1.0) -> Flown:
    rng = np.random.default_rng(seed)
    flight = fly(rng)
    stamps_s = np.arange(0.0, LASTS_S, STEP_S)
    seen = (stamps_s <= LASTS_S / 2) | (stamps_s >= LASTS_S / 2 + GAP_S)
    gap, stamps_s = int(np.argmin(seen)) - 1, stamps_s[seen]
    truth = flight.w_T_b(stamps_s)
    edges = [_edge(truth, k, k + 1, "odometry", rng) for k in range(len(truth) - 1) if k != gap]
    tilt = flight.angles.at(stamps_s)[:, :2] + rng.normal(0, TILT_STD_RAD, (len(truth), 2))
    std_rad = np.array([TILT_STD_RAD, TILT_STD_RAD, np.inf])
    slant = flight.slant(stamps_s) + rng.normal(0, RANGE_STD_M, len(truth))
    inertial = Inertial(readings(flight, rng, gyro_turned, vibration), NOISE)
    return Flown(
        truth=truth,
        edges=tuple(edges),
        attitudes=tuple(Attitude(k, np.array([*t, np.nan]), std_rad) for k, t in enumerate(tilt)),
        ranges=tuple(SlantRange(k, float(r), RANGE_STD_M) for k, r in enumerate(slant)),
        stamps_s=stamps_s,
        inertial=inertial,
        gap=gap,
    )


def _edge(truth: np.ndarray, i: int, j: int, kind, rng: np.random.Generator) -> RelativePose:
    noise = se3.exp(rng.normal(0, EDGE_STD)[None])[0]
    return RelativePose(i, j, se3.inverse(truth[i]) @ truth[j] @ noise, np.diag(EDGE_STD**2), kind)


def readings(
    flight: MadeFlight, rng: np.random.Generator, gyro_turned: bool, vibration: float
) -> InertialReadings:
    """Return readings with white noise, ``vibration`` times the nominal one, and constant offsets."""
    at_s = np.arange(-0.1, LASTS_S + 0.1, IMU_S)
    gyro, accel = (
        true + rng.normal(0, vibration * density / np.sqrt(IMU_S), true.shape) + rng.normal(0, offset, 3)
        for true, density, offset in (
            (flight.body_rate(at_s), NOISE.gyro_density, NOISE.gyro_offset_rad_s),
            (flight.force(at_s), NOISE.accel_density, NOISE.accel_offset_m_s2),
        )
    )
    return InertialReadings(at_s, gyro[:, [1, 0, 2]] if gyro_turned else gyro, accel)


def with_loop(made: Flown, off_m: float, seed: int) -> Flown:
    """Return the flight with a loop over the gap that is wrong by ``off_m``."""
    rng = np.random.default_rng(seed)
    loop = _edge(made.truth, made.gap - 5, made.gap + 6, "loop", rng)
    wrong = se3.exp(np.array([[0.0, 0.0, 0.0, off_m, 0.0, 0.0]]))[0]
    return replace(made, edges=(*made.edges, replace(loop, i_T_j=loop.i_T_j @ wrong)))


def bridge_nees(seed: int) -> float:
    made = flown(seed)
    (bridge,) = made.replayed().bridges()
    assert (bridge.i, bridge.j, bridge.kind) == (made.gap, made.gap + 1, "inertial")
    true = se3.inverse(made.truth[bridge.i][None]) @ made.truth[bridge.j]
    off = se3.log(se3.inverse(true) @ bridge.i_T_j)[0]
    return float(off @ np.linalg.solve(bridge.covariance, off))


def test_readings_bridge_a_gap_between_pictures():
    made = flown(1)
    off = made.off(made.replayed().trajectory())
    assert np.abs(off[:, 3:]).max() < 3 * navigation_bound_m(GAP_S, NOISE.gyro_density, NOISE.accel_density)


@pytest.mark.parametrize("vibration", [1.0, 5.0])
def test_the_noise_in_flight_is_found_from_the_pictures_before(vibration: float):
    made, noise = flown(3, vibration=vibration), FlightNoise()
    assert noise.factors() is None
    for edge in made.edges:
        noise.add(made.intervals[edge.j], edge, made.truth[edge.i, :3, :3])
    assert noise.factors() == (pytest.approx(vibration, rel=0.3), pytest.approx(vibration, rel=0.3))


@pytest.mark.slow
def test_the_bridge_over_a_gap_has_an_honest_covariance():
    nees = sum(bridge_nees(seed) for seed in range(30))
    assert chi2.ppf(0.005, 6 * 30) < nees < chi2.ppf(0.995, 6 * 30)


def test_without_readings_nothing_joins_what_lies_behind_a_gap():
    made = flown(1)
    with pytest.raises(BackendError, match=f"no relative pose joins keyframe {made.gap + 1} "):
        made.replayed(with_imu=False)


@pytest.mark.slow
def test_a_loop_over_the_gap_corrects_the_bridge_or_is_rejected_if_it_is_false():
    alone = flown(2)
    before = np.abs(alone.off(alone.replayed().trajectory())[-1, 3:]).max()
    true, false = (with_loop(alone, off_m, seed=3).replayed(budget_s=np.inf) for off_m in (0.0, 1.0))
    assert not true.rejected
    assert np.abs(alone.off(true.trajectory())[-1, 3:]).max() < before
    assert [edge.kind for edge in false.rejected] == ["loop"]
    assert np.abs(alone.off(false.trajectory())[-1, 3:]).max() < 2 * before + 0.02


def test_the_final_solve_is_near_that_of_the_batch_with_the_bridge_as_an_edge():
    made = flown(4)
    live = made.replayed()
    in_flight = live.trajectory()
    live.settle()
    edges = (*made.edges, *live.bridges())
    batch = solve(replace(made.measurements, relative_poses=edges), covariances=False)
    settled = made.off(live.trajectory())[:, 3:]
    std_m = np.sqrt(np.trace(live.bridges()[0].covariance[3:, 3:]))
    assert np.abs(settled - made.off(batch.w_T_b)[:, 3:]).max() < 0.2 * std_m
    assert np.abs(settled - made.off(in_flight)[:, 3:]).max() < std_m


def test_a_gyro_with_swapped_axes_is_left_out():
    made = flown(5, gyro_turned=True)
    with pytest.raises(BackendError, match=f"no relative pose joins keyframe {made.gap + 1} "):
        made.replayed()


def test_the_prior_on_the_bias_counts_once_however_often_readings_are_lost():
    made = flown(0)
    for k in (24, 27, 30):
        del made.intervals[k]
    graph = made.replayed()._received.graph()
    factors = [graph.at(k) for k in range(graph.size())]
    assert sum(isinstance(f, gtsam.PriorFactorConstantBias) for f in factors) == 1
    assert sum(isinstance(f, gtsam.BetweenFactorConstantBias) for f in factors) == 3

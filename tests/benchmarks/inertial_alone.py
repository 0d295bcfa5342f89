"""Camera and IMU alone over lively simulated flights: the scale, and the errors of the IMU and of its clock.

No range, position or speed is recorded. The accelerometer has a gain, an offset and an undeclared lever arm,
the pictures an undeclared delay, each drawn anew for each flight. The map states the scale and these errors
with standard deviations; errors over standard deviations are compared with their distribution.

``python -m tests.benchmarks.inertial_alone FIRST LAST`` runs some of them and prints one line of JSON each.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, RotationSpline
from scipy.stats import binom, norm

from backend.measurements import GRAVITY_M_S2
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.config import SensorTrust
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from tests.benchmarks.alone import print_alone
from tests.benchmarks.calibration import judged
from tests.benchmarks.inertial_bound import accel_noise_std_m_s2, known_path, lever_force
from tests.benchmarks.instrument_flights import ACCEL_OFFSET_M_S2, GYRO_OFFSET_RAD_S, corners
from tests.benchmarks.metric import Metric, at_least, at_most, reported

FLIGHTS, CORES = 8, 2
ARM_M, DELAY_S = 0.05, 0.03
"""Standard deviations of the lever arm along each axis, and of the delay of the pictures' clock."""
SIGMAS, SHARE = 2.0, 0.95
EXACT = "bound of Cramér and Rao, with pictures that show the path exactly"

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recovered:
    """Result of one flight."""

    seed: int
    status: str
    bound_percent: float
    """Least standard deviation of the scale that any estimator of these readings has, if its pictures show
    the path exactly."""
    known_path_percent: float = np.nan
    """Absolute error of the scale of an estimate from the same readings that reaches this bound."""
    scale_percent: float = np.nan
    """Absolute error of the map's lengths; NaN without metres."""
    scale_nees: float = np.nan
    """Squared ratio of the scale's error to its reported standard deviation."""
    offset_sigmas: tuple[float, ...] = ()
    """Error of the accelerometer's offset along each axis over its reported standard deviation; empty if it
    is not reported."""
    arm_sigmas: tuple[float, ...] = ()
    """The same of its lever arm."""
    delay_sigmas: tuple[float, ...] = ()
    """The same of the pictures' delay, one value."""


def measure() -> list[Metric]:
    """Return the figures over all flights."""
    with ProcessPoolExecutor(CORES, mp_context=get_context("spawn")) as pool:
        return figures(list(pool.map(fly, range(FLIGHTS))))


def figures(found: list[Recovered]) -> list[Metric]:
    """Return the figures of some flights."""
    percent = np.array([f.scale_percent for f in found])
    metric = np.isfinite(percent)
    median = float(np.median(percent[metric])) if metric.any() else np.nan
    bounds = np.array([f.bound_percent for f in found])
    known = np.array([f.known_path_percent for f in found])
    allowed = float(norm.ppf(0.75) * np.median(bounds))
    scatter = _median_std(bounds, len(found))
    worst = f"largest {np.max(percent[metric]):.3g} %" if metric.any() else ""
    metrics = [
        at_least(f"lively flights of {len(found)} with a metric scale", metric.sum(), "", len(found)),
        at_most("error of the scale, median", median, "%", 0.5, worst),
        reported(
            "least median error of the scale that the noise of the accelerometer allows", allowed, "%",
            f"{EXACT}; the median of {len(found)} flights scatters by {scatter:.2g} %",
        ),
        reported(
            "error of the scale over that of an estimate that knows the path up to its scale, RMS of each",
            _rms(percent[metric]) / _rms(known[metric]), "x", "the same readings; chance cancels",
        ),
    ]  # fmt: skip
    if metric.any():
        metrics += judged("scale", np.array([f.scale_nees for f in found])[metric], 1)
    for name, sigmas in (
        ("offset of the accelerometer", [f.offset_sigmas for f in found]),
        ("lever arm of the accelerometer", [f.arm_sigmas for f in found]),
        ("delay of the pictures", [f.delay_sigmas for f in found]),
    ):
        metrics.append(_recovered(name, [abs(s) for each in sigmas for s in each], len(found)))
    return metrics


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


def _median_std(std: Array, count: int) -> float:
    """Return the standard deviation of the median size of ``count`` normal errors, to first order in 1/count.

    Source: Cramér 1946, Mathematical Methods of Statistics, section 28.5: 1 / (2 f sqrt(n)), with the density
    f of the sizes at their median.
    """
    density = 2 * norm.pdf(norm.ppf(0.75)) / np.median(std)
    return float(1 / (2 * density * np.sqrt(count)))


def _recovered(name: str, sigmas: list[float], flights: int) -> Metric:
    """Return the share of components within their reported two standard deviations."""
    what = f"{name}: components within {SIGMAS:g} reported standard deviations"
    if not sigmas:
        return reported(what, 0.0, "%", f"not reported on any of {flights} flights")
    share = 100 * float(np.mean(np.array(sigmas) < SIGMAS))
    # The least share that 95 % leave by chance.
    least = 100 * float(binom.ppf(0.025, len(sigmas), SHARE)) / len(sigmas)
    return at_least(what, share, "%", least, f"{len(sigmas)} components; {100 * SHARE:g} % expected")


def fly(seed: int) -> Recovered:
    """Simulate one flight, map it with camera and IMU, and compare."""
    rng = np.random.default_rng((seed, 13))
    gain = 1 + SensorTrust.accel_gain_std * rng.normal()
    offset_m_s2, arm_m = rng.normal(0, ACCEL_OFFSET_M_S2, 3), rng.normal(0, ARM_M, 3)
    delay_s = float(rng.normal(0, DELAY_S))
    flight = lively(seed, rng)
    assert flight.imu is not None
    assert flight.truth is not None
    recorded, truth = flight.imu, flight.truth
    turn = RotationSpline(truth.stamps_s, Rotation.from_matrix(truth.w_T_b[:, :3, :3]))
    at_s = np.clip(recorded.stamps_s, truth.stamps_s[0], truth.stamps_s[-1])
    accel_m_s2 = gain * (recorded.accel_m_s2 + lever_force(turn, at_s, arm_m)) + offset_m_s2
    noise_std_m_s2 = accel_noise_std_m_s2(recorded)
    path = known_path(
        truth, recorded.stamps_s, noise_std_m_s2, SensorTrust.accel_gain_std, ACCEL_OFFSET_M_S2, ARM_M
    )
    imu = replace(
        recorded,
        accel_m_s2=accel_m_s2,
        gyro_rad_s=recorded.gyro_rad_s + rng.normal(0, GYRO_OFFSET_RAD_S, 3),
    )
    flight = replace(flight, imu=imu, sonar=None, velocity=None)
    late = flight.restamped(["frames"], lambda stamps_s: stamps_s + delay_s)
    bounds_percent = 100 * path.scale_std, 100 * abs(path.scale_error(accel_m_s2))
    try:
        estimate = optimize(late)
    except InputError as refused:
        return Recovered(seed, f"no map: {refused}", *bounds_percent)
    found = evaluate(estimate, flight)
    errors = estimate.instruments.accelerometer
    result = Recovered(seed, estimate.status, *bounds_percent)
    if estimate.metric and estimate.scale_std is not None:
        result = replace(
            result,
            scale_percent=100 * abs(1 / found.scale - 1),
            scale_nees=float((np.log(found.scale) / estimate.scale_std) ** 2),
        )
    if errors is None:
        return result
    # A gain along the thrust acts like an offset of its share of gravity.
    true_offset = offset_m_s2 + [0, 0, (gain - 1) * GRAVITY_M_S2]
    offset = (np.array(errors.offset_m_s2) - true_offset) / errors.offset_std_m_s2
    arm = (np.array(errors.arm_m) - arm_m) / errors.arm_std_m
    known = np.isfinite(errors.delay_std_s)
    delay = ((errors.delay_s - delay_s) / errors.delay_std_s,) if known else ()
    return replace(
        result,
        offset_sigmas=tuple(offset.tolist()),
        arm_sigmas=tuple(arm.tolist()),
        delay_sigmas=delay,
    )


def lively(seed: int, rng: np.random.Generator) -> Flight:
    """Simulate straight lines with hard corners; the pictures are held in memory."""
    recipe = corners(
        rng, maneuver={"cruise_m_s": 1.0, "acceleration_m_s2": 3.0, "laps": 2}, camera={"rate_hz": 15.0}
    )
    flight = simulate(recipe, seed)
    assert flight.frames is not None
    pictures = [flight.frames.load(k) for k in range(len(flight.frames))]
    return replace(flight, frames=replace(flight.frames, load=pictures.__getitem__))


if __name__ == "__main__":
    print_alone(fly)

"""Camera, IMU and sonar together, compared with each pair of them, over simulated flights.

In each flight all instruments have errors of their stated size: gain and zero of the sonar, gain and offset
of the accelerometer, offset of the gyro. On a recorded flight a single draw of the two gains decides: where
three instruments should be a tenth better than the best pair, they are so on one flight of three. Here gains
and zero are drawn in strata, so each set of flights has the right number of large ones.

``python -m tests.benchmarks.instruments FIRST LAST`` runs some of them and prints one line of JSON each.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np
from scipy.stats import norm

from slam.core.flight import Flight, Imu, Sonar
from slam.evaluation import evaluate
from slam.inertial.navigate import navigate
from slam.mapping.config import SensorTrust
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.recipe import recipe_from
from tests.benchmarks.alone import print_alone
from tests.benchmarks.calibration import judged
from tests.benchmarks.metric import Metric, at_most, reported

FLIGHTS, CORES = 24, 2
ALL, NO_SONAR, NO_IMU = "camera, IMU and sonar", "camera and IMU", "camera and sonar"
CORNERS, FLOOR_M, HEIGHTS_M, LEAST_LEG_M = 7, (0.2, 2.8), (0.6, 1.1), 1.0
ACCEL_OFFSET_M_S2, GYRO_OFFSET_RAD_S = 0.2, 0.01
"""Standard deviations of the errors of cheap units at rest."""

Band = tuple[float, float, float]
"""Mean NEES over a flight's keyframes, and its 95 % band."""


@dataclass(frozen=True)
class Mapped:
    """Result of one flight with some of its instruments."""

    error_m: float
    """RMS error of the positions, in metres."""
    log_scale: float
    """Ratio of the true lengths to the map's."""
    scale_std: float
    """Reported standard deviation of the scale."""
    farthest: float
    """NEES of the keyframe farthest from the first one."""
    pose: Band
    position: Band
    rotation: Band

    @property
    def in_band(self) -> bool:
        """Whether the flight would be called consistent."""
        mean, lower, upper = self.pose
        return lower <= mean <= upper


@dataclass(frozen=True)
class Flown:
    """Results of one flight."""

    seed: int
    maps: dict[str, Mapped]
    blind_error_m: float
    """RMS error of the positions with IMU and sonar only."""


def measure() -> list[Metric]:
    """Return the figures over all flights."""
    # Nothing is timed here, so that flights may share the cores.
    with ProcessPoolExecutor(CORES, mp_context=get_context("spawn")) as pool:
        flown = list(pool.map(fly, range(FLIGHTS)))
    maps = {name: [flight.maps[name] for flight in flown] for name in (ALL, NO_SONAR, NO_IMU)}
    error_m = {name: _rms([m.error_m for m in found]) for name, found in maps.items()}
    error_m["IMU and sonar"] = _rms([flight.blind_error_m for flight in flown])
    together = error_m.pop(ALL)
    best = [min(flight.maps[name].error_m for name in (NO_SONAR, NO_IMU)) for flight in flown]
    smaller = sum(flight.maps[ALL].error_m < two for flight, two in zip(flown, best, strict=True))
    metrics = [reported(f"{ALL}: position error (ate_m), RMS of {FLIGHTS} flights", together, "m")]
    metrics += [reported(f"the same from {name} alone", error, "m") for name, error in error_m.items()]
    metrics.append(
        at_most(
            "the same over the best of any two", together / min(error_m.values()), "x", 1.0,
            f"on {smaller} of {FLIGHTS} flights smaller than with whichever two did best there",
        )
    )  # fmt: skip
    for name, found in maps.items():
        metrics += judged(f"{name}, farthest keyframe", np.array([m.farthest for m in found]), 6)
        metrics += judged(f"{name}, scale", np.array([(m.log_scale / m.scale_std) ** 2 for m in found]), 1)
        metrics.append(reported(f"{name}: flights whose mean NEES is inside its band", _share(found), "%"))
    return metrics


def fly(seed: int) -> Flown:
    """Simulate one flight and map it with each pair of its instruments, and with all."""
    flight = off(seed)
    given = {ALL: flight, NO_SONAR: replace(flight, sonar=None), NO_IMU: replace(flight, imu=None)}
    alone = navigate(replace(flight, camera=None, frames=None)).estimate
    maps = {name: mapped(part, flight) for name, part in given.items()}
    return Flown(seed, maps, evaluate(alone, flight).ate_m.rmse)


def mapped(given: Flight, flight: Flight) -> Mapped:
    """Map some streams of a flight."""
    estimate = optimize(given)
    found = evaluate(estimate, flight)
    assert found.nees is not None
    assert estimate.scale_std is not None
    away_m = np.linalg.norm(found.tracks.reference_m - found.tracks.reference_m[0], axis=1)
    bands = [
        (c.mean, c.lower95, c.upper95) for c in (found.nees.pose, found.nees.position, found.nees.rotation)
    ]
    return Mapped(
        found.ate_m.rmse,
        float(np.log(found.scale)),
        estimate.scale_std,
        float(found.nees.per_keyframe[np.argmax(away_m)]),
        *bands,
    )


def off(seed: int) -> Flight:
    """Simulate straight lines at changing heights, with instrument errors."""
    rng = np.random.default_rng((seed, 11))
    points = [_anywhere(rng)]
    while len(points) < CORNERS:
        there = _anywhere(rng)
        if np.hypot(*np.subtract(there[:2], points[-1][:2])) > LEAST_LEG_M:
            points.append(there)
    recipe = recipe_from(
        {
            "name": "instruments",
            "maneuver": {"way_points": [*points, points[0]], "cruise_m_s": 0.8, "acceleration_m_s2": 1.5},
            "world": {"extent_m": [0, 0, 3.0, 3.0], "margin_m": 1.0, "seed": int(rng.integers(1000))},
            "camera": {"size_px": [176, 144], "rate_hz": 10.0},
        },
        "instruments",
    )
    flight = simulate(recipe, seed)
    assert flight.frames is not None
    assert flight.imu is not None
    assert flight.sonar is not None
    pictures = [flight.frames.load(k) for k in range(len(flight.frames))]
    gain, zero, accel_gain = _strata(seed, rng)
    return replace(
        flight,
        frames=replace(flight.frames, load=pictures.__getitem__),
        velocity=None,
        imu=_inertial(flight.imu, accel_gain, rng),
        sonar=_ranged(flight.sonar, gain, zero),
    )


def _anywhere(rng: np.random.Generator) -> tuple[float, float, float]:
    x, y = rng.uniform(*FLOOR_M, 2).tolist()
    return x, y, float(rng.uniform(*HEIGHTS_M))


def _strata(seed: int, rng: np.random.Generator) -> list[float]:
    """Return three standard normal numbers. Over the flights each has one from every stratum, in independent
    orders."""
    orders = np.random.default_rng(11).permuted(np.tile(np.arange(FLIGHTS), (3, 1)), axis=1)
    share = (orders[:, seed % FLIGHTS] + rng.uniform(size=3)) / FLIGHTS
    return list(norm.ppf(share))


def _ranged(sonar: Sonar, gain: float, zero: float) -> Sonar:
    # The simulator's own zero is stated as exact.
    scale_std, datum_std_m = Sonar.scale_std, Sonar.datum_std_m
    range_m = (1 + scale_std * gain) * sonar.range_m + datum_std_m * zero
    return replace(sonar, range_m=range_m, scale_std=scale_std, datum_std_m=datum_std_m)


def _inertial(imu: Imu, gain: float, rng: np.random.Generator) -> Imu:
    gain = 1 + SensorTrust.accel_gain_std * gain
    return replace(
        imu,
        accel_m_s2=gain * imu.accel_m_s2 + rng.normal(0, ACCEL_OFFSET_M_S2, 3),
        gyro_rad_s=imu.gyro_rad_s + rng.normal(0, GYRO_OFFSET_RAD_S, 3),
    )


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _share(found: list[Mapped]) -> float:
    return 100 * float(np.mean([m.in_band for m in found]))


if __name__ == "__main__":
    print_alone(fly)

"""Speed of the simulator, and speed and consistency of the Kalman filter on its flights."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from backend import se3
from slam.core.flight import Flight
from slam.evaluation.association import poses_at
from slam.evaluation.trajectory import gauge
from slam.inertial.motion import filter_motion
from slam.inertial.navigate import navigate
from slam.inertial.noise_identification import identify_noise
from slam.simulation import simulate
from slam.simulation.recipe import Recipe, load_recipe
from tests.benchmarks.metric import Metric, at_least, at_most, within

MEMBERS, SEEDS = 32, 50
MINUTE_S = 60.0


def measure() -> list[Metric]:
    """Return the figures with camera, without camera, and of the filter."""
    blind = without_camera(load_recipe("figure_eight"))
    return [with_camera(), *without_pictures(blind), filter_speed(blind), consistency(blind)]


def without_camera(recipe: Recipe) -> Recipe:
    """Return the flight with rests at its ends, about a minute long."""
    return replace(recipe, camera=None, maneuver=replace(recipe.maneuver, rest_s=3.5))


def with_camera() -> Metric:
    """Measure a minute at 176x144 and 15 Hz with every picture read, including the rendering of the floor."""
    began = time.perf_counter()
    flight = simulate(load_recipe("figure_eight_paper"), 1)
    assert flight.frames is not None
    for frame in flight.frames:
        frame.read()
    seconds = (time.perf_counter() - began) * MINUTE_S / lasts_s(flight)
    source = f"{len(flight.frames)} pictures in {lasts_s(flight):.1f} s of flight, drawing the floor included"
    return at_most("60 s of figure eight at 176x144, 15 Hz, all sensors", seconds, "s", 10.0, source)


def without_pictures(recipe: Recipe) -> list[Metric]:
    """Measure a single flight, and an ensemble."""
    flown_s = lasts_s(simulate(recipe, 0))
    began = time.perf_counter()
    simulate(recipe, 1)
    alone = time.perf_counter() - began
    began = time.perf_counter()
    for seed in range(MEMBERS):
        simulate(recipe, seed)
    together = time.perf_counter() - began
    return [
        at_least("without camera, one flight, over real time", flown_s / alone, "x", 20.0),
        at_least(
            f"without camera, {MEMBERS} flights, over real time", MEMBERS * flown_s / together, "x", 200.0
        ),
    ]


def filter_speed(recipe: Recipe) -> Metric:
    """Measure the filter alone on all instruments, with the IMU at 100 or 200 Hz."""
    flight = simulate(recipe, 0)
    assert flight.imu is not None
    given = identify_noise(flight)
    at_s = np.arange(given.start_s, given.end_s, 0.05)
    filter_motion(given, at_s, smooth=False)
    began = time.perf_counter()
    filter_motion(given, at_s, smooth=False)
    ratio = lasts_s(flight) / (time.perf_counter() - began)
    rate = 1 / np.median(np.diff(flight.imu.stamps_s))
    return at_least("Kalman filter over real time", ratio, "x", 100.0, f"IMU at {rate:.0f} Hz")


def consistency(recipe: Recipe) -> Metric:
    """Return the NEES of the last pose relative to the first, one sample a flight."""
    scores = [score(simulate(recipe, seed)) for seed in range(SEEDS)]
    low, high = chi2.ppf([0.025, 0.975], 6 * SEEDS) / SEEDS
    return within(
        f"mean NEES of the smoothed last pose, {SEEDS} flights",
        float(np.mean(scores)),
        "",
        (low, high),
        "95 % band",
    )


def score(flight: Flight) -> float:
    """Return the normalised squared error of the last pose, with the first one aligned to the truth."""
    assert flight.truth is not None
    estimate = navigate(flight, rate_hz=1.0).estimate
    last = len(estimate.stamps_s) - 2
    first_true, last_true = poses_at(flight.truth, estimate.stamps_s[[0, last]])
    placed = gauge(estimate.w_T_b[0], first_true) @ estimate.w_T_b[last]
    xi = se3.log((np.linalg.inv(placed) @ last_true)[None])[0]
    return float(xi @ np.linalg.solve(estimate.covariances[last], xi))


def lasts_s(flight: Flight) -> float:
    """Return the flight from take-off to landing."""
    assert flight.truth is not None
    return float(np.ptp(flight.truth.stamps_s))

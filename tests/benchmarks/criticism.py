"""Time of criticism on ten flights of a minute without pictures, after compilation."""

from __future__ import annotations

import time

from slam.criticism import criticise
from slam.simulation.healthy.flights import at_lower_rates, healthy_case
from slam.simulation.model import Model, load_model
from tests.benchmarks.metric import Metric, at_most, reported

FLIGHTS, SECONDS, SEED = 10, 60.0, 1
MOST_S = 60.0


def measure() -> list[Metric]:
    """Return the seconds with the whole catalogue: a healthy vehicle, and one with two effects."""
    nominal = load_model("nominal")
    slower = at_lower_rates(nominal)
    criticise(healthy_case(slower, SEED, 1, 10.0))
    ill = slower.with_term("quadratic_drag", c=0.1).with_term("sonar_lag", T=0.05)
    metrics = []
    for vehicle, name in ((slower, "healthy"), (ill, "drag beyond linear and a sonar that lags")):
        seconds, verdict = _timed(vehicle)
        metrics.append(at_most(f"ten flights of 60 s, {name}", seconds, "s", MOST_S, f"verdict {verdict}"))
    seconds, verdict = _timed(nominal)
    metrics.append(reported("the same with the IMU read 200 times a second, healthy", seconds, "s", verdict))
    return metrics


def _timed(vehicle: Model) -> tuple[float, str]:
    flights = healthy_case(vehicle, SEED, FLIGHTS, SECONDS)
    began = time.perf_counter()
    found = criticise(flights)
    causes = ", ".join(cause.name for cause in found.causes)
    return time.perf_counter() - began, f"{found.verdict}{': ' if causes else ''}{causes}"

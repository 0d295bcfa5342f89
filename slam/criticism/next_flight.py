"""The manoeuvre that would settle what these flights leave open: simulated, each from a healthy start.

Two terms are told apart by what is left of the first one's trace once the other's and the nuisances' are
taken out: its size times the root of that information is the separation in sigmas.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace

import numpy as np

from slam.criticism.healthy import at_lower_rates, flown
from slam.criticism.kalman.innovations import stretches
from slam.criticism.kalman.readings import ATTITUDE, IMU, SONAR, VELOCITY
from slam.criticism.kalman.record import record_of
from slam.criticism.kalman.reference import referred
from slam.criticism.kalman.setting import Setting, setting_of
from slam.criticism.manoeuvres import MANOEUVRES, stick_for
from slam.criticism.search.effects import Effect
from slam.criticism.search.nuisances import MEAN, direction_of, prior_precision
from slam.criticism.search.screening import project
from slam.criticism.threads import in_threads
from slam.progress import Progress, Tally, silent
from slam.simulation.model import Model

_STREAMS = {IMU: "imu", ATTITUDE: "attitude", VELOCITY: "velocity", SONAR: "sonar"}
TOLD_APART_SIGMA = 3.3
"""Separation at which two terms are told apart in nineteen of twenty cases."""


def next_flight(
    model: Model,
    first: Effect,
    second: Effect,
    sizes: np.ndarray,
    kinds: Container[int],
    progress: Progress = silent,
) -> str:
    """A sentence: which manoeuvre tells ``first``, of these sizes (columns,), from ``second`` best.

    Best for the time that it takes, with these ``kinds`` of instruments on board.
    """
    directions = [*first.directions, *second.directions]
    if not first.directions:
        return ""
    setting = setting_of(model)
    slower = at_lower_rates(model)
    beside = len(second.directions)

    def separation(name: str) -> float:
        flight = flown(slower, stick_for([name]), 1)
        missing = {stream: None for kind, stream in _STREAMS.items() if kind not in kinds}
        record = referred(record_of(replace(flight, **missing)), setting)  # type: ignore[arg-type]
        every = [direction_of(n) for n in MEAN] + directions
        information = np.zeros((len(every), len(every)))
        for rows in stretches(record, setting, every):
            information += rows.traces.T @ rows.traces
        count = len(MEAN)
        out = np.r_[np.arange(count), np.arange(len(every) - beside, len(every))].astype(np.int64)
        left = project(information, out, _precision(setting, beside)).information
        own = slice(count, count + len(first.directions))
        return float(np.sqrt(max(sizes @ left[own, own] @ sizes, 0.0)))

    names = list(MANOEUVRES)
    found = in_threads(Tally(progress, "next flight", len(names)).counting(separation), names)
    # Separation grows as the root of the time flown.
    took_s = np.array([stick_for([name]).duration_s for name in names])
    best = int(np.argmax(found / np.sqrt(took_s)))
    times = int(np.ceil((TOLD_APART_SIGMA / max(found[best], 1e-3)) ** 2))
    if times > 200:
        return f"No manoeuvre of the list tells {first.name} from {second.name}: another sensor must."
    often = "once" if times == 1 else f"{times} times"
    return (
        f"To tell {first.name} from {second.name} fly {names[best]!r} {often}: "
        f"{found[best]:.1f} sigma a time."
    )


def _precision(setting: Setting, beside: int) -> np.ndarray:
    # The other term's own prior: next to none.
    return np.array([prior_precision(n, setting) for n in MEAN] + [1e-9] * beside)

"""Test whether the manoeuvre that a verdict proposes distinguishes its causes, by the generator's own
figures.

The blind vehicle flies the manoeuvre as often as proposed, with the hidden effect of the case. The part that
the other cause of the set explains at its best size is projected out. The critic's own figure is not used.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

import numpy as np

from slam.simulation.healthy.manoeuvres import MANOEUVRES
from tests.blind.cases import Case, Outing
from tests.blind.faults import BY_NAME, UNTELLABLE
from tests.blind.plans import GRID_S
from tests.blind.score import Answer
from tests.blind.strength import NUISANCES, strengths
from tests.blind.vehicle import HEALTHY, Knobs

SETTLED = 2.56
"""Sigmas between two causes at which the more probable one is right in nine of ten cases."""
PROPOSED = re.compile(r"fly '(.+)' (once|\d+ times)")
RIVAL_SIZES = 6
SAME_FORCE = {"trim_offset", "canted_thrust"}
"""Without a measured attitude no flight separates these: a manoeuvre need only separate them from others."""


@dataclass(frozen=True)
class Proposed(Outing):
    """Return a manoeuvre as a plan, with a rest before and after."""

    def stick(self, flight: int) -> np.ndarray:
        """As given, on the plans' grid."""
        rest = (1.0, 0.0, 0.0, 0.0, 0.0)
        rows = (rest, *MANOEUVRES[self.plans[flight]], rest)
        return np.concatenate([np.tile(values, (round(span / GRID_S), 1)) for span, *values in rows])

    def start(self, flight: int) -> np.ndarray:
        """x y z yaw: high enough for every manoeuvre, whatever its place."""
        return np.array([0.0, 0.0, 1.2, 0.7])


def settles(answer: Answer) -> bool:
    """Return whether it names a manoeuvre that distinguishes the hidden effect from the other causes of its
    set."""
    found = PROPOSED.search(answer.verdict.get("next_flight") or "")
    if not found or found[1] not in MANOEUVRES:
        return False
    times = 1 if found[2] == "once" else int(found[2].split()[0])
    return separation(answer.case, found[1], times) >= SETTLED


def separation(case: Case, manoeuvre: str, times: int = 1) -> float:
    """Return the sigmas by which ``times`` such flights separate the hidden effect from the other causes."""
    (what,) = case.hidden
    knobs = tuple(sorted(case.knobs.items()))
    return _separation(what.name, what.amplitude, case.equivalents, knobs, manoeuvre, times)


@cache
def _separation(
    name: str,
    size: float,
    causes: tuple[str, ...],
    knobs: tuple[tuple[str, float], ...],
    manoeuvre: str,
    times: int,
) -> float:
    base = {**HEALTHY, **dict(knobs)}
    outing = Proposed(0, 0, (manoeuvre,), 0.0, one_heading=True)
    (streams,) = {b.streams for b in UNTELLABLE if set(b.equivalents) == set(causes)}
    # A direction is the case's own: the worse of two that can be separated.
    tried = [{**base, **BY_NAME[name].apply(size, base, np.random.default_rng(way))} for way in (1, 2)]
    traces = outing.traces(base, tried, streams)
    return min(
        unexplained(outing, base, traces[:, k : k + 1], rival, streams, times)
        for k in range(traces.shape[1])
        for rival in causes
        if rival != name and {rival, name} != SAME_FORCE
    )


def unexplained(
    outing: Outing, base: Knobs, trace: np.ndarray, rival: str, streams: tuple[str, ...], times: int = 1
) -> float:
    """Return the sigmas of a sensitivity (values, 1) that the rival, at its best size, and the nuisances
    leave."""
    steps = [{**base, n: base[n] + step} for n, (step, _) in NUISANCES.items()]
    halves = [half / abs(step) for step, half in NUISANCES.values()]
    fault = BY_NAME[rival]
    # Two directions span what a vector may be.
    tried = [
        {**base, **fault.apply(size, base, np.random.default_rng(way))}
        for size in np.geomspace(fault.low, fault.high, RIVAL_SIZES)
        for way in (1, 2)
    ]
    traces = outing.traces(base, [*steps, *tried], streams)
    healthy, ways = traces[:, : len(steps)], traces[:, len(steps) :]
    pairs = [np.hstack([healthy, ways[:, k : k + 2]]) for k in range(0, ways.shape[1], 2)]
    # The same flight again has the same information; the nuisances' priors count once.
    often = np.sqrt(times)
    return min(float(strengths(often * trace, often * pair, [*halves, 10.0, 10.0])[0]) for pair in pairs)

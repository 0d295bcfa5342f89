"""Choice of the next motion without commands, manoeuvre or handheld, by simulation of each.

The columns of the effects are those of the inertial comparisons and of pictures, with the noise of the
flights at hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.progress import Progress, Tally, silent
from slam.criticism.camera.feature_matches import FeatureMatches
from slam.criticism.camera.planned_matches import planned_matches
from slam.criticism.kalman.filter_parameters import CAMERA, filter_parameters_of
from slam.criticism.next_flight import advice, separation
from slam.criticism.search.search import SearchResult
from slam.criticism.threads import in_threads
from slam.criticism.without_commands.inertial_consistency import inertial_residuals
from slam.criticism.without_commands.likelihood import likelihood_of
from slam.criticism.without_commands.pictures import picture_rows
from slam.criticism.without_commands.sensor_comparison import airborne_record, with_free_motion
from slam.criticism.without_commands.whitened_rows import WhitenedRows
from slam.simulation.healthy.flights import simulate_flight, simulate_readings
from slam.simulation.healthy.handheld_motions import HANDHELD_MOTIONS, handheld_motion
from slam.simulation.healthy.manoeuvres import MANOEUVRES, stick_for
from slam.simulation.model import Model

Array = NDArray[np.float64]

SHORTEST_S = 14.0
"""Least duration: a shorter motion is repeated, as comparisons need some rows."""


def next_motion(
    model: Model,
    found: SearchResult,
    rows: Sequence[Sequence[WhitenedRows]],
    rivals: Sequence[str],
    seen: FeatureMatches | None = None,
    progress: Progress = silent,
) -> str:
    """Return a sentence naming the motion that separates two rivals best for the time that it takes.

    ``rows`` are those of the flights at hand; the first rival is one of the chosen effects of ``found``. A
    camera is on board as in ``seen``.
    """
    effect, other = (next(e for e in found.last.effects if e.name == name) for name in rivals)
    if not any(column in CAMERA for rival in (effect, other) for column in rival.columns):
        # Pictures would cost a path for each motion, and the other comparisons separate errors of
        # instruments.
        seen = None
    quadratic = found.last.quadratic
    maximum = quadratic.maximise(found.chosen)
    size, error = maximum.of(quadratic.index(effect.columns))
    _, plain = maximum.of(quadratic.index(effect.columns), white=True)
    wider = float(np.sqrt(np.max(np.diag(error) / np.diag(plain))))
    parameters = with_free_motion(filter_parameters_of(model))
    noise, beside = _noise(rows), [*(e for e in found.chosen if not e.repeats(effect)), other]

    def sigma(name: str) -> float:
        planned = [r for r in _rows(_flight(model, name), model, seen) if r.kind in noise]
        if not planned:
            return 0.0
        finer = _noise([planned])
        # A row weighs by the ratio of its precision to that of the flights at hand.
        weighed = [_times_precision(r, finer[r.kind] / noise[r.kind]) for r in planned]
        expansion = likelihood_of([weighed], parameters).last
        known = {e.name: e for e in expansion.effects}
        if effect.name not in known or known[effect.name].columns != effect.columns:
            return 0.0
        others = [known[e.name] for e in beside if e.name in known]
        return separation(expansion.quadratic, effect, others, size) / wider / float(np.sqrt(_times(name)))

    names = [*MANOEUVRES, *HANDHELD_MOTIONS]
    separations = in_threads(Tally(progress, "next flight", len(names)).counting(sigma), names)
    motions = [f"fly {name!r}" if name in MANOEUVRES else f"{name}," for name in names]
    return advice(rivals[0], rivals[1], motions, separations, [_took_s(name) for name in names])


def _rows(flight: Flight, model: Model, seen: FeatureMatches | None) -> list[WhitenedRows]:
    """Return the rows of a planned motion, and of its pictures, as predicted."""
    rows, record = inertial_residuals(flight), airborne_record(flight)
    if seen is None or record is None:
        return rows
    parameters = with_free_motion(filter_parameters_of(model))
    return [
        *rows,
        *picture_rows(replace(record, matches=planned_matches(record, parameters, seen)), parameters, {}),
    ]


def _times_precision(rows: WhitenedRows, precision: float) -> WhitenedRows:
    traces = {name: precision * trace for name, trace in rows.traces.items()}
    return replace(rows, off=precision * rows.off, traces=traces)


def _noise(rows: Sequence[Sequence[WhitenedRows]]) -> dict[str, float]:
    """Return kind of comparison -> root mean square noise of its differences."""
    squares: dict[str, list[float]] = {}
    for found in (r for flight in rows for r in flight):
        squares.setdefault(found.kind, []).append(found.noise**2)
    return {kind: float(np.sqrt(np.mean(of))) for kind, of in squares.items()}


def _flight(model: Model, name: str) -> Flight:
    """Simulate a healthy vehicle's readings of a motion, repeated where it is short."""
    if name in MANOEUVRES:
        return simulate_flight(model, stick_for([name] * _times(name)), 1)
    moved = handheld_motion(name, _times(name))
    return simulate_readings(model, model, moved, False, 1, np.random.default_rng(1))


def _took_s(name: str) -> float:
    """Return the duration of a motion, done once."""
    return stick_for([name]).duration_s if name in MANOEUVRES else handheld_motion(name).duration_s


def _times(name: str) -> int:
    return int(np.ceil(SHORTEST_S / _took_s(name)))

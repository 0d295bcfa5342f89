"""Sizes fitted to roll-outs over two seconds, for the causes of an out-of-model vehicle.

The equations belong to another vehicle. Their errors bias the sizes that make the next reading most likely.
The likelihoods of tens of thousands of slightly wrong readings confirm or refute nothing. For an out-of-model
vehicle, sizes therefore minimise the errors of roll-outs from the filtered states. A further cause enters if
with it each flight is better predicted from the others. Intervals are jackknife intervals: how far sizes move
as each flight in turn is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from frontend.cores import in_threads
from slam.core.arrays import Array
from slam.core.progress import Progress, Tally
from slam.criticism.cause import JUDGED_HORIZON_S
from slam.criticism.finding import OutOfRange
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import whole
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitted_parameters import FittedParameter, fitted_parameter, with_steps
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import MISFIT, load_thresholds
from slam.criticism.verdict.posterior import required_nats
from slam.criticism.verdict.rollouts import pooled_residuals, rollout_residuals

APART_S = 1.0
"""The time by which independent errors of one flight are apart."""
ROUNDS = 25
SETTLED = 1e-4
"""Least share of the squared errors that a round must remove to be followed by another."""
DAMPING, RIDGE = 1e-3, 1e-9
"""Damping and ridge: a column that no flight shows keeps its value."""
PULL = 0.01
"""Penalty weight: a constant at the edge of its healthy range costs the square of this, where a healthy
vehicle's errors cost 1."""
LAG, LAG_CONSTANT = "attitude_lag", "vehicle.attitude_time_s"
FREE = {"vehicle.gain": 0.02, "vehicle.drag_1_s": 0.02, LAG_CONSTANT: 0.005}
"""Constants of the vehicle, and the differences for their slopes."""
DELAY = {"control_latency.T": 0.01}
"""Difference for a delay. With smaller ones, commands move across readings, and fits get stuck."""
_FREE = tuple(map(fitted_parameter, FREE))
MOST_CANDIDATES = 3
"""Number of terms, those with the greatest score tests beyond chance, that are tried beside the chosen."""


@dataclass(frozen=True)
class RolloutFit:
    """Result of the fit to roll-outs."""

    parameters: FilterParameters
    chosen: tuple[Effect, ...]
    std: dict[str, float]
    """Column -> jackknife standard deviation of its size."""
    left_out: tuple[FilterParameters, ...]
    """Parameters for each flight, fitted on the others."""
    nats: dict[str, tuple[float, ...]]
    """Term -> gain in each flight, predicted from the others."""
    unhealthy: tuple[OutOfRange, ...] = ()
    """The vehicle's constants that are not healthy, or would not be but for a term."""

    def probability(self, effect: Effect) -> float:
        """Return the probability of a term, its alternatives among them, by held-out roll-outs."""
        return float(expit(sum(self.nats.get(effect.name, ())) - required_nats(effect)))


@dataclass(frozen=True)
class _Fit:
    """Fit of columns over all flights, and with each flight left out."""

    parameters: FilterParameters
    columns: tuple[str, ...]
    left_out: tuple[FilterParameters, ...]
    steps: Array
    """(flights, columns) steps from the fit to the fit without each flight."""
    residuals: Array
    """(flights, channels) squared errors of each, predicted from the others."""

    def better_than(self, other: _Fit) -> bool:
        """Whether the errors of held-out flights are smaller.

        One channel must improve by more than a misfit, all together must not worsen, and most of the flights
        that show a difference must improve.
        """
        channels, before = self.residuals.sum(axis=0), other.residuals.sum(axis=0)
        less = (channels < (1.0 - MISFIT) * before).any() and channels.sum() < before.sum()
        flights, before = self.residuals.sum(axis=1), other.residuals.sum(axis=1)
        shows = np.abs(flights - before) > MISFIT * before
        return bool(less and shows.any() and np.mean(flights[shows] < before[shows]) > 0.5)


def fit_rollouts(parameters: FilterParameters, found: SearchResult, progress: Progress) -> RolloutFit:
    """Fit the chosen terms to roll-outs, with further terms that improve them, and without those that improve
    no flight. The measure are the errors of a vehicle without any cause."""
    course = _Rollouts(found, parameters, progress)
    chosen, fit = _extended(course, found, course.fitted(parameters, found.chosen))
    chosen, fit, without = _needed(course, chosen, fit, found.model)
    off = fit.steps - fit.steps.mean(axis=0)
    std = np.sqrt((1.0 - 1.0 / len(found.records)) * (off**2).sum(axis=0))
    nats = {e.name: tuple(course.nats(fit, without[e.label]).tolist()) for e in chosen if e.label in without}
    spread = dict(zip(fit.columns, std.tolist(), strict=True))
    beyond = [n for n in _FREE if n.is_beyond(fit.parameters, found.model, spread[n.name])]
    if any(n.name == LAG_CONSTANT for n in beyond):
        chosen += [e for e in found.last.effects if e.name == LAG][:1]
    unhealthy = [_out_of_range(n, fit.parameters, found.model) for n in beyond if n.name != LAG_CONSTANT]
    for effect in (e for e in chosen if e.label in without):
        bare = without[effect.label]
        taking = [] if fit.better_than(bare) else _instead(fit, bare, found.model)
        unhealthy += [_out_of_range(n, bare.parameters, found.model, effect.name) for n in taking]
    return RolloutFit(fit.parameters, tuple(chosen), spread, fit.left_out, nats, tuple(unhealthy))


def _extended(course: _Rollouts, found: SearchResult, fit: _Fit) -> tuple[list[Effect], _Fit]:
    """Add those of the candidates that improve the roll-outs. Their gain must make them more probable than
    not, where their score test is below that of any second term."""
    chosen = list(found.chosen)
    tests = found.last.score_tests(chosen, found.last.effects)
    limits, names = load_thresholds(), {e.name for e in chosen}
    moving = [s for s in tests if s.z > limits.effects and _flies(s.effect) and s.effect.name not in names]
    for candidate in moving[:MOST_CANDIDATES]:
        extra = candidate.effect
        # A term that may be tried in two ways enters in the first way that improves the fit.
        if extra.name in {e.name for e in chosen}:
            continue
        tried = course.fitted(fit.parameters, [*chosen, extra])
        is_probable = candidate.z > limits.second or course.nats(tried, fit).sum() > required_nats(extra)
        if is_probable and tried.better_than(fit):
            chosen, fit = [*chosen, extra], tried
    return chosen, fit


def _needed(
    course: _Rollouts, chosen: list[Effect], fit: _Fit, model: FilterParameters
) -> tuple[list[Effect], _Fit, dict[str, _Fit]]:
    """Keep the terms that improve flights, or keep a constant of the vehicle healthy; at least one stays.

    Returns them, their fit, and the fits without each of them by label.
    """
    while True:
        without = {
            e.label: course.fitted(e.without(fit.parameters), [o for o in chosen if o is not e])
            for e in chosen
            if _flies(e)
        }
        tried = [(e, without[e.label]) for e in chosen if e.label in without]
        idle = [e for e, bare in tried if not fit.better_than(bare) and not _instead(fit, bare, model)]
        if not idle or len(chosen) == 1:
            return chosen, fit, without
        least = min(idle, key=lambda e: without[e.label].residuals.sum())
        chosen, fit = [e for e in chosen if e is not least], without[least.label]


def _instead(fit: _Fit, without: _Fit, model: FilterParameters) -> list[FittedParameter]:
    """Return the constants that are healthy with a term and take its place without it."""
    beyond = [n for n in _FREE if n.is_beyond(without.parameters, model)]
    return [n for n in beyond if not n.is_beyond(fit.parameters, model)]


def _out_of_range(
    constant: FittedParameter, parameters: FilterParameters, model: FilterParameters, effect: str = ""
) -> OutOfRange:
    value, healthy = constant.value_in(parameters), constant.healthy_range(model)
    return OutOfRange(value, constant.unit, healthy, channel=constant.name, effect=effect)


def _flies(effect: Effect) -> bool:
    """Whether a term has a slope in the errors of roll-outs."""
    kinds = {d.kind for d in effect.perturbations}
    has_slope = bool(kinds) and kinds <= {"dynamics", "sensor", "latency"} and not effect.is_profiled
    return effect.is_term and has_slope


class _Rollouts:
    """Roll-outs of the flights, from the same states under all parameters."""

    def __init__(self, found: SearchResult, parameters: FilterParameters, progress: Progress) -> None:
        records, healthy = found.records, found.first.parameters
        self._records, self._model = records, found.model
        self._rounds = Tally(progress, "fit roll-outs")
        self._states = in_threads(lambda record: whole(record, parameters).states, records)
        pooled = pooled_residuals(records, self._states, [healthy] * len(records), JUDGED_HORIZON_S, 1.0)
        seen = {c: m for c, m in pooled.items() if len(m)}
        spans = [record.duration_s // APART_S for record in records]
        self.independent = len(seen) * float(sum(spans))
        """Number of independent errors."""
        # Each channel weighs as much as any other, whatever its unit.
        self._weight = {c: 1.0 / np.sqrt(max(float(m @ m), 1e-12) * len(seen)) for c, m in seen.items()}

    def _by_channel(self, flight: int, parameters: FilterParameters) -> list[Array]:
        """Return the errors of a flight's roll-outs; squares of all sum to 1 for a healthy vehicle."""
        record, states = self._records[flight], self._states[flight]
        residuals = rollout_residuals(record, states, parameters, JUDGED_HORIZON_S, 1.0)
        return [weight * residuals[c] for c, weight in self._weight.items()]

    def _left(self, parameters: FilterParameters) -> list[Array]:
        """Return the errors of each flight, and last the faint distances of constants from healthy ones."""
        flights = range(len(self._records))
        residuals = in_threads(lambda k: np.concatenate(self._by_channel(k, parameters)), flights)
        x = np.array([nuisance.value_in(parameters) for nuisance in _FREE])
        low, high = np.transpose([nuisance.healthy_range(self._model) for nuisance in _FREE])
        return [*residuals, PULL * (2.0 * x - low - high) / (high - low)]

    def _slopes(
        self, parameters: FilterParameters, columns: Sequence[str], h: Array, left: list[Array]
    ) -> list[Array]:
        """Return (errors, columns) slopes of each part of ``_left``, for columns in units of ``h``."""
        beside = [
            self._left(fitted_parameter(c).stepped(parameters, step))
            for c, step in zip(columns, h.tolist(), strict=True)
        ]
        return [np.column_stack([b[k] - at for b in beside]) for k, at in enumerate(left)]

    def nats(self, fit: _Fit, other: _Fit) -> Array:
        """Return (flights,) the nats that each flight, held out, gains by one fit over another.

        Errors are Gaussian with the variance that is left, as many as there are independent ones.
        """
        gained = (other.residuals - fit.residuals).sum(axis=1)
        return np.asarray(0.5 * self.independent * gained / fit.residuals.sum())

    def fitted(self, start: FilterParameters, effects: Sequence[Effect]) -> _Fit:
        """Fit all flights by Levenberg-Marquardt; then make one more step for each flight left out."""
        steps = FREE | {
            d.name: DELAY.get(d.name, d.step) for e in effects if _flies(e) for d in e.perturbations
        }
        columns, h = tuple(steps), np.array(list(steps.values()))

        def moved(step: Array) -> FilterParameters:
            return with_steps(parameters, zip(columns, step.tolist(), strict=True), bounded=True)

        parameters, damping, left = start, DAMPING, self._left(start)
        slope = self._slopes(parameters, columns, h, left)
        for _ in self._rounds.each(range(ROUNDS)):
            trial = moved(h * _solved(slope, left, damping))
            now = self._left(trial)
            if _squares(now) < _squares(left):
                gained = 1.0 - _squares(now) / _squares(left)
                parameters, left, damping = trial, now, damping / 5.0
                slope = self._slopes(parameters, columns, h, left)
                if gained < SETTLED:
                    break
            else:
                damping *= 5.0
        apart = [
            h * _solved([*slope[:k], *slope[k + 1 :]], [*left[:k], *left[k + 1 :]], DAMPING)
            for k in range(len(self._records))
        ]
        by_others = tuple(map(moved, apart))
        residuals = [[_squares([c]) for c in self._by_channel(k, p)] for k, p in enumerate(by_others)]
        return _Fit(parameters, columns, by_others, np.array(apart), np.array(residuals))


def _solved(slope: Sequence[Array], left: Sequence[Array], damping: float) -> Array:
    slopes, residuals = np.concatenate(slope), np.concatenate(left)
    a, b = slopes.T @ slopes, slopes.T @ residuals
    return np.asarray(-np.linalg.solve(a + damping * np.diag(np.diag(a)) + RIDGE * np.eye(len(a)), b))


def _squares(parts: Sequence[Array]) -> float:
    return float(sum(part @ part for part in parts))

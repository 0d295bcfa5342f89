"""Quadratic likelihood: what each set of terms explains, in nats, with the nuisances fitted anew.

About one set of filter parameters the log likelihood is quadratic in all columns, b d - d G d / 2. A
hypothesis frees the nuisances, within their priors, and the columns of its terms. Terms that the parameters
include but the hypothesis does not are set back to zero. A nuisance has the variance of a uniform prior over
its healthy range. A stiff penalty acts beyond the range, unless the nuisance is relaxed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from slam.core.arrays import Array, Ints, Mask
from slam.core.normal_deviates import deviate, robust_deviate, robust_sigmas
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.search.effects import Effect, is_variance
from slam.criticism.search.fitted_parameters import GAIN_NUISANCES, NUISANCES, FittedParameter
from slam.criticism.search.information import FisherInformation

EDGE = 0.05
"""Softness of the edge of a healthy range, as a share of its half width."""
RIDGE = 1e-9
NINE_OF_TEN = 1.28
"""Standard deviations beyond a threshold that nine of ten cases exceed."""
SEEN = 1e-16
"""Information below this is rounding error: the flights do not show the column."""


@dataclass(frozen=True)
class Maximum:
    """Maximum of the likelihood under a hypothesis."""

    nats: float
    """Nats above the expansion point, priors included."""
    columns: tuple[str, ...]
    """Free columns: the nuisances, then those of the terms."""
    step: Array
    """(free,) step from the expansion point."""
    covariance: Array
    """(free, free)."""
    whole: Array
    """(all columns,) the step, with the excluded terms set back to zero."""
    white: Array
    """(free, free) covariance of white errors, equal to ``covariance`` where there are no clusters."""

    def of(self, columns: Sequence[str], white: bool = False) -> tuple[Array, Array]:
        """Return step and covariance of some of the free columns; the covariance of white errors if asked."""
        at = [self.columns.index(column) for column in columns]
        return self.step[at], (self.white if white else self.covariance)[np.ix_(at, at)]


@dataclass(frozen=True)
class QuadraticLikelihood:
    """The log likelihood as a quadratic function about one set of filter parameters."""

    fisher: FisherInformation
    """Score and information of each segment of the flights."""
    parameters: FilterParameters
    """The expansion point."""
    model: FilterParameters
    """The healthy vehicle, about which the nuisances have their ranges."""
    nuisances: Sequence[FittedParameter] = (*NUISANCES, *GAIN_NUISANCES)
    current: dict[str, float] = field(default_factory=dict)
    """Column -> value at the expansion point."""
    clustered: bool = False
    """Whether errors within a segment may be correlated: covariances are then cluster-robust, and a lead
    counts as far as segments agree on it."""

    @cached_property
    def information(self) -> Array:
        """(columns, columns) of all segments."""
        return np.asarray(self.fisher.information.sum(axis=0))

    @cached_property
    def score(self) -> Array:
        """(columns,) of all segments."""
        return np.asarray(self.fisher.score.sum(axis=0))

    @cached_property
    def _priors(self) -> tuple[Array, Array, Array]:
        """(nuisances,) values at the expansion point and prior precisions, (nuisances, 2) healthy ranges."""
        limits = np.array([n.healthy_range(self.model) for n in self.nuisances]).reshape(-1, 2)
        at = np.array([n.value_in(self.parameters) for n in self.nuisances])
        return at, np.array([n.prior_precision(self.model) for n in self.nuisances]), limits

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns of the nuisances."""
        return tuple(n.name for n in self.nuisances)

    @cached_property
    def _place(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.fisher.columns)}

    def index(self, names: Sequence[str]) -> Ints:
        """Return the indices of these columns."""
        return np.array([self._place[name] for name in names], dtype=np.int64)

    def _relaxed(self, effects: Sequence[Effect]) -> Mask:
        """Return (nuisances,) whether an effect frees it of its range."""
        relaxed = [c for e in effects for c in e.relaxes]
        return np.array([name in relaxed for name in self.names], dtype=np.bool_)

    def over(self, segments: Mask) -> Self:
        """Return the same for some segments of the flights alone."""
        return replace(self, fisher=self.fisher.of(segments))

    def maximise(
        self, effects: Sequence[Effect], reach: dict[str, float] | None = None, judged: int = 0
    ) -> Maximum:
        """Return the maximum for a set of terms.

        Columns in ``reach`` have a Gaussian prior about 0 with these standard deviations; all others are
        free. A cluster-robust covariance is that of ``judged`` parameters together, or of all if it is 0.
        """
        names = [*self.names, *(c for e in effects for c in e.columns if c not in self.names)]
        loose = self._relaxed(effects)
        fixed = np.zeros(len(self.score))
        for column, value in self.current.items():
            if column not in names and column in self._place:
                fixed[self.index([column])] = -value
        free = self.index(names)
        a = self.information[np.ix_(free, free)]
        b = (self.score - self.information @ fixed)[free]
        drawn_a, drawn_b = a.copy(), b.copy()
        for column, std in (reach or {}).items():
            k = names.index(column)
            drawn_a[k, k] += std**-2
            drawn_b[k] -= std**-2 * self.current.get(column, 0.0)
        step, covariance = self._peak(drawn_a, drawn_b, loose)
        nats = float(b @ step - 0.5 * step @ a @ step) - self._penalty(step, loose)
        nats += float(self.score @ fixed - 0.5 * fixed @ self.information @ fixed)
        whole = fixed.copy()
        whole[free] = step
        robust = covariance
        if self.clustered and len(free):
            robust = self.fisher.scatter(free, whole, covariance, judged or len(free))
        return Maximum(nats, tuple(names), step, robust, whole, covariance)

    def z(self, effects: Sequence[Effect], maximum: Maximum, nats: float) -> float:
        """Return the normal deviate of effects that explain ``nats`` together; with clusters, of their sizes
        by their robust covariance and the effects' tolerances."""
        columns = [c for e in effects for c in e.columns]
        if not self.clustered or nats == 0.0:
            return deviate(2 * nats, len(columns))
        spread, free = self._spread(effects, maximum)
        size, _ = maximum.of(columns)
        return robust_deviate(float(size @ np.linalg.solve(spread, size)), len(size), free)

    def _spread(self, effects: Sequence[Effect], maximum: Maximum) -> tuple[Array, float]:
        """Return the covariance of effects' sizes with their tolerances, and its degrees of freedom.

        White errors and tolerances are known. Only what segments scatter beyond these is estimated: the
        greater its share of the variance, the fewer degrees of freedom. By chance segments may scatter too
        little. In flights of a minute two tests of a thousand therefore exceed 4.
        """
        columns = [c for e in effects for c in e.columns]
        (_, robust), (_, known) = maximum.of(columns), maximum.of(columns, white=True)
        # The differences between segments are what a variance consists of: none means no variance.
        if not self.clustered or all(is_variance(d) for e in effects for d in e.perturbations):
            robust = known
        spread = robust + np.diag([e.tolerance**2 for e in effects for _ in e.columns])
        share = float(np.max(np.diag(robust - known) / np.diag(spread)))
        if not self.clustered or share <= 0.0:
            return spread, np.inf
        return spread, max(self.fisher.independent - len(columns), 1.0) / share

    def fitted(self, effect: Effect, maximum: Maximum) -> tuple[Array, Array]:
        """Return the sizes of an effect at a maximum, and their covariance."""
        step, covariance = maximum.of(effect.columns)
        return step + [self.current.get(c, 0.0) for c in effect.columns], covariance

    def shown_sizes(self, effect: Effect, z: float) -> Array:
        """Return (columns,) sizes of an effect that nine of ten cases would show by a deviate of ``z``."""
        spread, free = self._spread([effect], self.maximise([effect]))
        return np.asarray((robust_sigmas(z, len(spread), free) + NINE_OF_TEN) * np.sqrt(np.diag(spread)))

    def nats(self, effects: Sequence[Effect], beside: Sequence[Effect]) -> float:
        """Return the nats of a set; with clusters, as far as segments agree on its lead over ``beside``.

        Sets are compared with their union, from which one effect after the other is taken: where segments
        disagree on one of many steps, the others still count in full. An effect in another's place counts for
        what it explains in that place alone: one that explains something else is no rival.
        """
        if not self.clustered:
            return self.maximise(effects).nats
        union = [*beside, *(e for e in effects if e not in beside)]
        more = self._agreed(union, beside) if all(e in effects for e in beside) else 0.0
        return self.maximise(beside).nats + more - self._agreed(union, effects)

    def _agreed(self, union: Sequence[Effect], effects: Sequence[Effect]) -> float:
        """Return the nats by which a union of effects leads over some of them.

        For white rows the log likelihoods of a segment differ by m, which follows from its information, with
        a variance of 2 m. Where segments scatter about that by more, errors are correlated, and the lead
        counts proportionally less: minutes of one lasting error must not decide.
        """
        total, left = 0.0, list(union)
        before = self.maximise(left).whole
        for effect in [e for e in reversed(union) if e not in effects]:
            left = [e for e in left if e is not effect]
            after = self.maximise(left).whole
            moved = before - after
            lead = self.fisher.nats_at(before) - self.fisher.nats_at(after)
            expected = 0.5 * (self.fisher.information @ moved) @ moved
            scatter, whole = float(np.sum((lead - expected) ** 2)), float(np.sum(lead))
            total += whole * min(1.0, 2.0 * abs(whole) / max(scatter, 1e-12))
            before = after
        return total

    def correlation(self, one: Effect, other: Effect, beside: Sequence[Effect] = ()) -> float:
        """Return the greatest correlation of the sensitivities of two effects, all else projected out."""
        k, maximum = len(one.columns), self.maximise([*beside, one, other])
        # The correlation of the uncertainties is the same, except for its sign.
        _, covariance = maximum.of([*one.columns, *other.columns], white=True)
        covariance = covariance + np.diag(RIDGE * np.diag(covariance) + 1e-300)
        root = [np.linalg.cholesky(c) for c in (covariance[:k, :k], covariance[k:, k:])]
        between = np.linalg.solve(root[0], np.linalg.solve(root[1], covariance[:k, k:].T).T)
        return min(float(np.linalg.norm(between, 2)), 1.0)

    def sizes(self, effects: Sequence[Effect]) -> dict[str, float]:
        """Return the most probable size of each column of some effects."""
        columns = [c for e in effects for c in e.columns if c not in e.relaxes]
        step = self.maximise(effects).whole[self.index(columns)]
        return {c: float(x) + self.current.get(c, 0.0) for c, x in zip(columns, step, strict=True)}

    def nats_at_current(self, effects: Sequence[Effect]) -> float:
        """Return the log likelihood at the expansion point, less the prior's penalty beside some effects."""
        penalty = self._penalty(np.zeros(len(self.names)), self._relaxed(effects))
        return float(self.fisher.log_likelihood.sum()) - penalty

    def nats_at(self, step: Array) -> float:
        """Return the log likelihood, without priors, at a step of all columns."""
        return float(self.score @ step - 0.5 * step @ self.information @ step)

    def predicted(self, other: Maximum) -> float:
        """Return the log likelihood of these flights as predicted by others, averaged over their uncertainty.

        It is a Gaussian integral over the free columns about the step of ``other``, with its covariance.
        """
        free = self.index(other.columns)
        a = self.information[np.ix_(free, free)]
        pull = (self.score - self.information @ other.whole)[free]
        left, value = np.linalg.eigh(0.5 * (other.covariance + other.covariance.T))
        root = value * np.sqrt(np.maximum(left, 0.0))
        inner = np.eye(len(free)) + root.T @ a @ root
        along = root.T @ pull
        average = 0.5 * along @ np.linalg.solve(inner, along) - 0.5 * np.linalg.slogdet(inner)[1]
        return self.nats_at(other.whole) + float(average)

    def _peak(self, a: Array, b: Array, loose: Mask) -> tuple[Array, Array]:
        """Return the step to the most probable values and their covariance, by an active-set method."""
        count = len(self.names)
        at, precision, limits = self._priors
        centre, half = limits.mean(axis=1), (limits[:, 1] - limits[:, 0]) / 2
        precision = np.where(loose, 1e-4, 1.0) * precision
        edge = 1.0 / (EDGE * half) ** 2
        # A nuisance that the flights do not show at all keeps its value.
        drawn = precision * (np.diag(a)[:count] > SEEN)
        side = np.zeros(count)
        for _ in range(6):
            full, right = a.copy(), b.copy()
            bound = centre + side * half
            pull = np.where(side != 0, edge, 0.0)
            full[np.arange(count), np.arange(count)] += precision + pull
            right[:count] += drawn * (centre - at) + pull * (bound - at)
            diagonal = np.diag(full)
            scale = 1.0 / np.sqrt(np.where(diagonal > SEEN, diagonal, 1.0))
            scaled = full * scale[:, None] * scale + RIDGE * np.eye(len(b))
            covariance = np.linalg.inv(scaled) * scale[:, None] * scale
            step = covariance @ right
            x = at + step[:count]
            out = np.where(loose, 0.0, 1.0 * (x > limits[:, 1]) - 1.0 * (x < limits[:, 0]))
            if (out == side).all():
                break
            side = out
        return step, covariance

    def _penalty(self, step: Array, loose: Mask) -> float:
        at, precision, limits = self._priors
        half = (limits[:, 1] - limits[:, 0]) / 2
        away = at + step[: len(at)] - limits.mean(axis=1)
        beyond = np.where(loose, 0.0, np.maximum(np.abs(away) - half, 0.0) / (EDGE * half))
        precision = np.where(loose, 1e-4, 1.0) * precision
        return 0.5 * float(np.sum(precision * away**2) + np.sum(beyond**2))

"""Covariates: roll-out errors against what the leading cause predicts of them, beside the same for its rival.

All roll-outs start from the same filtered states. The difference between roll-outs without and with a cause
is the error that it predicts: its covariate, in the units of the channel. If the cause is right, the error
without it rises one for one with the covariate, and the error with it does not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from frontend.cores import in_threads
from slam.core.arrays import Array
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import CHANNEL_UNITS, CHANNELS
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitting import first_parts, refit
from slam.criticism.search.search import LINEAR_Z, SHORT_S, SearchResult
from slam.criticism.verdict.held_out import fitted_parameters
from slam.criticism.verdict.rollouts import pooled_residuals

AHEAD_S = 2.0


@dataclass(frozen=True)
class ChannelResiduals:
    """Roll-out errors of one channel over two seconds, against the covariate of one cause."""

    cause: str
    """Cause whose covariate it is."""
    channel: str
    unit: str
    explained: Array
    """(n,) error that the cause predicts for a model without it."""
    residuals: dict[str, Array]
    """Cause that is in the model, or "" for none -> (n,) measured less predicted."""


@dataclass(frozen=True)
class Covariate:
    """Covariates of the leading cause, and of its rival in the verdict."""

    cause: str
    rival: str
    """Name of the rival; empty where there is none, or where roll-outs cannot include it."""
    against: tuple[ChannelResiduals, ...]
    """Errors against the leading cause's covariate, and against the rival's."""


def covariate(
    records: Sequence[Record],
    parameters: FilterParameters,
    found: SearchResult,
    cause: str,
    rival: str,
    z: float,
) -> Covariate | None:
    """Return the covariates of a chosen ``cause`` with a score test of ``z``, and of its ``rival``; None
    where roll-outs do not show the cause.

    Sizes and nuisances are fitted without the cause, and with its rival. For a large cause the filter is run
    anew.
    """
    effect = next((e for e in found.chosen if e.name == cause), None)
    if effect is None or not (effect.perturbations or effect.relaxes):
        return None
    rest = [e for e in found.chosen if e is not effect]
    short = first_parts(records, SHORT_S)
    # Roll-outs cannot include a term that only adds noise.
    ways = (s.effect for s in found.in_place(effect, rival) if s.effect.perturbations or s.effect.relaxes)
    other = next(ways, None)

    def refitted(effects: list[Effect]) -> FilterParameters:
        if z < LINEAR_Z and not effect.is_saturation:
            return fitted_parameters(found, effects)
        return refit(short, found.model, effect.without(parameters), effects)[1]

    models = {"": refitted(rest), cause: parameters}
    if other is not None:
        models[rival] = refitted([*rest, other])
    states = in_threads(lambda record: whole(record, parameters).states, short)
    pooled = {}
    for name, with_cause in models.items():
        errors = pooled_residuals(short, states, [with_cause] * len(short), AHEAD_S, 1.0)
        pooled[name] = {(CHANNELS[c], CHANNEL_UNITS[c]): off for c, off in errors.items()}
    return covariate_of(pooled, cause, rival if other is not None else "")


def covariate_of(
    pooled: Mapping[str, dict[tuple[str, str], Array]], cause: str, rival: str
) -> Covariate | None:
    """Return the covariates of a cause and its rival; None where no error shows the cause.

    ``pooled``: cause that is in the model, or "" for none -> channel and unit -> (n,) measured less
    predicted.
    """
    against = tuple(m for name in pooled if name and (m := _against(pooled, name)) is not None)
    if not against or against[0].cause != cause:
        return None
    return Covariate(cause, rival, against)


def _against(pooled: Mapping[str, dict[tuple[str, str], Array]], cause: str) -> ChannelResiduals | None:
    """Return the errors of the channel in which the cause removes the greatest share; None without one."""
    shares = {}
    for channel, plain in pooled[""].items():
        left = pooled[cause][channel]
        if np.any(plain != left):
            shares[channel] = 1.0 - float(np.sum(left**2) / max(np.sum(plain**2), 1e-300))
    if not shares:
        return None
    best = max(shares, key=lambda c: shares[c])
    residuals = {name: of[best] for name, of in pooled.items()}
    return ChannelResiduals(cause, *best, pooled[""][best] - pooled[cause][best], residuals)

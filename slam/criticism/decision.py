"""From the search to a verdict: nothing wrong, named, ambiguous, named with a remainder, or unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slam.criticism.criticism import Cause, Gain, Interval, Verdict
from slam.criticism.effects import Effect, catalogue_value
from slam.criticism.heldout import held_out
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.setting import Setting
from slam.criticism.moving import on_grid
from slam.criticism.posterior import NOTHING, SOMETHING_ELSE, Posterior, named
from slam.criticism.rollouts import roll_out_errors
from slam.criticism.search import Look, Search, Standing
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]

SURE = 0.95
WIDE = 1.96


def causes_of(
    records: Sequence[Record], model: Setting, found: Search, posterior: Posterior
) -> tuple[Cause, ...]:
    """The chosen terms of the catalogue, most probable first."""
    known = [e for e in found.chosen if named(e)]
    if not known:
        return ()
    all_together = held_out(found, model)
    channels = roll_out_errors(records, all_together.before, all_together.after)
    causes = []
    for effect in known:
        rest = [e for e in found.chosen if e is not effect]
        own = held_out(found, model, rest) if rest else all_together
        place = list(found.chosen).index(effect)
        standing = found.last.standing(rest, [effect])[0]
        causes.append(
            Cause(
                effect.name,
                posterior.probability.get(effect.name, 0.0),
                sizes(found.last, effect, found.chosen),
                Gain(own.total, own.ci95, own.by, tuple(own.nats.tolist()), channels),
                standing.z,
                posterior.lead_nats[place],
            )
        )
    return tuple(sorted(causes, key=lambda c: (-round(c.probability, 3), -c.gain.nats)))


def sizes(look: Look, effect: Effect, chosen: Sequence[Effect]) -> dict[str, Interval]:
    """Fitted parameters of a term in the catalogue's units."""
    columns = look.parabola.index(effect.columns)
    step, covariance = look.parabola.answer(chosen).of(columns)
    found = {}
    for k, name in enumerate(effect.parameters):
        std = float(np.sqrt(covariance[k, k]))
        ends = [_value(look, effect, k, float(step[k]) + side * WIDE * std) for side in (0, -1, 1)]
        unit = CATALOGUE[effect.name].parameter(name).unit
        found[name] = Interval(ends[0], unit, min(ends[1:]), max(ends[1:]))
    return found


def _value(look: Look, effect: Effect, k: int, step: float) -> float:
    return catalogue_value(effect, k, step, look.setting, look.parabola.held.get(effect.columns[k], 0.0))


def decide(
    causes: Sequence[Cause], found: Search, posterior: Posterior, left: Sequence[Standing], shape_z: float
) -> tuple[Verdict, tuple[str, ...], str]:
    """Verdict, equivalence set, remainder."""
    odd = [e for e in found.chosen if not named(e)]
    remains = [f"{e.name}" for e in odd]
    remains += [f"{s.effect.name} (z = {s.z:.1f})" for s in left[:1] if s.z > shape_z]
    remainder = "; ".join(remains)
    if not causes:
        return ("unknown" if remainder else "nothing_wrong"), (), remainder
    sets = [a for e, a in zip(found.chosen, posterior.alternatives, strict=True) if named(e)]
    open_sets = [a for a in sets if len(a) > 1]
    unknown = posterior.probability[SOMETHING_ELSE]
    if not odd and unknown > 0.5 and causes[0].probability < 0.5:
        return "unknown", (), remainder or _strongest(left)
    if open_sets:
        return "ambiguous", tuple(dict.fromkeys(n for a in open_sets for n in a)), remainder
    if causes[0].probability < SURE or causes[0].gain.ci95[0] <= 0.0:
        return "ambiguous", tuple(c.name for c in causes), remainder
    doubtful = [f"{c.name} may be something else" for c in causes if c.probability < SURE]
    remainder = "; ".join([*([remainder] if remainder else []), *doubtful])
    return ("named_with_remainder" if remainder else "named"), tuple(c.name for c in causes), remainder


def _strongest(left: Sequence[Standing]) -> str:
    return f"{left[0].effect.name} (z = {left[0].z:.1f})" if left else ""


def detectable(look: Look, threshold: float) -> dict[str, tuple[float, str]]:
    """Smallest size of each term that would have been seen in nine of ten cases."""
    found: dict[str, tuple[float, str]] = {}
    for effect in look.effects:
        if not named(effect) or on_grid(effect):
            continue
        columns = look.parabola.index(effect.columns)
        _, covariance = look.parabola.answer([effect]).of(columns)
        # The direction of a vector that shows least.
        k = int(np.argmax(np.diag(covariance)))
        size = (threshold + 1.28) * float(np.sqrt(covariance[k, k]))
        neutral = catalogue_value(effect, k, 0.0, look.setting, 0.0)
        value = abs(catalogue_value(effect, k, size, look.setting, 0.0) - neutral)
        unit = CATALOGUE[effect.name].parameter(effect.parameters[k]).unit
        parameter = CATALOGUE[effect.name].parameter(effect.parameters[k])
        if np.isfinite(value) and value < 10 * max(abs(parameter.most), abs(parameter.least)):
            kept = found.get(effect.name)
            found[effect.name] = (min(value, kept[0]) if kept else value), unit
    return found


__all__ = ["NOTHING", "causes_of", "decide", "detectable", "sizes"]

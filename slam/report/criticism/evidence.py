"""Evidence of a criticism in sentences: how sure it is, what rules others out, where it shows, what it
changes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import either
from slam.core.names import enumerated
from slam.core.units import everyday, sized
from slam.report.criticism.certainty import fair_rival, is_established, probability_in_words, reservations
from slam.report.criticism.judged_data import parts_in_words
from slam.report.criticism.plain_names import figure, reading
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.cause import Cause, ChannelError, Gain

_TERMS_ALONE = ("nothing", "unknown")
"""Hypotheses that are no effects."""


def how_sure(result: Criticism) -> list[str]:
    """Return how certain it is that something is there and that it is the named cause, with the reasons;
    without a cause, how far all effects are from standing out."""
    if result.causes:
        told = [*_by_certainty(result), *(_reserved(cause, result) for cause in result.causes)]
        passed = f"At least {result.threshold:.1f} is asked for, {result.threshold_means}."
        return [*told, passed] if result.threshold_means else told
    effects = [rank for rank in result.ranking if rank.name not in _TERMS_ALONE]
    if not effects:
        return []
    most = max(effects, key=lambda rank: rank.z)
    told = [
        f"Of all effects {most.name} stands out most, by {most.z:.1f} standard deviations; "
        f"{result.threshold:.1f} is {result.threshold_means}."
    ]
    if result.verdict != "nothing_wrong" and result.patterns:
        told.append(f"What is not explained stands out by {result.patterns[0][1]:.1f}.")
    return told


def _by_certainty(result: Criticism) -> list[str]:
    """Return the causes that are certain, and those of which only something is, with their evidence."""
    told = []
    sure = [c for c in result.causes if is_established(c, result)]
    rest = [c for c in result.causes if c not in sure]
    for words, kind in (
        ("Certain", sure),
        ("Certainly there is something, but its name is less certain", rest),
    ):
        if kind:
            told.append(f"{words}: {enumerated([_evidence(cause, result) for cause in kind])}.")
    return told


def _evidence(cause: Cause, result: Criticism) -> str:
    of = "its readings" if cause.gain.by is None else "held-out data"
    strength = f"{cause.gain.nats:.0f} nats of {of}"
    if cause.gain.by is not None:
        strength = f"{cause.z:.1f} standard deviations, {strength}"
    told = probability_in_words(cause, result)
    return f"{cause.name} ({'probability ' * told[0].isdigit()}{told}; {strength})"


def _reserved(cause: Cause, result: Criticism) -> str:
    """Return the reservations about a cause in a sentence; empty without any."""
    told = reservations(cause, result)
    return f"{cause.name}: {'; '.join(told)}." if told else ""


def no_other(cause: Cause) -> str:
    """Return why the next best effect in the place of a cause is ruled out; empty where there is none."""
    if not fair_rival(cause):
        return ""
    return (
        f"The next best in place of {cause.name} is {cause.rival}: with it the flights fit worse by "
        f"{cause.lead_nats:.0f} nats."
    )


def where_it_shows(result: Criticism, drawn: Sequence[str]) -> list[str]:
    """Return in how many flights the leading cause shows, in which most, and what the page shows of it."""
    if not result.causes:
        return [*drawn]
    gain, names = result.causes[0].gain, result.flights
    parts = np.array(gain.parts)
    better = f"{int(np.sum(parts > 0))} of {parts_in_words(gain.by, len(parts))}"
    told = f"{'in' if len(result.causes) > 1 else 'In'} {better}"
    if len(parts) < 2:
        told = f"In {names[0]}" if len(names) == 1 else ""
    elif len(parts) == len(names) and gain.by != "segment":
        most, least = names[int(np.argmax(parts))], names[int(np.argmin(parts))]
        told += f"; most in {most} ({parts.max():.0f} nats), least in {least} ({parts.min():.0f} nats)"
    elif len(names) == 1:
        told += f" of {names[0]}"
    who = f"{result.causes[0].name}: " if len(result.causes) > 1 and told else ""
    return [f"{who}{told}." if told else "", *drawn]


def what_changes(result: Criticism) -> list[str]:
    """Return the error before and after of the channel that gains most, and of those that became worse."""
    if not result.causes:
        return []
    gain = result.causes[0].gain
    if gain.by is None:
        return ["Single readings, not the prediction of the motion: see “What shows it”."]
    most = gain.foremost
    included = f", with all {len(result.causes)} causes together" if len(result.causes) > 1 else ""
    first = f"{change_of(most)}, on held-out data{included}." if most else "No error of the prediction falls."
    return [first, *_others(gain), _worse(gain)]


def _others(gain: Gain) -> list[str]:
    """Return the changes of the other judged errors, from the greatest gain to the least."""
    others = sorted(
        (e for e in gain.judged if e is not gain.foremost and e.before), key=lambda e: e.after / e.before
    )
    told = [f"{reading(e.channel)} {percent_of(e.after / e.before)}" for e in others]
    return [f"The others change by: {', '.join(told)}."] if told else []


def percent_of(ratio: float) -> str:
    """Return a change as percent with its sign; one that rounds to nothing has none."""
    change = round(100 * (ratio - 1))
    return f"{change:+d} %" if change else "0 %"


def _worse(gain: Gain) -> str:
    from slam.criticism.search.thresholds import MISFIT

    worse = [change_of(error) for error in gain.judged if error.after > (1.0 + MISFIT) * error.before]
    if not worse:
        return f"No judged reading is predicted worse by more than {100 * MISFIT:.0f} %."
    return f"{either(len(worse), 'One', 'Some')} became worse: {'; '.join(worse)}."


def change_of(error: ChannelError) -> str:
    """Return the error of a channel over a horizon, after and before, in one unit."""
    factor, unit = everyday(error.before, error.unit)
    ahead = f"{error.horizon_s:g} s ahead" if error.horizon_s else "from picture to picture"
    change = percent_of(error.after / error.before) if error.before else "0 %"
    return (
        f"the error of {reading(error.channel)} {ahead} is {figure(factor * error.after)} {unit} instead of "
        f"{figure(factor * error.before)} ({change})"
    )


def longer_bar(result: Criticism) -> str:
    """Return why the most probable cause leads an effect that stands out by more alone; empty where none
    does."""
    if not result.causes:
        return ""
    lead, z = result.causes[0], {rank.name: rank.z for rank in result.ranking}
    found = {cause.name for cause in result.causes}
    others = [r for r in result.ranking if r.name in CATALOGUE and r.name not in found]
    longer = [r for r in others if r.z > z.get(lead.name, np.inf) and r.probability < lead.probability]
    if not longer:
        return ""
    other = max(longer, key=lambda rank: rank.z)
    together = " and together with the other causes" if len(result.causes) > 1 else ""
    worse = f": with it in this place the flights fit worse by {lead.lead_nats:.0f} nats or more"
    return (
        f"Alone, {CATALOGUE[other.name].title} stands out more ({sized(other.z, 'sigma')}) than "
        f"{CATALOGUE[lead.name].title} ({sized(z[lead.name], 'sigma')}), and is less probable all the same. "
        "The right side tests each by itself, as a small change; the probability counts how well it explains "
        f"the flights at its full size{together}{worse * (0.0 < lead.lead_nats < np.inf)}."
    )

"""Sentences of a verdict for a person: a headline of at most three short sentences, and details.

A cause is something that "the model lacks" only if it is more probable than not. A less probable one is
reported as possible, and one below ``FAINT`` is not named in the headline.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from slam.core.names import enumerated
from slam.core.units import everyday, sized
from slam.criticism.cause import FAINT, LIKELY, NOT_AHEAD_S, Cause, Gain
from slam.criticism.verdict.criticism import Criticism
from slam.simulation.terms import CATALOGUE

MOST_SENTENCES = 3
"""Greatest number of sentences of a headline."""


def with_sentences(found: Criticism, noise: tuple[str, ...]) -> Criticism:
    """Return the criticism of judged flights with its headline and its details, ``noise`` among them."""
    if found.verdict == "unusable":
        return found
    lines = (*details(found), *noise, *filter(None, [found.not_shown]))
    return replace(found, sentence=headline(found), details=lines, noise=noise)


def headline(found: Criticism) -> str:
    """Return at most three short sentences: the finding, then gain, what is unexplained and the limits."""
    match found.verdict:
        case "nothing_wrong":
            judged, seen = "an instrument" if found.limits else "the model", len(found.within_reach)
            first = f"The flights show no error of {judged}."
            gain = f"They would have shown {seen} of {len(CATALOGUE)} effects at their usual sizes."
        case "unknown":
            first = _unknown(found)
            possible = [cause for cause in found.causes if FAINT <= cause.probability <= LIKELY]
            gain = f"A part may be {_listed_causes(possible)}." if possible else ""
        case _:
            first = (_ambiguous if found.verdict == "ambiguous" else _named)(found)
            leads = [cause.gain for cause in found.causes[:1]]
            gain = "".join(_sentence(_gain_of_channel(of) or _gain_in_nats(of)) for of in leads)
    others = len(found.findings) - 1
    more = f", and {others} more" if others > 0 else ""
    unexplained = f"Unexplained: {found.findings[0]}{more}." if found.findings else ""
    rest = [part for part in (gain, unexplained, found.limits) if part]
    return " ".join([first, *rest[-(MOST_SENTENCES - 1) :]])


def details(found: Criticism) -> tuple[str, ...]:
    """Return further lines on causes, equivalents, unexplained findings, noise, and sizes that would show."""
    lines = [_describe(cause) for cause in found.causes]
    if found.causes and (ahead := _gain_of_channel(found.causes[0].gain)):
        lines.append(_sentence(f"{'with all causes together, ' * (len(found.causes) > 1)}{ahead}"))
    lines += indistinguishable(found)
    lines += [f"Unexplained: {finding}." for finding in found.findings]
    if found.noise_correlation:
        shares = ", ".join(f"{name} ({share:.2f})" for name, share in found.noise_correlation.items())
        lines.append(f"Noise is correlated from one sample to the next, which is healthy: {shares}.")
    return (*lines, *smallest_sizes(found))


def indistinguishable(found: Criticism) -> list[str]:
    """Return a sentence on the effects that explain the flights equally well; none for another verdict."""
    if found.verdict != "ambiguous":
        return []
    alike = ", ".join(f"{n} (probability {found.probability_of(n):.2f})" for n in found.equivalence_set)
    return [f"Effects that the flights cannot distinguish: {alike}."]


def smallest_sizes(found: Criticism) -> list[str]:
    """Return a sentence on what flights without an error would have shown; none for another verdict."""
    seen = found.within_reach if found.verdict == "nothing_wrong" else ()
    sizes = ", ".join(f"{name} {sized(*found.detectable[name], digits=2)}" for name in _one_a_family(seen))
    return [f"Smallest sizes that nine of ten such flights would have shown: {sizes}."] if sizes else []


def unusable(reasons: Sequence[str], dropped: Sequence[str] = (), advice: str = "") -> Criticism:
    """Return a verdict on flights that cannot be judged; its headline has the first reason alone."""
    first, *others = reasons
    more = f", and {len(others)} further reason{'s' if len(others) > 1 else ''}" if others else ""
    text = f"These data cannot be judged: {first}{more}."
    lines = tuple(f"{reason}." for reason in others)
    return Criticism("unusable", f"{text} {advice}".rstrip(), details=lines, dropped=tuple(dropped))


def _unknown(found: Criticism) -> str:
    """Name probable causes in the main clause: what else is wrong does not make them less probable."""
    if lacking := _lacking(found):
        more = "more is wrong that no term of the catalogue explains"
        return f"The model lacks {enumerated(lacking)}, and {more}."
    return "Something is wrong that no term of the catalogue explains."


def _ambiguous(found: Criticism) -> str:
    also = [c for c in found.probable if c.name not in found.equivalence_set]
    the_flights = f"The model lacks {_listed_causes(also)}; the flights" if also else "The flights"
    likely = [n for n in found.equivalence_set if found.probability_of(n) >= FAINT]
    if len(likely) == 1:
        best = f"{likely[0]} is the most probable ({found.probability_of(likely[0]):.2f})"
        return f"{the_flights} cannot distinguish {len(found.equivalence_set)} effects, of which {best}."
    return f"{the_flights} cannot distinguish {enumerated(likely or found.equivalence_set)}."


def _named(found: Criticism) -> str:
    if not found.causes:
        return "No term of the catalogue is a probable cause."
    if len(lacking := _lacking(found)) > 1 or (lacking and not found.probable):
        return f"The model lacks {enumerated(lacking)}."
    lead = found.probable[0] if found.probable else found.causes[0]
    sizes = ", ".join(f"{n} = {sized(p.value, p.unit)}" for n, p in lead.parameters.items())
    bracket = f"({sizes}{'; ' if sizes else ''}probability {lead.probability:.2f})"
    if found.probable:
        return f"The model lacks {lead.name}: {CATALOGUE[lead.name].meaning} {bracket}."
    if lead.probability >= FAINT:
        return f"The most probable cause is {lead.name}: {CATALOGUE[lead.name].meaning} {bracket}."
    return f"No term of the catalogue is a probable cause; the nearest is {lead.name}."


def _lacking(found: Criticism) -> list[str]:
    """Return the causes that are more probable than not, alone or with their alternatives."""
    known = {n: found.probability_of(n) for c in found.causes for n in c.alternatives}
    sets = [c for c in found.causes if c.probability <= LIKELY < c.with_alternatives(known)]
    return [f"{c.name} (probability {c.probability:.2f})" for c in found.probable] + [
        f"{' or '.join(c.alternatives)} (together {c.with_alternatives(known):.2f})" for c in sets
    ]


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _gain_of_channel(gain: Gain) -> str:
    """Describe the channel that gains most, in its own unit; empty where no channel is better."""
    most = gain.foremost
    if gain.by is None or most is None:
        return ""
    what = f"the error of {most.channel} {most.horizon_s:g} s ahead"
    if most.horizon_s == NOT_AHEAD_S:
        what = "the reprojection error from picture to picture"
    factor, unit = everyday(most.before, most.unit)
    after, before = (f"{factor * error:.2g}" for error in (most.after, most.before))
    return f"on held-out {gain.by}s {what} is {after} {unit} instead of {before}"


def _gain_in_nats(gain: Gain) -> str:
    if gain.by is None:
        return f"single readings show it, by {gain.nats:.0f} nats of log likelihood"
    ahead = ", and no channel is predicted better" if gain.foremost is None and gain.channels else ""
    return f"on held-out {gain.by}s the log likelihood gains {gain.nats:.0f} nats{ahead}"


def _describe(cause: Cause) -> str:
    """Describe a cause with its probability, its gain and its lead; its sizes are in a table of their own."""
    words = f"{CATALOGUE[cause.name].meaning} (probability {cause.probability:.2f})"
    rival = cause.fair_rival if len(cause.alternatives) < 2 else ""
    lead = f"; {rival}, the next best, fits the flights worse by {cause.lead_nats:.0f} nats" if rival else ""
    return f"{cause.name}: {words}; {_gain_in_nats(cause.gain)}{lead}."


def _listed_causes(causes: Sequence[Cause]) -> str:
    """Return the names with their probabilities."""
    return enumerated([f"{c.name} (probability {c.probability:.2f})" for c in causes])


def _one_a_family(names: Iterable[str]) -> list[str]:
    first: dict[str, str] = {}
    for name in names:
        first.setdefault(CATALOGUE[name].family, name)
    return list(first.values())

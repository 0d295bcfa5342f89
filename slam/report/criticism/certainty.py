"""How sure a cause is: that something is there, and that it has this name, are two questions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slam.core.names import enumerated
from slam.core.units import sized
from slam.criticism.finding import Inconsistency
from slam.report.criticism.judged_data import judged_of
from slam.report.criticism.plain_names import title_of
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism
    from slam.criticism.cause import Cause


@dataclass(frozen=True)
class CertaintyRow:
    """Table row of the evidence for one cause."""

    title: str
    alone: str
    """Standard deviations by which it stands out, added to the original model by itself."""
    beside: str
    """The same beside the other causes."""
    nats: str
    parts: str
    """Held-out parts that it predicts better."""
    rival: str
    probability: str


def certainty_rows(result: Criticism) -> list[CertaintyRow]:
    """Return the evidence for each cause."""
    alone = {rank.name: rank.z for rank in result.ranking}
    rows = []
    for cause in result.causes:
        parts, single = np.array(cause.gain.parts), cause.gain.by is None
        rows.append(
            CertaintyRow(
                title=title_of(cause.name),
                alone=f"{alone[cause.name]:.1f}" if cause.name in alone else "–",
                beside="–" if single else f"{cause.z:.1f}",
                nats=f"{cause.gain.nats:.0f}",
                parts="single readings" if single else f"{int(np.sum(parts > 0))} of {len(parts)}",
                rival=_next_best(cause),
                probability=doubt_of_name(cause, result) or f"{cause.probability:.2f}",
            )
        )
    return rows


def _next_best(cause: Cause) -> str:
    rival = cause.fair_rival
    return f"{title_of(rival)}, {cause.lead_nats:.0f} nats worse" if rival else "none explains a fair part"


def differs(cause: Cause) -> bool:
    """Return whether any size of a cause is different from no effect, by its 95 % interval."""
    if not cause.parameters:
        return True
    neutral = CATALOGUE[cause.name].neutral
    return any(not p.low <= neutral[name] <= p.high for name, p in cause.parameters.items())


def is_established(cause: Cause, result: Criticism) -> bool:
    """Return whether a cause is certain, has a size that is not none, and no other looks the same."""
    from slam.criticism.cause import SURE

    alone = len(cause.alternatives) < 2 and not likeness_of_rival(cause, result)
    return cause.probability >= SURE and alone and differs(cause)


def by_certainty(result: Criticism) -> tuple[list[Cause], list[Cause], list[Cause]]:
    """Return the causes that are established, those of which something is there whose name is less certain,
    and those whose size may be none."""
    sure = [c for c in result.causes if is_established(c, result)]
    rest = [c for c in result.causes if c not in sure]
    return sure, [c for c in rest if differs(c)], [c for c in rest if not differs(c)]


def uncertain(result: Criticism) -> list[Cause]:
    """Return the causes with one name that is not certain."""
    from slam.criticism.cause import SURE

    return [c for c in result.causes if 0 < c.probability < SURE and len(c.alternatives) < 2]


def changes(cause: Cause, result: Criticism) -> bool:
    """Return whether a size of a cause changes during the flights."""
    return any(series.effect == cause.name for series in result.changes)


def drifting(result: Criticism) -> list[Cause]:
    """Return the causes that are there with a size that changes during the flights."""
    return [cause for cause in result.causes if changes(cause, result) and differs(cause)]


def likeness_of_rival(cause: Cause, result: Criticism) -> float:
    """Return the likeness of a cause and its fair rival where both have nearly the same course over these
    flights; else 0."""
    from slam.criticism.search.expansion import ONE_CLASS

    pair = {cause.name, cause.fair_rival}
    likeness = max((c for a, b, c in result.confusable if {a, b} == pair), default=0.0)
    return likeness if likeness > ONE_CLASS else 0.0


def doubt_of_name(cause: Cause, result: Criticism) -> str:
    """Return why the probability of a cause is none of its name; empty where it is.

    A probability that says only that one of several effects is there is none of the name.
    """
    if not differs(cause):
        return "not established: its size may be none"
    if not likeness_of_rival(cause, result):
        return ""
    return f"hardly distinct from {title_of(cause.fair_rival)} here"


def certainly_more(result: Criticism) -> str:
    """Return that something outside of the catalogue is certain, where it makes causes uncertain."""
    from slam.criticism.cause import SURE
    from slam.criticism.verdict.posterior import SOMETHING_ELSE

    is_certain = uncertain(result) and result.probability_of(SOMETHING_ELSE) > SURE
    return "These flights certainly hold something outside of the catalogue." if is_certain else ""


def outside_of_catalogue(result: Criticism) -> str:
    """Return where the rest of the probability of uncertain causes belongs; empty where none is uncertain, or
    where nothing outside of the catalogue is probable."""
    if not certainly_more(result):
        return ""
    open_ = uncertain(result)
    rest = {f"{1.0 - c.probability:.2f}" for c in open_}
    share = f"other {rest.pop()} of the" if len(rest) == 1 else "rest of the"
    if len(open_) == 1:
        return f"The {share} probability is that of a cause outside of the catalogue."
    return (
        f"For each, the {share} probability is that of a cause outside of the catalogue in its place; "
        "several may be there at once."
    )


def reservations(cause: Cause, result: Criticism) -> list[str]:
    """Return what speaks against a cause, or why it is not certain, in sentences without their subject."""
    lines = []
    if not differs(cause):
        lines.append("no size of it differs from none, so it is not established by itself")
    if cause.gain.by and cause.z < result.threshold:
        lines.append(
            f"beside the other causes it stands out by {cause.z:.1f} standard deviations, less than the "
            f"{result.threshold:.1f} that it had to reach when it was chosen"
        )
    if likeness := likeness_of_rival(cause, result):
        lines.append(
            f"it has nearly the same course over these flights as {title_of(cause.fair_rival)} (likeness "
            f"{likeness:.3f}), so its name is open: the {cause.lead_nats:.0f} nats by which it fits better "
            "would decide only if the model were exact"
        )
    why = _why_not_certain(cause, result)
    return [*lines, why] if why else lines


def _why_not_certain(cause: Cause, result: Criticism) -> str:
    """Return why a cause without an alternative is not certain, as the verdict decided it."""
    from slam.criticism.cause import SURE
    from slam.criticism.verdict.posterior import SOMETHING_ELSE

    if cause.probability >= SURE or len(cause.alternatives) > 1:
        return ""
    if result.probability_of(SOMETHING_ELSE) <= SURE:
        return "the flights gain too little by it"
    left_z = max((pattern.z for pattern in result.patterns[:1]), default=0.0)
    changing = (f for f in result.findings if isinstance(f, Inconsistency) and f.is_cause)
    if any(finding.effect == cause.name for finding in changing):
        return "its size differs between parts of the flights"
    if cause.gain.flies_worse:
        return "with it an error two seconds ahead becomes larger"
    if cause.z < left_z:
        return (
            f"something unknown stands out more ({left_z:.1f} standard deviations): this may be a part of it"
        )
    return "any motion that is not modelled looks like more scatter"


def out_of_order(cause: Cause, flights: Sequence[Flight]) -> str:
    """Return that readings with a cause's scatter would be out of order, so that it may rather be a motion;
    empty for another cause, a constant delay among them, or where readings are farther apart."""
    times = [size for size in cause.parameters.values() if size.unit == "s"]
    each = (s for f in flights for s in (f.attitude, f.velocity, f.sonar, f.imu) if s is not None)
    streams = [s for s in each if len(s.stamps_s) > 1]
    term = CATALOGUE[cause.name]
    if term.acts_on != "clock" or term.undo is not None or not times or not streams:
        return ""
    apart_s = max(float(np.median(np.diff(s.stamps_s))) for s in streams)
    if times[0].low <= apart_s:
        return ""
    return (
        f"readings only {sized(apart_s, 's')} apart would be out of order by such a scatter: it may be a "
        "motion that is not modelled"
    )


def how_sure(result: Criticism, flights: Sequence[Flight] = ()) -> list[str]:
    """Return how certain it is that something is there and that it is the named cause, with the reasons;
    without a cause, how far all effects are from standing out."""
    if result.causes:
        judged = judged_of(result, flights)
        lines = [*_by_certainty(result), certainly_more(result)]
        lines = [*filter(None, lines), *(_reserved(cause, result, judged) for cause in result.causes)]
        single = " (alone, of single readings)" * any(c.gain.by is None for c in result.causes)
        passed = (
            f"At least {result.threshold:.1f} standard deviations are asked for beside the other causes"
            f"{single}, {result.threshold_means}."
        )
        return [*lines, passed] if result.threshold_means else lines
    effects = [rank for rank in result.ranking if rank.name in CATALOGUE]
    if not effects:
        return []
    most = max(effects, key=lambda rank: rank.z)
    lines = [
        f"Of all effects {most.name} stands out most, by {most.z:.1f} standard deviations; "
        f"{result.threshold:.1f} is {result.threshold_means}."
    ]
    if result.verdict != "nothing_wrong" and result.patterns:
        lines.append(f"What is not explained stands out by {result.patterns[0].z:.1f}.")
    return lines


def _by_certainty(result: Criticism) -> list[str]:
    """Return the causes that are certain, and those that are less so, with their evidence."""
    words = (
        "Certain",
        "Certainly there is something, but its name is less certain",
        "Perhaps not there",
    )
    return [
        f"{begin}: {enumerated([_evidence(cause, result) for cause in kind])}."
        for begin, kind in zip(words, by_certainty(result), strict=True)
        if kind
    ]


def _evidence(cause: Cause, result: Criticism) -> str:
    alone, of = (" alone", "its readings") if cause.gain.by is None else ("", "held-out data")
    strength = f"{cause.z:.1f} standard deviations{alone}, {cause.gain.nats:.0f} nats of {of}"
    name = doubt_of_name(cause, result) or f"probability {cause.probability:.2f}"
    return f"{cause.name} ({name}; {strength})"


def _reserved(cause: Cause, result: Criticism, flights: Sequence[Flight]) -> str:
    """Return the reservations about a cause in a sentence; empty without any."""
    lines = [*reservations(cause, result), *filter(None, [out_of_order(cause, flights)])]
    return f"{cause.name}: {'; '.join(lines)}." if lines else ""


def no_other(cause: Cause) -> str:
    """Return why the next best effect in the place of a cause is ruled out."""
    return (
        f"The next best in place of {cause.name} is {cause.rival}: with it the flights fit worse by "
        f"{cause.lead_nats:.0f} nats."
    )


def longer_bar(result: Criticism) -> str:
    """Return why the most probable cause leads an effect that stands out by more; empty where none does."""
    if not result.causes:
        return ""
    lead, found = result.causes[0], {cause.name for cause in result.causes}
    others = [r for r in result.ranking if r.name in CATALOGUE and r.name not in found]
    longer = [r for r in others if r.z > lead.z and r.probability < lead.probability]
    if not longer:
        return ""
    other = max(longer, key=lambda rank: rank.z)
    beside, together = "", ""
    if len(result.causes) > 1:
        beside, together = " beside the other causes", " and together with the other causes"
    worse = f": with it in this place the flights fit worse by {lead.lead_nats:.0f} nats or more"
    return (
        f"Alone, {CATALOGUE[other.name].title} stands out more ({sized(other.z, 'sigma')}) than "
        f"{CATALOGUE[lead.name].title}{beside} ({sized(lead.z, 'sigma')}), and is less probable all the "
        "same. The right side tests it by itself, as a small change; the probability counts how well it "
        f"explains the flights at its full size{together}{worse * (0.0 < lead.lead_nats < np.inf)}."
    )

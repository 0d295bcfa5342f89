"""How sure a cause is: that something is there, and that it is this cause, are two questions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slam.core.names import enumerated
from slam.report.criticism.plain_names import title_of
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
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
                probability=probability_in_words(cause, result),
            )
        )
    return rows


def _next_best(cause: Cause) -> str:
    rival = fair_rival(cause)
    return f"{title_of(rival)}, {cause.lead_nats:.0f} nats worse" if rival else "none explains a fair part"


def fair_rival(cause: Cause) -> str:
    """Return the next best effect in the place of a cause, if it explains a fair part of what the cause
    does; else an empty name."""
    from slam.criticism.verdict.sentence import FAIR_SHARE

    explained = FAIR_SHARE * 0.5 * cause.z**2
    return cause.rival if cause.rival and 0.0 < cause.lead_nats < explained else ""


def differs(cause: Cause) -> bool:
    """Return whether any size of a cause is different from no effect, by its 95 % interval."""
    if not cause.parameters:
        return True
    neutral = CATALOGUE[cause.name].neutral
    return any(not p.low <= neutral[name] <= p.high for name, p in cause.parameters.items())


def is_established(cause: Cause, result: Criticism) -> bool:
    """Return whether a cause is certain, has a size that is not none, and no other looks the same."""
    from slam.criticism.cause import SURE

    alone = len(cause.alternatives) < 2 and not look_alike(cause, result)
    return cause.probability >= SURE and alone and differs(cause)


def changes(cause: Cause, result: Criticism) -> bool:
    """Return whether a size of a cause changes during the flights."""
    return any(series.column.partition(".")[0] == cause.name for series in result.changes)


def look_alike(cause: Cause, result: Criticism) -> list[str]:
    """Return the effects whose course over these flights is that of a cause, and that explain a fair part of
    what it does in its place."""
    from slam.criticism.verdict.posterior import ONE_CLASS

    pairs = [(a, b) for a, b, likeness in result.confusable if likeness > ONE_CLASS]
    return [name for name in (fair_rival(cause),) if {(cause.name, name), (name, cause.name)} & {*pairs}]


def probability_in_words(cause: Cause, result: Criticism) -> str:
    """Return the probability of a cause's name, or why there is none: a probability that says only that one
    of several effects is there is none of the name."""
    if not differs(cause):
        return "not established"
    if alike := look_alike(cause, result):
        return f"not separable from {enumerated([title_of(name) for name in alike])}"
    return f"{cause.probability:.2f}"


def outside_of_catalogue(result: Criticism) -> str:
    """Return where the rest of the probability of uncertain causes belongs; empty where none is uncertain, or
    where nothing outside of the catalogue is probable."""
    from slam.criticism.cause import SURE
    from slam.criticism.verdict.posterior import SOMETHING_ELSE

    open_ = [c for c in result.causes if 0 < c.probability < SURE and len(c.alternatives) < 2]
    if not open_ or result.probability_of(SOMETHING_ELSE) <= SURE:
        return ""
    rest = {f"{1.0 - c.probability:.2f}" for c in open_}
    share = f"other {rest.pop()} of the" if len(rest) == 1 else "rest of the"
    if len(open_) == 1:
        return f"The {share} probability is that of a cause outside of the catalogue."
    return (
        f"For each, the {share} probability is that of a cause outside of the catalogue; they do not exclude "
        "each other."
    )


def reservations(cause: Cause, result: Criticism) -> list[str]:
    """Return what speaks against a cause, or why it is not certain, in sentences without their subject."""
    told = []
    if not differs(cause):
        told.append("no size of it differs from none, so it is not established by itself")
    if cause.gain.by and cause.z < result.threshold:
        told.append(
            f"beside the other causes it stands out by {cause.z:.1f} standard deviations, less than the "
            f"{result.threshold:.1f} that it had to reach when it was chosen"
        )
    if alike := look_alike(cause, result):
        others = enumerated([title_of(name) for name in alike])
        told.append(
            f"it has the same course over these flights as {others}, so the two can hardly be told apart: "
            "only the fit as a whole prefers it"
        )
    if changes(cause, result):
        told.append("its size changes during the flights, so one size for all is a mean")
    why = _why_not_certain(cause, result)
    return [*told, why] if why else told


def _why_not_certain(cause: Cause, result: Criticism) -> str:
    """Return why a cause without an alternative is not certain, as the verdict decided it."""
    from slam.criticism.cause import SURE
    from slam.criticism.verdict.posterior import SOMETHING_ELSE

    if cause.probability >= SURE or len(cause.alternatives) > 1:
        return ""
    if result.probability_of(SOMETHING_ELSE) <= SURE:
        return "the flights gain too little by it"
    unknown = "these flights certainly hold something that no effect of the catalogue describes, and"
    left_z = max((z for _, z in result.patterns[:1]), default=0.0)
    if any(part.startswith(f"{cause.name} changes ") for part in result.unexplained):
        return f"{unknown} its size differs between parts of the flights"
    if cause.gain.flies_worse:
        return f"{unknown} with it an error two seconds ahead becomes larger"
    if cause.z < left_z:
        return f"{unknown} that stands out more ({left_z:.1f} standard deviations): this may be a part of it"
    return f"{unknown} any motion that is not modelled looks like more scatter"

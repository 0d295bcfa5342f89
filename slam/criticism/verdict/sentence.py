"""Sentences of a verdict for a person: a headline of at most three short sentences, and details.

A cause is something that "the model lacks" only if it is more probable than not. A less probable one is
reported as possible, and one below ``FAINT`` is not named in the headline.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from slam.criticism.cause import FAINT, JUDGED_HORIZON_S, LIKELY, NOT_AHEAD_S, Cause, Gain
from slam.criticism.verdict.criticism import Criticism, Verdict
from slam.criticism.verdict.power import within_reach
from slam.simulation.terms import CATALOGUE

FAIR_SHARE = 0.9
"""Share of the cause's evidence by which a rival may lag: one that lags by more explains none of it."""
MOST_SENTENCES = 3
"""Greatest number of sentences of a headline."""


_USE_IT = (
    "simulate, replay and map with --model extended.toml. Where the cause is a fault of an instrument, "
    "repair or calibrate it, and fly again to see it gone."
)
_LOOK = (
    "look at the pictures of the unexplained channel in the report, and check its sensor, mounting and clock "
    "first. Do not rely on the model's prediction of that channel."
)
_WHAT_TO_DO: Mapping[Verdict, str] = {
    "nothing_wrong": "simulate with the model as it is. To see smaller effects, fly longer, and fly "
    "the manoeuvres that docs/recipes.md lists for each effect.",
    "named": _USE_IT,
    "ambiguous": "fly the manoeuvre that docs/recipes.md lists for these effects, and criticise the flights "
    "together. Until then extended.toml predicts flights like these, but perhaps no others.",
    "named_with_remainder": f"{_USE_IT} For the rest, {_LOOK}",
    "unknown": _LOOK,
}
"""Verdict on flights that can be judged -> what their pilot should do."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Content of a verdict that its sentences report."""

    verdict: Verdict
    causes: Sequence[Cause] = ()
    """Causes, the leading one first."""
    equivalents: Sequence[str] = ()
    """Names that an ambiguous verdict cannot distinguish."""
    remainder: str = ""
    """Findings that no cause explains, separated by semicolons."""
    detectable: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    """Term -> smallest size that the flights would have shown in nine of ten cases, and its unit."""
    noise_correlation: Mapping[str, float] = field(default_factory=dict)
    """Instrument -> AR(1) coefficient of its noise, where it is above zero."""
    probability: Mapping[str, float] = field(default_factory=dict)
    """Term -> posterior probability; needed for ``equivalents`` that are no causes."""
    limits: str = ""
    """Sentence on what the verdict does not judge; empty where it judges everything."""

    @property
    def probable(self) -> list[Cause]:
        """Causes that are more probable than not."""
        return [c for c in self.causes if c.probability > LIKELY]

    @property
    def possible(self) -> list[Cause]:
        """Causes that are not probable, but not excluded either."""
        return [c for c in self.causes if FAINT <= c.probability <= LIKELY]

    @property
    def unexplained(self) -> list[str]:
        """Findings that no cause explains."""
        return [part for part in self.remainder.split("; ") if part]


def headline(finding: Finding) -> str:
    """Return at most three short sentences: the finding, then what is unexplained, the limits of the verdict
    and the gain, as far as there is room."""
    first = {"nothing_wrong": _nothing_wrong, "unknown": _unknown, "ambiguous": _ambiguous}.get(
        finding.verdict, _named
    )(finding)
    gain = {"nothing_wrong": _tested, "unknown": _partly_explained}.get(finding.verdict, _foremost_gain)(
        finding
    )
    rest = [part for part in (gain, _unexplained(finding), finding.limits) if part]
    return " ".join([first, *rest[-(MOST_SENTENCES - 1) :]])


def details(finding: Finding) -> tuple[str, ...]:
    """Return further lines: each cause and its gain, the equivalents, each unexplained finding, correlated
    noise, and the smallest sizes that a verdict of no error excludes."""
    lines = [_describe(cause) for cause in finding.causes]
    if finding.causes and (ahead := _gain_of_channel(finding.causes[0].gain)):
        together = "With all causes together, " if len(finding.causes) > 1 else ""
        lines.append(f"{together}{ahead if together else ahead[0].upper() + ahead[1:]}.")
    if finding.equivalents and finding.verdict == "ambiguous":
        lines.append(f"Effects that the flights cannot distinguish: {_with_probabilities(finding)}.")
    lines += [f"Unexplained: {part}." for part in finding.unexplained]
    if finding.noise_correlation:
        shares = ", ".join(f"{name} ({share:.2f})" for name, share in finding.noise_correlation.items())
        lines.append(f"Noise is correlated from one sample to the next, which is healthy: {shares}.")
    if finding.verdict == "nothing_wrong" and (seen := within_reach(finding.detectable)):
        sizes = (
            f"{name} {finding.detectable[name][0]:.2g}{_spaced(finding.detectable[name][1])}"
            for name in _one_a_family(seen)
        )
        lines.append(f"Smallest sizes that nine of ten such flights would have shown: {', '.join(sizes)}.")
    return tuple(lines)


def next_step(verdict: Verdict) -> str:
    """Return what the pilot should do after a verdict on flights that can be judged."""
    return f"What to do next: {_WHAT_TO_DO[verdict]}"


def unusable(reasons: Sequence[str], dropped: Sequence[str] = (), advice: str = "") -> Criticism:
    """Return a verdict on flights that cannot be judged. The headline has the first reason, the details have
    the others."""
    first, *others = reasons
    more = f", and {len(others)} further reason{'s' if len(others) > 1 else ''}" if others else ""
    text = f"These data cannot be judged: {first}{more}."
    lines = tuple(f"{reason}." for reason in others)
    return Criticism("unusable", f"{text} {advice}".rstrip(), details=lines, dropped=tuple(dropped))


def _nothing_wrong(finding: Finding) -> str:
    return "The flights show no error of the model."


def _tested(finding: Finding) -> str:
    seen = len(within_reach(finding.detectable))
    return f"They would have shown {seen} of {len(CATALOGUE)} effects at their usual sizes."


def _unknown(finding: Finding) -> str:
    """Name probable causes in the main clause: what else is wrong does not make them less probable."""
    if finding.probable:
        lacks = _listed_causes(finding.probable)
        return f"The model lacks {lacks}, and more is wrong that no term of the catalogue explains."
    return "Something is wrong that no term of the catalogue explains."


def _partly_explained(finding: Finding) -> str:
    if not finding.possible:
        return ""
    return f"A part may be {_listed_causes(finding.possible)}."


def _ambiguous(finding: Finding) -> str:
    also = [c for c in finding.probable if c.name not in finding.equivalents]
    the_flights = f"The model lacks {_listed_causes(also)}; the flights" if also else "The flights"
    likely = [n for n in finding.equivalents if _probability_of(n, finding) >= FAINT]
    if len(likely) == 1:
        best = f"{likely[0]} is the most probable ({_probability_of(likely[0], finding):.2f})"
        return f"{the_flights} cannot distinguish {len(finding.equivalents)} effects, of which {best}."
    return f"{the_flights} cannot distinguish {_listed(likely or finding.equivalents)}."


def _named(finding: Finding) -> str:
    if not finding.causes:
        return "No term of the catalogue is a probable cause."
    if len(finding.probable) > 1:
        return f"The model lacks {_listed_causes(finding.probable)}."
    lead = finding.probable[0] if finding.probable else finding.causes[0]
    sizes = ", ".join(f"{n} = {p.value:.3g}{_spaced(p.unit)}" for n, p in lead.parameters.items())
    bracket = f"({sizes}{'; ' if sizes else ''}probability {lead.probability:.2f})"
    if finding.probable:
        return f"The model lacks {lead.name}: {CATALOGUE[lead.name].meaning} {bracket}."
    if lead.probability >= FAINT:
        return f"The most probable cause is {lead.name}: {CATALOGUE[lead.name].meaning} {bracket}."
    return f"No term of the catalogue is a probable cause; the nearest is {lead.name}."


def _unexplained(finding: Finding) -> str:
    """Return a sentence with the first unexplained finding and the count of the others."""
    first, *others = finding.unexplained or [""]
    more = f", and {len(others)} more" if others else ""
    return f"Unexplained: {first}{more}." if first else ""


def _foremost_gain(finding: Finding) -> str:
    """Return a sentence with the gain of the leading cause in the channel that gains most; empty without a
    cause."""
    if not finding.causes:
        return ""
    text = _gain_of_channel(finding.causes[0].gain) or _gain_in_nats(finding.causes[0].gain)
    return f"{text[0].upper()}{text[1:]}."


def _gain_of_channel(gain: Gain) -> str:
    """Describe the channel that gains most, in its own unit; empty where no channel is better."""
    most = gain.foremost
    if gain.by is None or most is None:
        return ""
    if most.horizon_s == NOT_AHEAD_S:
        what = "the reprojection error from picture to picture"
    else:
        what = f"the error of {most.channel} {JUDGED_HORIZON_S:g} s ahead"
    return f"on held-out {gain.by}s {what} is {most.after:.2g} {most.unit} instead of {most.before:.2g}"


def _gain_in_nats(gain: Gain) -> str:
    if gain.by is None:
        return f"single readings show it, by {gain.nats:.0f} nats of log likelihood"
    no_better = gain.foremost is None and gain.channels
    ahead = f", and no channel is better {JUDGED_HORIZON_S:g} s ahead" if no_better else ""
    return f"on held-out {gain.by}s the log likelihood gains {gain.nats:.0f} nats{ahead}"


def _describe(cause: Cause) -> str:
    """Describe a cause with its probability, its gain and the lead over its rival; its sizes are in a table
    of their own."""
    words = f"{CATALOGUE[cause.name].meaning} (probability {cause.probability:.2f})"
    return f"{cause.name}: {words}; {_gain_in_nats(cause.gain)}{_excluded(cause)}."


def _excluded(cause: Cause) -> str:
    """Describe the lead over the next best explanation; empty where none explains a fair part."""
    explained = FAIR_SHARE * 0.5 * cause.z**2
    if len(cause.alternatives) > 1 or not cause.rival or not 0.0 < cause.lead_nats < explained:
        return ""
    return f"; {cause.rival}, the next best, explains {cause.lead_nats:.0f} nats less"


def _listed(names: Sequence[str]) -> str:
    return " and ".join([*([", ".join(names[:-1])] if len(names) > 1 else []), *names[-1:]])


def _listed_causes(causes: Sequence[Cause]) -> str:
    """Return the names with their probabilities."""
    return _listed([f"{c.name} (probability {c.probability:.2f})" for c in causes])


def _probability_of(name: str, finding: Finding) -> float:
    own = {cause.name: cause.probability for cause in finding.causes}
    return own.get(name, finding.probability.get(name, 0.0))


def _with_probabilities(finding: Finding) -> str:
    return ", ".join(f"{n} (probability {_probability_of(n, finding):.2f})" for n in finding.equivalents)


def _one_a_family(names: Iterable[str]) -> list[str]:
    first: dict[str, str] = {}
    for name in names:
        first.setdefault(CATALOGUE[name].family, name)
    return list(first.values())


def _spaced(unit: str) -> str:
    """Return the unit after a space; a factor has none."""
    return "" if unit == "1" else f" {unit}"

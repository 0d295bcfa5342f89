"""The sentence of a verdict for a person."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from slam.criticism.cause import JUDGED_HORIZON_S, NOT_AHEAD_S, Cause, Gain
from slam.criticism.verdict.criticism import Verdict
from slam.criticism.verdict.power import within_reach
from slam.criticism.verdict.words import IN_WORDS
from slam.simulation.terms import CATALOGUE

FAIR_SHARE = 0.9
"""Share of the cause's evidence by which a rival may lag: one that lags by more explains none of it."""


def sentence_of(
    verdict: Verdict,
    causes: Sequence[Cause],
    equivalents: Sequence[str],
    remainder: str,
    detectable: dict[str, tuple[float, str]],
    noise_correlation: Mapping[str, float] | None = None,
) -> str:
    """Return a sentence with the finding, its probability and its gain, and the instruments with correlated
    noise."""
    said = _said(verdict, causes, equivalents, remainder, detectable)
    if not noise_correlation:
        return said
    shares = ", ".join(f"{name} ({share:.2f})" for name, share in noise_correlation.items())
    return f"{said} Noise is correlated from one sample to the next, which is healthy: {shares}."


def _said(
    verdict: Verdict,
    causes: Sequence[Cause],
    equivalents: Sequence[str],
    remainder: str,
    detectable: dict[str, tuple[float, str]],
) -> str:
    if verdict == "nothing_wrong":
        seen = within_reach(detectable)
        sizes = {name: detectable[name] for name in _one_a_family(seen)}
        some = ", ".join(f"{name} of {size:.2g}{_spaced(unit)}" for name, (size, unit) in sizes.items())
        return (
            "The flights show no error of the model; at a usual size they would have shown "
            f"{len(seen)} of {len(CATALOGUE)} effects, such as {some}."
        )
    if verdict == "unknown":
        named = (
            f" ({', '.join(c.name for c in causes)} explain{'s' if len(causes) == 1 else ''} a part)"
            if causes
            else ""
        )
        return f"Something is wrong that no term of the catalogue explains: {remainder}{named}."
    described = "; ".join(_describe(cause) for cause in causes)
    gain = _describe_gain(causes[0].gain)
    if verdict == "ambiguous":
        text = f"The flights cannot distinguish {', '.join(equivalents)}; best: {described}; {gain}"
    else:
        text = f"The model lacks {described}; {gain}{_excluded(causes[0])}"
    return f"{text}; left over: {remainder}." if remainder else f"{text}."


def _one_a_family(names: Iterable[str]) -> list[str]:
    first: dict[str, str] = {}
    for name in names:
        first.setdefault(CATALOGUE[name].family, name)
    return list(first.values())


def _spaced(unit: str) -> str:
    """Return the unit after a space; a factor has none."""
    return "" if unit == "1" else f" {unit}"


def _describe_gain(gain: Gain) -> str:
    """Describe the channel that gains most two seconds ahead, in its own unit; nats where no channel is
    better."""
    most = gain.foremost
    if gain.by is None:
        return f"single readings show it, by {gain.nats:.0f} nats of log likelihood"
    if most is None:
        ahead = f", and no channel is better {JUDGED_HORIZON_S:g} s ahead" if gain.channels else ""
        return f"on held-out {gain.by}s the log likelihood gains {gain.nats:.0f} nats{ahead}"
    if most.horizon_s == NOT_AHEAD_S:
        what = "the reprojection error from picture to picture"
    else:
        what = f"the error of {most.channel} {JUDGED_HORIZON_S:g} s ahead"
    return (
        f"on held-out {gain.by}s {what} is {most.after:.2g} {most.unit} instead of {most.before:.2g} "
        f"(log likelihood {gain.nats:+.0f} nats)"
    )


def _describe(cause: Cause) -> str:
    sizes = ", ".join(
        f"{name} = {p.value:.3g} ({p.low:.3g} to {p.high:.3g}){_spaced(p.unit)}"
        for name, p in cause.parameters.items()
    )
    return f"{cause.name}: {IN_WORDS[cause.name]} ({sizes}; probability {cause.probability:.2f})"


def _excluded(cause: Cause) -> str:
    """Describe the lead over the next best explanation; empty where none explains a fair part."""
    explained = FAIR_SHARE * 0.5 * cause.z**2
    if len(cause.alternatives) > 1 or not cause.rival or not 0.0 < cause.lead_nats < explained:
        return ""
    return f"; {cause.rival}, the next best, explains {cause.lead_nats:.0f} nats less"

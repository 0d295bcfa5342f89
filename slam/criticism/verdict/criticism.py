"""Result of criticism: everything that a verdict, a report and an extended model need."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np

from slam.criticism.cause import LIKELY, Cause, ChannelError, Gain, Interval
from slam.criticism.finding import ResidualPattern
from slam.criticism.search.expansion import CORRELATION_DIGITS
from slam.criticism.verdict.over_time import SizeOverTime
from slam.criticism.verdict.rollouts import Covariate
from slam.data_quality.finding import Finding
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

Verdict = Literal["nothing_wrong", "named", "ambiguous", "named_with_remainder", "unknown", "unusable"]


@dataclass(frozen=True)
class Rank:
    """One bar of the ranking."""

    name: str
    probability: float
    z: float
    """Score test alone on the healthy vehicle; 0 for ``nothing`` and ``unknown``."""


@dataclass(frozen=True)
class ChannelCheck:
    """Check that the innovations of a channel are white under the final parameters."""

    channel: str
    count: int
    variance: float
    autocorrelation: float
    """Lag-one autocorrelation, of samples of the channel in a row."""
    tenths: tuple[float, ...] = ()
    """(10,) share of the innovations in each tenth of a standard normal distribution; ideally 0.1 each."""

    def to_json(self) -> dict[str, Any]:
        """Return its content in verdict.json."""
        moments = {"mean_square": round(self.variance, 4), "correlation": round(self.autocorrelation, 4)}
        return {"samples": self.count} | moments | {"tenths": [round(share, 4) for share in self.tenths]}


@dataclass(frozen=True, repr=False)
class Criticism:
    """Criticism of a simulation by some flights."""

    verdict: Verdict
    sentence: str = ""
    """Headline: at most three short sentences."""
    causes: tuple[Cause, ...] = ()
    equivalence_set: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    """Findings that no cause explains, with the strongest residual pattern."""
    next_flight: str = ""
    detectable: dict[str, tuple[float, str]] = field(default_factory=dict)
    """Name -> smallest size that these flights would have shown in nine of ten cases, and its unit."""
    ranking: tuple[Rank, ...] = ()
    confusable: tuple[tuple[str, str, float], ...] = ()
    """Pairs of terms whose sensitivities in these flights correlate by more than 0.9, and how much."""
    patterns: tuple[ResidualPattern, ...] = ()
    """Strongest residual patterns beside the causes."""
    nuisances: dict[str, Interval] = field(default_factory=dict)
    noise_correlation: dict[str, float] = field(default_factory=dict)
    """Instrument -> AR(1) coefficient of its noise, where it is above zero, which is healthy."""
    checks: tuple[ChannelCheck, ...] = ()
    covariate: Covariate | None = None
    """Roll-out errors against what the leading cause predicts of them; None where they do not show it."""
    threshold: float = 0.0
    """Threshold of the score test in standard deviations."""
    threshold_means: str = ""
    """Description of the threshold and its reason."""
    model: Model | None = None
    """The nominal model that was criticised."""
    extended: Model | None = None
    """The model with the causes in it and the nuisances fitted."""
    unseen: dict[str, Model] = field(default_factory=dict)
    """Flight -> the extended model fitted on all other flights."""
    flights: tuple[str, ...] = ()
    details: tuple[str, ...] = ()
    """Further sentences on all that follows from the other fields; why flights cannot be judged."""
    noise: tuple[str, ...] = ()
    """Sentences on noise that is larger or smaller than stated."""
    not_shown: str = ""
    """Sentence on what flights without commands could not show."""
    dropped: tuple[str, ...] = ()
    """Flights and streams that were not judged, with the reason, one line each."""
    changes: tuple[SizeOverTime, ...] = ()
    """Sizes over time of the parameters that are not the same throughout."""
    limits: str = ""
    """Sentence on what the verdict does not judge; empty where it judges everything."""

    def __repr__(self) -> str:
        causes = ", ".join(cause.name for cause in self.causes)
        return f"Criticism({self.verdict!r}, causes=[{causes}], flights={len(self.flights)})"

    @property
    def probable(self) -> list[Cause]:
        """Causes that are more probable than not."""
        return [c for c in self.causes if c.probability > LIKELY]

    @property
    def remainder(self) -> str:
        """Text of all findings."""
        return "; ".join(map(str, self.findings))

    @property
    def within_reach(self) -> dict[str, float]:
        """Terms that would have shown at a usual size, the most sharply tested first.

        Each has its smallest size as a share of the greatest usual one.
        """
        shares = {}
        for name, (size, unit) in self.detectable.items():
            sizes = [p for p in CATALOGUE[name].parameters if p.unit == unit]
            usual = max(max(abs(p.low - p.neutral), abs(p.high - p.neutral)) for p in sizes)
            # The lower a limit, the greater is its effect.
            shares[name] = sizes[0].low / size if sizes[0].is_limit else size / usual
        return dict(sorted((item for item in shares.items() if item[1] <= 1.0), key=lambda item: item[1]))

    def probability_of(self, name: str) -> float:
        """Return the posterior probability of a term: that of a cause, or else that in the ranking."""
        known = {rank.name: rank.probability for rank in self.ranking}
        return (known | {cause.name: cause.probability for cause in self.causes}).get(name, 0.0)

    def to_json(self) -> dict[str, Any]:
        """Return the content of verdict.json."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "details": list(self.details),
            "causes": [_cause(cause) for cause in self.causes],
            "equivalence_set": list(self.equivalence_set),
            "remainder": self.remainder or None,
            "findings": [_finding(finding) for finding in self.findings],
            "next_flight": self.next_flight or None,
            "detectable": {n: {"size": _short(s), "unit": u} for n, (s, u) in self.detectable.items()},
            "gain": _gain(self.causes[0].gain) if self.causes else None,
            "ranking": [
                {"name": r.name, "probability": round(r.probability, 6), "z": round(r.z, 3)}
                for r in self.ranking
            ],
            "noise_correlation": {n: _short(x) for n, x in self.noise_correlation.items()},
            "confusable": [
                {"names": [a, b], "cosine": round(c, CORRELATION_DIGITS)} for a, b, c in self.confusable
            ],
            "shapes": [{"name": pattern.name, "z": round(pattern.z, 2)} for pattern in self.patterns],
            "nuisances": {n: _interval(x) for n, x in self.nuisances.items()},
            "checks": {c.channel: c.to_json() for c in self.checks},
            "flights": list(self.flights),
            "dropped": list(self.dropped),
        }


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        "name": cause.name,
        "probability": round(cause.probability, 6),
        "parameters": {name: _interval(p) for name, p in cause.parameters.items()},
        "gain": _gain(cause.gain),
        "equivalence_set": list(cause.alternatives or (cause.name,)),
    }


def _finding(finding: Finding) -> dict[str, Any]:
    """Return kind, all fields except arrays, and text."""
    kind = re.sub("(?<=.)(?=[A-Z])", "_", type(finding).__name__).lower()
    known = {f.name: getattr(finding, f.name) for f in fields(finding)}
    numbers = {name: _short(x) for name, x in known.items() if not isinstance(x, np.ndarray)}
    return {"kind": kind} | numbers | {"text": str(finding)}


def _interval(p: Interval) -> dict[str, Any]:
    return {"value": _short(p.value), "unit": p.unit, "ci95": [_short(p.low), _short(p.high)]}


def _gain(gain: Gain) -> dict[str, Any]:
    every = [{"channel": c.channel, "horizon_s": c.horizon_s} | _before_after(c) for c in gain.channels]
    ci95, parts = ([round(x, 2) for x in of] for of in (gain.ci95, gain.parts))
    nats = {"nats": round(gain.nats, 2), "ci95": ci95, "held_out_by": gain.by, "parts": parts}
    return nats | {"horizons": every, "channels": {c.channel: _before_after(c) for c in gain.judged}}


def _before_after(error: ChannelError) -> dict[str, Any]:
    return {"before": _short(error.before), "after": _short(error.after), "unit": error.unit}


def _short(value: Any) -> Any:
    """Return a number, or each of a tuple, with five digits; what is no number as it is."""
    if value is None or isinstance(value, str | bool):
        return value
    return [_short(x) for x in value] if isinstance(value, tuple) else float(f"{value:.5g}")

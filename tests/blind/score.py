"""The score card of the blind tests: what the verdicts say beside what is true."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from tests.blind.cases import Case, Hidden

VERDICTS = ("nothing_wrong", "named", "ambiguous", "named_with_remainder", "unknown", "unusable")
FLAGS = ("unknown", "named_with_remainder")
ALARMS = ("named", "ambiguous", "named_with_remainder", "unknown")
LARGEST_SET = 4
"""A longer set of causes names nothing."""
SHORE = 0.3
"""Probability from which a cause counts as claimed beside others."""
WIDE = 1.959964
Verdict = dict[str, Any]


def wilson(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson 1927)."""
    if of == 0:
        return 0.0, 1.0
    rate, z2 = hits / of, WIDE**2
    middle = (rate + z2 / (2 * of)) / (1 + z2 / of)
    half = WIDE * math.sqrt(rate * (1 - rate) / of + z2 / (4 * of * of)) / (1 + z2 / of)
    return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class Row:
    """One line of the card: a rate, or a mean."""

    name: str
    hits: float
    of: int
    floor: float
    best: float
    at_most: bool = False
    """Whether small is good."""
    is_rate: bool = True

    @property
    def rate(self) -> float:
        """Hits of all."""
        return self.hits / self.of if self.of else math.nan

    @property
    def met(self) -> bool | None:
        """Whether the floor is kept; None without a case."""
        if not self.of:
            return None
        return self.rate <= self.floor if self.at_most else self.rate >= self.floor

    def line(self) -> str:
        """For the console."""
        sign = "<=" if self.at_most else ">="
        if not self.of:
            return f"{self.name:52s}      -"
        if not self.is_rate:
            aim = f"{sign} {self.floor:g} ({self.best:g})"
            return f"{self.name:52s} {self.of:4d} cases {self.rate:8.3g}{'':22s} {aim}"
        low, high = wilson(round(self.hits), self.of)
        aim = f"{sign} {100 * self.floor:g} % ({100 * self.best:g} %)"
        mark = "" if self.met else "  MISSED"
        counted = f"{round(self.hits):4d} of {self.of:<4d} {100 * self.rate:6.1f} %"
        counted += f"  [{100 * low:5.1f}, {100 * high:5.1f}]"
        return f"{self.name:52s} {counted}  {aim}{mark}"


@dataclass(frozen=True)
class Answer:
    """A case and the verdict on it."""

    case: Case
    verdict: Verdict
    seconds: float = 0.0
    commit: str = ""
    """State of the repository that was judged by."""

    @property
    def word(self) -> str:
        """The verdict's one word; "invalid" for any other."""
        said = self.verdict.get("verdict")
        return said if said in VERDICTS else "invalid"

    @property
    def causes(self) -> list[dict[str, Any]]:
        """Most probable first."""
        return sorted(self.verdict.get("causes") or [], key=lambda c: -(c.get("probability") or 0.0))

    @property
    def top(self) -> str | None:
        """The most probable cause."""
        return self.causes[0]["name"] if self.causes else None

    @property
    def equals(self) -> set[str]:
        """The equivalence set, unless it is so long that it names nothing."""
        found = set(self.verdict.get("equivalence_set") or [])
        return found if len(found) <= LARGEST_SET else set()

    @property
    def credible(self) -> set[str]:
        """Causes up to 95 % of the probability, and what cannot be told from them."""
        out, total = set(), 0.0
        for cause in self.causes:
            if total >= 0.95:
                break
            out.add(cause["name"])
            total += cause.get("probability") or 0.0
        return out | self.equals

    @property
    def claimed(self) -> set[str]:
        """Causes with a probability worth a claim."""
        return {c["name"] for c in self.causes if (c.get("probability") or 0.0) >= SHORE}

    @property
    def alarm(self) -> bool:
        """Whether anything is said to be wrong."""
        return self.word in ALARMS

    @property
    def d(self) -> float | None:
        """Of the weakest effect."""
        known = [h.d for h in self.case.hidden if h.d is not None]
        return min(known) if known and len(known) == len(self.case.hidden) else None

    @property
    def right(self) -> bool:
        """A single cause is named, or stands in a short set."""
        good = set(self.case.equivalents)
        return (
            self.word in ALARMS and self.word != "unknown" and (self.top in good or bool(self.equals & good))
        )

    def parameter(self, hidden: Hidden) -> tuple[float, bool | None] | None:
        """Relative error of a cause's size, whether its interval holds it; None where not to be compared."""
        cause = next((c for c in self.causes if c["name"] == hidden.name), None)
        if cause is None or not hidden.value:
            return None
        same = [p for p in (cause.get("parameters") or {}).values() if p and p.get("unit") == hidden.unit]
        values = [p["value"] for p in same if p.get("value") is not None]
        if not values:
            return None
        error = abs(math.hypot(*values) - hidden.value) / hidden.value
        if len(values) > 1 or not same[0].get("ci95"):
            return error, None
        low, high = sorted(same[0]["ci95"])
        return error, low <= hidden.value <= high or low <= -hidden.value <= high


def _rate(
    name: str, answers: Iterable[Answer], hit: Callable[[Answer], bool], floor: float, best: float
) -> Row:
    found = [bool(hit(a)) for a in answers]
    return Row(name, sum(found), len(found), floor, best)


def card(answers: list[Answer]) -> list[Row]:
    """The rows of the model criticism's figures: floor and best in class beside each."""
    of = {kind: [a for a in answers if a.case.kind == kind] for kind in {a.case.kind for a in answers}}
    one, two = of.get("single", []), of.get("pair", [])
    clean = of.get("null", []) + of.get("null_edge", [])
    strange, blind = of.get("strange", []), of.get("untellable", [])
    calm, seen_alarms = of.get("seen_null", []), [a for a in of.get("seen_single", []) if a.alarm]
    seen, seen_strange = of.get("seen_single", []), of.get("seen_strange", [])

    def at(d: float, some: list[Answer]) -> list[Answer]:
        return [a for a in some if a.d is not None and a.d >= d]

    found, sure = (
        [a for a in one if a.alarm],
        [a for a in one if (a.causes or [{}])[0].get("probability", 0) >= 0.95],
    )
    alarm = [
        Row(name, sum(a.alarm for a in some), len(some), floor, best, at_most=True)
        for name, some, floor, best in (
            ("false alarms, clean", clean, 0.02, 0.01),
            ("false alarms, heavy tails", of.get("null_heavy", []), 0.05, 0.02),
            ("false alarms, coloured noise", of.get("null_coloured", []), 0.05, 0.02),
        )
    ]
    sizes = [len(a.credible) for a in at(8, found)]
    compared = [(a, h, p) for a in one for h in a.case.hidden if (p := a.parameter(h)) is not None]
    errors = sorted(p[0] for _, h, p in compared if h.d is not None and h.d >= 8)
    held = [p[1] for _, _, p in compared if p[1] is not None]
    gains = [
        c["gain"]["nats"]
        for a in found
        for c in a.causes[:1]
        if (c.get("gain") or {}).get("nats") is not None
    ]
    return [
        *alarm,
        _rate("detected, any strength", one, lambda a: a.alarm, 0.0, 0.0),
        _rate("detected, d >= 5", at(5, one), lambda a: a.alarm, 0.80, 0.90),
        _rate("detected, d >= 6", at(6, one), lambda a: a.alarm, 0.90, 0.97),
        _rate("right, given detection", found, lambda a: a.right, 0.0, 0.0),
        _rate("right, given detection, d >= 6", at(6, found), lambda a: a.right, 0.85, 0.95),
        _rate("true cause in the 95 % set", found, lambda a: bool(a.credible & true(a)), 0.90, 0.95),
        Row("mean size of that set, d >= 8", sum(sizes), len(sizes), 2.0, 1.3, at_most=True, is_rate=False),
        _rate("right when claiming P >= 0.95", sure, lambda a: a.top in a.case.equivalents, 0.90, 0.97),
        Row("parameter within 25 %, d >= 8", sum(e <= 0.25 for e in errors), len(errors), 0.90, 0.97),
        Row("parameter inside its interval", sum(held), len(held), 0.85, 0.94),
        _rate("pairs: detected", two, lambda a: a.alarm, 0.90, 0.97),
        _rate("pairs: both found, each d >= 8", at(8, two), lambda a: true(a) <= a.claimed, 0.60, 0.85),
        _rate("strange: not misnamed", strange, lambda a: not misnamed(a), 0.80, 0.95),
        _rate("strange: flagged", strange, lambda a: a.word in FLAGS, 0.60, 0.85),
        _rate("strange: right channel", strange, points_at_channel, 0.60, 0.85),
        Row("pictures: false alarms", sum(a.alarm for a in calm), len(calm), 0.02, 0.01, at_most=True),
        _rate("pictures: detected", seen, lambda a: a.alarm, 0.80, 0.90),
        _rate("pictures: right, given detection", seen_alarms, lambda a: a.right, 0.85, 0.95),
        _rate("pictures, strange: not misnamed", seen_strange, lambda a: not misnamed(a), 0.80, 0.95),
        _rate("pictures, strange: flagged", seen_strange, lambda a: a.word in FLAGS, 0.60, 0.85),
        _rate("pictures, strange: right channel", seen_strange, points_at_channel, 0.60, 0.85),
        _rate("cannot tell: says so", blind, says_so, 0.80, 0.95),
        Row("held-out gain above 0", sum(g > 0 for g in gains), len(gains), 0.85, 0.90),
        _rate("valid verdicts", answers, lambda a: a.word != "invalid", 1.0, 1.0),
    ]  # fmt: skip


def true(a: Answer) -> set[str]:
    """Names of what is there."""
    return set(a.case.equivalents)


def misnamed(a: Answer) -> bool:
    """A cause that is not there, told as certain."""
    return a.word == "named" or (
        a.word == "ambiguous" and any((c.get("probability") or 0) >= 0.95 for c in a.causes)
    )


def points_at_channel(a: Answer) -> bool:
    """The remainder's own words hold one of the channels where the effect shows: names of terms are none."""
    said = str(a.verdict.get("remainder") or "").lower()
    for words in ("out of range", *sorted(a.verdict.get("detectable") or (), key=len, reverse=True)):
        said = said.replace(words, "")
    return any(word in said for h in a.case.hidden for word in h.channels)


def says_so(a: Answer) -> bool:
    """The set of causes and the manoeuvre that would tell; nothing at all where nothing can be seen."""
    if a.case.invisible:
        return a.word in ("nothing_wrong", "unusable") or (
            a.word == "ambiguous" and bool(a.equals & set(a.case.equivalents))
        )
    both = set(a.case.equivalents) <= a.credible | a.claimed
    return a.word == "ambiguous" and both and bool(a.verdict.get("next_flight"))

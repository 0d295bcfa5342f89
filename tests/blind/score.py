"""Score card of the blind tests: comparison of the verdicts with the truth."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from tests.blind.cases import KINDS, Case, Hidden
from tests.blind.rows import Bound, Row, least, most

VERDICTS = ("nothing_wrong", "named", "ambiguous", "named_with_remainder", "unknown", "unusable")
FLAGS = ("unknown", "named_with_remainder")
ALARMS = ("named", "ambiguous", "named_with_remainder", "unknown")
LARGEST_SET = 4
"""Length beyond which a set of causes counts as no answer."""
SHORE = 0.3
"""Probability from which a further cause counts as claimed."""
Verdict = dict[str, Any]


@dataclass(frozen=True)
class Answer:
    """A case and its verdict."""

    case: Case
    verdict: Verdict
    seconds: float = 0.0
    commit: str = ""
    """Commit of the critic."""

    @property
    def word(self) -> str:
        """Verdict word; "invalid" for any other."""
        said = self.verdict.get("verdict")
        return said if said in VERDICTS else "invalid"

    @property
    def causes(self) -> list[dict[str, Any]]:
        """Causes, the most probable first."""
        return sorted(self.verdict.get("causes") or [], key=lambda c: -(c.get("probability") or 0.0))

    @property
    def top(self) -> str | None:
        """The most probable cause."""
        return self.causes[0]["name"] if self.causes else None

    @property
    def equals(self) -> set[str]:
        """Equivalence set of the verdict, unless it is too long to be an answer."""
        found = set(self.verdict.get("equivalence_set") or []) if self.word == "ambiguous" else set()
        return found if len(found) <= LARGEST_SET else set()

    @property
    def credible(self) -> set[str]:
        """Causes up to 95 % of the probability, and their equivalents."""
        out, total = set(), 0.0
        for cause in self.causes:
            if total >= 0.95:
                break
            out.add(cause["name"])
            total += cause.get("probability") or 0.0
        return out | self.equals

    @property
    def claimed(self) -> set[str]:
        """Causes with a probability above the limit for a claim."""
        return {c["name"] for c in self.causes if (c.get("probability") or 0.0) >= SHORE}

    @property
    def alarm(self) -> bool:
        """Whether the verdict reports an error."""
        return self.word in ALARMS

    @property
    def d(self) -> float | None:
        """Strength d of the weakest effect."""
        known = [h.d for h in self.case.hidden if h.d is not None]
        return min(known) if known and len(known) == len(self.case.hidden) else None

    @property
    def right(self) -> bool:
        """Whether a single cause is named, or is in a short set."""
        good = set(self.case.equivalents)
        return (
            self.word in ALARMS and self.word != "unknown" and (self.top in good or bool(self.equals & good))
        )

    def parameter(self, hidden: Hidden) -> tuple[float, bool | None] | None:
        """Relative error of a cause's size, and whether its interval contains it; None if not comparable."""
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

    def along(self, hidden: Hidden) -> float | None:
        """Cosine between a cause's sizes and the hidden ones, with signs; None without a sign to compare or
        without such a cause."""
        cause = next((c for c in self.causes if c["name"] == hidden.name), None)
        if cause is None or not hidden.way:
            return None
        sizes = {name: (p or {}).get("value") or 0.0 for name, p in (cause.get("parameters") or {}).items()}
        found = [sizes.get(name, 0.0) for name in hidden.way]
        both = math.hypot(*found) * math.hypot(*hidden.way.values())
        return sum(a * b for a, b in zip(found, hidden.way.values(), strict=True)) / both if both else 0.0


ONE_IN_HUNDRED = Bound(0.005, 0.015, whole_interval=True)
"""Stated rate of false alarms; a lower rate would mean that the critic detects less than it could."""
T = TypeVar("T")


def _rate(name: str, answers: Iterable[T], hit: Callable[[T], bool], floor: float, aim: float) -> Row:
    found = [bool(hit(a)) for a in answers]
    return Row(name, sum(found), len(found), least(floor), least(aim))


def _reported(name: str, answers: Sequence[Answer], hit: Callable[[Answer], bool]) -> Row:
    return Row(name, sum(hit(a) for a in answers), len(answers))


def _at(d: float, some: Iterable[Answer]) -> list[Answer]:
    return [a for a in some if a.d is not None and a.d >= d]


def card(answers: list[Answer], settles: Callable[[Answer], bool] | None = None) -> list[Row]:
    """Return the rows of the card with their floors and aims.

    ``settles`` returns whether the proposed manoeuvre of an ambiguous verdict decides; without it there is no
    such row.
    """
    of = {kind: [a for a in answers if a.case.kind == kind] for kind in KINDS}
    return [
        *_alarms(of),
        *_singles(of["single"]),
        _rate("pairs: detected", of["pair"], lambda a: a.alarm, 0.90, 0.97),
        _rate(
            "pairs: both found, each d >= 8", _at(8, of["pair"]), lambda a: true(a) <= a.claimed, 0.60, 0.85
        ),
        *_strange("out of catalogue", of["strange"] + of["stranger"]),
        *_pictures(of),
        *_open(of["untellable"], settles),
        _held_out(of["single"]),
        _rate("valid verdicts", answers, lambda a: a.word != "invalid", 1.0, 1.0),
    ]


def _alarms(of: dict[str, list[Answer]]) -> list[Row]:
    clean = of["null"] + of["null_edge"]
    return [
        Row("false alarms, clean", sum(a.alarm for a in clean), len(clean), most(0.02), ONE_IN_HUNDRED),
        *(
            Row(f"false alarms, {name}", sum(a.alarm for a in some), len(some), most(0.05), most(0.02))
            for name, some in (
                ("heavy tails", of["null_heavy"]),
                ("AR(1) noise", of["null_coloured"]),
                ("state-dependent noise", of["null_uneven"]),
            )
        ),
    ]


def _singles(one: list[Answer]) -> list[Row]:
    found = [a for a in one if a.alarm]
    sure = [a for a in one if (a.causes or [{}])[0].get("probability", 0) >= 0.95]
    sizes = [len(a.credible) for a in _at(8, found)]
    compared = [(a, h, p) for a in one for h in a.case.hidden if (p := a.parameter(h)) is not None]
    errors = [p[0] for _, h, p in compared if h.d is not None and h.d >= 8]
    ways = [x for a in one for h in a.case.hidden if (x := a.along(h)) is not None]
    held = [p[1] for _, _, p in compared if p[1] is not None]
    inside = [bool(a.credible & true(a)) for a in found]
    middle, mean = (statistics.median(errors) if errors else math.nan), sum(sizes) / max(len(sizes), 1)
    return [
        _reported("detected, any strength", one, lambda a: a.alarm),
        _rate("detected, d >= 5", _at(5, one), lambda a: a.alarm, 0.80, 0.90),
        _rate("detected, d >= 6", _at(6, one), lambda a: a.alarm, 0.90, 0.97),
        _reported("right, given detection", found, lambda a: a.right),
        _rate("right, given detection, d >= 6", _at(6, found), lambda a: a.right, 0.85, 0.95),
        Row("true cause in the 95 % set", sum(inside), len(inside), least(0.90), Bound(0.94, 0.99)),
        Row("mean size of that set, d >= 8", 0, len(sizes), most(2.0), most(1.3), figure=mean),
        _rate("right when claiming P >= 0.95", sure, lambda a: a.top in a.case.equivalents, 0.90, 0.97),
        Row("parameter's error, median, d >= 8", 0, len(errors), most(0.25), most(0.10), middle, share=True),
        _rate("parameter within 25 %, d >= 8", errors, lambda e: e <= 0.25, 0.90, 0.97),
        _rate("parameter's sign, or direction within 37 deg", ways, lambda x: x > 0.8, 0.90, 0.97),
        Row("parameter inside its interval", sum(held), len(held), Bound(0.85, 0.99), Bound(0.93, 0.97)),
    ]  # fmt: skip


def _strange(name: str, some: list[Answer]) -> list[Row]:
    return [
        _rate(f"{name}: not misnamed", some, lambda a: not misnamed(a), 0.80, 0.95),
        _rate(f"{name}: flagged", some, lambda a: a.word in FLAGS, 0.60, 0.85),
        _rate(f"{name}: right channel", some, points_at_channel, 0.60, 0.85),
    ]


def _pictures(of: dict[str, list[Answer]]) -> list[Row]:
    calm, seen = of["seen_null"], of["seen_single"]
    alarms = [a for a in seen if a.alarm]
    return [
        Row("pictures: false alarms", sum(a.alarm for a in calm), len(calm), most(0.02), ONE_IN_HUNDRED),
        _rate("pictures: detected", seen, lambda a: a.alarm, 0.80, 0.90),
        _rate("pictures: right, given detection", alarms, lambda a: a.right, 0.85, 0.95),
        *_strange("pictures, out of catalogue", of["seen_strange"]),
    ]


def _open(blind: list[Answer], settles: Callable[[Answer], bool] | None) -> list[Row]:
    rows = [_rate("indistinguishable: reported as such", blind, says_so, 0.80, 0.95)]
    if settles is not None:
        # No manoeuvre is proposed where no effect can be seen.
        some = [a for a in blind if not a.case.invisible]
        rows.append(_rate("indistinguishable: its manoeuvre would decide", some, settles, 0.80, 0.95))
    return rows


def _held_out(one: list[Answer]) -> Row:
    causes = (c for a in one if a.alarm for c in a.causes[:1])
    nats = [(c.get("gain") or {}).get("nats") for c in causes]
    gains = [gain for gain in nats if gain is not None]
    return Row("held-out gain above 0", sum(g > 0 for g in gains), len(gains), least(0.85))


def true(a: Answer) -> set[str]:
    """Return the names of the hidden effects."""
    return set(a.case.equivalents)


def misnamed(a: Answer) -> bool:
    """Return whether an absent cause is reported as certain and as the whole explanation, without a
    remainder."""
    return a.word == "named" or (
        a.word == "ambiguous" and any((c.get("probability") or 0) >= 0.95 for c in a.causes)
    )


def points_at_channel(a: Answer) -> bool:
    """Return whether the remainder names a channel that shows the effect, apart from names of terms."""
    said = str(a.verdict.get("remainder") or "").lower()
    for words in ("out of range", *sorted(a.verdict.get("detectable") or (), key=len, reverse=True)):
        said = said.replace(words, "")
    return any(word in said for h in a.case.hidden for word in h.channels)


def says_so(a: Answer) -> bool:
    """Return whether the set of causes and the manoeuvre are right, or no cause is named where none can be
    seen."""
    if a.case.invisible:
        return a.word in ("nothing_wrong", "unusable") or (
            a.word == "ambiguous" and bool(a.equals & set(a.case.equivalents))
        )
    both = set(a.case.equivalents) <= a.credible | a.claimed
    return a.word == "ambiguous" and both and bool(a.verdict.get("next_flight"))

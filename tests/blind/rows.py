"""Rows of the score card: a rate or another figure, its bounds, and whether it meets them."""

from __future__ import annotations

import math
from dataclasses import dataclass

WIDE = 1.959964


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate (Wilson 1927)."""
    if of == 0:
        return 0.0, 1.0
    rate, z2 = hits / of, WIDE**2
    middle = (rate + z2 / (2 * of)) / (1 + z2 / of)
    half = WIDE * math.sqrt(rate * (1 - rate) / of + z2 / (4 * of * of)) / (1 + z2 / of)
    return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class Bound:
    """Bound of a figure: a smallest value, a largest value, or both."""

    least: float | None = None
    most: float | None = None
    whole_interval: bool = False
    """Whether the whole 95 % interval of the rate must lie within the bound."""

    def met(self, value: float, interval: tuple[float, float]) -> bool | None:
        """Return whether the bound is met; None where the interval is too wide to decide."""
        least = -math.inf if self.least is None else self.least
        most = math.inf if self.most is None else self.most
        if not self.whole_interval:
            return least <= value <= most
        low, high = interval
        if least <= low and high <= most:
            return True
        return None if low <= most and high >= least else False

    def in_words(self, share: float, unit: str) -> str:
        """Return the bound in words: ``at least 90 %`` or ``93 to 97 %``."""
        ends = [f"{share * end:g}" for end in (self.least, self.most) if end is not None]
        words = (
            " to ".join(ends)
            if len(ends) == 2
            else f"{'at most' if self.least is None else 'at least'} {ends[0]}"
        )
        return f"{'interval within ' if self.whole_interval else ''}{words}{unit}"


def least(value: float) -> Bound:
    """Return a lower bound."""
    return Bound(least=value)


def most(value: float) -> Bound:
    """Return an upper bound."""
    return Bound(most=value)


@dataclass(frozen=True)
class Row:
    """One line of the card: a rate, or a figure taken over some cases."""

    name: str
    hits: float
    of: int
    floor: Bound | None = None
    """Required bound."""
    aim: Bound | None = None
    """Desired bound."""
    figure: float | None = None
    """Value of the row if it is no rate."""
    share: bool = False
    """Whether the figure is printed in percent."""

    @property
    def rate(self) -> float:
        """Share of hits, or the figure."""
        if self.figure is not None:
            return self.figure
        return self.hits / self.of if self.of else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of a rate; the figure itself otherwise."""
        return wilson(round(self.hits), self.of) if self.figure is None else (self.rate, self.rate)

    def kept(self, bound: Bound | None) -> str:
        """Return ``met``, ``missed``, or ``open`` with too few cases to decide; empty without a bound."""
        if not self.of or bound is None:
            return ""
        return {True: "met", False: "missed", None: "open"}[bound.met(self.rate, self.interval)]

    @property
    def met(self) -> bool | None:
        """Whether the floor is met; None without cases or a floor."""
        return {"met": True, "missed": False}.get(self.kept(self.floor))

    def cells(self) -> list[str]:
        """Return the cells: cases, rate, interval, floor and its result, aim and its result."""
        share, unit = (1.0, "") if self.figure is not None and not self.share else (100.0, " %")
        cases, rate, interval = f"{self.of}", f"{share * self.rate:.3g}{unit}", ""
        if self.figure is None:
            low, high = (100 * bound for bound in self.interval)
            cases, rate = f"{round(self.hits)} of {self.of}", f"{100 * self.rate:.1f} %"
            interval = f"{low:.1f} to {high:.1f} %"
        out = [cases, rate, interval]
        for bound in (self.floor, self.aim):
            out += [bound.in_words(share, unit) if bound else "", self.kept(bound)]
        return out

    def line(self) -> str:
        """Return the row as a line for the console."""
        if not self.of:
            return f"{self.name:52s} -"
        cases, rate, interval, floor, over, aim, best = self.cells()
        kept = [
            f"{name} {words}: {met}"
            for name, words, met in (("floor", floor, over), ("aim", aim, best))
            if words
        ]
        return f"{self.name:52s} {cases:>10s} {rate:>8s}  {interval:18s} {', '.join(kept)}".rstrip()

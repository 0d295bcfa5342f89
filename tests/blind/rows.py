"""Lines of the score card: a rate or another figure, what it is held to, and whether it keeps to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

WIDE = 1.959964


def wilson(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson 1927)."""
    if of == 0:
        return 0.0, 1.0
    rate, z2 = hits / of, WIDE**2
    middle = (rate + z2 / (2 * of)) / (1 + z2 / of)
    half = WIDE * math.sqrt(rate * (1 - rate) / of + z2 / (4 * of * of)) / (1 + z2 / of)
    return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class Bound:
    """What a figure is held to: a smallest or a largest value, or both."""

    least: float | None = None
    most: float | None = None
    whole_interval: bool = False
    """Whether the rate's 95 % interval must lie within, and not the rate alone."""

    def met(self, value: float, interval: tuple[float, float]) -> bool | None:
        """Whether it is kept; None where the interval is too wide to say."""
        least = -math.inf if self.least is None else self.least
        most = math.inf if self.most is None else self.most
        if not self.whole_interval:
            return least <= value <= most
        low, high = interval
        if least <= low and high <= most:
            return True
        return None if low <= most and high >= least else False

    def told(self, share: float, unit: str) -> str:
        """``at least 90 %``, ``93 to 97 %``."""
        ends = [f"{share * end:g}" for end in (self.least, self.most) if end is not None]
        words = (
            " to ".join(ends)
            if len(ends) == 2
            else f"{'at most' if self.least is None else 'at least'} {ends[0]}"
        )
        return f"{'interval within ' if self.whole_interval else ''}{words}{unit}"


def least(value: float) -> Bound:
    """No less than this."""
    return Bound(least=value)


def most(value: float) -> Bound:
    """No more than this."""
    return Bound(most=value)


@dataclass(frozen=True)
class Row:
    """One line of the card: a rate, or a figure taken over some cases."""

    name: str
    hits: float
    of: int
    floor: Bound | None = None
    """What less than would be too little."""
    aim: Bound | None = None
    """What would be best."""
    figure: float | None = None
    """Where it is no rate."""
    share: bool = False
    """Whether the figure is one that is told in percent."""

    @property
    def rate(self) -> float:
        """Hits of all, or the figure."""
        if self.figure is not None:
            return self.figure
        return self.hits / self.of if self.of else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 %, of a rate."""
        return wilson(round(self.hits), self.of) if self.figure is None else (self.rate, self.rate)

    def kept(self, bound: Bound | None) -> str:
        """``met``, ``missed``, ``open`` where there are too few cases to say; empty without case or bound."""
        if not self.of or bound is None:
            return ""
        return {True: "met", False: "missed", None: "open"}[bound.met(self.rate, self.interval)]

    @property
    def met(self) -> bool | None:
        """Whether the floor is kept; None without a case or a floor."""
        return {"met": True, "missed": False}.get(self.kept(self.floor))

    def cells(self) -> list[str]:
        """Cases, rate, its interval, floor, whether kept, aim, whether kept."""
        share, unit = (1.0, "") if self.figure is not None and not self.share else (100.0, " %")
        cases, rate, interval = f"{self.of}", f"{share * self.rate:.3g}{unit}", ""
        if self.figure is None:
            low, high = (100 * bound for bound in self.interval)
            cases, rate = f"{round(self.hits)} of {self.of}", f"{100 * self.rate:.1f} %"
            interval = f"{low:.1f} to {high:.1f} %"
        out = [cases, rate, interval]
        for bound in (self.floor, self.aim):
            out += [bound.told(share, unit) if bound else "", self.kept(bound)]
        return out

    def line(self) -> str:
        """For the console."""
        if not self.of:
            return f"{self.name:52s} -"
        cases, rate, interval, floor, over, aim, best = self.cells()
        kept = [
            f"{name} {told}: {met}"
            for name, told, met in (("floor", floor, over), ("aim", aim, best))
            if told
        ]
        return f"{self.name:52s} {cases:>10s} {rate:>8s}  {interval:18s} {', '.join(kept)}".rstrip()

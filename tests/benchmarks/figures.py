"""Formatting of figures for docs/figures.md, the README and the screen."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

from tests.benchmarks.metric import Metric

BEGIN, END = "<!-- figures -->", "<!-- /figures -->"

_DEMO = "Figure eight, worst of five flights"
HEADLINES = {
    "5 seeds, worst: largest landmark error, chain of homographies": f"{_DEMO}: landmarks, chain of pictures",
    "5 seeds, worst: largest landmark error, optimized without loops": f"{_DEMO}: landmarks, without loops",
    "5 seeds, worst: largest landmark error, with loops": f"{_DEMO}: landmarks, one map",
    "5 seeds, worst: A-E gap error, with loops": f"{_DEMO}: a gap of 0.30 m seen a whole loop apart",
    "position error after similarity (ate_sim3_m)": "A real drone's motion: positions after a similarity",
    "position error (ate_m)": "A real drone's motion: positions without alignment, sonar 4 % short",
    "RMS to pycolmap with a free principal point after a similarity": "75 aerial photographs: distance to "
    "structure from motion",
    "our processor time over pycolmap's at its best, CPU": "75 photographs: our CPU time over pycolmap's",
    "front end on the demo's frames, 320x240, two cores": "Pictures a second, 320x240",
    "sphere2500: solve over raw gtsam's, both from arrays": "A graph of 2500 poses: our time over gtsam's",
    "peak memory, without mosaic, 10 laps over 1": "Peak memory of a flight ten times as long",
}
"""Key of a figure -> its name in the README: the few of most interest. Of equal keys the first one counts."""


@dataclass(frozen=True)
class Section:
    """Figures of one benchmark."""

    title: str
    metrics: Sequence[Metric]
    skipped: str = ""
    """Why there are no figures."""
    commit: str = ""
    """Commit that was measured."""

    @property
    def state(self) -> str:
        """Text beside the title."""
        if self.skipped:
            return f"skipped: {self.skipped}"
        return f"at {self.commit}" if self.commit else ""


def number(value: float) -> str:
    """Return three digits; whole numbers unchanged."""
    if value == int(value) and abs(value) < 1e6:
        return str(int(value))
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(digits, 6)}f}"


def measured(metric: Metric) -> str:
    """Return value and unit: ``1.25 mm``, as metres below a tenth are shown in millimetres."""
    if not math.isfinite(metric.value):
        return "no answer"
    value, unit = _readable(metric.value, metric)
    return f"{number(value)} {unit}".strip()


def verdict(metric: Metric) -> tuple[str, str]:
    """Return the target, and ``met`` or ``missed``; both empty without a target."""
    if metric.met is None:
        return "", ""
    limits = [number(_readable(limit, metric)[0]) for limit in metric.limit]
    unit = _readable(metric.value, metric)[1]
    target = " to ".join(limits) if metric.direction == "within" else f"{metric.direction} {limits[0]}"
    return f"{target} {unit}".strip(), "met" if metric.met else "missed"


def _readable(value: float, metric: Metric) -> tuple[float, str]:
    small = metric.unit == "m" and max(abs(metric.value), *map(abs, metric.limit), 0.0) < 0.1
    return (1e3 * value, "mm") if small else (value, metric.unit)


def markdown(sections: Sequence[Section]) -> str:
    """Return the block of docs/figures.md with all figures."""
    lines = [
        f"Measured by `make bench` on {_cores()}, each part at the commit that stands beside it (a + where"
        " files differed from it); `python -m tests.benchmarks.run NAME` takes one part alone. Speed and"
        " memory are given as ratios of runs side by side; seconds and megabytes are those of that one run.",
        "",
        "| figure | measured | target | |",
        "|---|---|---|---|",
    ]
    for section in sections:
        lines.append(f"| **{section.title}** | {section.state} | | |")
        for m in section.metrics:
            source = f" <br><sub>{m.source}</sub>" if m.source else ""
            lines.append(f"| {m.key}{source} | {measured(m)} | {' | '.join(_target(m))} |")
    return "\n".join(lines)


def headlines(sections: Sequence[Section]) -> str:
    """Return the README's block: the figures of most interest, and the number of targets that are met."""
    metrics = [m for section in sections for m in section.metrics]
    lines = ["| figure | measured | target |", "|---|---|---|"]
    named = {m.key: m for m in reversed(metrics)}
    for m, words in ((named[key], words) for key, words in HEADLINES.items() if key in named):
        target, met = _target(m)
        lines.append(f"| {words} | {measured(m)} | {target}{f': {met}' if 'missed' in met else ''} |")
    targeted = [m for m in metrics if m.met is not None]
    missed = sum(not m.met for m in targeted)
    lines += ["", f"Of {len(targeted)} figures with a target, {len(targeted) - missed} meet it."]
    if missed:
        does = "that does" if missed == 1 else f"{missed} that do"
        lines[-1] += f" The {does} not are marked in [docs/figures.md](docs/figures.md)."
    return "\n".join(lines)


def _target(metric: Metric) -> tuple[str, str]:
    target, met = verdict(metric)
    return target, "**missed**" if met == "missed" else met


def _cores() -> str:
    count = os.cpu_count() or 1
    words = {1: "one core", 2: "two cores", 4: "four cores"}
    return words.get(count, f"{count} cores")


def with_block(text: str, block: str) -> str:
    """Return ``text`` with another block between the two markers; missing markers are added at its end."""
    before, found, rest = text.partition(BEGIN)
    if not found:
        return f"{text.rstrip()}\n\n## Figures\n\n{BEGIN}\n{block}\n{END}\n"
    _, closed, after = rest.partition(END)
    if not closed:
        raise ValueError(f"README.md: {BEGIN} is never closed by {END}; add it")
    return f"{before}{BEGIN}\n{block}\n{END}{after}"

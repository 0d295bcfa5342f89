"""Smallest sizes of effects that the flights could have shown, and the effects that they could not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from backend.wording import counted, either
from slam.core.names import enumerated
from slam.core.units import everyday
from slam.criticism.finding import Inconsistency
from slam.report.criticism.certainty import differs, is_established, likeness_of_rival
from slam.report.criticism.judged_data import as_seen, judged_of, missing_streams
from slam.report.criticism.plain_names import in_plain_names, title_of
from slam.report.criticism.values import sized_one, usual
from slam.simulation.terms import CATALOGUE, Parameter

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism

_WITHOUT: Mapping[str, str] = {
    "frames": "without pictures",
    "imu": "without gyro and accelerometer",
    "sonar": "without a height sensor",
    "velocity": "without a measured speed",
    "command": "without a log of the sticks",
}
"""Stream -> the reason why effects do not show."""
_OTHERWISE = "by this motion"
_COMPARED = "by comparing instruments with each other"
_SINGLE = "except in single readings, in which none was found"
_LARGER = "at usual sizes, only beyond them at those of the table"
UNSURE, ALONE = "not established", "alone only: not in the best set"
UNSTEADY = "not explained: something like it changes"
FOUND, UNCERTAIN, NOT_FOUND = "found", "found, name uncertain", "not found"
PERHAPS = "perhaps, instead of what was found"
TOO_LARGE = "not even at usual sizes"


@dataclass(frozen=True)
class DetectableRow:
    """Table row of the smallest visible size of an effect."""

    title: str
    name: str
    size: str
    usual: str
    verdict: str
    manoeuvre: str
    """Manoeuvre that shows a smaller one."""


def detectable_rows(result: Criticism, flights: Sequence[Flight] = ()) -> list[DetectableRow]:
    """Return the smallest visible size of each effect beside the usual one, with the manoeuvre that shows a
    smaller one."""
    judged, reached = judged_of(result, flights), result.within_reach
    found = {c.name: FOUND if is_established(c, result) else UNCERTAIN for c in result.causes}
    doubles = {other for c in result.causes for other in c.alternatives}
    doubles |= {c.fair_rival for c in result.causes if likeness_of_rival(c, result)}
    alone, none = {r.name: r.z for r in result.ranking}, [c.name for c in result.causes if not differs(c)]
    unsteady = {f.effect for f in result.findings if isinstance(f, Inconsistency) and not f.is_cause}
    rows = []
    for name, (size, unit) in result.detectable.items():
        parameter = next(p for p in CATALOGUE[name].parameters if p.unit == unit)
        factor, everyday_unit = everyday(min(size, 0.5 * _most(parameter)), unit)
        verdict = found.get(name, PERHAPS if name in doubles else NOT_FOUND)
        verdict = ALONE if verdict == NOT_FOUND and alone.get(name, 0.0) > result.threshold > 0.0 else verdict
        verdict = verdict if name in found.keys() | reached.keys() else TOO_LARGE
        verdict = UNSURE if name in none else UNSTEADY if name in unsteady else verdict
        rows.append(
            DetectableRow(
                title_of(name), name, _smallest(parameter, size, factor, everyday_unit),
                usual(parameter, factor, everyday_unit), verdict, as_seen(CATALOGUE[name].excitation, judged),
            )
        )  # fmt: skip
    return rows


def _smallest(parameter: Parameter, size: float, factor: float, unit: str) -> str:
    """Return the smallest visible size; a limit shows only below it, and a change of what is there already
    beyond one of two sizes, of which an invalid one is left out."""
    shown = sized_one(size, factor, unit)
    if parameter.is_limit:
        return f"a limit below {shown}"
    if parameter.neutral == 0.0:
        return shown
    low, high = parameter.neutral - size, parameter.neutral + size
    below = f"below {sized_one(low, factor, unit)}" if low > parameter.least else ""
    above = f"above {sized_one(high, factor, unit)}" if high < parameter.most else ""
    return " or ".join(filter(None, (below, above))) or "none"


def _most(parameter: Parameter) -> float:
    return max(abs(parameter.low), abs(parameter.high))


def unseen(result: Criticism, flights: Sequence[Flight], unshown: Sequence[str]) -> list[str]:
    """Return how many effects the flights could show at usual sizes, and the others by the reason why not."""
    if not result.detectable:
        return list(unshown)
    missed = _unseen(result)
    if not missed:
        return ["Every effect of the catalogue would have shown at its usual size.", *unshown]
    shown = len(CATALOGUE) - len(missed)
    lines = [
        f"{counted(len(missed), 'effect')} of {len(CATALOGUE)}, even at usual sizes; {shown} "
        f"{either(shown, 'was', 'were')} found or would have shown (“What these flights could have shown” "
        "lists the smallest sizes).",
    ]
    by_reason: dict[str, list[str]] = {}
    missing = missing_streams(judged_of(result, flights))
    for name in missed:
        by_reason.setdefault(_reason(name, missing, result), []).append(title_of(name))
    for reason, names in sorted(by_reason.items(), key=lambda of: -len(of[1])):
        lines.append(f"Not {reason}: {enumerated(names)}.")
    return [*lines, *(_without_effects(line) for line in unshown)]


def _without_effects(line: str) -> str:
    """Return a sentence that ends with a list, without the effects of the catalogue, which are told above."""
    parts = [part for part in line.removesuffix(".").split(", ") if part not in CATALOGUE]
    return f"{in_plain_names(', '.join(parts))}." if line else ""


def _unseen(result: Criticism) -> list[str]:
    """Return the effects that were neither found nor would have shown at their usual sizes."""
    reached, found = result.within_reach, {cause.name for cause in result.causes}
    return [name for name in CATALOGUE if name not in reached and name not in found]


def hidden_without(stream: str, result: Criticism, missing: Sequence[str]) -> list[str]:
    """Return the titles of the effects that do not show for want of a stream; the ``missing`` ones are
    known."""
    return [title_of(name) for name in _unseen(result) if _reason(name, missing, result) == _WITHOUT[stream]]


def _reason(name: str, missing: Sequence[str], result: Criticism) -> str:
    """Return why an effect does not show: for want of a stream, or of motion."""
    term = CATALOGUE[name]
    needs = {
        "frames": term.acts_on == "image" or term.stream == "frames",
        "imu": term.stream == "imu",
        "sonar": term.family == "sonar" or term.acts_on == "place",
        "velocity": term.stream == "velocity",
        "command": term.acts_on in ("command", "force", "wind"),
    }
    hidden = _SINGLE if term.in_single_readings else _COMPARED if result.limits else _OTHERWISE
    otherwise = _LARGER if name in result.detectable else hidden
    return next((_WITHOUT[s] for s, needed in needs.items() if needed and s in missing), otherwise)

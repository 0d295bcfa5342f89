"""Answers to the questions that a pilot asks of a criticism, from its verdict."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import counted, either
from slam.core.names import enumerated, listed
from slam.core.units import sized
from slam.report.criticism.evidence import how_sure, no_other, what_changes, where_it_shows
from slam.report.criticism.plain_names import reading, sized_between, title_of, with_titles
from slam.report.page import Item
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.cause import Cause

_RIGHT: Mapping[str, str] = {
    "nothing_wrong": "Yes, as far as these flights can show.",
    "named": "No, but what is wrong was found, and extended.toml has it.",
    "ambiguous": "No. Two causes or more explain what is wrong equally well; extended.toml has one of them.",
    "named_with_remainder": "No. A part of what is wrong was found, and extended.toml has it.",
    "unknown": "No, and no effect of the catalogue explains what is wrong.",
    "unusable": "Not known: these data cannot be judged.",
}
"""Verdict -> whether the model is right about the flights."""
_MORE = " More is wrong than that explains."
_UNEXPLAINED, _USE, _FLY = "Unexplained: ", "What to do next: ", "Next flight: "
_SAME, _NOISE, _UNSHOWN = "Effects that the flights cannot distinguish", "Noise ", "These flights could not"
_SMALLEST = "Smallest sizes"
_USABLE: Mapping[str, str] = {
    "nothing_wrong": "Yes, as it is",
    "named": "Yes, the extended one",
    "ambiguous": "Yes, the extended one for flights like these",
    "named_with_remainder": "Yes, the extended one, but not for what is unexplained",
    "unknown": "Only apart from what is unexplained",
}
"""Verdict -> whether the model, or the extended one, can be used."""
_INSTRUMENTS = {"imu": "gyro or accelerometer", "sonar": "the height sensor", "camera": "the camera"}
"""Family of an effect -> the instrument whose error it is; other families are no instrument's."""
_AXES = ("x", "y", "z")
MOSTLY = 0.99
"""Share of the moments in which a cause moves a reading by less than the page tells."""
_IN_WORDS: tuple[tuple[str, str], ...] = (
    (r"^(.*) out of range$", r"\1: the best value lies outside of what healthy vehicles have"),
    (r"^(.*) ~ (.*) \(z = ([-\d.]+)\)$", r"the error of \1 changes with \2 (by \3 standard deviations)"),
    (r"^(.*) \(z = ([-\d.]+)\)$", r"\1 (by \2 standard deviations)"),
    (r"^(.*) (early|late) by ([-\d.]+) ms$", r"the readings of \1 come \3 ms too \2 by their stamps"),
    (r"^(.*) may be something else$", r"\1 may be an effect that the catalogue does not hold"),
    (r"^(.*) may be (.*)$", r"\1 may be \2 instead: both have similar effects in these flights"),
)
"""Pattern of what is left over in verdict.json -> in words."""


def criticism_answers(result: Criticism, drawn: Sequence[str] = ()) -> tuple[Item, ...]:
    """Return questions and answers; only those that apply to a verdict. ``drawn`` are sentences on the parts
    of flights that the page shows."""
    told = _lines_by_kind(result)
    unexplained = [unexplained_in_words(line) for line in told[_UNEXPLAINED]]
    rows = (
        _item(
            "Is the model right about these flights?",
            [f"{_RIGHT[result.verdict]}{_MORE * bool(unexplained and result.causes)}"],
        ),
        _item("What is wrong?", [*_meanings(result), *told[""]]),
        _item("How large is it?", _sizes(result)),
        _item("How sure is that, and why?", how_sure(result)),
        _item("What else could it be, and why not?", _else(result, told[_SAME])),
        _item("In which flight does it show, and when?", where_it_shows(result, drawn)),
        _item("What is not explained?", unexplained),
        _item("What changes in the prediction?", what_changes(result)),
        _item(
            "Can I use the model now, and how?",
            [f"{_USABLE.get(result.verdict, 'No')}: {line}" for line in told[_USE]],
        ),
        _item("What do I fly next?", told[_FLY]),
        _item("What can these flights not show?", _unseen(result, [*told[_UNSHOWN], *told[_SMALLEST]])),
        _item(
            "Which instrument or flight is doubted, or was left out?",
            [_doubted(result), *told[_NOISE], *left_out_by_flight(result)],
        ),
    )
    return tuple(row for row in rows if row is not None)


def _lines_by_kind(result: Criticism) -> dict[str, list[str]]:
    """Return beginning -> the rest of each line of the verdict's details; what begins a sentence of its own
    is kept.

    Lines on a cause are left out: the rows tell them from the causes themselves.
    """
    from slam.criticism.verdict.sentence import details

    removed, kept = (_UNEXPLAINED, _USE, _FLY), (_SAME, _NOISE, _UNSHOWN, _SMALLEST)
    told = {
        begin: [line.removeprefix(begin) for line in result.details if line.startswith(begin)]
        for begin in removed
    }
    told |= {begin: [line for line in result.details if line.startswith(begin)] for begin in kept}
    of_causes = details(result)
    told[""] = [
        line for line in result.details if line not in of_causes and not line.startswith((*removed, *kept))
    ]
    return told


def _item(question: str, lines: Sequence[str]) -> Item | None:
    """Return the question with its lines, the first of which is the answer in short; None without lines."""
    # A name of a reading keeps its letters.
    named = with_titles([line for line in lines if line])
    shown = [f"{x[0].upper()}{x[1:]}" if x.split()[0].rstrip(",:").isalpha() else x for x in named]
    return Item(question, shown[0], tuple(shown[1:])) if shown else None


def _meanings(result: Criticism) -> list[str]:
    """Return what each cause does; what is possible is told as such."""
    sure = {cause.name for cause in result.probable}
    perhaps = {name: "" if name in sure else "perhaps " for name in (c.name for c in result.causes)}
    return [f"{perhaps[c.name]}{c.name}: {CATALOGUE[c.name].meaning}." for c in result.causes]


def _sizes(result: Criticism) -> list[str]:
    """Return the size of each cause, and what the leading one moves."""
    told = [_size(cause, f"{cause.name}: " * (len(result.causes) > 1)) for cause in result.causes]
    if any(told):
        told.append("In brackets: the interval that holds it in 95 of 100 cases.")
    if result.covariate and (misses := result.covariate.against[0]).unit != "sigma":
        most = float(np.quantile(np.abs(misses.explained), MOSTLY))
        name = f"{result.covariate.cause} " if len(result.causes) > 1 else "It "
        told.append(
            f"{name}moves {reading(misses.channel)} by up to {sized(most, misses.unit)} within 2 s (by less "
            f"in {100 * MOSTLY:.0f} of 100 moments)."
        )
    return told


def _size(cause: Cause, name: str) -> str:
    """Return the sizes of a cause in everyday units; those along axes have a size together."""
    sizes = [
        f"{parameter} = {sized(p.value, p.unit)} ({sized_between(p.low, p.high, p.unit)})"
        for parameter, p in cause.parameters.items()
    ]
    if not sizes:
        return ""
    along = [p for axis, p in cause.parameters.items() if axis in _AXES]
    whole = float(np.hypot.reduce([p.value for p in along])) if len(along) > 1 else 0.0
    together = f"{sized(whole, along[0].unit)} in all: " if whole else ""
    return f"{name}{together}{', '.join(sizes)}."


def _else(result: Criticism, alike: Sequence[str]) -> list[str]:
    """Return the causes that these flights cannot tell from those that were found, or why others are ruled
    out."""
    told = list(alike)
    for cause in result.causes:
        others = [name for name in cause.alternatives if name != cause.name]
        if others and not alike:
            rivals = enumerated([f"{name} ({result.probability_of(name):.2f})" for name in others])
            told.append(f"Instead of {cause.name} (probability {cause.probability:.2f}) perhaps {rivals}.")
    if result.causes and not told:
        told.append("Nothing else in the catalogue explains these flights as well.")
        told += [no_other(cause) for cause in result.causes]
        found = {cause.name for cause in result.causes}
        near = {b if a in found else a for a, b, _ in result.confusable if (a in found) != (b in found)}
        if near:
            worse = either(len(near), "fits worse", "fit worse")
            told.append(f"{enumerated(sorted(near))} would look much alike here, but {worse}.")
    return told


def _doubted(result: Criticism) -> str:
    """Return the instruments whose errors are among the causes."""
    found = {_INSTRUMENTS.get(CATALOGUE[c.name].family): c for c in result.causes if c.name in CATALOGUE}
    named = [
        f"{what} ({title_of(cause.name)}, probability {cause.probability:.2f})"
        for what, cause in found.items()
        if what
    ]
    if result.verdict == "unusable":
        return ""
    if named:
        return f"{enumerated(named)}."
    if result.verdict == "nothing_wrong":
        return "No instrument: none shows an error."
    check = " What is not explained may still be one." if result.unexplained else ""
    return f"No instrument: no cause that was found is an error of a sensor.{check}"


def left_out_by_flight(result: Criticism) -> list[str]:
    """Return what was not judged in a line for each flight, with all its reasons."""
    reasons: dict[str, list[str]] = {}
    for line in result.dropped:
        name, colon, reason = line.partition(": ")
        reasons.setdefault(name if colon else "", []).append(reason if colon else line)
    if not reasons:
        return ["No flight was left out."] if result.flights else []
    return [f"{name}{': ' if name else ''}{'; '.join(of)}." for name, of in reasons.items()]


def _unseen(result: Criticism, unshown: Sequence[str]) -> list[str]:
    """Return what is not judged, and which errors are too small for these flights."""
    from slam.criticism.verdict.power import within_reach

    # What limits the verdict is told with its reason among what was dropped, where it is there.
    begins = tuple(line.partition(":")[0] for line in result.dropped)
    limits = "" if result.limits.partition(":")[0].lower() in begins else result.limits
    told = [limits]
    if result.detectable:
        found = {cause.name for cause in result.causes}
        reached = within_reach(result.detectable)
        missed = [title_of(name) for name in CATALOGUE if name not in reached and name not in found]
        told += [
            f"{counted(len(missed), 'effect')} of {len(CATALOGUE)}, even at usual sizes. Not shown: "
            f"{listed(missed, 6)}."
            if missed
            else "Every effect of the catalogue would have shown at its usual size.",
            "“What these flights could not have shown” lists the smallest visible sizes, and what to fly to "
            "see smaller ones.",
        ]
    return [*told, *unshown]


def unexplained_in_words(part: str) -> str:
    """Return what is left over as `slam.criticism.verdict.decision` describes it, in plain words."""
    bare = part.removesuffix(".")
    for pattern, words in _IN_WORDS:
        if re.match(pattern, bare):
            return f"{re.sub(pattern, words, bare)}."
    return f"{bare}."

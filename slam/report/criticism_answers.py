"""Answers to the questions that a pilot asks of a criticism, from the lines of its verdict."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from backend.wording import either
from slam.core.names import enumerated
from slam.report.page import Item
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism

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
_UNEXPLAINED, _NEXT = "Unexplained: ", "What to do next: "
_SAME, _NOISE, _UNSHOWN = "Effects that the flights cannot distinguish", "Noise ", "These flights could not"
_INSTRUMENTS = {"imu": "gyro or accelerometer", "sonar": "the height sensor", "camera": "the camera"}
"""Family of an effect -> the instrument whose error it is; other families are no instrument's."""
_IN_WORDS: tuple[tuple[str, str], ...] = (
    (r"^(.*) out of range$", r"\1: the best value lies outside of what healthy vehicles have"),
    (r"^(.*) ~ (.*) \(z = ([-\d.]+)\)$", r"the error of \1 changes with \2 (by \3 standard deviations)"),
    (r"^(.*) \(z = ([-\d.]+)\)$", r"\1 (by \2 standard deviations)"),
    (r"^(.*) (early|late) by ([-\d.]+) ms$", r"the readings of \1 come \3 ms too \2 by their stamps"),
    (r"^(.*) may be something else$", r"\1 may be an effect that the catalogue does not hold"),
    (r"^(.*) may be (.*)$", r"\1 may be \2 instead: both have similar effects in these flights"),
)
"""Pattern of what is left over in verdict.json -> in words."""


def criticism_answers(result: Criticism) -> tuple[Item, ...]:
    """Return questions and answers; only those that apply to a verdict."""
    groups = (_UNEXPLAINED, _NEXT, _SAME, _NOISE, _UNSHOWN)
    told = {begin: [line for line in result.details if line.startswith(begin)] for begin in groups}
    causes = [line for line in result.details if not line.startswith(groups)]
    unexplained = [unexplained_in_words(line.removeprefix(_UNEXPLAINED)) for line in told[_UNEXPLAINED]]
    sizes = ["Sizes and their 95 % intervals stand under “The extension”."] if result.causes else []
    rows = (
        _item(
            "Is the model right about these flights?",
            [f"{_RIGHT[result.verdict]}{_MORE * bool(unexplained and result.causes)}"],
        ),
        _item("What is wrong, and how sure is that?", [*causes, *sizes]),
        _item("What else could it be?", _else(result, told[_SAME])),
        _item("What is not explained?", unexplained),
        _item("Which sensor is doubted?", [_doubted(result), *told[_NOISE]]),
        _item("What was not judged, or could not be seen?", _unseen(result, told[_UNSHOWN])),
        _item("What do I do next?", [line.removeprefix(_NEXT) for line in told[_NEXT]]),
    )
    return tuple(row for row in rows if row is not None)


def _item(question: str, lines: Sequence[str]) -> Item | None:
    """Return the question with its lines, the first of which is the answer in short; None without lines."""
    # A name of an effect or of a reading keeps its letters.
    shown = [f"{x[0].upper()}{x[1:]}" if x.split()[0].rstrip(",").isalpha() else x for x in lines if x]
    return Item(question, shown[0], tuple(shown[1:])) if shown else None


def _else(result: Criticism, alike: Sequence[str]) -> list[str]:
    """Return the causes that these flights cannot tell from those that were found."""
    told = list(alike)
    for cause in result.causes:
        others = [name for name in cause.alternatives if name != cause.name]
        if others and not alike:
            rivals = enumerated([f"{name} ({result.probability_of(name):.2f})" for name in others])
            told.append(f"Instead of {cause.name} (probability {cause.probability:.2f}) perhaps {rivals}.")
    if result.causes and not told:
        told.append("Nothing else in the catalogue explains these flights as well.")
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
        f"{what} ({cause.name}, probability {cause.probability:.2f})" for what, cause in found.items() if what
    ]
    if result.verdict == "unusable":
        return ""
    if named:
        return f"{enumerated(named)}."
    check = " What is not explained may still be one." if result.unexplained else ""
    return f"None: no cause that was found is an error of a sensor.{check}"


def _unseen(result: Criticism, unshown: Sequence[str]) -> list[str]:
    """Return what was not judged, and which errors are too small for these flights."""
    # What limits the verdict is told with its reason among what was dropped, where it is there.
    begins = tuple(line.partition(":")[0] for line in result.dropped)
    limits = "" if result.limits.partition(":")[0].lower() in begins else result.limits
    told = [limits, *(f"{line}." for line in result.dropped), *unshown]
    if result.detectable:
        told.append(
            "An effect smaller than “What these flights could not have shown” lists would have been missed."
        )
    return told


def unexplained_in_words(part: str) -> str:
    """Return what is left over as `slam.criticism.verdict.decision` describes it, in plain words."""
    bare = part.removesuffix(".")
    for pattern, words in _IN_WORDS:
        if re.match(pattern, bare):
            return f"{re.sub(pattern, words, bare)}."
    return f"{bare}."

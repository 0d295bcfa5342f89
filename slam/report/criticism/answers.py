"""Answers to the questions that a pilot asks of a criticism, from its verdict."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from slam.core.names import enumerated
from slam.core.units import sized
from slam.criticism.cause import JUDGED_HORIZON_S
from slam.criticism.verdict.sentence import indistinguishable, smallest_sizes
from slam.report.criticism.cause_evidence import CauseEvidence, shown_in_short
from slam.report.criticism.certainty import (
    by_certainty,
    how_sure,
    likeness_of_rival,
    no_other,
    outside_of_catalogue,
    uncertain,
)
from slam.report.criticism.detectable import unseen
from slam.report.criticism.findings import findings_in_words
from slam.report.criticism.gains import what_changes, where_it_shows
from slam.report.criticism.headline import promises
from slam.report.criticism.instruments import instruments_doubted
from slam.report.criticism.judged_data import judged_data
from slam.report.criticism.next_flights import to_fly, to_use
from slam.report.criticism.plain_names import quantity, reading, with_titles
from slam.report.criticism.values import (
    NO_DIFFERENCE,
    before_and_after,
    change_of_size,
    changes_in_time,
    compared,
    one_unit,
    sized_interval,
    sized_one,
)
from slam.report.page import Item
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism
    from slam.criticism.cause import Cause

_RIGHT: Mapping[str, str] = {
    "nothing_wrong": "Yes, as far as these flights can show.",
    "named": "No, but what is wrong was found, and extended.toml has it.",
    "ambiguous": "No: two causes or more explain what is wrong equally well; extended.toml has one of them.",
    "named_with_remainder": "No: a part of what is wrong was found, and extended.toml has it.",
    "unknown": "No, and no effect of the catalogue explains what is wrong.",
    "unusable": "Not known: these data cannot be judged.",
}
"""Verdict -> whether the model is right about the flights."""
_RIGHT_IN_PART = "Its instruments are, as far as these flights can show. Its motion was not judged."
"""The same of flights on which nothing is wrong, but whose motion is not judged."""
_MORE = " More is wrong than that explains."
_USABLE: Mapping[str, str] = {
    "nothing_wrong": "Yes",
    "named": "Yes, the extended one",
    "ambiguous": "Yes, the extended one for flights like these",
    "named_with_remainder": "Yes, the extended one, for flights like these",
    "unknown": "Only apart from what is unexplained",
}
"""Verdict -> whether the model, or the extended one, can be used."""
_NO_MEANING = {"the", "a", "an", "is", "are", "in", "its", "reads", "there"}
"""Words that say nothing beyond a title."""
MOSTLY = 0.99
"""Share of the moments in which a cause moves a reading by less than the page tells."""


def criticism_answers(
    result: Criticism,
    drawn: Sequence[str] = (),
    flights: Sequence[Flight] = (),
    evidence: CauseEvidence | None = None,
) -> tuple[Item, ...]:
    """Return questions and answers; only those that apply to a verdict. ``drawn`` are sentences on the parts
    of flights that the page shows, and ``evidence`` is what it shows of each certain cause."""
    unexplained, is_usable = findings_in_words(result), result.verdict != "unusable"
    right, usable = _RIGHT[result.verdict], _USABLE.get(result.verdict, "")
    if result.limits and result.verdict == "nothing_wrong":
        right, usable = _RIGHT_IN_PART, "Its instruments only"
    rows = (
        _item(
            "Is the model right about these flights?",
            [f"{right}{_MORE * bool(unexplained and result.causes)}"],
        ),
        _item("What does this result promise, and what not?", promises(result)),
        _item("Which flights were judged, and what was left out?", _judged(result, flights)),
        _item("What is wrong, and how large is it?", _wrong(result) if is_usable else result.details),
        _item("How sure is that, and why?", how_sure(result, flights)),
        _item("What else could it be, and why not?", _else(result, indistinguishable(result))),
        _item(
            "In which flight does it show, and when?",
            where_it_shows(result, drawn, shown_in_short(evidence)),
        ),
        _item("What is not explained?", unexplained),
        _item("What changes in the prediction?", what_changes(result)),
        _item(
            "Is an instrument damaged, or is the model incomplete?",
            [*instruments_doubted(result, flights), *result.noise],
        ),
        _item(
            "Can I use the model now, and how?",
            to_use(result, usable) if is_usable else [],
        ),
        _item("What do I fly next?", to_fly(result, flights) if is_usable else []),
        _item(
            "What can these flights not show?",
            unseen(result, flights, [result.not_shown, *smallest_sizes(result)]),
        ),
    )
    return tuple(row for row in rows if row is not None)


def _judged(result: Criticism, flights: Sequence[Flight]) -> list[str]:
    """Return the flights and their streams, and what was left out."""
    lines = left_out_by_flight(result)
    known = {flight.name for flight in flights} | {*result.flights}
    if result.dropped and result.flights and not any(line.partition(": ")[0] in known for line in lines):
        lines = ["No flight was left out.", *lines]
    return [*judged_data(result, flights), *lines]


def _item(question: str, lines: Sequence[str]) -> Item | None:
    """Return the question with its lines, the first of which is the answer in short; None without lines."""
    # A name of a reading keeps its letters.
    named = with_titles([line for line in lines if line])
    shown = [f"{x[0].upper()}{x[1:]}" if x.split()[0].rstrip(",:").isalpha() else x for x in named]
    return Item(question, shown[0], tuple(shown[1:])) if shown else None


def _wrong(result: Criticism) -> list[str]:
    """Return what each cause does and its size, and what the leading one moves; what is less certain is told
    as such."""
    words = ("", ", if it is that", ", if it is there at all")
    doubts = {c.name: doubt for doubt, of in zip(words, by_certainty(result), strict=True) for c in of}
    lines = []
    for cause in result.causes:
        begin = f"{cause.name}{doubts[cause.name]}{_meaning(cause)}"
        lines.append(f"{begin}{': ' if cause.parameters else ''}{_size(cause, result)}.")
    if any(cause.parameters for cause in result.causes):
        lines.append("In brackets: the 95 % interval. “Values” lists each beside its usual range.")
    if result.covariate and (misses := result.covariate.against[0]).unit != "sigma":
        most = float(np.quantile(np.abs(misses.explained), MOSTLY))
        lines.append(
            f"{result.covariate.cause} moves {reading(misses.channel)} by less than "
            f"{sized(most, misses.unit)} within {JUDGED_HORIZON_S:g} s in {100 * MOSTLY:.0f} of 100 moments."
        )
    return lines


def _meaning(cause: Cause) -> str:
    """Return what a cause does, in brackets; empty where its title says the same."""
    term = CATALOGUE[cause.name]
    more = {*re.findall(r"\w+", term.meaning.lower())} - {*re.findall(r"\w+", term.title.lower())}
    return f" ({term.meaning})" if more - _NO_MEANING else ""


def _size(cause: Cause, result: Criticism) -> str:
    """Return the sizes of a cause in everyday units; of those along axes the ones that differ from none."""
    term, lines = CATALOGUE[cause.name], []
    same: list[str] = []
    about_none: list[str] = []
    for parameter, found in cause.parameters.items():
        words, change = quantity(cause.name, parameter), change_of_size(result, cause.name, parameter)
        if change is not None:
            mean = f"extended.toml has the mean, {sized_interval(found)}"
            lines.append(f"{words} {before_and_after(change)} ({mean})")
            continue
        varies = changes_in_time(cause.name, parameter, result)
        is_same = compared(term.parameter(parameter), found) == NO_DIFFERENCE
        if is_same and len(cause.parameters) > 1:
            (about_none if varies else same).append(words)
        else:
            mean, own = " (mean of a size that changes)" * varies, term.parameter(parameter)
            if own.neutral != 0.0 and not own.is_limit:
                mean = f" instead of {sized_one(own.neutral, *one_unit(found))}{mean}"
            lines.append(f"{words} {sized_interval(found)}{mean}{', which may be none' * is_same}")
    if about_none:
        lines.append(f"changing, with a mean that may be none: {enumerated(about_none)}")
    if same:
        lines.append(f"not different from none: {enumerated(same)}")
    return "; ".join(lines)


def _else(result: Criticism, ties: Sequence[str]) -> list[str]:
    """Return the causes that these flights cannot tell from those that were found, or why others are ruled
    out."""
    lines, ruled_out, none = list(ties), [], []
    for cause in result.causes:
        others = [name for name in cause.alternatives if name != cause.name]
        if others and not ties:
            rivals = enumerated([f"{name} ({result.probability_of(name):.2f})" for name in others])
            lines.append(f"Instead of {cause.name} (probability {cause.probability:.2f}) perhaps {rivals}.")
        elif not others and (likeness := likeness_of_rival(cause, result)):
            lines.append(
                f"{cause.name} may be {cause.fair_rival}, which has nearly the same course here (likeness "
                f"{likeness:.3f}); with it the flights fit worse by {cause.lead_nats:.0f} nats."
            )
        elif not others and cause.fair_rival:
            ruled_out.append(no_other(cause))
        elif not others:
            none.append(cause.name)
    alike = [f"{c.name}: {text}" for c in result.causes if (text := CATALOGUE[c.name].looks_alike)]
    if result.causes and not lines and not alike:
        lines = ["No other effect that these flights can show explains them as well."]
    lines += [*alike, *ruled_out]
    if none:
        lines.append(f"In place of {enumerated(none)} no other effect of the catalogue explains a fair part.")
    if rest := outside_of_catalogue(result):
        open_ = enumerated([cause.name for cause in uncertain(result)])
        lines.append(f"{open_}: {rest[0].lower()}{rest[1:]}")
    return lines


def left_out_by_flight(result: Criticism) -> list[str]:
    """Return what was not judged in a line for each flight, with all its reasons."""
    reasons: dict[str, list[str]] = {}
    for line in result.dropped:
        name, colon, reason = line.partition(": ")
        reasons.setdefault(name if colon else "", []).append(reason if colon else line)
    if not reasons:
        return ["No flight was left out."] if result.flights else []
    return [f"{name}{': ' if name else ''}{'; '.join(of)}." for name, of in reasons.items()]

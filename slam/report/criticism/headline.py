"""Headline of a criticism for a pilot, and what it promises."""

from __future__ import annotations

from typing import TYPE_CHECKING

from backend.wording import counted, either
from slam.core.names import enumerated
from slam.report.criticism.certainty import (
    by_certainty,
    changes,
    doubt_of_name,
)
from slam.report.criticism.findings import distinct_findings, findings_in_words
from slam.report.criticism.gains import change_of, together
from slam.report.criticism.plain_names import in_plain_names, title_of, with_titles
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism


def lead(result: Criticism) -> str:
    """Return the headline in plain words: what was found and how surely, the gain, and what is left over."""
    if not result.verdict.startswith("named"):
        return with_titles([in_plain_names(result.sentence)])[0]
    lines = [_found(result), _gain(result), _left(result), result.limits]
    return " ".join(part for part in lines if part)


def _found(result: Criticism) -> str:
    sure, others, none = by_certainty(result)
    lines = []
    if len(sure) == 1:
        lines.append(f"Certain: {CATALOGUE[sure[0].name].title} ({CATALOGUE[sure[0].name].meaning}).")
    elif sure:
        varying = " (whose size changes)"
        each = [f"{CATALOGUE[c.name].title}{varying * changes(c, result)}" for c in sure]
        lines.append(f"Certain: {enumerated(each)}.")
    if others:
        each = [
            f"{CATALOGUE[c.name].title} ({doubt_of_name(c, result) or f'probability {c.probability:.2f}'})"
            for c in others
        ]
        what = "Something else is there too" if sure else "Something is there"
        name = either(len(others), "a less certain name", "less certain names")
        lines.append(f"{what}, with {name}: {enumerated(each)}.")
    if none:
        each = [CATALOGUE[c.name].title for c in none]
        lines.append(f"Not established, because the size may be none: {enumerated(each)}.")
    return " ".join(lines)


def _gain(result: Criticism) -> str:
    gain = result.causes[0].gain if result.causes else None
    if gain is None or gain.by is None or gain.foremost is None:
        return ""
    with_all, fitted = together(result), "on data that was not used for the fit"
    return f"{with_all[0].upper()}{with_all[1:]}, {change_of(gain.foremost)} {fitted}."


def _left(result: Criticism) -> str:
    parts = distinct_findings(result)
    if not parts:
        return ""
    (first,) = with_titles(findings_in_words(result)[:1])
    text = f"{counted(len(parts), 'finding')} {either(len(parts), 'is', 'are')} not explained"
    return f"{text}{'; one of them' if len(parts) > 1 else ''}: {first}"


def _better(result: Criticism) -> str:
    """Return what the extended model makes better on data that the fit did not use, and than what."""
    parts = "stretches of these flights" if result.causes[0].gain.by == "segment" else "flights"
    unused = f"{parts} that the fit did not use"
    if result.limits:
        return f"in {unused} the instruments agree better once the extended model corrects them"
    return (
        f"the extended model predicts {unused} better than the model with this vehicle's constants but "
        "without the causes"
    )


def promises(result: Criticism) -> list[str]:
    """Return what the verdict promises, and what it does not."""
    if result.verdict == "unusable":
        return ["Nothing: these data show neither an error of the model nor that there is none."]
    beyond = "other speeds, heights, sticks or weather than these flights have"
    if result.verdict == "nothing_wrong":
        return [
            "It promises that an effect that these flights could show would have been found in nine of ten "
            "cases at the sizes that are listed.",
            f"It does not promise anything about the other effects, or about {beyond}.",
        ]
    if not result.causes:
        return [
            "It promises that something is wrong beyond chance. It does not promise what it is.",
        ]
    sure, open_, none = ([title_of(c.name) for c in kind] for kind in by_certainty(result))
    lines = []
    if sure:
        is_there = either(len(sure), "is", "are")
        lines.append(f"It promises that {enumerated(sure)} {is_there} in these flights.")
    if result.causes[0].gain.by:
        lines.append(f"It promises that {_better(result)}, by the changes under “Gain on held-out data”.")
    no = []
    if open_:
        no.append(f"that {enumerated(open_)} {either(len(open_), 'is', 'are')} named rightly")
    if none:
        no.append(f"that {enumerated(none)} {either(len(none), 'is', 'are')} there at all")
    if left := distinct_findings(result):
        no.append(f"that the model is complete ({counted(len(left), 'finding')} left over)")
    no.append(f"that the gain is the same for {beyond}")
    lines.append(f"It does not promise {enumerated(no)}.")
    if result.limits:
        lines.append("Nothing is promised of the vehicle's motion, which was not judged.")
    return lines

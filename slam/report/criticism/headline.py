"""Headline of a criticism for a pilot, and what it promises."""

from __future__ import annotations

from typing import TYPE_CHECKING

from backend.wording import counted, either
from slam.core.names import enumerated
from slam.report.criticism.certainty import (
    changes,
    differs,
    is_established,
    look_alike,
    outside_of_catalogue,
)
from slam.report.criticism.evidence import change_of
from slam.report.criticism.findings import distinct_findings, findings_in_words
from slam.report.criticism.plain_names import in_plain_names, title_of, with_titles
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.cause import Cause


def lead(result: Criticism) -> str:
    """Return the headline in plain words: what was found and how surely, the gain, and what is left over."""
    if not result.verdict.startswith("named"):
        return with_titles([in_plain_names(result.sentence)])[0]
    told = [_found(result), _gain(result), _left(result), result.limits]
    return " ".join(part for part in told if part)


def _found(result: Criticism) -> str:
    sure = [cause for cause in result.causes if is_established(cause, result)]
    others = [cause for cause in result.causes if cause not in sure]
    told = []
    if len(sure) == 1:
        told.append(f"Certain: {CATALOGUE[sure[0].name].title} ({CATALOGUE[sure[0].name].meaning}).")
    elif sure:
        each = [_titled(c, result) for c in sure]
        told.append(f"Certain: {enumerated(each)}.")
    if others:
        each = [f"{CATALOGUE[c.name].title} ({_doubt(c, result)})" for c in others]
        told.append(
            f"{'Also there' if sure else 'Found'}, but named with less certainty: {enumerated(each)}."
        )
    if rest := outside_of_catalogue(result):
        told.append(rest)
    return " ".join(told)


def _titled(cause: Cause, result: Criticism) -> str:
    """Return the name of a cause; an error that drifts is not called constant."""
    title = CATALOGUE[cause.name].title
    if not changes(cause, result):
        return title
    if "constant error" in title:
        return f"{title.replace('constant error', 'drifting error')} (bias)"
    return f"{title} (whose size changes)"


def _doubt(cause: Cause, result: Criticism) -> str:
    if not differs(cause):
        return "its size may be none"
    if alike := look_alike(cause, result):
        return f"or {' or '.join(title_of(name) for name in alike)}, which looks the same here"
    return f"probability {cause.probability:.2f}"


def together(result: Criticism) -> str:
    """Return the words for the causes that a gain includes."""
    count = len(result.causes)
    return f"with all {count} causes together" if count > 1 else "with this cause"


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
    told = f"{counted(len(parts), 'finding')} {either(len(parts), 'is', 'are')} not explained"
    return f"{told}{'; one of them' if len(parts) > 1 else ''}: {first}"


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
    sure = [title_of(c.name) for c in result.causes if is_established(c, result)]
    open_ = [title_of(c.name) for c in result.causes if not is_established(c, result)]
    told = []
    if sure:
        is_there = either(len(sure), "is", "are")
        told.append(f"It promises that {enumerated(sure)} {is_there} in these flights.")
        told.append(f"{_chance(result)}.")
    if result.causes[0].gain.by:
        told.append(
            "It promises that the extended model predicts such flights better than the original one, by the "
            "changes under “Gain on held-out data”."
        )
    no = []
    if open_:
        no.append(f"that {enumerated(open_)} {either(len(open_), 'is', 'are')} named rightly")
    if left := distinct_findings(result):
        no.append(f"that the model is complete ({counted(len(left), 'finding')} left over)")
    no.append(f"that the gain is the same for {beyond}")
    told.append(f"It does not promise {enumerated(no)}.")
    if result.limits:
        told.append("Nothing is promised of the vehicle's motion, which was not judged.")
    return told


def _chance(result: Criticism) -> str:
    more = "; what single readings show has no such measure" if _in_readings(result) else ""
    bar = f"a cause had to stand out by {result.threshold:.1f} standard deviations"
    return f"To be found, {bar}: {result.threshold_means}{more}"


def _in_readings(result: Criticism) -> bool:
    return any(cause.gain.by is None for cause in result.causes)

"""Next flights: the manoeuvre for each open question, and what it settles."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from backend.wording import counted, either
from slam.core.names import enumerated
from slam.report.criticism.advice import CHECK, STAYS, flight_after, what_to_do
from slam.report.criticism.certainty import by_certainty, differs, drifting, is_established, likeness_of_rival
from slam.report.criticism.detectable import hidden_without
from slam.report.criticism.findings import GAIN, concerned, distinct_findings, is_of_speed
from slam.report.criticism.instruments import BY_HAND, is_far, is_in_the_file, may_be_above
from slam.report.criticism.judged_data import as_seen, judged_of, missing_streams
from slam.report.criticism.plain_names import constant, title_of
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism


_SHARE = re.compile(r"0\.\d+\b(?! s\b)")
"""A share of a stick: no seconds."""
_RIGHT_NAME = "the right name"


def to_use(result: Criticism, usable: str) -> list[str]:
    """Return whether the model is ``usable``, and the verdict's advice with the instruments by their names;
    in numbered steps where a part of extended.toml is not established."""
    sensors = concerned(result)
    check = f"check {enumerated(sensors)} first ({BY_HAND}): {STAYS}" if sensors else CHECK
    far = [CATALOGUE[c.name].instrument for c in result.causes if is_established(c, result) and is_far(c)]
    faulty = enumerated([f"the {name}" for name in dict.fromkeys(far) if name])
    repair = f"Calibrate, or repair, {faulty}, and fly again to see the error gone." if faulty else ""
    advice = what_to_do(result, check if result.verdict == "unknown" else _what_stays(result), repair)
    none = [cause.name for cause in result.causes if not differs(cause)]
    if not none:
        return [f"{usable}: {advice}"]
    parts = enumerated([f"[{kind}.{name}]" for name in none for kind in ("terms", "std")])
    return [
        f"{usable}, after one change.",
        f"1. Delete the parts {parts} of extended.toml: the size of {enumerated(none)} may be none.",
        f"2. {advice[0].upper()}{advice[1:]}",
    ]


def _what_stays(result: Criticism) -> str:
    """Return what stays wrong with the extended model, apart from constants that it has as they were
    found."""
    if result.limits:
        return "what is not explained stays in the corrected readings"
    in_file = [f.channel for f in distinct_findings(result) if is_in_the_file(f.channel, result)]
    if not in_file:
        return STAYS
    has = f"it has {enumerated([constant(name) for name in in_file])} as found"
    count = len(distinct_findings(result)) - len(in_file)
    others = either(count, "finding that is", f"{count} findings that are")
    return f"{has}, but stays wrong by the other {others} not explained" if count else has


def to_fly(result: Criticism, flights: Sequence[Flight] = ()) -> list[str]:
    """Return the manoeuvres, each with the questions that it settles, or else the verdict's advice, and what
    to log."""
    judged = judged_of(result, flights)
    asked = _manoeuvres(result)
    lines = (
        [] if asked and not result.next_flight and len(result.equivalence_set) < 2 else [flight_after(result)]
    )
    lines += [line for manoeuvre, line in asked.items() if manoeuvre not in " ".join(lines)]
    if any(_RIGHT_NAME in line for line in lines):
        lines.append(
            "A new size in the old interval supports a name; outside of it, the cause is probably another."
        )
    lines += _to_separate(result, " ".join(lines))
    if is_of_speed(result):
        lines.append(
            "To see whether the unexplained error of the speed is the sensor's, or a motion that is not "
            f"modelled: {CATALOGUE['flow_scale'].excitation}."
        )
    if "camera" in " ".join(lines) and judged and "frames" in missing_streams(judged):
        lines.append("For the camera, record pictures as well.")
    lines = [as_seen(line, judged) for line in (*lines, *_to_log(result, judged))]
    return [*lines, _how(result, " ".join(lines))]


def _manoeuvres(result: Criticism) -> dict[str, str]:
    """Return manoeuvre -> the sentence on it, with all questions about causes that it settles."""
    _, open_, none = by_certainty(result)
    questions = (
        (open_, "whether", f"is {_RIGHT_NAME}", f"are {_RIGHT_NAME}s"),
        (none, "whether", "is there at all", "are there at all"),
        (drifting(result), "how", "changes", "change"),
        (
            [c for c in result.causes if may_be_above(c)],
            "whether",
            "is more than usual",
            "are more than usual",
        ),
    )
    settled: dict[str, list[str]] = {}
    for causes, begin, one, more in questions:
        for manoeuvre in dict.fromkeys(CATALOGUE[c.name].manoeuvre for c in causes):
            names = [c.name for c in causes if CATALOGUE[c.name].manoeuvre == manoeuvre]
            words = f"{begin} {enumerated(names)} {either(len(names), one, more)}"
            settled.setdefault(manoeuvre, []).append(words)
    return {manoeuvre: f"To see {enumerated(of)}: {manoeuvre}." for manoeuvre, of in settled.items()}


def _to_separate(result: Criticism, text: str) -> list[str]:
    """Return the manoeuvre that shows the effect which looks like a cause, unless it is told already."""
    lines = []
    for cause in (c for c in result.causes if likeness_of_rival(c, result)):
        other, manoeuvre = cause.fair_rival, CATALOGUE[cause.fair_rival].manoeuvre
        if manoeuvre not in text:
            lines.append(f"To tell {cause.name} from {other}: {manoeuvre}.")
    return lines


def _to_log(result: Criticism, judged: Sequence[Flight]) -> list[str]:
    """Return what to log as well: the sticks, or the attitude where the open questions are about tilt."""
    missing = missing_streams(judged) if judged else []
    if result.limits and "command" in missing and (hidden := hidden_without("command", result, missing)):
        return [
            "Log the sticks as well, which these flights have not: then the vehicle's motion is judged too, "
            f"with {counted(len(hidden), 'effect')}, such as {hidden[0]}, that do not show without them."
        ]
    if result.limits or not {"attitude", "imu"} <= {*missing}:
        return []
    open_ = [constant(GAIN)] if any(finding.channel == GAIN for finding in result.findings) else []
    of_tilt = [c for c in result.causes if CATALOGUE[c.name].acts_on == "command"]
    open_ += [title_of(c.name) for c in of_tilt if not is_established(c, result)]
    if not open_:
        return []
    shows = either(len(open_), "shows", "show")
    return [
        f"Log the attitude as well: without it {enumerated(open_)} {shows} only by the speed, which drag and "
        "braking change too."
    ]


def _how(result: Criticism, text: str) -> str:
    """Return how manoeuvres are told, and how often to fly them."""
    from slam.criticism.verdict.held_out import FEWEST_FLIGHTS

    sticks = (
        "" if result.limits or not _SHARE.search(text) else "Sticks are told as shares of full deflection. "
    )
    many = len(result.flights) >= FEWEST_FLIGHTS
    more = "" if many else ": from then on whole flights are held out"
    again = f"Repeat each manoeuvre in {FEWEST_FLIGHTS} recordings or more and judge them together with these"
    return f"{sticks}{again}{more}."

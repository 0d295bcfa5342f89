"""Next flights: the manoeuvre for each open question, and what it settles."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from backend.wording import counted, either
from slam.core.names import enumerated, listed
from slam.criticism.finding import Onset
from slam.report.criticism.certainty import by_certainty, differs, drifting, is_established, likeness_of_rival
from slam.report.criticism.detectable import hidden_without
from slam.report.criticism.findings import GAIN, concerned, is_of_speed
from slam.report.criticism.instruments import is_far, may_be_above
from slam.report.criticism.judged_data import missing_streams
from slam.report.criticism.plain_names import constant, title_of
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism


_BY_HAND = "mounting, wiring, settings and time stamps"
_SHARE = re.compile(r"0\.\d+\b(?! s\b)")
"""A share of a stick: no seconds."""
_NAMED = 4
"""Number of effects that are named of those that the sticks would show."""


def to_use(result: Criticism, usable: str) -> list[str]:
    """Return whether the model is ``usable``, and the verdict's advice with the instruments by their names;
    in numbered steps where a part of extended.toml is not established."""
    from slam.criticism.verdict.sentence import CHECK, what_to_do

    sensors = concerned(result)
    check = f"check {enumerated(sensors)} first ({_BY_HAND})" if sensors else CHECK
    far = [CATALOGUE[c.name].instrument for c in result.causes if is_established(c, result) and is_far(c)]
    faulty = enumerated([f"the {name}" for name in dict.fromkeys(far) if name])
    repair = f"Calibrate, or repair, {faulty}, and fly again to see the error gone." if faulty else ""
    advice = what_to_do(result, check, repair)
    none = [cause.name for cause in result.causes if not differs(cause)]
    if not none:
        return [f"{usable}: {advice}"]
    parts = enumerated([f"[{kind}.{name}]" for name in none for kind in ("terms", "std")])
    return [
        f"{usable}, after one change.",
        f"1. Delete the parts {parts} of extended.toml: the size of {enumerated(none)} may be none.",
        f"2. {advice[0].upper()}{advice[1:]}",
    ]


def to_fly(result: Criticism, flights: Sequence[Flight] = ()) -> list[str]:
    """Return the verdict's advice, and for each cause that is not certain the manoeuvre that settles it."""
    from slam.criticism.verdict.sentence import flight_after

    _, open_, none = ([c.name for c in kind] for kind in by_certainty(result))
    told = [flight_after(result)]
    more = [name for name in (*open_, *none) if CATALOGUE[name].manoeuvre not in told[0]]
    told += [f"For {name}: {CATALOGUE[name].manoeuvre}." for name in more]
    told += _to_separate(result, " ".join(told))
    told += [
        f"To see whether {c.name} is more than usual: {CATALOGUE[c.name].manoeuvre}."
        for c in result.causes
        if may_be_above(c) and CATALOGUE[c.name].manoeuvre not in " ".join(told)
    ]
    settled = [
        f"whether {enumerated(names)} {either(len(names), 'is', 'are')} {what}"
        for names, what in ((open_, "named rightly"), (none, "there at all"))
        if names
    ]
    if settled:
        told.append(f"What it settles: {enumerated(settled)}. The right cause comes back with the same size.")
    if is_of_speed(result):
        told.append(f"For the error of the speed: {CATALOGUE['flow_scale'].excitation}.")
    known = {finding.effect for finding in result.findings if isinstance(finding, Onset)}
    varying = [c.name for c in drifting(result) if c.name not in known]
    if varying:
        told.append(
            f"The same at the start and at the end of a flight shows how {enumerated(varying)} "
            f"{either(len(varying), 'changes', 'change')}."
        )
    told += _to_log(result, flights)
    judged = [flight for flight in flights if flight.name in result.flights]
    if "camera" in " ".join(told) and judged and "frames" in missing_streams(judged):
        told.append(
            "Record pictures as well, which these flights have not: a manoeuvre above asks for the camera."
        )
    told.append(_how(result, " ".join(told)))
    return told


def _to_separate(result: Criticism, told: str) -> list[str]:
    """Return the manoeuvre that shows the effect which looks like a cause, unless it is told already."""
    lines = []
    for cause in (c for c in result.causes if likeness_of_rival(c, result)):
        other, manoeuvre = cause.fair_rival, CATALOGUE[cause.fair_rival].manoeuvre
        if manoeuvre not in told:
            lines.append(f"To tell {cause.name} from {other}: {manoeuvre}, which shows {other}.")
    return lines


def _to_log(result: Criticism, flights: Sequence[Flight]) -> list[str]:
    """Return what to log as well: the sticks, or the attitude where the open questions are about tilt."""
    judged = [flight for flight in flights if flight.name in result.flights]
    missing = missing_streams(judged) if judged else []
    if result.limits and "command" in missing and (hidden := hidden_without("command", result, missing)):
        return [
            "Log the sticks as well, which these flights have not: then the vehicle's motion is judged too. "
            f"That settles {counted(len(hidden), 'effect')} that the last question below lists as not shown "
            f"without a log of the sticks, such as {listed(hidden, _NAMED)}."
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


def _how(result: Criticism, told: str) -> str:
    """Return how manoeuvres are told, and how often to fly them."""
    from slam.criticism.verdict.held_out import FEWEST_FLIGHTS

    sticks = (
        "" if result.limits or not _SHARE.search(told) else "Sticks are told as shares of full deflection. "
    )
    many = len(result.flights) >= FEWEST_FLIGHTS
    more = "" if many else ": from then on whole flights are held out"
    again = f"Repeat each manoeuvre in {FEWEST_FLIGHTS} recordings or more and judge them together with these"
    return f"{sticks}{again}{more}."

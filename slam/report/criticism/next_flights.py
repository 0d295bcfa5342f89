"""Next flights: the manoeuvre for each open question, and what it settles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from backend.wording import either
from slam.core.names import enumerated
from slam.report.criticism.certainty import changes, is_established
from slam.report.criticism.judged_data import missing_streams
from slam.report.criticism.plain_names import constant, title_of
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism

_OF_TILT = ("attitude_lag", "control_latency", "tilt_limit", "command_nonlinearity", "trim_offset")
"""Effects that act on the commanded tilt."""


def to_fly(result: Criticism, advice: Sequence[str], flights: Sequence[Flight] = ()) -> list[str]:
    """Return the verdict's advice, and for each cause that is not certain the manoeuvre that settles it."""
    if not advice:
        return []
    open_ = [c.name for c in result.causes if not is_established(c, result)]
    told = list(advice)
    more = [name for name in open_ if CATALOGUE[name].manoeuvre not in " ".join(advice)]
    told += [f"For {name}: {CATALOGUE[name].manoeuvre}." for name in more]
    if open_:
        told.append(
            f"What it settles: whether {enumerated(open_)} {either(len(open_), 'is', 'are')} named rightly."
        )
    varying = [c.name for c in result.causes if changes(c, result)]
    if varying:
        told.append(
            f"The same at the start and at the end of a flight shows how {enumerated(varying)} changes."
        )
    told += _to_log(result, flights)
    told.append(_how(result))
    return told


def _to_log(result: Criticism, flights: Sequence[Flight]) -> list[str]:
    """Return what to log as well where the open questions are about tilt, and no attitude is known."""
    judged = [flight for flight in flights if flight.name in result.flights]
    missing = missing_streams(judged) if judged else []
    if result.limits or not {"attitude", "imu"} <= {*missing}:
        return []
    open_ = [constant(name) for name in ("vehicle.gain",) if _is_open(name, result)]
    open_ += [title_of(c.name) for c in result.causes if c.name in _OF_TILT and not is_established(c, result)]
    if not open_:
        return []
    shows = either(len(open_), "shows", "show")
    return [
        f"Log the attitude as well: without it {enumerated(open_)} {shows} only by the speed, which drag and "
        "braking change too."
    ]


def _is_open(name: str, result: Criticism) -> bool:
    return any(name in part for part in result.unexplained)


def _how(result: Criticism) -> str:
    from slam.criticism.verdict.held_out import FEWEST_FLIGHTS

    sticks = "" if result.limits else "Sticks are told as shares of full deflection. "
    again = (
        f"Repeat each manoeuvre in {FEWEST_FLIGHTS} recordings or more and judge them together with these: "
        "from then on whole flights are held out."
    )
    return f"{sticks}{again}"

"""Next flights: the manoeuvre for each open question, and what it settles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from slam.core.names import enumerated
from slam.report.criticism.certainty import is_established
from slam.report.criticism.plain_names import title_of
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism


def to_fly(result: Criticism, advice: Sequence[str]) -> list[str]:
    """Return the verdict's advice, and for each cause that is not certain the manoeuvre that settles it."""
    if not advice:
        return []
    open_ = [c.name for c in result.causes if not is_established(c, result)]
    told = list(advice)
    more = [name for name in open_ if CATALOGUE[name].manoeuvre not in " ".join(advice)]
    told += [f"For {name}: {CATALOGUE[name].manoeuvre}." for name in more]
    if open_:
        names = enumerated([title_of(name) for name in open_])
        told.append(f"That settles whether {names} {'is' if len(open_) == 1 else 'are'} the right name.")
    told.append(_how(result))
    return told


def _how(result: Criticism) -> str:
    from slam.criticism.verdict.held_out import FEWEST_FLIGHTS

    sticks = "" if result.limits else "Sticks are told as shares of full deflection. "
    again = (
        f"Repeat each manoeuvre in {FEWEST_FLIGHTS} recordings or more and judge them together with these: "
        "from then on whole flights are held out."
    )
    return f"{sticks}{again}"

"""Advice after a verdict: what to do, and what to fly next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from slam.criticism.cause import SURE
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.verdict.criticism import Verdict

MOST_ADVISED = 3
"""Greatest number of effects for which a flight is advised."""
_CORRECT = "give extended.toml by --model to slam optimize, which corrects the instruments."
_REPAIR = "Calibrate, or repair, the instrument that has the error, and fly again to see it gone."
STAYS = "the model's predictions stay wrong by what is not explained"
CHECK = f"check the sensor, mounting and clock that the unexplained error concerns first: {STAYS}"
_AGAIN = (
    "fly the same once more. An error that comes back with the same sticks is the vehicle's, one at the same "
    "place is the floor's, and one that stays away is the weather's or an instrument's."
)
_ADVICE: Mapping[Verdict, tuple[str, str]] = {
    "nothing_wrong": ("{sound}", "none is needed."),
    "ambiguous": (
        "{use}{perhaps}",
        "fly the manoeuvres that docs/recipes.md lists for these effects, and judge them together.",
    ),
    "named": (
        "{use}",
        "one of these once more, with the same sticks: by extended.toml nothing should be wrong.",
    ),
    "named_with_remainder": ("{use} For the rest, {rest}.", _AGAIN),
    "unknown": ("{rest}.", _AGAIN),
}
"""Verdict on flights that can be judged -> what to do, and what to fly where no better flight is known."""


def advice_after(found: Criticism) -> tuple[str, ...]:
    """Return what to do and what to fly, a sentence each; none where the flights cannot be judged."""
    if found.verdict == "unusable":
        return ()
    faulty = any(CATALOGUE[cause.name].is_of_instrument for cause in found.causes)
    what = what_to_do(found, CHECK, _REPAIR * faulty)
    return f"What to do next: {what}", f"Next flight: {flight_after(found)}"


def what_to_do(found: Criticism, rest: str, repair: str) -> str:
    """Return what to do after judged flights; ``rest``: about the unexplained, ``repair``: on instruments."""
    corrects = any(CATALOGUE[cause.name].undo is not None for cause in found.causes)
    commands = "slam simulate, slam replay and slam optimize" if corrects else "slam simulate and slam replay"
    correct = _CORRECT if corrects else "these recordings cannot be corrected afterwards."
    use = correct if found.limits else f"give extended.toml to {commands} by --model."
    perhaps = "" if found.limits else " It predicts flights like these, but perhaps no others."
    sound = "no instrument needs a correction." if found.limits else "simulate with the model as it is."
    told = _ADVICE[found.verdict][0].format(use=use, perhaps=perhaps, rest=rest, sound=sound)
    return f"{told} {repair}".rstrip()


def flight_after(found: Criticism) -> str:
    """Return what to fly next: what separates causes, or shows effects that were missed."""
    advised = found.next_flight or _flight_for(found)
    if advised and found.verdict == "ambiguous":
        advised += " Then criticise the flights together."
    return advised.strip() or _ADVICE[found.verdict][1]


def _flight_for(found: Criticism) -> str:
    """Return the manoeuvres that show effects alike, or, of a sound vehicle, effects that were missed."""
    sound, reached = found.verdict == "nothing_wrong", found.within_reach
    open_ = [c.name for c in found.causes if c.probability < SURE]
    open_ = open_ if len(found.equivalence_set) < 2 else [*found.equivalence_set]
    unsure = [n for n in found.detectable if n not in reached] if sound else open_
    each = "; ".join(f"for {name}: {CATALOGUE[name].manoeuvre}" for name in unsure[:MOST_ADVISED])
    return each and f"{'none is needed. To see more, fly' if sound else 'fly'} {each}."

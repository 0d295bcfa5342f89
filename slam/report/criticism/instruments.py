"""Whether an instrument is damaged or the model incomplete: each cause beside what is usual."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import either
from slam.core.names import enumerated
from slam.core.units import everyday, spaced, to_error
from slam.report.criticism.certainty import changes, differs, drifting, is_established
from slam.report.criticism.findings import GAIN, concerned, distinct_findings
from slam.report.criticism.judged_data import judged_of, missing_streams
from slam.report.criticism.plain_names import constant, figure, title_of
from slam.report.criticism.values import (
    ABOUT,
    MORE,
    NO_DIFFERENCE,
    ONLY_THE_MEAN,
    before_and_after,
    change_of_size,
    compared,
    one_unit,
    own_value,
    usual,
)
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism
    from slam.criticism.cause import Cause, Interval

_CALIBRATE = "nothing needs a repair, and slam optimize --model extended.toml corrects it"
_CALIBRATE_MEAN = f"nothing needs a repair now, and slam optimize --model {ONLY_THE_MEAN}"
_KEEP = "nothing needs a repair, and nothing can be corrected afterwards"
_CHECK = "look at its mounting and wiring, and replace it if the same comes back after a calibration"
BY_HAND = "mounting, wiring, settings and time stamps"
_STAMPS = "look at how the log gets its stamps: a calibration does not remove it"


def instruments_doubted(result: Criticism, flights: Sequence[Flight] = ()) -> list[str]:
    """Return whether instruments or the model are at fault, with each size beside the usual one."""
    if result.verdict == "unusable":
        return []
    if not result.causes:
        if result.verdict == "nothing_wrong":
            model = "whether the model of motion holds was not judged" if result.limits else "the model holds"
            return [f"{'No' if result.limits else 'Neither: no'} instrument shows an error, and {model}."]
        return ["Not known: what is wrong has no name, and may be an instrument's or the model's."]
    of_instruments = [c for c in result.causes if CATALOGUE[c.name].instrument]
    of_vehicle = [c for c in result.causes if c not in of_instruments]
    lines = [_in_short(of_instruments, of_vehicle, result)]
    by_advice: dict[str, list[str]] = {}
    for cause in of_instruments:
        by_advice.setdefault(_advice(cause, result), []).append(_beside_usual(cause, result))
    lines += [f"{advice[0].upper()}{advice[1:]}: {'; '.join(of)}." for advice, of in by_advice.items()]
    if of_vehicle:
        names = enumerated([f"{title_of(cause.name)}{_above(cause)}" for cause in of_vehicle])
        lines.append(f"Of the vehicle or the place, not of an instrument: {names}.")
    return [*lines, *whose_is_it(result, flights)]


def _in_short(instruments: list[Cause], vehicle: list[Cause], result: Criticism) -> str:
    far = [c for c in instruments if is_far(c)]
    if far:
        names = enumerated([f"the {CATALOGUE[c.name].instrument} ({title_of(c.name)})" for c in far])
        incomplete = "The model is incomplete. " if vehicle else ""
        sure = any(is_established(c, result) for c in far)
        begin = "More" if sure else "Nothing certain needs a repair; perhaps more"
        return f"{incomplete}{begin} than usual is wrong with {names}."
    if not instruments:
        return "The model is incomplete: no cause that was found is an error of an instrument."
    above = [title_of(c.name) for c in instruments if may_be_above(c)]
    size = f"usual size, or a little more ({enumerated(above)})" if above else "usual size"
    unsteady = [title_of(c.name) for c in drifting(result) if c in instruments]
    watch = f", but watch {enumerated(unsteady)}, which {either(len(unsteady), 'is', 'are')} not steady"
    sound = f"none looks damaged{watch if unsteady else ''}"
    if vehicle:
        return f"The model is incomplete, and instruments have errors of {size}: {sound}."
    return f"Instruments have errors of {size}: {sound}."


def _above(cause: Cause) -> str:
    """Return in brackets that a size is more than usual, or may be; empty for a usual one."""
    about = " (perhaps more than usual)" if may_be_above(cause) else ""
    return " (more than usual)" if is_far(cause) else about


def may_be_above(cause: Cause) -> bool:
    """Return whether a size of a cause is more than usual, with an interval that reaches into the range."""
    return ABOUT in _verdicts(cause)


def is_far(cause: Cause) -> bool:
    """Return whether a size of a cause is beyond the usual range by its whole interval."""
    return MORE in _verdicts(cause)


def _verdicts(cause: Cause) -> set[str]:
    """Return how the sizes of a cause compare with the usual ones."""
    parameters = CATALOGUE[cause.name].parameter
    return {compared(parameters(name), found) for name, found in cause.parameters.items()}


def _beside_usual(cause: Cause, result: Criticism) -> str:
    """Return an instrument's error beside the usual size."""
    known = [p for p in CATALOGUE[cause.name].parameters if p.name in cause.parameters]
    is_open = differs(cause) and not is_established(cause, result)
    title = f"{title_of(cause.name)}{', if it is that,' * is_open}"
    if not known:
        return title.removesuffix(",")
    each = [cause.parameters[p.name] for p in known]
    apart = [p.name for p, x in zip(known, each, strict=True) if compared(p, x) != NO_DIFFERENCE]
    little = "a little more than usual, " if may_be_above(cause) else "usual: "
    usual_range = f"({little}{usual(known[0], *one_unit(each[0]))})"
    change = change_of_size(result, cause.name, apart[0]) if len(apart) == 1 else None
    if change is not None:
        return f"{title} {before_and_after(change)} {usual_range}"
    sizes = [cause.parameters[name].value for name in apart] or [each[0].value]
    size = sizes[0] if len(sizes) == 1 else float(np.hypot.reduce(sizes))
    return f"{title} {_rounded(size, each)} {usual_range}"


def _rounded(size: float, each: Sequence[Interval]) -> str:
    """Return a size to the digits that the narrowest of its intervals leaves."""
    factor, unit = everyday(size, each[0].unit)
    half = min(0.5 * factor * (found.high - found.low) for found in each)
    return f"{to_error(factor * size, half)}{spaced(unit)}"


def _advice(cause: Cause, result: Criticism) -> str:
    """Return how an instrument's error compares with the usual one, and what to do about it."""
    term = CATALOGUE[cause.name]
    if not differs(cause):
        return "not established, so not to be repaired or corrected (“Can I use the model now” says how)"
    if is_far(cause):
        return f"more than usual; {_STAMPS if term.acts_on == 'clock' else _CHECK}"
    correct = _CALIBRATE_MEAN if changes(cause, result) else _CALIBRATE
    return _KEEP if term.undo is None else correct


def whose_is_it(result: Criticism, flights: Sequence[Flight]) -> list[str]:
    """Return whether what is left over is an instrument's or the vehicle's, or which log decides."""
    found = distinct_findings(result)
    lines = []
    if any(finding.channel == GAIN and not finding.effect for finding in found) and (
        size := result.nuisances.get(GAIN)
    ):
        begin = f"{constant(GAIN)} is {figure(size.value)}{_in_the_file(GAIN, result)}"
        judged = judged_of(result, flights)
        if {"attitude", "imu"} <= {*missing_streams(judged)}:
            lines.append(
                f"{begin}: the vehicle tilts otherwise than the model, or the speed sensor reads "
                f"{figure(size.value)} times the speed; these flights cannot tell the two apart. A log of "
                "the attitude, which they have not, can: then scale the sticks otherwise, or calibrate the "
                "sensor."
            )
        else:
            lines.append(f"{begin}: of the vehicle, whose sticks are scaled otherwise than the model's.")
    if sensors := concerned(result):
        whose = "" if result.limits else " It may be a motion of the vehicle that is not modelled, too."
        it = either(len(sensors), "it", "them")
        first = f"look at {it} before the next flight ({BY_HAND}), and if all is in order, fly"
        lines.append(f"What is not explained concerns {enumerated(sensors)}: {first}.{whose}")
    elif found:
        lines.append("What is not explained may still be an instrument's.")
    return lines


def _in_the_file(name: str, result: Criticism) -> str:
    """Return in brackets whether extended.toml has the value that was found for a constant."""
    if result.extended is None or (value := own_value(name, result, result.extended)) is None:
        return ""
    if is_in_the_file(name, result):
        return " (extended.toml has that value; its cause is not known)"
    return f" (extended.toml keeps {figure(value)})"


def is_in_the_file(name: str, result: Criticism) -> bool:
    """Return whether extended.toml has a constant as it was found, within its interval."""
    size = result.nuisances.get(name)
    if result.extended is None or size is None:
        return False
    value = own_value(name, result, result.extended)
    return value is not None and size.low <= value <= size.high

"""Errors injected into measured flights without commands: which of them criticism names or tells.

Each kind is injected at three sizes, and the finding is compared with that of the untouched recording. An
error counts as named if its term is among the causes where it was not, or with another size. It counts as
told if a finding is new that names its instrument, and as listed if the page says that these flights cannot
show it.
Recordings that are only cut, thinned or reordered should change nothing.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.criticism import criticise
from slam.criticism.verdict.criticism import Criticism
from slam.data_quality.lag import LateReadings
from slam.io.flight_folder import read_flight
from tests.benchmarks.injected_errors import KINDS, STREAM, Kind
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_least, at_most, reported

Array = NDArray[np.float64]
SIZES = ("faint", "middle", "plain")
FLOOR, MOST_CHANGED = 0.9, 0.05
SHARE = 0.99
"""Share of the readings that a thinned recording keeps."""
SPANS = {
    "ardrone2-optitrack": ((0.0, 90.0),),
    "px4flow-quad": ((60.0, 180.0), (180.0, 300.0), (300.0, 420.0), (540.0, 660.0)),
}
"""Recording -> parts, in seconds: five parts of flights of two vehicles."""
VEHICLE = ("imu", "attitude", "velocity", "sonar")


def _kept(flight: Flight, which: Callable[[Array], NDArray[np.bool_]], streams: tuple[str, ...]) -> Flight:
    """Return the flight with those readings of some streams whose stamps are kept."""
    out = flight
    for name in streams:
        if (series := getattr(flight, name)) is not None:
            kept = which(series.stamps_s)
            values = {k: v[kept] for k, v in vars(series).items() if np.shape(v)[:1] == kept.shape}
            out = replace(out, **{name: replace(series, **values)})
    return out


def _between(flight: Flight, begin_s: float, end_s: float) -> Flight:
    cut = _kept(flight, lambda t: (t >= begin_s) & (t < end_s), VEHICLE)
    return cut.restamped(VEHICLE, lambda t: t - begin_s)


def _thinned(flight: Flight) -> Flight:
    """Return the flight without one in a hundred of its velocities and ranges."""
    rng = np.random.default_rng(1)
    return _kept(flight, lambda t: rng.uniform(size=len(t)) < SHARE, ("velocity", "sonar"))


def _cut(flight: Flight) -> Flight:
    """Return the flight without its first three seconds."""
    return _between(flight, float(flight.imu.stamps_s[0]) + 3.0, np.inf)


def _later(flight: Flight) -> Flight:
    return flight.restamped(VEHICLE, lambda t: t + 7.0)


HARMLESS = {
    "thinned": _thinned,
    "cut": _cut,
    "stamped later": _later,
}


def recordings() -> dict[str, Flight]:
    """Return parts of measured recordings, without commands and pictures."""
    found = {}
    for name, spans in SPANS.items():
        whole = read_flight(folder("flights") / name)
        alone = replace(whole, command=None, frames=None, camera=None, truth=None)
        for begin_s, end_s in spans:
            found[f"{name} from {begin_s:.0f} s"] = _between(alone, begin_s, end_s)
    return found


def findings(found: Criticism) -> set[str]:
    """Return the sentences and causes of a verdict, without their numbers."""
    parts = [*map(str, found.findings), *found.details, *(cause.name for cause in found.causes)]
    return {_without_numbers(part) for part in parts if part}


def _without_numbers(part: str) -> str:
    return re.sub(r"[-+]?[0-9.]+(e-?[0-9]+)?", "#", part)


def answer(kind: Kind, size: float, before: Criticism, after: Criticism) -> str:
    """Return "named", "told", "listed" or "silent"."""
    old = {cause.name: cause.parameters for cause in before.causes}
    for cause in after.causes:
        earlier = old.get(cause.name, {})
        moved = [
            abs(p.value - earlier[n].value) if n in earlier else np.inf for n, p in cause.parameters.items()
        ]
        if cause.name == kind.term and max(moved) > abs(size) / 2.0:
            return "named"
    new = [part for part in findings(after) - findings(before) if any(word in part for word in kind.words)]
    later = abs(_delay_ms(kind, after) - _delay_ms(kind, before)) > 500.0 * abs(size)
    hidden = _without_numbers(after.not_shown)
    if any(part != hidden for part in new) or _noisier(kind, before, after) or later:
        return "told"
    words = (*kind.words, kind.term) if kind.term else kind.words
    return "listed" if any(word in after.not_shown for word in words) else "silent"


def _delay_ms(kind: Kind, found: Criticism) -> float:
    """Return the delay that is told of the instrument, in ms; 0 without one."""
    told = (finding for finding in found.findings if isinstance(finding, LateReadings))
    return next((1e3 * late.late_s for late in told if late.channel in kind.words), 0.0)


def _noisier(kind: Kind, before: Criticism, after: Criticism) -> bool:
    """Return whether the noise that is reported of the instrument has grown by half."""
    ratios = []
    for found in (before, after):
        text = " ".join(found.noise)
        ratios.append(
            [float(x) for word in kind.words for x in re.findall(rf"{word} ([0-9.e+]+) times", text)]
        )
    return any(now > 1.5 * max(ratios[0], default=1.0) for now in ratios[1])


def changed(before: Criticism, after: Criticism) -> bool:
    """Return whether verdict or leading cause differ."""
    lead = [found.causes[0].name if found.causes else "" for found in (before, after)]
    return before.verdict != after.verdict or lead[0] != lead[1]


def measure(sizes: tuple[str, ...] = SIZES, only: str = "") -> list[Metric]:
    """Return the shares of injected errors that are named, told or listed, by size."""
    answers: dict[str, list[str]] = {size: [] for size in sizes}
    silent: dict[str, list[str]] = {size: [] for size in sizes}
    false = []
    for name, flight in recordings().items():
        if only not in name:
            continue
        before = criticise([flight])
        for harmless, change in HARMLESS.items():
            false.append(changed(before, criticise([change(flight)])))
            print(f"{name}: {harmless}: {'changed' if false[-1] else 'the same'}", flush=True)
        for label, kind in KINDS.items():
            for size in sizes:
                value = kind.sizes[SIZES.index(size)]
                if getattr(flight, STREAM[label.split()[0]]) is None:
                    continue
                after = criticise([kind.inject(flight, value)])
                answers[size].append(answer(kind, value, before, after))
                print(
                    f"{name}: {label} {value:g} ({size}): {answers[size][-1]}: {after.sentence}", flush=True
                )
                if answers[size][-1] == "silent":
                    silent[size].append(f"{label} ({name})")
    metrics = [
        (at_least if size == "plain" else reported)(
            f"errors injected at the size {size}: named or told",
            float(np.mean([a in ("named", "told") for a in answers[size]])),
            "",
            *((FLOOR,) if size == "plain" else ()),
            f"of {len(answers[size])}; {answers[size].count('named')} named, {answers[size].count('listed')} "
            f"listed as not shown; silent: {', '.join(silent[size]) or 'none'}",
        )
        for size in sizes
    ]
    spoilt = at_most("harmless changes that change the verdict", float(np.mean(false)), "", MOST_CHANGED)
    return [*metrics, spoilt]


if __name__ == "__main__":
    for metric in measure(tuple(sys.argv[2].split(",")) if len(sys.argv) > 2 else SIZES, *sys.argv[1:2]):
        print(metric)
